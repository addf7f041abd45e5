"""``site.yaml`` and ``photographs.csv``: how a site lies on disk."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime, tzinfo
from pathlib import Path
from typing import Any, TypeVar
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import pyproj
from pyproj import Transformer
from rasterio.crs import CRS
from rasterio.errors import CRSError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from workbench.cameras.sun import sun_position
from workbench.errors import SiteError
from workbench.site.cameras import read_cameras
from workbench.site.control import read_control, read_observations
from workbench.site.describe import OPTIONAL_FILES
from workbench.site.model import Observation, Photograph, Site
from workbench.site.names import find_photographs

_AnyCrs = TypeVar("_AnyCrs", CRS, pyproj.CRS)
COLUMNS = (
    *("name", "camera", "x", "y", "z", "sd_x", "sd_y", "sd_z", "omega", "phi", "kappa"),
    *("sd_omega", "sd_phi", "sd_kappa", "time"),
    *("strip", "order", "height_above_ground", "bands", "sun_elevation", "sun_azimuth", "note", "set_aside"),
)


def load_site(name: str, root: Path | str = ".") -> Site:
    """Read ``data/sites/NAME``.

    Raises
    ------
    SiteError
        If the site does not exist or one of its files cannot be understood.
    """
    root = Path(root)
    folder = root / "data" / "sites" / name
    path = folder / "site.yaml"
    values = read_description(path)
    crs = _crs(values.get("crs"), path)
    photo_folder = folder / str(values.get("photographs", "photographs"))
    photographs = with_sun(
        _read_photographs(folder / "photographs.csv", photo_folder),
        crs,
        time_zone_of(values.get("time_zone"), path),
    )
    cameras, questions = read_cameras(values.get("cameras") or {}, path)
    if not values.get("vertical_datum"):
        questions.insert(0, f"{path}: vertical_datum is open: what do heights refer to?")
    if crs is None:
        questions.insert(0, f"{path}: crs is open: state a projected CRS such as EPSG:25832.")
    control, observations = folder / "control.csv", folder / "observations.csv"
    return Site(
        name=name,
        root=root,
        crs=crs,
        vertical_datum=values.get("vertical_datum") or None,
        photographs=tuple(p for p in photographs if not p.set_aside),
        set_aside=tuple(p for p in photographs if p.set_aside),
        cameras=cameras,
        unanswered=tuple(questions),
        time_zone=values.get("time_zone"),
        flight={key: value and str(value) for key, value in (values.get("flight") or {}).items()},
        control=read_control(control) if control.exists() else (),
        observations=_observations(observations, photographs) if observations.exists() else (),
        water_level=_optional_number(values.get("water_level"), "water_level", path),
        **_optional_files(values, folder),
    )


def _observations(path: Path, photographs: Iterable[Photograph]) -> tuple[Observation, ...]:
    """Measurements, with the names of photographs as the site has them."""
    measured = read_observations(path)
    names = find_photographs({o.photo for o in measured}, [p.name for p in photographs])
    return tuple(replace(o, photo=names.get(o.photo, o.photo)) for o in measured)


def with_sun(photographs: Iterable[Photograph], crs: Any, zone: tzinfo | None) -> list[Photograph]:
    """Photographs with their time in UTC, where a zone is known, and the sun's place at that time."""
    transform = Transformer.from_crs(crs, 4326, always_xy=True) if crs is not None else None
    result = []
    for p in photographs:
        time = p.time
        if time is not None and time.tzinfo is None and zone is not None:
            time = time.replace(tzinfo=zone).astimezone(UTC)
        sun = None
        if transform is not None and p.position is not None and time is not None and time.tzinfo is not None:
            sun = sun_position(time, *transform.transform(*p.position[:2]))
        result.append(replace(p, time=time, sun=sun))
    return result


def time_zone_of(name: str | None, path: Path) -> ZoneInfo | None:
    """Time zone of an IANA name.

    Raises
    ------
    SiteError
        If there is no such zone.
    """
    if name is None:
        return None
    try:
        return ZoneInfo(str(name))
    except (ZoneInfoNotFoundError, ValueError, OSError) as error:
        raise SiteError(
            f"{path}: time_zone '{name}' is unknown. Write it as Europe/Berlin or UTC."
        ) from error


def projected(crs: _AnyCrs, subject: str) -> _AnyCrs:
    """The CRS itself, if it is projected in metres.

    Raises
    ------
    SiteError
        If it is geographic or in other units.
    """
    known = pyproj.CRS.from_user_input(crs)
    if not known.is_projected or any(axis.unit_conversion_factor != 1 for axis in known.axis_info[:2]):
        raise SiteError(f"{subject} is not projected in metres. Choose, for example, the UTM zone.")
    return crs


def render_photographs(photographs: Iterable[Photograph]) -> str:
    """Table of photographs as CSV text."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for p in photographs:
        writer.writerow(
            [
                p.name,
                p.camera,
                *_three(p.position, 4),
                *_three(p.position_sd, 4),
                *_three(p.attitude, 5),
                *_three(p.attitude_sd, 5),
                p.time.isoformat() if p.time else "",
                p.strip,
                p.order,
                "" if p.height_above_ground is None else f"{p.height_above_ground:.2f}",
                p.bands,
                *([f"{angle:.2f}" for angle in p.sun] if p.sun else ["", ""]),
                p.note,
                p.set_aside,
            ]
        )
    return out.getvalue()


def relative_to(path: Path, folder: Path) -> str:
    """Path as it is written into ``site.yaml``: relative within the same root, absolute elsewhere."""
    path, folder = path.resolve(), folder.resolve()
    return os.path.relpath(path, folder) if path.is_relative_to(folder.parents[2]) else str(path)


def write_text(text: str, path: Path) -> None:
    """Write a text under a temporary name, then rename it.

    Raises
    ------
    SiteError
        If the folder cannot be written.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise SiteError(f"{path}: cannot be written ({error}). Free space or choose another root.") from error


def read_description(path: Path) -> dict[str, Any]:
    """Content of ``site.yaml``.

    Raises
    ------
    SiteError
        If it is missing, not YAML, or no mapping.
    """
    if not path.exists():
        raise SiteError(
            f"{path}: no such site. Make it with `workbench new-site {path.parent.name} --photos FOLDER`."
        )
    try:
        values = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
    except (YAMLError, UnicodeDecodeError) as error:
        raise SiteError(f"{path}: not valid YAML ({error}).") from error
    if not isinstance(values, dict):
        raise SiteError(f"{path}: must hold the description of a site.")
    return values


def _read_photographs(path: Path, folder: Path) -> list[Photograph]:
    if not path.exists():
        raise SiteError(f"{path}: missing. Run `workbench new-site` again to list the photographs.")
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        lacking = [name for name in ("name", "camera") if name not in (reader.fieldnames or ())]
        if lacking:
            raise SiteError(f"{path}: no column {', '.join(lacking)}. Run `workbench new-site` again.")
        rows = list(reader)
    photographs: dict[str, Photograph] = {}
    for line, row in enumerate(rows, start=2):
        try:
            photograph = _read_photograph_row({key: value or "" for key, value in row.items()}, folder)
        except ValueError as error:
            raise SiteError(
                f"{path}, line {line}: {error}. Mend it, or run `workbench new-site` again."
            ) from error
        if photograph.name in photographs:
            raise SiteError(f"{path}, line {line}: {photograph.name} occurs twice; delete one line.")
        photographs[photograph.name] = photograph
    return list(photographs.values())


def _read_photograph_row(row: dict[str, str], folder: Path) -> Photograph:
    def cell(key: str) -> str:
        return row.get(key, "").strip()

    return Photograph(
        name=row["name"],
        path=folder / row["name"],
        camera=row["camera"],
        position=_read_three(row, "x", "y", "z"),
        position_sd=_read_three(row, "sd_x", "sd_y", "sd_z"),
        attitude=_read_three(row, "omega", "phi", "kappa"),
        attitude_sd=_read_three(row, "sd_omega", "sd_phi", "sd_kappa"),
        time=datetime.fromisoformat(cell("time")) if cell("time") else None,
        strip=int(cell("strip") or 0),
        order=int(cell("order") or 0),
        height_above_ground=float(cell("height_above_ground")) if cell("height_above_ground") else None,
        bands=int(cell("bands") or 3),
        note=cell("note"),
        set_aside=cell("set_aside"),
    )


def _crs(text: Any, path: Path) -> CRS | None:
    if not text:
        return None
    try:
        return projected(CRS.from_user_input(text), f"{path}: crs {text}")
    except (CRSError, pyproj.exceptions.CRSError) as error:
        raise SiteError(f"{path}: crs '{text}' is unknown. Write it as EPSG:n.") from error


def _optional_files(values: dict[str, Any], folder: Path) -> dict[str, Path]:
    files = {}
    for key in OPTIONAL_FILES:
        if values.get(key):
            files[key] = folder / str(values[key])
            if not files[key].exists():
                raise SiteError(f"{folder / 'site.yaml'}: {key}: {files[key]} does not exist.")
    return files


def _optional_number(value: Any, key: str, path: Path) -> float | None:
    if value is None:
        return None
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise SiteError(f"{path}: {key} is '{value}', not a number in metres.") from error


def _three(values: tuple[float, float, float] | None, digits: int) -> list[str]:
    return ["", "", ""] if values is None else [f"{value:.{digits}f}" for value in values]


def _read_three(row: dict[str, str], *keys: str) -> tuple[float, float, float] | None:
    texts = [row.get(key, "").strip() for key in keys]
    if not any(texts):
        return None
    if not all(texts):
        raise ValueError(f"{', '.join(keys)} are filled in part")
    a, b, c = (float(text) for text in texts)
    if not all(map(math.isfinite, (a, b, c))):
        raise ValueError(f"{', '.join(keys)} are not all finite numbers")
    return a, b, c
