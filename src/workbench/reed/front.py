"""Front of the reed towards open water, islets and holes [reed 2.5.4]."""

from __future__ import annotations

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.geometry.base import BaseGeometry

from workbench.errors import ReedError
from workbench.params import ReedParameters
from workbench.reed.extent import ReedExtent

_DEFAULTS = ReedParameters()
_EDGE = 0.05  # Share of a pixel within which an outline lies on the border of something.
_CLOSED = 1e-9  # Share of its length by which the ends of a closed line may miss each other by rounding.


@dataclass(frozen=True, eq=False)
class Front:
    """Lines between reed and open water."""

    lines: gpd.GeoDataFrame
    """Open pieces: ``length_m``, ``straight_m`` (between the ends), ``sinuosity``."""
    closed: gpd.GeoDataFrame
    """Closed lines as polygons: ``kind`` (islet: reed away from the shore; hole: water in the reed;
    unknown: more than half of the line runs along ground without heights, or little else is in it),
    ``area_m2``."""


def sinuosity(line: BaseGeometry | gpd.GeoSeries | gpd.GeoDataFrame | ArrayLike) -> float:
    """Length of a front over the straight distance between its ends [reed 2.5.4].

    Pieces that meet are joined; of several pieces the lengths and the distances are summed first.

    Parameters
    ----------
    line
        Line or lines, or the (n, 2) coordinates of one.

    Returns
    -------
    float
        At least 1; NaN for closed lines, whose ends have no distance, and for no line at all.

    Raises
    ------
    ReedError
        If the geometry is no line.
    """
    pieces = _pieces_of(line)
    length, straight = float(shapely.length(pieces).sum()), float(_straight(pieces).sum())
    return max(length / straight, 1.0) if straight > _CLOSED * length else float("nan")


def _pieces_of(line: BaseGeometry | gpd.GeoSeries | gpd.GeoDataFrame | ArrayLike) -> np.ndarray:
    if isinstance(line, gpd.GeoSeries | gpd.GeoDataFrame):
        shapes = line.geometry.to_numpy()
    elif isinstance(line, BaseGeometry):
        shapes = np.array([line], dtype=object)
    else:
        coordinates = np.asarray(line, dtype=float)
        if coordinates.ndim != 2 or coordinates.shape[1] != 2:
            raise ReedError(f"Sinuosity of values of shape {coordinates.shape}: give (n, 2) coordinates.")
        shapes = np.array([shapely.LineString(coordinates)], dtype=object)
    strange = [
        s.geom_type for s in shapes if s.geom_type not in ("LineString", "MultiLineString", "LinearRing")
    ]
    if strange:
        raise ReedError(f"Sinuosity of a {strange[0]}: give the line of the front.")
    parts = shapely.get_parts(shapes)
    if len(parts) > 1:
        parts = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(parts)))
    return parts


def trace_front(
    extent: ReedExtent,
    *,
    shore_tolerance: float = _DEFAULTS.shore_tolerance,
    smoothing: float = _DEFAULTS.front_smoothing,
    shortest: float = _DEFAULTS.front_piece,
    min_hole: float = _DEFAULTS.min_hole,
) -> Front:
    """Outline of the reed minus the shoreline, and its closed lines.

    A patch that comes within the tolerance of the shoreline, or of the border of the surface, stands on
    the shore: its outline is front, except along the shoreline, the border, and unknown ground. Any
    other patch is an islet, rings inside of patches are holes, unless they mostly run along unknown ground.

    Parameters
    ----------
    extent
        As :func:`workbench.reed.map_extent` gives it.
    shore_tolerance
        Outline so near to the shoreline is no front, m.
    smoothing
        Tolerance, in pixels, of the straight lines that replace the corners of pixels. A straight front
        at any angle then has sinuosity 1 (up to 1.41 along pixel edges).
    shortest
        Shorter open pieces are dropped, m.
    min_hole
        A ring that holds less water of known height is no hole, m². The extent keeps such rings open
        because of ground without heights in them, then they are unknown; or because they hang on other
        water by the corner of a cell, then they are part of that and not listed.
    """
    pixel = extent.grid.resolution
    edge = _EDGE * pixel
    patches = shapely.get_parts(extent.reed)
    shore_zone = shapely.buffer(extent.shore, max(shore_tolerance, edge))
    frame = shapely.buffer(shapely.box(*extent.grid.bounds).boundary, edge)
    gaps = shapely.get_parts(extent.unknown)
    for zone in (shore_zone, frame):
        shapely.prepare(zone)
    ashore = shapely.intersects(shore_zone, patches) | shapely.intersects(frame, patches)
    lines = shapely.get_exterior_ring(patches[ashore])
    for zone in (shore_zone, frame, _beside(gaps, lines, edge)):
        lines = _without(lines, zone)
    lines = lines[shapely.length(lines) > 0]
    lines = shapely.simplify(lines, smoothing * pixel, preserve_topology=False) if smoothing > 0 else lines
    lines = lines[shapely.length(lines) >= shortest]
    islets = shapely.get_exterior_ring(patches[~ashore])
    holes = np.array([ring for patch in patches for ring in patch.interiors], dtype=object)
    rings = np.concatenate([islets, holes])
    kinds = np.array(["islet"] * len(islets) + ["hole"] * len(holes), dtype=object)
    kinds[_mostly_beside(rings, gaps, edge)] = "unknown"
    shapes = shapely.polygons(rings)
    least = min_hole * (1 - 1e-9)
    kinds[(kinds == "hole") & (_known_area(shapes, gaps) < least)] = "unknown"
    # A small ring of known heights is left only where it hangs on other water by the corner of a cell.
    pocket = (kinds == "unknown") & (_known_area(shapes, gaps) > (1 - 1e-6) * shapely.area(shapes))
    pocket &= (shapely.area(shapes) < least) & (np.arange(len(rings)) >= len(islets))
    kinds, shapes = kinds[~pocket], shapes[~pocket]
    closed = gpd.GeoDataFrame(
        {"kind": kinds, "area_m2": shapely.area(shapes)}, geometry=shapes, crs=extent.grid.crs
    )
    return Front(_line_frame(lines, extent), closed)


def _beside(gaps: np.ndarray, lines: np.ndarray, edge: float) -> BaseGeometry:
    """Gaps that lines run along, widened by a hair."""
    near = shapely.STRtree(gaps).query(lines, predicate="dwithin", distance=edge)[1]
    return shapely.union_all(shapely.buffer(gaps[np.unique(near)], edge, quad_segs=1))


def _mostly_beside(rings: np.ndarray, gaps: np.ndarray, edge: float) -> np.ndarray:
    """Whether more than half of a ring runs along gaps."""
    ring, gap = shapely.STRtree(gaps).query(rings, predicate="dwithin", distance=edge)
    along = shapely.length(
        shapely.intersection(rings[ring], shapely.buffer(gaps[gap], edge, quad_segs=1, join_style="mitre"))
    )
    return np.bincount(ring, along, minlength=len(rings)) > 0.5 * shapely.length(rings)


def _known_area(shapes: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """Area of polygons without the gaps in them, m²."""
    shape, gap = shapely.STRtree(shapely.point_on_surface(gaps)).query(shapes, predicate="contains")
    return shapely.area(shapes) - np.bincount(shape, shapely.area(gaps[gap]), minlength=len(shapes))


def _without(lines: np.ndarray, zone: BaseGeometry) -> np.ndarray:
    """Parts of lines outside of a zone, joined where they meet."""
    if zone.is_empty or not len(lines):
        return lines
    shapely.prepare(zone)
    touched = shapely.intersects(zone, lines)
    rest = shapely.line_merge(shapely.difference(lines[touched], zone))
    return np.concatenate([lines[~touched], shapely.get_parts(rest)])


def _straight(lines: np.ndarray) -> np.ndarray:
    return shapely.distance(shapely.get_point(lines, 0), shapely.get_point(lines, -1))


def _line_frame(lines: np.ndarray, extent: ReedExtent) -> gpd.GeoDataFrame:
    length, straight = shapely.length(lines), _straight(lines)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(straight > _CLOSED * length, length / straight, np.nan)
    values = {"length_m": length, "straight_m": straight, "sinuosity": ratio}
    return gpd.GeoDataFrame(values, geometry=lines, crs=extent.grid.crs)
