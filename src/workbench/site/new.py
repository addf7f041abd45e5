"""Making a site from a folder of photographs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from workbench.cameras import Pose
from workbench.errors import SiteError
from workbench.params import OrientParameters
from workbench.site.control import (
    read_control,
    read_observations,
    render_control,
    render_observations,
)
from workbench.site.describe import OPTIONAL_FILES, Description, render_site
from workbench.site.files import (
    load_site,
    projected,
    read_description,
    relative_to,
    render_photographs,
    time_zone_of,
    with_sun,
    write_text,
)
from workbench.site.gcp_list import gcp_list_crs, is_gcp_list, read_gcp_list
from workbench.site.model import Observation, Photograph, Site
from workbench.site.names import find_photographs
from workbench.site.navigation import NavigationFormat, NavigationRow, grid_convergence, read_navigation
from workbench.site.places import doubtful_degrees, far_from_rest, utm_zone
from workbench.site.scan import Found, number_cameras, scan_photographs
from workbench.site.strips import find_strips

_UNKNOWN_HEIGHT_SD = 10_000.0  # Metres: a height that was not recorded weighs nothing.


def new_site(
    name: str,
    *,
    photos: Path | str,
    root: Path | str = ".",
    navigation: Path | str | None = None,
    navigation_format: NavigationFormat | None = None,
    control: Path | str | None = None,
    observations: Path | str | None = None,
    crs: str | None = None,
    vertical_datum: str | None = None,
    time_zone: str | None = None,
    water_level: float | None = None,
    **optional: Path | str | None,
) -> Site:
    """Describe photographs as a site: ``site.yaml``, ``photographs.csv``, control and observations.

    Photographs are referenced, not copied. Damaged ones are set aside with the reason; recorded
    positions that cannot be true are left out with a note. Where the site exists already, what its
    ``site.yaml`` answers is kept unless given anew, and so are control and observations.

    Parameters
    ----------
    name
        Folder to make under ``data/sites``.
    photos
        Folder of JPEG and TIFF files; subfolders are read too, one a camera for a rig.
    navigation, navigation_format
        Text file of positions and angles, see :func:`workbench.site.read_navigation`; goes before EXIF.
    control, observations
        Control file and measurements, or OpenDroneMap's ``gcp_list.txt`` as ``control``.
    crs
        Projected CRS, metres; if not given, the UTM zone of the positions, or that of ``gcp_list.txt``.
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
        If there are no photographs, the CRS is unusable, a file cannot be understood, or the folder
        cannot be written.
    """
    unknown = sorted(set(optional) - set(OPTIONAL_FILES))
    if unknown:
        raise SiteError(f"Unknown site file(s) {', '.join(unknown)}; known are {', '.join(OPTIONAL_FILES)}.")
    root, photos = Path(root), Path(photos)
    folder = root / "data" / "sites" / name
    before = read_description(folder / "site.yaml") if (folder / "site.yaml").exists() else {}
    zone = time_zone or before.get("time_zone")
    time_zone_of(zone, folder / "site.yaml")

    found = scan_photographs(photos)
    stated_crs = crs or before.get("crs")
    chosen = _choose_crs(stated_crs, found, navigation, control)
    cameras = number_cameras(found)
    rows = read_navigation(navigation, chosen, navigation_format) if navigation and chosen else {}
    photographs = [
        _photograph(item, cameras[item.name][0] if item.name in cameras else "", row, chosen)
        for item, row in zip(found, _rows_of(found, rows, navigation), strict=True)
    ]
    photographs = _order(_without_far_positions(photographs))
    photographs = with_sun(photographs, chosen, time_zone_of(zone, folder / "site.yaml"))

    _write_control(folder, control, observations, chosen, photographs)
    write_text(render_photographs(photographs), folder / "photographs.csv")
    files = {key: before.get(key) for key in OPTIONAL_FILES}
    files |= {key: relative_to(Path(value), folder) for key, value in optional.items() if value}
    description = Description(
        name,
        crs=_crs_text(chosen),
        crs_is_proposed=stated_crs is None,
        vertical_datum=vertical_datum or before.get("vertical_datum"),
        photographs=relative_to(photos, folder),
        time_zone=zone,
        water_level=before.get("water_level") if water_level is None else water_level,
        files=files,
        flight=before.get("flight") or {},
        cameras=dict(sorted(cameras.values())),
        answers=before.get("cameras") or {},
    )
    write_text(render_site(description), folder / "site.yaml")
    return load_site(name, root)


def _choose_crs(
    stated: str | None, found: list[Found], navigation: Path | str | None, control: Path | str | None
) -> CRS | None:
    if stated is not None:
        try:
            return projected(CRS.from_user_input(stated), f"CRS {stated}")
        except CRSError as error:
            raise SiteError(f"CRS '{stated}' is unknown. Write it as EPSG:n.") from error
    places = [
        (item.facts.longitude, item.facts.latitude)
        for item in found
        if item.facts.longitude is not None
        and item.facts.latitude is not None
        and not doubtful_degrees(item.facts.longitude, item.facts.latitude)
    ]
    if not places:
        if navigation:
            raise SiteError(f"{navigation}: state the CRS of the site with --crs EPSG:n.")
        if control is None or not is_gcp_list(control):
            return None
        return projected(gcp_list_crs(control), f"The CRS of {control}")
    longitude, latitude = np.median(np.array(places, dtype=float), axis=0)
    return utm_zone(float(longitude), float(latitude))


def _crs_text(crs: CRS | None) -> str | None:
    if crs is None:
        return None
    return f"EPSG:{crs.to_epsg()}" if crs.to_epsg() else crs.to_wkt()


def _rows_of(
    found: list[Found], rows: Mapping[str, NavigationRow], navigation: Path | str | None
) -> list[NavigationRow | None]:
    """Navigation of each photograph."""
    if not rows:
        return [None] * len(found)
    photos = find_photographs(rows, [item.name for item in found])
    owners = {photo: rows[name] for name, photo in photos.items()}
    if not owners:
        raise SiteError(
            f"{navigation}: none of its {len(rows)} rows names a photograph; the first is "
            f"'{next(iter(rows))}', the first photograph '{found[0].name}'. Mend the names."
        )
    return [owners.get(item.name) for item in found]


def _photograph(item: Found, camera: str, row: NavigationRow | None, crs: CRS | None) -> Photograph:
    facts = item.facts
    photograph = Photograph(
        item.name,
        item.path,
        camera,
        time=facts.time,
        height_above_ground=facts.relative_altitude,
        bands=item.bands,
        set_aside=item.problem,
    )
    note = doubtful_degrees(facts.longitude, facts.latitude)
    if facts.longitude is not None and facts.latitude is not None and not note and crs is not None:
        photograph = replace(photograph, **_recorded(item, crs))
    elif note and row is None:
        photograph = replace(photograph, note=note)
    if row is not None:
        photograph = replace(
            photograph,
            position=row.position,
            position_sd=row.position_sd,
            attitude=row.attitude or photograph.attitude,
            attitude_sd=row.attitude_sd,
            time=row.time or photograph.time,
            note="",
        )
    return photograph


def _recorded(item: Found, crs: CRS) -> dict[str, Any]:
    """Position, standard deviations and angles that EXIF and XMP hold, in the site's CRS."""
    facts = item.facts
    transform = Transformer.from_crs(CRS.from_epsg(4326), crs, always_xy=True)
    x, y = transform.transform(facts.longitude, facts.latitude)
    if not np.isfinite([x, y]).all():
        return {"note": f"recorded position {facts.longitude}, {facts.latitude} has no place in {crs.name}"}
    deviations, note = facts.position_sd, ""
    if facts.altitude is None:
        usual = OrientParameters().gnss_sd_xy
        east, north = deviations[:2] if deviations else (usual, usual)
        deviations, note = (east, north, _UNKNOWN_HEIGHT_SD), "no altitude recorded"
    position = (float(x), float(y), facts.altitude or 0.0)
    attitude = None
    if facts.gimbal is not None:
        roll, pitch, yaw = facts.gimbal
        heading = yaw - grid_convergence(x, y, crs)
        pose = Pose.from_roll_pitch_heading(np.array(position), roll, 0, heading, tilt_forward=90 + pitch)
        attitude = pose.omega_phi_kappa
    return {"position": position, "position_sd": deviations, "attitude": attitude, "note": note}


def _without_far_positions(photographs: list[Photograph]) -> list[Photograph]:
    """Positions far from all others become notes: the photograph may be good all the same."""
    placed = [p for p in photographs if p.position is not None]
    xy = np.array([p.position[:2] for p in placed if p.position is not None], dtype=np.float64).reshape(-1, 2)
    middle = np.median(xy, axis=0) if len(xy) else np.zeros(2)
    notes = {}
    for p, far, place in zip(placed, far_from_rest(xy), xy, strict=True):
        if far:
            away = np.hypot(*(place - middle)) / 1000
            notes[p.name] = f"recorded position is {away:.1f} km from the others"
    return [
        replace(p, position=None, position_sd=None, note=notes[p.name]) if p.name in notes else p
        for p in photographs
    ]


def _order(photographs: list[Photograph]) -> list[Photograph]:
    """Number strips, camera by camera, in the order of exposure."""
    numbered: dict[str, Photograph] = {}
    first = 0
    for camera in sorted({p.camera for p in photographs}):
        mine = [p for p in photographs if p.camera == camera and p.position and not p.set_aside]
        mine.sort(key=_by_time(mine))
        strip, order = find_strips([(p.position[0], p.position[1]) for p in mine if p.position])
        for p, number, place in zip(mine, strip, order, strict=True):
            numbered[p.name] = replace(p, strip=first + number, order=place)
        first += max(strip, default=-1) + 1
    return [numbered.get(p.name, p) for p in photographs]


def _by_time(photographs: list[Photograph]) -> Callable[[Photograph], tuple[float, str]]:
    """Key of the order of exposure; by name, as cameras count, where times are missing or incomparable."""
    zoned = {p.time.tzinfo is not None if p.time else None for p in photographs}
    comparable = zoned in ({True}, {False})

    def key(p: Photograph) -> tuple[float, str]:
        if not comparable or p.time is None:
            return 0.0, p.name
        return p.time.replace(tzinfo=p.time.tzinfo or UTC).timestamp(), p.name

    return key


def _write_control(
    folder: Path,
    control: Path | str | None,
    observations: Path | str | None,
    crs: CRS | None,
    photographs: list[Photograph],
) -> None:
    """Copy what is given into the site; what is not given stays, or begins as an empty table."""
    points: tuple = ()
    measured: tuple = ()
    if control is not None:
        if crs is not None and is_gcp_list(control):
            points, measured = read_gcp_list(control, crs)
        else:
            points = read_control(control)
    if observations is not None:
        measured = measured + read_observations(observations)
    measured = _with_own_names(measured, photographs, observations or control)
    if control is not None or not (folder / "control.csv").exists():
        write_text(render_control(points), folder / "control.csv")
    if measured or not (folder / "observations.csv").exists():
        write_text(render_observations(measured), folder / "observations.csv")


def _with_own_names(
    measured: tuple[Observation, ...], photographs: list[Photograph], file: Path | str | None
) -> tuple[Observation, ...]:
    """Measurements with the names of the photographs as the site has them."""
    names = find_photographs({o.photo for o in measured}, [p.name for p in photographs])
    if measured and not names:
        raise SiteError(
            f"{file}: none of its {len(measured)} measurements names a photograph; the first is in "
            f"'{measured[0].photo}', the first photograph is '{photographs[0].name}'. Mend the names."
        )
    return tuple(replace(o, photo=names.get(o.photo, o.photo)) for o in measured)
