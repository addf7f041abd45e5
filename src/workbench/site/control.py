"""Control points and their observations: our CSV files and OpenDroneMap's gcp_list.txt."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from workbench.errors import SiteError
from workbench.site.model import ControlPoint, Observation
from workbench.site.tables import number, read_table

CONTROL_HEADER = "name,x,y,z,sd_xy,sd_z,role"
OBSERVATION_HEADER = "name,photo,column,row"
_COLLINEAR = 0.02  # Second over largest spread of points; below, a rotation about the line is free.
_USUAL_SD = 0.02  # Survey with RTK, where the file leaves the accuracy open.
_ODM_SD = 0.05  # gcp_list.txt states no accuracy; RTK surveys of signalled points reach 2-5 cm.


def on_a_line(points: np.ndarray) -> bool:
    """Whether points (n, 2 or 3) lie so close to a line that a block could turn about it."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] < _COLLINEAR * spread[0])


def read_control(path: Path | str) -> tuple[ControlPoint, ...]:
    """Read control points from a CSV with the header ``name,x,y,z,sd_xy,sd_z,role``.

    Decimal commas and semicolons are understood. Without a standard deviation 2 cm are taken, without
    a role ``control``.

    Raises
    ------
    SiteError
        Naming the file and line of what is missing, not a number, repeated, or an unknown role.
    """
    path = Path(path)
    points: dict[str, ControlPoint] = {}
    for line, row in read_table(path, CONTROL_HEADER.split(",")[:4]):
        name = row["name"]
        role = (row.get("role") or "control").lower()
        if role not in ("control", "check", "verify"):
            raise SiteError(f"{path}, line {line}: role '{role}'; use control, check or verify.")
        if name in points:
            raise SiteError(f"{path}, line {line}: point '{name}' occurs twice; give each its own name.")
        x, y, z = (number(row, key, path, line) for key in ("x", "y", "z"))
        sd_xy, sd_z = (number(row, key, path, line, _USUAL_SD) for key in ("sd_xy", "sd_z"))
        if min(sd_xy, sd_z) <= 0:
            raise SiteError(f"{path}, line {line}: standard deviations must be positive.")
        points[name] = ControlPoint(name, x, y, z, sd_xy, sd_z, role)  # type: ignore[arg-type]
    return tuple(points.values())


def read_observations(path: Path | str) -> tuple[Observation, ...]:
    """Read observations from a CSV with the header ``name,photo,column,row``.

    Raises
    ------
    SiteError
        Naming the file and line of what is missing or not a number.
    """
    path = Path(path)
    return tuple(
        Observation(
            row["name"], row["photo"], number(row, "column", path, line), number(row, "row", path, line)
        )
        for line, row in read_table(path, OBSERVATION_HEADER.split(","))
    )


def is_gcp_list(path: Path | str) -> bool:
    """Whether a file looks like OpenDroneMap's ``gcp_list.txt``: a CRS, then rows of 6 or more words.

    Raises
    ------
    SiteError
        If the file is missing or no text.
    """
    path = Path(path)
    try:
        lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
    except FileNotFoundError as error:
        raise SiteError(f"{path}: no such control file.") from error
    except (UnicodeDecodeError, IsADirectoryError) as error:
        raise SiteError(f"{path}: not a text file in UTF-8 ({error}).") from error
    header = lines[0].lower().replace(";", ",").replace("\t", ",").split(",") if lines else []
    return bool(lines) and "name" not in [word.strip() for word in header]


def read_gcp_list(path: Path | str, crs: CRS) -> tuple[tuple[ControlPoint, ...], tuple[Observation, ...]]:
    """Read ``gcp_list.txt``: a line with the CRS, then ``x y z column row photo [name]`` rows.

    Points are transformed to ``crs``, heights are taken as they are; rows without a name are one
    point where x, y and z agree. The file states no accuracy: 5 cm are taken.

    Raises
    ------
    SiteError
        If the CRS line or a row cannot be understood, a name has two places, or a place lies outside
        of the CRS.
    """
    path = Path(path)
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    transform = Transformer.from_crs(_odm_crs(lines[0], path), crs, always_xy=True)
    names: dict[tuple[float, float, float], str] = {}
    points: dict[str, ControlPoint] = {}
    observations = []
    for line, text in enumerate(lines[1:], start=2):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        place, column, row, photo, stated = _odm_row(text, path, line)
        name = stated or names.get(place) or f"gcp{len(points) + 1}"
        if names.setdefault(place, name) != name:
            raise SiteError(f"{path}, line {line}: point '{name}' is '{names[place]}' on an earlier line.")
        east, north = transform.transform(place[0], place[1])
        point = ControlPoint(name, float(east), float(north), place[2], _ODM_SD, _ODM_SD)
        if points.setdefault(name, point) != point:
            raise SiteError(f"{path}, line {line}: point '{name}' has other coordinates on an earlier line.")
        if not (abs(east) < float("inf") and abs(north) < float("inf")):
            raise SiteError(f"{path}, line {line}: {place[0]}, {place[1]} has no place in {crs.name}.")
        observations.append(Observation(name, photo, column, row))
    return tuple(points.values()), tuple(observations)


def render_control(points: tuple[ControlPoint, ...]) -> str:
    """Control points as CSV text."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(CONTROL_HEADER.split(","))
    for p in points:
        writer.writerow([p.name, f"{p.x:.4f}", f"{p.y:.4f}", f"{p.z:.4f}", p.sd_xy, p.sd_z, p.role])
    return out.getvalue()


def render_observations(observations: tuple[Observation, ...]) -> str:
    """Observations as CSV text."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(OBSERVATION_HEADER.split(","))
    for o in observations:
        writer.writerow([o.name, o.photo, f"{o.column:.3f}", f"{o.row:.3f}"])
    return out.getvalue()


def _odm_crs(text: str, path: Path) -> CRS:
    words = text.strip()
    utm = re.fullmatch(r"WGS84\s+UTM\s+(\d{1,2})\s*([NS])", words, re.IGNORECASE)
    if utm:
        return CRS.from_epsg((32600 if utm[2].upper() == "N" else 32700) + int(utm[1]))
    try:
        return CRS.from_user_input(words)
    except CRSError as error:
        raise SiteError(
            f"{path}, line 1: '{words}' is neither the header {CONTROL_HEADER} of a control file nor the "
            "CRS of a gcp_list.txt: write 'EPSG:n', 'WGS84 UTM 33N' or a proj string."
        ) from error


def _odm_row(text: str, path: Path, line: int) -> tuple[tuple[float, float, float], float, float, str, str]:
    """Place, column, row, photograph and name (or nothing) of a row."""
    words = text.split()
    try:
        x, y, z, column, row = (float(word) for word in words[:5])
        return (x, y, z), column, row, words[5], words[6] if len(words) > 6 else ""
    except (ValueError, IndexError) as error:
        raise SiteError(f"{path}, line {line}: expected 'x y z column row photo [name]'.") from error
