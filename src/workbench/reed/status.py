"""Status of 10 m sections: the aquatic reed status index [reed 2.5.5]."""

from __future__ import annotations

from typing import Any

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from workbench.errors import ReedError
from workbench.params import ReedParameters
from workbench.reed.front import Front, sinuosity

_DEFAULTS = ReedParameters()
_SINUOSITY_WEIGHT = 3.0
_VERTICES = 64
HEALTHY, STRESSED, EXCLUDED = "healthy", "stressed", "excluded"

SECTION_COLUMNS = [
    "aoi",
    "section",
    "front_m",
    "straight_m",
    "sinuosity",
    "fronts",
    "islets",
    "holes",
    "sparse_m2",
    "dense_m2",
    "unknown_m2",
    "arsi",
    "status",
    "reason",
]


def arsi(
    sinuosity: ArrayLike, islets: ArrayLike, holes: ArrayLike, sparse_area: ArrayLike, dense_area: ArrayLike
) -> Any:
    """Aquatic reed status index: 3 S + islets + holes + sparse / dense [reed 2.5.5].

    Without dense reed the ratio grows beyond all limits: the index is infinite where there is sparse
    reed, and NaN where there is no reed at all. Without a front (S is NaN) it is NaN.

    Parameters
    ----------
    sinuosity
        Of the front, at least 1, or NaN.
    islets, holes
        Numbers of closed lines.
    sparse_area, dense_area
        m². All of them numbers or arrays of one shape.

    Returns
    -------
    float or ndarray
        At least 3. Worked example: sinuosity 1.5, one islet, two holes, 20 m² sparse and 80 m² dense
        reed give 4.5 + 1 + 2 + 0.25:

    >>> arsi(1.5, 1, 2, 20.0, 80.0)
    7.75

    Raises
    ------
    ReedError
        If a number or area is negative, or a sinuosity below 1.
    """
    s, i, h, sparse, dense = (
        np.asarray(value, dtype=float) for value in (sinuosity, islets, holes, sparse_area, dense_area)
    )
    for name, value in (("islets", i), ("holes", h), ("sparse_area", sparse), ("dense_area", dense)):
        if np.any(value < 0):
            raise ReedError(f"aRSI: {name} is negative ({value.min():g}).")
    if np.any(s < 1 - 1e-9):
        raise ReedError(
            f"aRSI: a sinuosity of {np.nanmin(s):g} is below 1: lines are no shorter than straight."
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        index = _SINUOSITY_WEIGHT * s + i + h + sparse / dense
    return float(index) if index.ndim == 0 else index


def classify(index: ArrayLike, cut: float = _DEFAULTS.arsi_cut) -> np.ndarray:
    """Status of each index: healthy below the cut, stressed at it and above, excluded where NaN."""
    index = np.asarray(index, dtype=float)
    status = np.where(index < cut, HEALTHY, STRESSED)
    return np.where(np.isnan(index), EXCLUDED, status)


def assess_sections(
    strips: gpd.GeoDataFrame,
    front: Front,
    cells: gpd.GeoDataFrame,
    unknown: BaseGeometry,
    *,
    box_buffer: float = _DEFAULTS.box_buffer,
    shortest: float = _DEFAULTS.front_piece,
    cut: float = _DEFAULTS.arsi_cut,
) -> gpd.GeoDataFrame:
    """Metrics, index and status of every section.

    The box of a section is a rectangle, ``box_buffer`` to both sides of the straight line between the
    outermost points of its front, cut at its strip, so that nothing counts twice. Closed lines belong to
    the box that holds a point of their inside, density cells to the box that holds their middle. Several
    pieces of front in a section are taken together: their lengths over the distances of their ends.

    Parameters
    ----------
    strips
        ``aoi``, ``section`` and the strip between two transects.
    front
        As :func:`workbench.reed.trace_front` gives it.
    cells
        As :func:`workbench.reed.density_cells` gives it.
    unknown
        Area of the lake without heights.
    box_buffer
        m.
    shortest
        Shorter pieces of front within a section are ignored, m.
    cut
        See :func:`classify`.

    Returns
    -------
    GeoDataFrame
        ``SECTION_COLUMNS`` and the box (of excluded sections: the strip). ``status`` is healthy,
        stressed or excluded; ``reason`` says why it is excluded.
    """
    lines = _short(front.lines.geometry.to_numpy())
    tree = shapely.STRtree(lines)
    points = front.closed.geometry.representative_point().to_numpy()
    closed = shapely.STRtree(points)
    middles = shapely.centroid(cells.geometry.to_numpy())
    cell_tree = shapely.STRtree(middles)
    kinds = front.closed.kind.to_numpy()
    density, area = cells.density.to_numpy(), cells.reed_m2.to_numpy(dtype=float)
    rows = []
    for strip in strips.itertuples():
        near = lines[np.sort(tree.query(strip.geometry, predicate="intersects"))]
        pieces = _pieces(near, strip.geometry, shortest)
        box = _box(pieces, strip.geometry, box_buffer)
        inside = closed.query(box, predicate="intersects")
        stand = cell_tree.query(box, predicate="intersects")
        areas = {
            name: float(area[stand][density[stand] == name].sum()) for name in ("sparse", "dense", "unknown")
        }
        rows.append(
            {
                "aoi": strip.aoi,
                "section": strip.section,
                "front_m": float(shapely.length(pieces).sum()),
                "straight_m": float(
                    shapely.distance(shapely.get_point(pieces, 0), shapely.get_point(pieces, -1)).sum()
                ),
                "sinuosity": sinuosity(shapely.multilinestrings(pieces)),
                "fronts": len(pieces),
                "islets": int((kinds[inside] == "islet").sum()),
                "holes": int((kinds[inside] == "hole").sum()),
                **{f"{name}_m2": value for name, value in areas.items()},
                "reason": _reason(pieces, areas, len(inside), strip.geometry, unknown),
                "geometry": box,
            }
        )
    frame = gpd.GeoDataFrame(
        rows, columns=[*SECTION_COLUMNS, "geometry"], geometry="geometry", crs=strips.crs
    )
    index = arsi(
        *(frame[c].to_numpy(dtype=float) for c in ("sinuosity", "islets", "holes", "sparse_m2", "dense_m2"))
    )
    frame["arsi"] = np.where(frame.reason == "", index, np.nan)
    frame["status"] = classify(frame.arsi, cut)
    return frame


def _short(lines: np.ndarray) -> np.ndarray:
    """Lines in pieces of few vertices, so that a strip is not cut with all of a lakeshore."""
    pieces: list[BaseGeometry] = []
    for line in lines:
        corners = shapely.get_coordinates(line)
        starts = range(0, max(len(corners) - 1, 1), _VERTICES)
        pieces += [shapely.linestrings(corners[start : start + _VERTICES + 1]) for start in starts]
    return np.array(pieces, dtype=object)


def _pieces(lines: np.ndarray, strip: BaseGeometry, shortest: float) -> np.ndarray:
    """Parts of lines within a strip, joined where they meet."""
    if not len(lines):
        return lines
    parts = shapely.get_parts(shapely.intersection(lines, strip))
    parts = parts[shapely.get_type_id(parts) == 1]
    parts = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(parts)))
    return parts[shapely.length(parts) >= shortest]


def _box(pieces: np.ndarray, strip: BaseGeometry, half: float) -> BaseGeometry:
    """Rectangle along the front within the strip; the strip itself without a front."""
    if not len(pieces):
        return strip
    corners = shapely.get_coordinates(strip)[:4]
    along = (corners[1] + corners[2]) / 2 - (corners[0] + corners[3]) / 2
    points = shapely.get_coordinates(pieces)
    place = points @ along
    first, last = points[np.argmin(place)], points[np.argmax(place)]
    if np.allclose(first, last):
        return strip
    return LineString([first, last]).buffer(half, cap_style="flat").intersection(strip)


def _reason(
    pieces: np.ndarray, areas: dict[str, float], closed: int, strip: BaseGeometry, unknown: BaseGeometry
) -> str:
    """Why a section cannot be assessed; empty if it can."""
    measured = areas["sparse"] + areas["dense"] > 0
    if measured and len(pieces):
        return "" if sinuosity(shapely.multilinestrings(pieces)) >= 1 else "front closes on itself"
    if shapely.area(shapely.intersection(strip, unknown)) > 0.5 * strip.area:
        return "surface unknown"
    if not measured:
        return "no density known" if areas["unknown"] > 0 else "no reed"
    return "no front, closed lines only" if closed else "no front"
