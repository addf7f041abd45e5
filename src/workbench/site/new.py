"""Making a site from a folder of photographs."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC
from pathlib import Path
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from workbench.cameras import Pose
from workbench.cameras.exif import PhotographFacts, read_facts
from workbench.cameras.sun import sun_position
from workbench.cameras.table import find_sensor
from workbench.errors import SiteError
from workbench.photographs import is_complete, photograph_size
from workbench.site.control import (
    is_gcp_list,
    read_control,
    read_gcp_list,
    read_observations,
    render_control,
    render_observations,
)
from workbench.site.files import OPTIONAL_FILES, load_site, relative_to, render_photographs, write_text
from workbench.site.model import Photograph, Site
from workbench.site.navigation import NavigationRow, grid_convergence, read_navigation
from workbench.site.strips import find_strips

SUFFIXES = {".jpg", ".jpeg", ".tif", ".tiff"}


@dataclass(frozen=True)
class _Found:
    """A file that may be a photograph."""

    name: str
    path: Path
    facts: PhotographFacts
    size: tuple[int, int]
    problem: str = ""

    @property
    def camera(self) -> tuple:
        facts = self.facts
        focal = None if facts.focal_length is None else round(facts.focal_length, 6)
        # A rig keeps one folder a camera, whose bodies may share make and model.
        folder = self.name.rpartition("/")[0]
        return folder, facts.make, facts.model, facts.serial, focal, self.size


def new_site(
    name: str,
    *,
    photos: Path | str,
    root: Path | str = ".",
    navigation: Path | str | None = None,
    navigation_columns: Mapping[str, str] | None = None,
    control: Path | str | None = None,
    observations: Path | str | None = None,
    crs: str | None = None,
    vertical_datum: str | None = None,
    time_zone: str | None = None,
    water_level: float | None = None,
    **optional: Path | str | None,
) -> Site:
    """Describe photographs as a site: ``site.yaml``, ``photographs.csv``, control and observations.

    Photographs are referenced, not copied. Damaged ones are set aside with the reason.

    Parameters
    ----------
    name
        Folder to make under ``data/sites``; an existing description is replaced.
    photos
        Folder of JPEG and TIFF files; subfolders are read too, one a camera for a rig.
    navigation
        Text file of positions and angles, see :func:`workbench.site.read_navigation`; goes before EXIF.
    control, observations
        Control file and measurements, or OpenDroneMap's ``gcp_list.txt`` as ``control``.
    crs
        Projected CRS, metres; the UTM zone of the positions if not given.
    vertical_datum
        What heights refer to, in words; stays an open question if not given.
    time_zone
        IANA name, for cameras whose clock shows local time; needed for the sun's position.
    water_level
        Metres in the vertical datum.
    optional
        ``shoreline``, ``dtm``, ``areas``, ``transects``, ``field_points``, ``plots``,
        ``reference_status``, ``reference_trees``: files that the later stages use.

    Raises
    ------
    SiteError
        If there are no photographs, the CRS is unusable, or a file cannot be understood.
    """
    unknown = set(optional) - set(OPTIONAL_FILES)
    if unknown:
        raise SiteError(f"Unknown site file(s) {sorted(unknown)}; known are {', '.join(OPTIONAL_FILES)}.")
    root, photos = Path(root), Path(photos)
    folder = root / "data" / "sites" / name
    found = _find(photos)
    chosen = _choose_crs(crs, found, navigation)
    rows = read_navigation(navigation, chosen, navigation_columns) if navigation and chosen else {}
    zone = _zone(time_zone)
    cameras = _number_cameras(found)
    photographs = _order([_photograph(item, cameras, rows, chosen, zone) for item in found])
    suns = {p.name: _sun(p, chosen) for p in photographs}
    _write_control(folder, control, observations, chosen, photographs)
    write_text(render_photographs(photographs, suns), folder / "photographs.csv")
    files = {key: relative_to(Path(value), folder) for key, value in optional.items() if value}
    text = _render(
        name,
        crs=_crs_text(chosen),
        proposed=crs is None,
        vertical_datum=vertical_datum,
        photographs=relative_to(photos, folder),
        time_zone=time_zone,
        water_level=water_level,
        files=files,
        cameras=cameras,
    )
    write_text(text, folder / "site.yaml")
    return load_site(name, root)


def _find(photos: Path) -> list[_Found]:
    if not photos.is_dir():
        raise SiteError(f"{photos}: no such folder of photographs.")
    paths = sorted(path for path in photos.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    if not paths:
        raise SiteError(f"{photos}: holds no photograph ({', '.join(sorted(SUFFIXES))}).")
    found: list[_Found] = []
    seen: dict[bytes, str] = {}
    for path in paths:
        name = path.relative_to(photos).as_posix()
        try:
            size = photograph_size(path)
            problem = "" if is_complete(path) else "truncated: the end of the JPEG is missing, copy it again"
            facts = read_facts(path)
        except SiteError:
            size, facts, problem = (0, 0), PhotographFacts(), "not a readable image: copy it again"
        digest = hashlib.blake2b(path.read_bytes(), digest_size=16).digest()
        if digest in seen and not problem:
            problem = f"the same picture as {seen[digest]}"
        seen.setdefault(digest, name)
        found.append(_Found(name, path, facts, size, problem))
    return found


def _choose_crs(crs: str | None, found: list[_Found], navigation: Path | str | None) -> CRS | None:
    if crs is not None:
        try:
            return CRS.from_user_input(crs)
        except CRSError as error:
            raise SiteError(f"CRS '{crs}' is unknown. Write it as EPSG:n.") from error
    places = [(f.facts.longitude, f.facts.latitude) for f in found if _has_place(f.facts)]
    if not places:
        if navigation:
            raise SiteError(f"{navigation}: state the CRS of the site with --crs EPSG:n.")
        return None
    longitude, latitude = np.median(np.array(places, dtype=float), axis=0)
    zone = int((longitude + 180) // 6) + 1
    return CRS.from_epsg((32600 if latitude >= 0 else 32700) + zone)


def _crs_text(crs: CRS | None) -> str | None:
    if crs is None:
        return None
    return f"EPSG:{crs.to_epsg()}" if crs.to_epsg() else crs.to_wkt()


def _has_place(facts: PhotographFacts) -> bool:
    # Receivers without a fix write 0, 0.
    return (
        facts.longitude is not None
        and facts.latitude is not None
        and (abs(facts.longitude) > 1e-6 or abs(facts.latitude) > 1e-6)
    )


def _number_cameras(found: list[_Found]) -> dict[tuple, str]:
    kinds = sorted({item.camera for item in found if item.size != (0, 0)}, key=str)
    return {kind: f"camera{number}" for number, kind in enumerate(kinds, start=1)}


def _photograph(
    item: _Found,
    cameras: dict[tuple, str],
    rows: Mapping[str, NavigationRow],
    crs: CRS | None,
    zone: ZoneInfo | None,
) -> Photograph:
    facts, time = item.facts, item.facts.time
    if time is not None and time.tzinfo is None and zone is not None:
        time = time.replace(tzinfo=zone).astimezone(UTC)
    row = rows.get(item.name) or rows.get(Path(item.name).name) or rows.get(Path(item.name).stem)
    position, deviations, attitude = _recorded(facts, crs)
    if row is not None:
        position, deviations = row.position, row.position_sd
        attitude = row.attitude or attitude
    return Photograph(
        item.name,
        item.path,
        cameras.get(item.camera, ""),
        position,
        deviations,
        attitude,
        time,
        height_above_ground=facts.relative_altitude,
        set_aside=item.problem,
    )


def _recorded(facts: PhotographFacts, crs: CRS | None) -> tuple:
    """Position, standard deviations and angles that EXIF and XMP hold, in the site's CRS."""
    if crs is None or not _has_place(facts):
        return None, None, None
    transform = Transformer.from_crs(CRS.from_epsg(4326), crs, always_xy=True)
    x, y = transform.transform(facts.longitude, facts.latitude)
    if not np.isfinite([x, y]).all():
        return None, None, None
    position = (x, y, facts.altitude if facts.altitude is not None else 0.0)
    attitude = None
    if facts.gimbal is not None:
        roll, pitch, yaw = facts.gimbal
        heading = yaw - grid_convergence(x, y, crs)
        pose = Pose.from_roll_pitch_heading(np.array(position), roll, 0, heading, tilt_forward=90 + pitch)
        attitude = pose.omega_phi_kappa
    return position, facts.position_sd, attitude


def _order(photographs: list[Photograph]) -> list[Photograph]:
    """Number strips, camera by camera, in the order of exposure."""
    numbered: dict[str, Photograph] = {}
    first = 0
    for camera in sorted({p.camera for p in photographs}):
        mine = [p for p in photographs if p.camera == camera and p.position and not p.set_aside]
        if mine and all(p.time for p in mine):
            mine.sort(key=lambda p: (p.time.timestamp(), p.name))  # type: ignore[union-attr]
        strip, order = find_strips([p.position[:2] for p in mine])  # type: ignore[index]
        for p, number, place in zip(mine, strip, order, strict=True):
            numbered[p.name] = replace(p, strip=first + number, order=place)
        first += max(strip, default=-1) + 1
    return [numbered.get(p.name, p) for p in photographs]


def _sun(photograph: Photograph, crs: CRS | None) -> tuple[float, float] | None:
    if crs is None or photograph.position is None or photograph.time is None or not photograph.time.tzinfo:
        return None
    transform = Transformer.from_crs(crs, CRS.from_epsg(4326), always_xy=True)
    longitude, latitude = transform.transform(*photograph.position[:2])
    return sun_position(photograph.time, longitude, latitude)


def _zone(name: str | None) -> ZoneInfo | None:
    if name is None:
        return None
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError) as error:
        raise SiteError(f"Time zone '{name}' is unknown. Write it as Europe/Berlin or UTC.") from error


def _write_control(
    folder: Path,
    control: Path | str | None,
    observations: Path | str | None,
    crs: CRS | None,
    photographs: list[Photograph],
) -> None:
    points: tuple = ()
    measured: tuple = ()
    if control is not None:
        if not Path(control).exists():
            raise SiteError(f"{control}: no such control file.")
        if is_gcp_list(control):
            if crs is None:
                raise SiteError(f"{control}: state the CRS of the site with --crs EPSG:n.")
            points, measured = read_gcp_list(control, crs)
        else:
            points = read_control(control)
    if observations is not None:
        measured = measured + read_observations(observations)
    names = {Path(p.name).name: p.name for p in photographs} | {p.name: p.name for p in photographs}
    measured = tuple(replace(o, photo=names.get(o.photo, o.photo)) for o in measured)
    write_text(render_control(points), folder / "control.csv")
    write_text(render_observations(measured), folder / "observations.csv")


def _render(
    name: str,
    *,
    crs: str | None,
    proposed: bool,
    vertical_datum: str | None,
    photographs: str,
    time_zone: str | None,
    water_level: float | None,
    files: Mapping[str, str],
    cameras: Mapping[tuple, str],
) -> str:
    origin = " # proposed: the UTM zone of the positions" if proposed and crs else ""
    lines = [
        f"# Site {name}. null is an open question.",
        f"name: {name}",
        f"crs: {_quoted(crs)}{origin}",
        "# What heights of positions, control and products refer to, in words, such as 'DHHN2016 heights'.",
        f"vertical_datum: {_quoted(vertical_datum)}",
        "# GNSS heights are used as the recorder gives them; control points decide where there are any.",
        "gnss_height: as recorded",
        "# Folder of the photographs; names in photographs.csv are relative to it.",
        f"photographs: {_quoted(photographs)}",
        "# Zone of the cameras' clocks where EXIF holds no GNSS time (IANA name); the sun needs it.",
        f"time_zone: {_quoted(time_zone)}",
        "# Water level in the vertical datum, metres, and the lake side of the official shoreline.",
        f"water_level: {'null' if water_level is None else water_level}",
    ]
    lines += [f"{key}: {_quoted(files.get(key))}" for key in OPTIONAL_FILES]
    lines += [
        "# A reproducible study documents its flight.",
        "flight:",
        *[f"  {key}: null" for key in ("purpose", "operator", "platform", "weather", "wind", "notes")],
        "# Inner orientation a priori. An unknown model is asked for, never guessed.",
        "cameras:",
    ]
    for (_, make, model, serial, focal, size), identifier in cameras.items():
        sensor = find_sensor(make, model)
        width = None if sensor is None else sensor.sensor_width * 1000
        if focal is None and sensor is not None:
            focal = sensor.focal_length
        lines += [
            f"  {identifier}:",
            f"    make: {_quoted(make)}",
            f"    model: {_quoted(model)}",
            f"    serial: {_quoted(serial)}",
            f"    width: {size[0]}",
            f"    height: {size[1]}",
            f"    focal_length_mm: {'null' if focal is None else round(focal * 1000, 4)}",
            f"    sensor_width_mm: {'null' if width is None else round(width, 4)}",
            f"    source: {'camera table' if sensor else 'question'}",
            "    distortion: []",
        ]
    return "\n".join(lines) + "\n"


def _quoted(text: str | None) -> str:
    return "null" if not text else '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
