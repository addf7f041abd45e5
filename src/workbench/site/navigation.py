"""Navigation text: position and attitude of each photograph, as the 3K system delivers them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyproj import CRS, Proj, Transformer

from workbench.cameras import Pose
from workbench.site.control import _number, read_table

DEFAULT_COLUMNS = {
    "photo": "photo",
    "x": "x",
    "y": "y",
    "z": "z",
    "longitude": "longitude",
    "latitude": "latitude",
    "height": "height",
    "roll": "roll",
    "pitch": "pitch",
    "heading": "heading",
    "omega": "omega",
    "phi": "phi",
    "kappa": "kappa",
    "sd_x": "sd_x",
    "sd_y": "sd_y",
    "sd_z": "sd_z",
    "tilt_right": "tilt_right",
}
"""Our name of each column and the name it has in the file; give others where the file differs."""


@dataclass(frozen=True)
class NavigationRow:
    """What the navigation says of one photograph, in the site's CRS."""

    position: tuple[float, float, float]
    """x, y, z, metres."""
    position_sd: tuple[float, float, float] | None
    """Standard deviations, metres."""
    attitude: tuple[float, float, float] | None
    """Omega, phi, kappa, degrees."""


def read_navigation(
    path: Path | str, crs: CRS, columns: Mapping[str, str] | None = None
) -> dict[str, NavigationRow]:
    """Read a navigation file.

    Positions are ``x, y, z`` in the site's CRS, or ``longitude, latitude, height`` in WGS 84.
    Angles are ``omega, phi, kappa``, or ``roll, pitch, heading`` of the aircraft in degrees, heading
    from true north (turned to grid north here) and ``tilt_right`` of a side-looking camera.

    Returns
    -------
    dict
        By the name of the photograph, in the file's order.

    Raises
    ------
    SiteError
        If columns or numbers are missing.
    """
    path = Path(path)
    names = DEFAULT_COLUMNS | dict(columns or {})
    rows = read_table(path, [names["photo"].lower()])
    table = {}
    transform = Transformer.from_crs(CRS.from_epsg(4326), crs, always_xy=True)
    for line, raw in rows:
        row = {ours: raw.get(theirs.lower(), "") for ours, theirs in names.items()}
        if row["longitude"]:
            longitude, latitude = (_number(row, key, path, line) for key in ("longitude", "latitude"))
            x, y = transform.transform(longitude, latitude)
            z = _number(row, "height", path, line) if row["height"] else _number(row, "z", path, line)
        else:
            x, y, z = (_number(row, key, path, line) for key in ("x", "y", "z"))
        position = (x, y, z)
        deviations = None
        if row["sd_x"]:
            deviations = tuple(_number(row, key, path, line) for key in ("sd_x", "sd_y", "sd_z"))
        table[row["photo"]] = NavigationRow(
            position,
            deviations,  # type: ignore[arg-type]
            _attitude(row, position, crs, path, line),
        )
    return table


def grid_convergence(x: float, y: float, crs: CRS) -> float:
    """Angle from true north to grid north at a place of a projected CRS, degrees, clockwise positive."""
    longitude, latitude = Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True).transform(x, y)
    return float(Proj(crs).get_factors(longitude, latitude).meridian_convergence)


def _attitude(
    row: dict[str, str], position: tuple[float, float, float], crs: CRS, path: Path, line: int
) -> tuple[float, float, float] | None:
    if row["omega"]:
        omega, phi, kappa = (_number(row, key, path, line) for key in ("omega", "phi", "kappa"))
        return omega, phi, kappa
    if not row["heading"]:
        return None
    roll, pitch, heading = (_number(row, key, path, line) for key in ("roll", "pitch", "heading"))
    tilt = _number(row, "tilt_right", path, line, 0.0)
    heading -= grid_convergence(position[0], position[1], crs)
    pose = Pose.from_roll_pitch_heading(np.array(position), roll, pitch, heading, tilt_right=tilt)
    return pose.omega_phi_kappa
