"""Transects from the water to the shore, and the strips between them."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import geopandas as gpd
import numpy as np
import shapely
from scipy.ndimage import gaussian_filter1d
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from workbench.errors import ReedError
from workbench.params import ReedParameters

_DEFAULTS = ReedParameters()
_STEP = 1.0  # Distance of the points of a smoothed shoreline, m.


def strips(
    transects: gpd.GeoDataFrame,
    shore: BaseGeometry,
    *,
    beyond: float = _DEFAULTS.box_buffer,
    may_cross: bool = False,
) -> gpd.GeoDataFrame:
    """Strips between neighbouring transects of each area, in the order of their numbers.

    Parameters
    ----------
    transects
        Lines with ``aoi`` and ``transect`` (number).
    shore
        The shoreline, lines; it decides which end is in the water. If empty, lines run from the water.
    beyond
        Strips reach so far beyond both ends of the transects, m, unless they would cross there.
    may_cross
        Transects that are no neighbours may cross, as those of :func:`lay_transects` do in a narrow bay.

    Returns
    -------
    GeoDataFrame
        ``aoi``, ``section`` (1 between the first two transects ...), quadrilaterals.

    Raises
    ------
    ReedError
        If columns are missing, a transect is no line, or two transects of an area cross.
    """
    lacking = [column for column in ("aoi", "transect") if column not in transects.columns]
    if lacking:
        raise ReedError(f"Transects lack the column {' and '.join(lacking)}: add it, one line a transect.")
    rows = []
    for aoi, part in transects.groupby("aoi", sort=False):
        part = part.sort_values("transect")
        walks = [_walk(row, shore) for row in part.itertuples()]
        numbers = list(part.transect)
        if not may_cross:
            _refuse_crossing(str(aoi), numbers, walks)
        for index, (first, second) in enumerate(pairwise(walks), start=1):
            strip = _strip(_longer(first, beyond), _longer(second, beyond))
            if not strip.is_valid:
                strip = shapely.convex_hull(_strip(first, second))
            rows.append({"aoi": str(aoi), "section": index, "geometry": strip})
    return gpd.GeoDataFrame(
        rows, columns=["aoi", "section", "geometry"], geometry="geometry", crs=transects.crs
    )


def lay_transects(
    shore: BaseGeometry,
    lake: BaseGeometry,
    crs: object,
    *,
    spacing: float = _DEFAULTS.section_length,
    length: float = _DEFAULTS.transect_length,
    smoothing: float = _DEFAULTS.shore_smoothing,
    aoi: str = "shore",
) -> gpd.GeoDataFrame:
    """Transects at equal distances along a smoothed line parallel to the shore, where there are none.

    Parameters
    ----------
    shore
        The shoreline, lines.
    lake
        Lake side, polygons.
    crs
        Of both.
    spacing
        Along the smoothed line, m; what is left at its ends is shared.
    length
        How far a transect reaches into the lake, m; neighbours that would cross are shortened.
    smoothing
        Standard deviation of the Gaussian along the shoreline, m.
    aoi
        Name of the shore; several pieces are numbered.

    Returns
    -------
    GeoDataFrame
        ``aoi``, ``transect``, lines from the water to the shore. None for a shore shorter than a section.
    """
    pieces = [line for line in shapely.get_parts(_merged(shore)) if line.length >= spacing * (1 - 1e-3)]
    shapely.prepare(lake)
    rows = []
    for number, line in enumerate(pieces, start=1):
        name = aoi if len(pieces) == 1 else f"{aoi} {number}"
        feet, heads = _stations(line, lake, spacing, length, smoothing)
        for index, (foot, head) in enumerate(zip(feet, heads, strict=True), start=1):
            rows.append({"aoi": name, "transect": index, "geometry": LineString([head, foot])})
    return gpd.GeoDataFrame(rows, columns=["aoi", "transect", "geometry"], geometry="geometry", crs=crs)


def _merged(shore: BaseGeometry) -> BaseGeometry:
    return shapely.line_merge(shore) if shore.geom_type == "MultiLineString" else shore


def _stations(
    line: BaseGeometry, lake: BaseGeometry, spacing: float, length: float, smoothing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Feet on the smoothed shore and heads in the lake, (n, 2) each."""
    count = max(int(np.ceil(line.length / _STEP)), 2)
    points = shapely.get_coordinates(line.interpolate(np.linspace(0, line.length, count + 1)))
    step = line.length / count
    if line.is_ring:
        points = np.vstack([gaussian_filter1d(points[:-1], smoothing / step, axis=0, mode="wrap")] * 2)
        points = points[: count + 1]
    else:
        # Mirrored through the ends, so that these stay where they are and straight stays straight.
        far = min(int(4 * smoothing / step), count)
        before, after = 2 * points[0] - points[far:0:-1], 2 * points[-1] - points[-2 : -far - 2 : -1]
        points = gaussian_filter1d(np.vstack([before, points, after]), smoothing / step, axis=0)
        points = points[far : far + count + 1]
    smooth = LineString(points)
    number = int(smooth.length / spacing + 1e-3)
    if number < 1:
        return np.zeros((0, 2)), np.zeros((0, 2))
    places = (smooth.length - number * spacing) / 2 + np.arange(number + 1) * spacing
    places = np.clip(places, 0, smooth.length)
    feet = shapely.get_coordinates(smooth.interpolate(places))
    half = spacing / 2
    ahead = shapely.get_coordinates(smooth.interpolate(np.minimum(places + half, smooth.length)))
    behind = shapely.get_coordinates(smooth.interpolate(np.maximum(places - half, 0)))
    along = (ahead - behind) / np.linalg.norm(ahead - behind, axis=1)[:, None]
    out = np.column_stack([-along[:, 1], along[:, 0]])
    wet = [shapely.contains_xy(lake, *(feet + side * half * out).T).sum() for side in (1, -1)]
    out = out if wet[0] >= wet[1] else -out
    return feet, feet + _reaches(feet, out, length)[:, None] * out


def _reaches(feet: np.ndarray, out: np.ndarray, length: float) -> np.ndarray:
    """Lengths of transects, shortened before neighbours cross."""
    reach = np.full(len(feet), length)
    for i in range(len(feet) - 1):
        cross = out[i, 0] * out[i + 1, 1] - out[i, 1] * out[i + 1, 0]
        if abs(cross) < 1e-12:
            continue
        gap = feet[i + 1] - feet[i]
        here = (gap[0] * out[i + 1, 1] - gap[1] * out[i + 1, 0]) / cross
        there = (gap[0] * out[i, 1] - gap[1] * out[i, 0]) / cross
        if here > 0 and there > 0:
            reach[i], reach[i + 1] = min(reach[i], 0.9 * here), min(reach[i + 1], 0.9 * there)
    return reach


def _walk(row: Any, shore: BaseGeometry) -> np.ndarray:
    """Ends (2, 2) of a transect, first the one in the water."""
    line = row.geometry
    if line is None or line.geom_type != "LineString" or line.length == 0:
        kind = "nothing" if line is None else line.geom_type
        raise ReedError(
            f"Transect {row.transect} of {row.aoi} is {kind}: draw a line from the water to the shore."
        )
    ends = shapely.get_coordinates(line)[[0, -1], :2]
    if not shore.is_empty:
        first, last = shapely.distance(shore, shapely.points(ends))
        if first < last:
            ends = ends[::-1]
    return ends


def _refuse_crossing(aoi: str, numbers: list, walks: list[np.ndarray]) -> None:
    lines = [LineString(walk) for walk in walks]
    for i, first in enumerate(lines):
        for j in range(i + 1, len(lines)):
            if first.crosses(lines[j]):
                raise ReedError(
                    f"Transects {numbers[i]} and {numbers[j]} of area {aoi} cross: sections lie between "
                    "neighbouring transects. Are their numbers or points mixed up?"
                )


def _longer(walk: np.ndarray, beyond: float) -> np.ndarray:
    direction = (walk[1] - walk[0]) / np.linalg.norm(walk[1] - walk[0])
    return np.array([walk[0] - beyond * direction, walk[1] + beyond * direction])


def _strip(first: np.ndarray, second: np.ndarray) -> Polygon:
    return Polygon([first[0], second[0], second[1], first[1]])
