"""OpenDroneMap's ``gcp_list.txt``: a CRS, then the measurements of surveyed points, as people write it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from workbench.errors import SiteError
from workbench.site.model import ControlPoint, Observation
from workbench.site.places import outside_area, utm_zone

_SD = 0.05  # Metres: the file states no accuracy; RTK surveys of signalled points reach 2-5 cm.
_NUMBER = re.compile(r"[-+]?(\d+(\.\d*|,\d+)?|[.,]\d+)([eE][-+]?\d+)?")
_COLUMNS = ("x", "y", "z", "column", "row")
_ROW = "x y z column row photo [name]"
_WGS84, _ETRS89 = (32600, 32700), (25800, None)  # EPSG codes before the zones, north and south.
_UTM = re.compile(r"(WGS ?84|ETRS ?89)? ?/? ?UTM ?(?:ZONE)? ?(\d{1,2}) ?([NS])", re.IGNORECASE)


def is_gcp_list(path: Path | str) -> bool:
    """Whether a file looks like OpenDroneMap's ``gcp_list.txt``, and not like a table with a column ``name``.

    Raises
    ------
    SiteError
        If the file is missing or no text.
    """
    lines = [text for _, text in _read_lines(Path(path))]
    plain = next((k for k, text in enumerate(lines) if not text.startswith("#")), len(lines) - 1)
    if not lines or _crs_of(lines[plain]) is not None:
        return bool(lines)
    headers = [re.split(r"[,;\t]", text.lower().lstrip("# ")) for text in lines[: plain + 1]]
    return not any("name" in [word.strip() for word in words] for words in headers)


def gcp_list_crs(path: Path | str) -> CRS:
    """A projected CRS for a site that states none: that of the file, or the UTM zone of its first point.

    Raises
    ------
    SiteError
        If the line with the CRS or the first row cannot be understood.
    """
    stated, rows = _split(Path(path))
    if not stated.is_geographic or not rows:
        return stated
    (x, y, _), *_ = _row(rows[0][1], f"{path}, line {rows[0][0]}")
    return utm_zone(*Transformer.from_crs(stated, 4326, always_xy=True).transform(x, y))


def read_gcp_list(path: Path | str, crs: CRS) -> tuple[tuple[ControlPoint, ...], tuple[Observation, ...]]:
    """Read ``gcp_list.txt``: a line with the CRS, then ``x y z column row photo [name]`` rows.

    Rows are separated by spaces, tabs, commas or semicolons; decimals may be commas where these do not
    separate; lines that begin with # are comments. Degrees are longitude before latitude. Points are
    transformed to ``crs``, heights are taken as they are; rows without a name are one point where x, y and z
    agree. The file states no accuracy: 5 cm are taken.

    Raises
    ------
    SiteError
        If the line with the CRS or a row cannot be understood, the CRS is not in metres or degrees, a name
        has two places, latitude comes before longitude, or a place lies outside of the CRS.
    """
    stated, rows = _split(Path(path))
    transform = Transformer.from_crs(stated, crs, always_xy=True)
    names: dict[tuple[float, float, float], str] = {}
    points: dict[str, ControlPoint] = {}
    observations = []
    for line, text in rows:
        subject = f"{path}, line {line}"
        place, (column, row), photo, called = _row(text, subject)
        name = called or names.get(place) or f"gcp{len(points) + 1}"
        if names.setdefault(place, name) != name:
            raise SiteError(f"{subject}: point '{name}' is '{names[place]}' on an earlier line.")
        x, y = _transformed(place, transform, stated, crs, subject)
        point = ControlPoint(name, x, y, place[2], _SD, _SD)
        if points.setdefault(name, point) != point:
            raise SiteError(f"{subject}: point '{name}' has other coordinates on an earlier line.")
        observations.append(Observation(name, photo, column, row))
    return tuple(points.values()), tuple(observations)


def _read_lines(path: Path) -> list[tuple[int, str]]:
    """Lines that say something, with their numbers."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError as error:
        raise SiteError(f"{path}: no such control file.") from error
    except (UnicodeDecodeError, IsADirectoryError) as error:
        raise SiteError(f"{path}: not a text file in UTF-8 ({error}).") from error
    return [(n, text.strip()) for n, text in enumerate(lines, start=1) if text.strip()]


def _split(path: Path) -> tuple[CRS, list[tuple[int, str]]]:
    """The CRS, and the rows with their numbers."""
    lines = [(line, text) for line, text in _read_lines(path) if not text.startswith("#")]
    line, words = lines[0] if lines else (1, "")
    crs = _crs_of(words)
    if crs is None or not (crs.is_projected or crs.is_geographic):
        raise SiteError(
            f"{path}, line {line}: '{words}' is neither the header name,x,y,z,sd_xy,sd_z,role of a control "
            "file nor the CRS of a gcp_list.txt: write 'EPSG:n', 'WGS84 UTM 33N' (with N or S), 'WGS84' for "
            "degrees, or a proj string."
        )
    units = {axis.unit_name for axis in crs.axis_info if axis.unit_conversion_factor != 1}
    if crs.is_projected and units:
        raise SiteError(
            f"{path}, line {line}: {crs.name} counts in {', '.join(units)}, and heights may do so too: "
            "convert x, y and z to metres."
        )
    return crs, lines[1:]


def _crs_of(text: str) -> CRS | None:
    """The horizontal CRS that a line states, or None."""
    words = " ".join(text.strip("'\" ,;\t").split())
    if utm := _UTM.fullmatch(words):
        north, south = _ETRS89 if (utm[1] or "").upper().startswith("ETRS") else _WGS84
        family = north if utm[3].upper() == "N" else south
        return None if family is None else _known(f"EPSG:{family + int(utm[2])}")
    crs = _known(re.sub(r"(?i)^epsg[ :]+", "EPSG:", words))
    # PROJ searches for names that look alike: 'lat/lon' would be a frame of 2020.
    exact = words.startswith("+proj") or words.upper().startswith("EPSG") or "[" in words
    if crs is None or not (exact or crs.name.replace(" ", "").lower() == words.replace(" ", "").lower()):
        return None
    return crs.sub_crs_list[0] if crs.is_compound else crs


def _known(text: str) -> CRS | None:
    try:
        return CRS.from_user_input(text)
    except CRSError:
        return None


def _row(text: str, subject: str) -> tuple[tuple[float, float, float], tuple[float, float], str, str]:
    """Place, column and row, photograph and name (or nothing) of a row."""
    words = _words(text)
    if len(words) < len(_COLUMNS) + 1:
        raise SiteError(f"{subject}: expected '{_ROW}'.")
    for what, word in zip(_COLUMNS, words, strict=False):
        if not _NUMBER.fullmatch(word):
            raise SiteError(f"{subject}: {what} is '{word}', not a number. Expected '{_ROW}'.")
    x, y, z, column, row = (float(word.replace(",", ".")) for word in words[: len(_COLUMNS)])
    return (x, y, z), (column, row), words[5], words[6] if len(words) > 6 else ""


def _words(text: str) -> list[str]:
    """Cells of a row, whatever separates them."""
    for sign in ("\t", ";"):
        cells = [cell.strip() for cell in text.split(sign)]
        if len(cells) > len(_COLUMNS):
            return cells
    words = text.split()
    if len(words) <= len(_COLUMNS) or not _NUMBER.fullmatch(words[0]):
        cells = [cell.strip() for cell in text.split(",")]
        return cells if len(cells) >= len(words) else words
    return words


def _transformed(
    place: tuple[float, float, float], transform: Transformer, source: CRS, target: CRS, subject: str
) -> tuple[float, float]:
    x, y, _ = place
    east, north = transform.transform(x, y)
    swapped = transform.transform(y, x)
    if source.is_geographic and _is_outside(east, north, target) and not _is_outside(*swapped, target):
        raise SiteError(f"{subject}: {x:g} {y:g} is latitude before longitude. Exchange the columns.")
    if not np.isfinite([east, north]).all():
        raise SiteError(f"{subject}: {x}, {y} has no place in {target.name}.")
    return float(east), float(north)


def _is_outside(east: float, north: float, crs: CRS) -> bool:
    return not np.isfinite([east, north]).all() or bool(outside_area(np.array([[east, north]]), crs)[0])
