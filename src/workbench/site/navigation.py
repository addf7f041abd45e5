"""Navigation text: position and attitude of each photograph, as the 3K system delivers them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Literal

import numpy as np
from pyproj import CRS, Proj, Transformer
from pyproj.exceptions import CRSError

from workbench.cameras import Pose
from workbench.errors import SiteError
from workbench.site.tables import number, read_table

COLUMNS = (
    *("photo", "x", "y", "z", "longitude", "latitude", "height", "roll", "pitch", "heading"),
    *("omega", "phi", "kappa", "sd_x", "sd_y", "sd_z", "sd_roll", "sd_pitch", "sd_heading"),
    *("sd_omega", "sd_phi", "sd_kappa", "tilt_right", "time"),
)
"""Names of the columns that are understood; a file may call them otherwise."""


@dataclass(frozen=True)
class NavigationFormat:
    """How a navigation file is written.

    Examples
    --------
    >>> NavigationFormat({"photo": "IMAGE", "x": "EAST", "y": "NORTH", "z": "HGT"}, crs="EPSG:31468")
    NavigationFormat(columns={'photo': 'IMAGE', 'x': 'EAST', 'y': 'NORTH', 'z': 'HGT'}, separator=None, \
header=True, crs='EPSG:31468', angles='degrees', heading_from='true north', tilts={})
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    """Our name of a column -> its name in the file, or its number from 1 if there is no header."""
    separator: str | None = None
    """Between columns; None finds semicolons, tabs, commas and spaces by itself."""
    header: bool = True
    """Whether the first line (a leading # is ignored) names the columns."""
    crs: str | None = None
    """CRS of x and y, the site's own if None. Longitude and latitude are WGS 84."""
    angles: Literal["degrees", "radians", "gon"] = "degrees"
    """Unit of all angles but longitude and latitude, which are degrees."""
    heading_from: Literal["true north", "grid north"] = "true north"
    """Where headings count from."""
    tilts: Mapping[str, float] = field(default_factory=dict)
    """Subfolder of photographs -> degrees by which its camera looks to the right of straight down."""

    def __post_init__(self) -> None:
        unknown = sorted(set(self.columns) - set(COLUMNS))
        if unknown:
            raise SiteError(f"Navigation columns {', '.join(unknown)} are unknown; use {', '.join(COLUMNS)}.")


@dataclass(frozen=True)
class NavigationRow:
    """What the navigation says of one photograph, in the site's CRS."""

    position: tuple[float, float, float]
    """x, y, z, metres."""
    position_sd: tuple[float, float, float] | None
    """Standard deviations, metres."""
    attitude: tuple[float, float, float] | None
    """Omega, phi, kappa, degrees."""
    attitude_sd: tuple[float, float, float] | None = None
    """Standard deviations of turns about x, y, z, degrees."""
    time: datetime | None = None
    """Exposure, where the file states it."""


def read_navigation(
    path: Path | str, crs: CRS, form: NavigationFormat | None = None
) -> dict[str, NavigationRow]:
    """Read a navigation file.

    Positions are ``x, y, z`` in a projected CRS, or ``longitude, latitude, height`` in WGS 84.
    Angles are ``omega, phi, kappa``, or ``roll, pitch, heading`` of the aircraft (right wing down,
    nose up, clockwise) with ``tilt_right`` of a side-looking camera. Angles are turned from the
    north that they count from to the grid north of the site.

    Parameters
    ----------
    path
        Text file, one row a photograph, with a header unless the format says otherwise.
    crs
        Projected CRS of the site.
    form
        Names of columns, separator, CRS and units; ours by default.

    Returns
    -------
    dict
        By the name of the photograph, in the file's order.

    Raises
    ------
    SiteError
        Naming file and line of missing columns, repeated photographs and what is not a number.
    """
    path, form = Path(path), form or NavigationFormat()
    names = {ours: form.columns.get(ours, ours).lower() for ours in COLUMNS}
    place = ("longitude", "latitude") if _has(path, form, names["longitude"]) else ("x", "y", "z")
    needed = [names[key] for key in ("photo", *place)]
    rows = read_table(path, needed, separator=form.separator, header=form.header, spaces=True)
    reader = _RowReader(path, crs, form)
    table: dict[str, NavigationRow] = {}
    for line, raw in rows:
        row = {ours: raw.get(theirs, "") for ours, theirs in names.items()}
        photo = row["photo"].replace("\\", "/")
        if photo in table:
            raise SiteError(f"{path}, line {line}: photograph '{photo}' occurs twice; delete one row.")
        table[photo] = reader.read(row, photo, line)
    return table


def grid_convergence(x: float, y: float, crs: CRS) -> float:
    """Angle from true north to grid north at a place of a projected CRS, degrees, clockwise positive."""
    longitude, latitude = Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True).transform(x, y)
    return float(Proj(crs).get_factors(longitude, latitude).meridian_convergence)


class _RowReader:
    """Turns rows of text into the site's CRS."""

    def __init__(self, path: Path, crs: CRS, form: NavigationFormat) -> None:
        self.path, self.crs, self.form = path, crs, form
        try:
            self.own_crs = CRS.from_user_input(form.crs) if form.crs else crs
        except CRSError as error:
            raise SiteError(f"{path}: CRS '{form.crs}' is unknown. Write it as EPSG:n.") from error
        self.from_degrees = Transformer.from_crs(CRS.from_epsg(4326), crs, always_xy=True)
        self.from_own = Transformer.from_crs(self.own_crs, crs, always_xy=True)
        self.to_degrees = {"degrees": 1.0, "radians": 180 / np.pi, "gon": 0.9}[form.angles]

    def read(self, row: dict[str, str], photo: str, line: int) -> NavigationRow:
        own_x, own_y, position = self._position(row, line)
        deviations = self._deviations(row, ("sd_x", "sd_y", "sd_z"), line)
        turn = self._turn(row, own_x, own_y, position)
        time = None
        if row["time"]:
            try:
                time = datetime.fromisoformat(row["time"])
            except ValueError as error:
                raise SiteError(
                    f"{self.path}, line {line}: time '{row['time']}'; write it as 2020-06-01T10:20:30+00:00."
                ) from error
        attitude = self._attitude(row, photo, turn, line)
        return NavigationRow(position, deviations, attitude, self._attitude_deviations(row, line), time)

    def _position(self, row: dict[str, str], line: int) -> tuple[float, float, tuple[float, float, float]]:
        if row["longitude"]:
            first, second = (number(row, key, self.path, line) for key in ("longitude", "latitude"))
            transform = self.from_degrees
        else:
            first, second = (number(row, key, self.path, line) for key in ("x", "y"))
            transform = self.from_own
        x, y = transform.transform(first, second)
        if not np.isfinite([x, y]).all():
            raise SiteError(
                f"{self.path}, line {line}: {first}, {second} has no place in {self.crs.name}. "
                "Are the two columns swapped, or is the CRS another one?"
            )
        height = "height" if row["height"] else "z"
        return first, second, (float(x), float(y), number(row, height, self.path, line))

    def _turn(
        self, row: dict[str, str], own_x: float, own_y: float, position: tuple[float, float, float]
    ) -> float:
        """Degrees, clockwise, from the north of the file's angles to the site's grid north."""
        to_site = grid_convergence(position[0], position[1], self.crs)
        if row["heading"] and self.form.heading_from == "true north":
            return to_site
        if row["longitude"] or self.own_crs == self.crs:
            return 0.0
        return to_site - grid_convergence(own_x, own_y, self.own_crs)

    def _attitude(
        self, row: dict[str, str], photo: str, turn: float, line: int
    ) -> tuple[float, float, float] | None:
        origin = np.zeros(3)
        if row["omega"]:
            omega, phi, kappa = self._three(row, ("omega", "phi", "kappa"), line, self.to_degrees)
            pose = Pose.from_omega_phi_kappa(origin, omega, phi, kappa)
            # Seen from a north that lies further clockwise, everything is turned the other way.
            c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
            world = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            return Pose(pose.rotation @ world.T, origin).omega_phi_kappa
        if not row["heading"]:
            return None
        roll, pitch, heading = self._three(row, ("roll", "pitch", "heading"), line, self.to_degrees)
        tilt = self.form.tilts.get(str(PurePosixPath(photo).parent), 0.0)
        if row["tilt_right"]:
            tilt = number(row, "tilt_right", self.path, line) * self.to_degrees
        pose = Pose.from_roll_pitch_heading(origin, roll, pitch, heading - turn, tilt_right=tilt)
        return pose.omega_phi_kappa

    def _attitude_deviations(self, row: dict[str, str], line: int) -> tuple[float, float, float] | None:
        """About x, y, z; roll and pitch, whose axes turn with the heading, count alike."""
        if row["omega"]:
            return self._deviations(row, ("sd_omega", "sd_phi", "sd_kappa"), line, self.to_degrees)
        stated = self._deviations(row, ("sd_roll", "sd_pitch", "sd_heading"), line, self.to_degrees)
        if stated is None:
            return None
        level = float(np.hypot(stated[0], stated[1]) / np.sqrt(2))
        return level, level, stated[2]

    def _deviations(
        self, row: dict[str, str], keys: tuple[str, str, str], line: int, factor: float = 1.0
    ) -> tuple[float, float, float] | None:
        if not row[keys[0]]:
            return None
        deviations = self._three(row, keys, line, factor)
        if min(deviations) <= 0:
            raise SiteError(f"{self.path}, line {line}: standard deviations must be positive.")
        return deviations

    def _three(
        self, row: dict[str, str], keys: tuple[str, str, str], line: int, factor: float = 1.0
    ) -> tuple[float, float, float]:
        a, b, c = (number(row, key, self.path, line) * factor for key in keys)
        return a, b, c


def _has(path: Path, form: NavigationFormat, column: str) -> bool:
    rows = read_table(path, [], separator=form.separator, header=form.header, spaces=True)
    return bool(rows) and column in rows[0][1]
