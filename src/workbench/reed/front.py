"""Front of the reed towards open water, islets and holes [reed 2.5.4]."""

from __future__ import annotations

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from workbench.errors import ReedError
from workbench.params import ReedParameters
from workbench.reed.extent import ReedExtent

_DEFAULTS = ReedParameters()
_EDGE = 0.05  # Share of a pixel within which an outline lies on the border of something.


@dataclass(frozen=True, eq=False)
class Front:
    """Lines between reed and open water."""

    lines: gpd.GeoDataFrame
    """Open pieces: ``length_m``, ``straight_m`` (between the ends), ``sinuosity``."""
    closed: gpd.GeoDataFrame
    """Closed lines as polygons: ``kind`` (islet: reed away from the shore; hole: water in the reed;
    unknown: a gap whose surface is mostly unknown), ``area_m2``."""


def sinuosity(line: BaseGeometry) -> float:
    """Length of a front over the straight distance between its ends [reed 2.5.4].

    Of several pieces the lengths and the distances are summed first.

    Returns
    -------
    float
        At least 1; NaN for closed lines, whose ends have no distance.

    Raises
    ------
    ReedError
        If the geometry is no line.
    """
    if line.geom_type not in ("LineString", "MultiLineString", "LinearRing"):
        raise ReedError(f"Sinuosity of a {line.geom_type}: give the line of the front.")
    pieces = shapely.get_parts(line)
    straight = float(_straight(pieces).sum())
    return float(shapely.length(pieces).sum()) / straight if straight > 0 else float("nan")


def trace_front(
    extent: ReedExtent,
    *,
    shore_tolerance: float = _DEFAULTS.shore_tolerance,
    smoothing: float = _DEFAULTS.front_smoothing,
    shortest: float = _DEFAULTS.front_piece,
) -> Front:
    """Outline of the reed minus the shoreline, and its closed lines.

    A patch that comes within the tolerance of the shoreline, or of the border of the surface, stands on
    the shore: its outline is front, except along the shoreline, the border, and unknown ground. Any
    other patch is an islet. Rings inside of patches are holes, unless most of their area is unknown.

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
    """
    pixel = extent.grid.resolution
    patches = shapely.get_parts(extent.reed)
    shore_zone = shapely.buffer(extent.shore, max(shore_tolerance, _EDGE * pixel))
    frame = shapely.buffer(shapely.box(*extent.grid.bounds).boundary, _EDGE * pixel)
    for zone in (shore_zone, frame):
        shapely.prepare(zone)
    ashore = shapely.intersects(shore_zone, patches) | shapely.intersects(frame, patches)
    dark = shapely.buffer(extent.unknown, _EDGE * pixel)
    lines = shapely.get_exterior_ring(patches[ashore])
    for zone in (shore_zone, frame, dark):
        lines = _without(lines, zone)
    lines = lines[shapely.length(lines) > 0]
    lines = shapely.simplify(lines, smoothing * pixel, preserve_topology=False) if smoothing > 0 else lines
    lines = lines[shapely.length(lines) >= shortest]
    islets = shapely.polygons(shapely.get_exterior_ring(patches[~ashore]))
    rings = [ring for patch in patches for ring in patch.interiors]
    holes = shapely.polygons(rings) if rings else np.array([], dtype=object)
    return Front(_line_frame(lines, extent), _closed_frame(islets, holes, extent))


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
        ratio = np.where(straight > 0, length / straight, np.nan)
    values = {"length_m": length, "straight_m": straight, "sinuosity": ratio}
    return gpd.GeoDataFrame(values, geometry=lines, crs=extent.grid.crs)


def _closed_frame(islets: np.ndarray, holes: np.ndarray, extent: ReedExtent) -> gpd.GeoDataFrame:
    kinds = np.array(["islet"] * len(islets) + ["hole"] * len(holes), dtype=object)
    if len(holes) and not extent.unknown.is_empty:
        dark = shapely.area(shapely.intersection(holes, extent.unknown))
        kinds[len(islets) :][dark > 0.5 * shapely.area(holes)] = "unknown"
    shapes = np.concatenate([islets, holes])
    values = {"kind": kinds, "area_m2": shapely.area(shapes)}
    return gpd.GeoDataFrame(values, geometry=shapes, crs=extent.grid.crs)
