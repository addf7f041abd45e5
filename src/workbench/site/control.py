"""Control points and their observations: our CSV files and OpenDroneMap's gcp_list.txt."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from workbench.errors import SiteError
from workbench.site.model import ControlPoint, Observation

CONTROL_HEADER = "name,x,y,z,sd_xy,sd_z,role"
OBSERVATION_HEADER = "name,photo,column,row"
_USUAL_SD = 0.02  # Survey with RTK, where the file leaves the accuracy open.
_ODM_SD = 0.05  # gcp_list.txt states no accuracy; RTK surveys of signalled points reach 2-5 cm.


def read_control(path: Path | str) -> tuple[ControlPoint, ...]:
    """Read control points from a CSV with the header ``name,x,y,z,sd_xy,sd_z,role``.

    Decimal commas and semicolons are understood.

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
        x, y, z = (_number(row, key, path, line) for key in ("x", "y", "z"))
        sd_xy, sd_z = (_number(row, key, path, line, _USUAL_SD) for key in ("sd_xy", "sd_z"))
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
            row["name"], row["photo"], _number(row, "column", path, line), _number(row, "row", path, line)
        )
        for line, row in read_table(path, OBSERVATION_HEADER.split(","))
    )


def is_gcp_list(path: Path | str) -> bool:
    """Whether a file looks like OpenDroneMap's ``gcp_list.txt``: no CSV header, rows of 6 or more words."""
    first = Path(path).read_text(encoding="utf-8-sig", errors="replace").lstrip().splitlines()
    return bool(first) and "name" not in first[0].lower().replace(";", ",").split(",")


def read_gcp_list(path: Path | str, crs: CRS) -> tuple[tuple[ControlPoint, ...], tuple[Observation, ...]]:
    """Read ``gcp_list.txt``: a line with the CRS, then ``x y z column row photo [name]`` rows.

    Points are transformed to ``crs``; rows without a name are one point where x, y and z agree.

    Raises
    ------
    SiteError
        If the CRS line or a row cannot be understood.
    """
    path = Path(path)
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    transform = Transformer.from_crs(_odm_crs(lines[0], path), crs, always_xy=True)
    points: dict[tuple[float, float, float], ControlPoint] = {}
    observations = []
    for number, text in enumerate(lines[1:], start=2):
        words = text.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            x, y, z, column, row = (float(word) for word in words[:5])
            photo = words[5]
        except (ValueError, IndexError) as error:
            raise SiteError(f"{path}, line {number}: expected 'x y z column row photo [name]'.") from error
        if (x, y, z) not in points:
            name = words[6] if len(words) > 6 else f"gcp{len(points) + 1}"
            east, north = transform.transform(x, y)
            points[x, y, z] = ControlPoint(name, east, north, z, _ODM_SD, _ODM_SD)
        observations.append(Observation(points[x, y, z].name, photo, column, row))
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


def read_table(path: Path, needed: list[str]) -> list[tuple[int, dict[str, str]]]:
    """Rows of a CSV by column name, with their line numbers.

    Separators may be commas, semicolons or tabs; with semicolons or tabs decimals may be commas.

    Raises
    ------
    SiteError
        If the file is missing or lacks one of the needed columns.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise SiteError(f"{path}: no such file.") from error
    except UnicodeDecodeError as error:
        raise SiteError(f"{path}: not a text file in UTF-8 ({error}).") from error
    header = text.splitlines()[0] if text.strip() else ""
    separator = next((sign for sign in (";", "\t") if sign in header), ",")
    reader = csv.DictReader(io.StringIO(text), delimiter=separator)
    names = [(name or "").strip().lower() for name in reader.fieldnames or []]
    lacking = [name for name in needed if name not in names]
    if lacking:
        raise SiteError(f"{path}: no column {', '.join(lacking)}. Its header is: {header or '(empty)'}")
    reader.fieldnames = names
    rows = []
    for row in reader:
        plain = {key: (value or "").strip() for key, value in row.items() if key}
        if any(plain.values()):
            rows.append((reader.line_num, plain))
    return rows


def _number(row: dict[str, str], key: str, path: Path, line: int, default: float | None = None) -> float:
    text = row.get(key, "")
    if not text and default is not None:
        return default
    if re.fullmatch(r"[-+]?\d+,\d+", text):
        text = text.replace(",", ".")
    try:
        return float(text)
    except ValueError as error:
        raise SiteError(f"{path}, line {line}: {key} is '{text}', not a number.") from error


def _odm_crs(text: str, path: Path) -> CRS:
    words = text.strip()
    utm = re.fullmatch(r"WGS84\s+UTM\s+(\d{1,2})\s*([NS])", words, re.IGNORECASE)
    if utm:
        return CRS.from_epsg((32600 if utm[2].upper() == "N" else 32700) + int(utm[1]))
    try:
        return CRS.from_user_input(words)
    except CRSError as error:
        raise SiteError(
            f"{path}, line 1: '{words}' is no CRS. Write 'EPSG:n', 'WGS84 UTM 33N' or a proj string."
        ) from error
