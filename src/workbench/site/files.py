"""``site.yaml`` and ``photographs.csv``: how a site lies on disk."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import Any

from rasterio.crs import CRS
from rasterio.errors import CRSError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from workbench.cameras import Camera
from workbench.errors import SiteError
from workbench.site.control import read_control, read_observations
from workbench.site.model import Photograph, Site

COLUMNS = (
    *("name", "camera", "x", "y", "z", "sd_x", "sd_y", "sd_z", "omega", "phi", "kappa", "time"),
    *("strip", "order", "height_above_ground", "sun_elevation", "sun_azimuth", "set_aside"),
)
OPTIONAL_FILES = (
    "shoreline",
    "dtm",
    "areas",
    "transects",
    "field_points",
    "plots",
    "reference_status",
    "reference_trees",
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
    values = _read_yaml(folder / "site.yaml")
    photo_folder = folder / str(values.get("photographs", "photographs"))
    photographs = _read_photographs(folder / "photographs.csv", photo_folder)
    cameras, questions = _cameras(values.get("cameras") or {}, folder / "site.yaml")
    if not values.get("vertical_datum"):
        questions.insert(0, f"{folder / 'site.yaml'}: vertical_datum is open: what do heights refer to?")
    if not values.get("crs"):
        questions.insert(0, f"{folder / 'site.yaml'}: crs is open: state a projected CRS such as EPSG:25832.")
    optional = {}
    for key in OPTIONAL_FILES:
        if values.get(key):
            optional[key] = folder / str(values[key])
            if not optional[key].exists():
                raise SiteError(f"{folder / 'site.yaml'}: {key}: {optional[key]} does not exist.")
    control, observations = folder / "control.csv", folder / "observations.csv"
    return Site(
        name=name,
        root=root,
        crs=_crs(values.get("crs"), folder / "site.yaml"),
        vertical_datum=values.get("vertical_datum") or None,
        photographs=tuple(p for p in photographs if not p.set_aside),
        set_aside=tuple(p for p in photographs if p.set_aside),
        cameras=cameras,
        unanswered=tuple(questions),
        control=read_control(control) if control.exists() else (),
        observations=read_observations(observations) if observations.exists() else (),
        water_level=_optional_number(values.get("water_level"), "water_level", folder / "site.yaml"),
        **optional,
    )


def render_photographs(photographs: Iterable[Photograph], suns: dict[str, tuple[float, float] | None]) -> str:
    """Table of photographs as CSV text."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for p in photographs:
        sun = suns.get(p.name)
        writer.writerow(
            [
                p.name,
                p.camera,
                *_three(p.position, 4),
                *_three(p.position_sd, 4),
                *_three(p.attitude, 5),
                p.time.isoformat() if p.time else "",
                p.strip,
                p.order,
                "" if p.height_above_ground is None else f"{p.height_above_ground:.2f}",
                *([f"{angle:.2f}" for angle in sun] if sun else ["", ""]),
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


def _read_yaml(path: Path) -> dict[str, Any]:
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
        rows = list(csv.DictReader(file))
    try:
        return [
            Photograph(
                name=row["name"],
                path=folder / row["name"],
                camera=row["camera"],
                position=_read_three(row, "x", "y", "z"),
                position_sd=_read_three(row, "sd_x", "sd_y", "sd_z"),
                attitude=_read_three(row, "omega", "phi", "kappa"),
                time=datetime.fromisoformat(row["time"]) if row["time"] else None,
                strip=int(row["strip"] or 0),
                order=int(row["order"] or 0),
                height_above_ground=float(row["height_above_ground"]) if row["height_above_ground"] else None,
                set_aside=row["set_aside"],
            )
            for row in rows
        ]
    except (KeyError, ValueError) as error:
        raise SiteError(f"{path}: cannot be understood ({error}). Run `workbench new-site` again.") from error


def _cameras(entries: dict[str, Any], path: Path) -> tuple[dict[str, Camera], list[str]]:
    cameras, questions = {}, []
    for identifier, entry in entries.items():
        focal, sensor = entry.get("focal_length_mm"), entry.get("sensor_width_mm")
        if not focal or not sensor:
            lacking = "focal_length_mm" if not focal else "sensor_width_mm"
            questions.append(
                f"{path}: cameras.{identifier}.{lacking} is open for '{entry.get('make', '')} "
                f"{entry.get('model', '')}': look it up in the maker's data sheet (not the 35 mm equivalent)."
            )
            continue
        pixel = float(sensor) / 1000 / int(entry["width"])
        cameras[identifier] = Camera.from_focal_length(
            f"{entry.get('make', '')} {entry.get('model', '')}".strip() or identifier,
            int(entry["width"]),
            int(entry["height"]),
            focal_length=float(focal) / 1000,
            pixel_size=pixel,
            distortion=tuple(float(value) for value in entry.get("distortion") or ()),
        )
    return cameras, questions


def _crs(text: Any, path: Path) -> CRS | None:
    if not text:
        return None
    try:
        crs = CRS.from_user_input(text)
    except CRSError as error:
        raise SiteError(f"{path}: crs '{text}' is unknown. Write it as EPSG:n.") from error
    if not crs.is_projected or crs.linear_units_factor[1] != 1:
        raise SiteError(f"{path}: crs {text} is not projected in metres. Choose, for example, the UTM zone.")
    return crs


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
    if not all(row[key] for key in keys):
        return None
    a, b, c = (float(row[key]) for key in keys)
    return a, b, c
