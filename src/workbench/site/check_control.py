"""What can be wrong with control points and their observations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np
from pyproj import CRS, Transformer

from workbench.site.control import on_a_line
from workbench.site.model import ControlPoint, Problem, Site
from workbench.site.places import outside_area

_HIGHEST, _LOWEST = 9000.0, -500.0  # Metres: no point of the land is beyond, in any datum.
_DEGREES = ("its coordinates look like degrees.", "Transform them to the CRS of the site.")


def control_problems(site: Site) -> Iterator[Problem]:
    """Problems of ``control.csv`` and ``observations.csv``."""
    yield from _observations(site)
    yield from _numbers(site)
    yield from _places(site)


def _observations(site: Site) -> Iterator[Problem]:
    file, listing = str(site.folder / "control.csv"), str(site.folder / "observations.csv")
    names = {point.name for point in site.control}
    photos = {p.name: p for p in site.photographs}
    aside = {p.name for p in site.set_aside}
    if site.observations and not any(o.photo in photos for o in site.observations):
        first = site.observations[0].photo
        yield Problem(
            "error",
            listing,
            f"none of its {len(site.observations)} measurements names a photograph; the first: '{first}'.",
            "Mend the names, or delete the rows.",
        )
        return
    repeated = Counter((o.name, o.photo) for o in site.observations)
    for (name, photo), count in repeated.items():
        if count > 1:
            subject = f"{listing} ({name} in {photo})"
            yield Problem("error", subject, f"measured {count} times.", "Keep one of the rows.")
    for o in site.observations:
        subject = f"{listing} ({o.name} in {o.photo})"
        if o.name not in names:
            yield Problem("warning", subject, "no such control point.", "Add it to control.csv.")
        if o.photo not in photos:
            reason = "the photograph is set aside." if o.photo in aside else "no such photograph."
            yield Problem(
                "warning", subject, reason, "The observation is not used; mend the name if it is wrong."
            )
            continue
        camera = site.cameras.get(photos[o.photo].camera)
        if camera and not (0 <= o.column <= camera.width and 0 <= o.row <= camera.height):
            yield Problem(
                "error",
                subject,
                f"column {o.column:g}, row {o.row:g} lies outside the {camera.width} x {camera.height} px.",
                "Mend or delete it; the origin is the upper left corner.",
            )
    seen = Counter(name for name, photo in repeated if photo in photos)
    for point in site.control:
        if seen[point.name] < 2:
            yield Problem(
                "warning",
                f"{file} ({point.name})",
                f"observed in {seen[point.name]} photograph(s).",
                "It is not used: measure it in at least two.",
            )


def _numbers(site: Site) -> Iterator[Problem]:
    """Whether what is left fixes a block that has nothing else."""
    file = str(site.folder / "control.csv")
    photos = {p.name for p in site.photographs}
    seen = Counter(o.name for o in site.observations if o.photo in photos)
    useful = [p for p in site.control if p.role == "control" and seen[p.name] >= 2]
    placed = sum(p.position is not None for p in site.photographs)
    if site.control and placed < 3 and len(useful) < 3:
        yield Problem(
            "error",
            file,
            f"{len(useful)} control point(s) are measured in two photographs, and positions are lacking.",
            "Three are needed to place and level the block; measure more of them.",
        )
    elif len(useful) == 3 and placed < 3:
        yield Problem(
            "warning",
            file,
            "three control points fix the block and leave nothing to test them with.",
            "Measure more, some of them with the role check.",
        )
    # A point in another zone or with swapped axes, named below, would make the others look like a line.
    crs = None if site.crs is None else CRS.from_user_input(site.crs)
    xy = np.array([(p.x, p.y) for p in useful if _away_from_area(p, crs) is None])
    if len(xy) >= 3 and placed < 3 and on_a_line(xy):
        yield Problem(
            "error",
            file,
            "all control points lie on a line.",
            "Measure one beside it, or the block can roll.",
        )


def _places(site: Site) -> Iterator[Problem]:
    """Points that lie away from the block or where the CRS has no place: swapped axes, another zone."""
    if not site.control:
        return
    file = str(site.folder / "control.csv")
    placed = np.array([p.position[:2] for p in site.photographs if p.position is not None], dtype=np.float64)
    crs = None if site.crs is None else CRS.from_user_input(site.crs)
    for point in site.control:
        subject = f"{file} ({point.name})"
        if not _LOWEST <= point.z <= _HIGHEST:
            yield Problem(
                "error", subject, f"its height is {point.z:g} m.", "Columns may be mixed up; mend them."
            )
        if len(placed):
            fault = _away_from(placed, point, crs)
        else:
            fault = _away_from_area(point, crs)
        if fault:
            yield Problem("error", subject, *fault)


def _away_from(placed: np.ndarray, point: ControlPoint, crs: CRS | None) -> tuple[str, str] | None:
    """What is wrong with the place of a point beside a block, and the remedy; None if it is near."""
    low, high = placed.min(axis=0), placed.max(axis=0)
    # Points may lie outside of the outermost positions by half a footprint: the block's size is ample.
    reach = max(float(np.hypot(*(high - low))), 500.0)

    def near(x: float, y: float) -> bool:
        return bool(np.all(np.array([x, y]) > low - reach) and np.all(np.array([x, y]) < high + reach))

    if near(point.x, point.y):
        return None
    if near(point.y, point.x):
        return "x and y are swapped.", "Exchange the two columns."
    for other in _neighbouring_zones(crs):
        x, y = Transformer.from_crs(other, crs, always_xy=True).transform(point.x, point.y)
        if near(x, y):
            return (
                f"its coordinates are in {other.name}.",
                f"Transform them to {crs.name if crs else 'the CRS'}; of a gcp_list.txt, mend the zone.",
            )
    away = np.hypot(point.x - placed[:, 0].mean(), point.y - placed[:, 1].mean()) / 1000
    if _looks_like_degrees(point):
        return _DEGREES
    return f"it lies {away:.1f} km from the photographs.", "Check its coordinates and their CRS."


def _away_from_area(point: ControlPoint, crs: CRS | None) -> tuple[str, str] | None:
    """The same without positions of photographs, from the area of the CRS alone."""
    if crs is None or not outside_area(np.array([[point.x, point.y]]), crs)[0]:
        return None
    if not outside_area(np.array([[point.y, point.x]]), crs)[0]:
        return "x and y are swapped.", "Exchange the two columns."
    if _looks_like_degrees(point):
        return _DEGREES
    return f"it lies outside of the area of {crs.name}.", "Check its coordinates and their CRS."


def _looks_like_degrees(point: ControlPoint) -> bool:
    return min(abs(point.x), abs(point.y)) <= 90 and max(abs(point.x), abs(point.y)) <= 180


def _neighbouring_zones(crs: CRS | None) -> list[CRS]:
    """UTM zones beside that of the site, and the same zone of the other hemisphere."""
    epsg = None if crs is None else crs.to_epsg()
    if epsg is None:
        return []
    family = next((base for base in (32600, 32700, 25800) if base < epsg <= base + 60), None)
    if family is None:
        return []
    first, last = (28, 38) if family == 25800 else (1, 60)
    zone = epsg - family
    zones = [family + z for z in (zone - 2, zone - 1, zone + 1, zone + 2) if first <= z <= last]
    mirrored = {32600: [32700 + zone], 32700: [32600 + zone]}.get(family, [])
    return [CRS.from_epsg(code) for code in zones + mirrored]
