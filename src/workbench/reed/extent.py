"""Extent of aquatic reed: heights within limits, on the lake side of the shoreline [reed 2.5.2].

What has no height is neither reed nor water: it is unknown, and is mapped and counted as such.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import TypeAlias

import cv2
import geopandas as gpd
import numpy as np
import rasterio.features
import shapely
import xarray as xr
from scipy import ndimage
from shapely.geometry.base import BaseGeometry

from workbench.errors import ReedError
from workbench.params import ReedParameters
from workbench.rasters import Grid
from workbench.reed.heights import object_height

_DEFAULTS = ReedParameters()
_ALL_NEIGHBOURS = np.ones((3, 3), dtype=bool)

Shoreline: TypeAlias = gpd.GeoDataFrame | gpd.GeoSeries | BaseGeometry


@dataclass(frozen=True, eq=False)
class LakeGround:
    """The lake side within a raster."""

    unknown: BaseGeometry
    """MultiPolygon of what has no height."""
    lake: BaseGeometry
    """All of it."""
    shore: BaseGeometry
    """The shoreline, lines."""
    grid: Grid
    """Cells of the raster."""
    near: np.ndarray
    """(rows, columns) cells that the lake side touches, so that the exact cut can follow."""


@dataclass(frozen=True, eq=False)
class ReedExtent:
    """Where reed stands, and where nothing is known."""

    reed: BaseGeometry
    """MultiPolygon along cell edges, cut at the shoreline; empty without reed."""
    unknown: BaseGeometry
    """MultiPolygon of the lake side within the raster that has no height."""
    lake: BaseGeometry
    """Lake side of the shoreline within the raster."""
    shore: BaseGeometry
    """The shoreline within the raster, lines."""
    grid: Grid
    """Cells that it was mapped on."""

    @property
    def frame(self) -> gpd.GeoDataFrame:
        """One row with ``area_m2`` and the dissolved polygon; no row without reed."""
        rows = [] if self.reed.is_empty else [{"area_m2": self.reed.area, "geometry": self.reed}]
        return gpd.GeoDataFrame(rows, columns=["area_m2", "geometry"], geometry="geometry", crs=self.grid.crs)


def extent(
    dsm: xr.DataArray,
    water_level: float,
    min_height: float = _DEFAULTS.min_height,
    max_height: float = _DEFAULTS.max_height,
    shoreline: Shoreline | None = None,
    *,
    min_area: float = _DEFAULTS.min_area,
    min_hole: float = _DEFAULTS.min_hole,
    sliver_width: float = _DEFAULTS.sliver_width,
) -> gpd.GeoDataFrame:
    """Extent of aquatic reed: ``water_level + min_height < dsm < water_level + max_height``.

    Parameters
    ----------
    dsm
        Surface heights (y, x), m, with CRS and vertical datum; NaN where unknown.
    water_level
        a: of the day, m in the datum of the surface.
    min_height, max_height
        b, c: limits of reed above the water, m, both exclusive.
    shoreline
        Polygon of the lake side of the official shoreline, in any CRS if it is a frame; without it all of
        the raster counts as lake.
    min_area, min_hole, sliver_width
        See :func:`map_extent`.

    Returns
    -------
    GeoDataFrame
        One row: ``area_m2`` and the dissolved polygon, holes kept; none where there is no reed.

    Raises
    ------
    ReedError
        If limits, water level or shoreline are impossible; see also :func:`map_extent`.
    """
    ohm = object_height(dsm, water_level)
    return map_extent(
        ohm,
        shoreline,
        min_height=min_height,
        max_height=max_height,
        min_area=min_area,
        min_hole=min_hole,
        sliver_width=sliver_width,
    ).frame


def map_extent(
    ohm: xr.DataArray,
    shoreline: Shoreline | None = None,
    *,
    min_height: float = _DEFAULTS.min_height,
    max_height: float = _DEFAULTS.max_height,
    min_area: float = _DEFAULTS.min_area,
    min_hole: float = _DEFAULTS.min_hole,
    sliver_width: float = _DEFAULTS.sliver_width,
    edge_share: float = _DEFAULTS.edge_share,
    stand: np.ndarray | None = None,
    edge_reach: float = _DEFAULTS.edge_reach,
    ground: LakeGround | None = None,
) -> ReedExtent:
    """Map reed and unknown areas on an object height model.

    Cells that touch at corners only belong to different patches. Patches are dropped and gaps closed by
    area before the cut at the shoreline, what the cut leaves once more after it. A gap without heights
    stays open: it is unknown.

    Parameters
    ----------
    ohm
        Heights above the water (y, x), m.
    shoreline
        Polygon of the lake side.
    min_height, max_height
        Limits of reed, m, exclusive.
    min_area
        Smaller patches are dropped, m².
    min_hole
        Smaller gaps are closed, m².
    sliver_width
        Patches at the shoreline that are narrower than this everywhere are dropped, m.
    edge_share
        Reed is higher than this share of the highest reed around it, 0..1; 0: limits of height alone.
        Matching smears a front over the water in front of it and fills narrow gaps; half the height of the
        stand is where the step was.
    stand, edge_reach
        As :func:`stand_height` gives it, where it is known already; otherwise the distance for it, m.
    ground
        As :func:`survey_ground` gives it for this raster and shoreline, where it is known already.

    Raises
    ------
    ReedError
        If the limits are not in order, or the shoreline is empty, no polygon or away from the raster.
    """
    if not 0 <= min_height < max_height:
        raise ReedError(f"Reed between {min_height} and {max_height} m: give 0 <= minimum < maximum.")
    ground = ground or survey_ground(ohm, shoreline)
    heights = ohm.values
    with np.errstate(invalid="ignore"):
        reed = (heights > min_height) & (heights < max_height) & ground.near
        if edge_share > 0:
            stand = stand_height(ohm, edge_reach, max_height) if stand is None else stand
            reed &= heights > np.float32(edge_share) * stand
    reed = _cleaned(reed, np.isfinite(heights), ground.grid, min_area, min_hole)
    patches = _polygons(reed, ground.grid)
    if shoreline is not None:
        patches = _cut(patches, ground.lake, min_area, sliver_width)
    return ReedExtent(shapely.multipolygons(patches), ground.unknown, ground.lake, ground.shore, ground.grid)


def stand_height(ohm: xr.DataArray, reach: float, max_height: float) -> np.ndarray:
    """Highest reed, lower than ``max_height`` (m), within a distance (m) of every pixel; below 0 without any.

    A pixel counts if its centre lies in the disc. (rows, columns) float32, m.
    """
    heights = ohm.values.astype(np.float32, copy=False)
    with np.errstate(invalid="ignore"):
        reed = np.where(heights < max_height, heights, np.float32(-1.0))
    cells = int(np.floor(reach / Grid.of(ohm).resolution * (1 + 1e-9)))
    rows, columns = np.mgrid[-cells : cells + 1, -cells : cells + 1]
    disc = rows**2 + columns**2 <= (reach / Grid.of(ohm).resolution) ** 2 * (1 + 1e-9)
    return cv2.dilate(reed, disc.astype(np.uint8))


def survey_ground(heights: xr.DataArray, shoreline: Shoreline | None = None) -> LakeGround:
    """What does not depend on any threshold: where the lake is, and where heights are missing.

    Raises
    ------
    ReedError
        As :func:`lake_side`.
    """
    grid = Grid.of(heights)
    frame = shapely.box(*grid.bounds)
    lake = frame if shoreline is None else lake_side(shoreline, grid)
    # The outline of the lake side without the border of the raster.
    shore = shapely.difference(lake.boundary, shapely.buffer(frame.boundary, 1e-6))
    near = rasterio.features.rasterize(
        [lake], out_shape=grid.shape, transform=grid.transform, all_touched=True, dtype="uint8"
    ).astype(bool)
    gaps = _polygons(~np.isfinite(heights.values) & near, grid)
    if shoreline is not None:
        gaps = _cut(gaps, lake, 0.0, 0.0)
    return LakeGround(shapely.multipolygons(gaps), lake, shore, grid, near)


def lake_side(shoreline: Shoreline, grid: Grid) -> BaseGeometry:
    """Lake side of a shoreline within a grid, in its CRS.

    Raises
    ------
    ReedError
        If it is empty, holds lines, lacks a CRS, or does not touch the grid.
    """
    if isinstance(shoreline, BaseGeometry):
        shape = shoreline
    else:
        if shoreline.crs is None:
            raise ReedError("The shoreline has no CRS: set it, for example with .set_crs().")
        shape = shapely.union_all(shoreline.to_crs(grid.crs).geometry.to_numpy())
    if shape.is_empty:
        raise ReedError("The shoreline is empty: give the polygon of the lake side.")
    if shape.geom_type not in ("Polygon", "MultiPolygon"):
        raise ReedError(
            f"The shoreline is a {shape.geom_type}: give the polygon of the lake side, so that it is known "
            "on which side the water is (in QGIS: Lines to polygons, or split a rectangle with the line)."
        )
    if not shape.is_valid:
        shape = shapely.make_valid(shape)
    inside = shapely.intersection(shape, shapely.box(*grid.bounds))
    parts = [part for part in shapely.get_parts(inside) if part.geom_type == "Polygon" and part.area > 0]
    if not parts:
        raise ReedError(
            f"The lake side of the shoreline {tuple(round(v, 1) for v in shape.bounds)} does not touch the "
            f"surface {tuple(round(v, 1) for v in grid.bounds)}: is it in {grid.crs}?"
        )
    return shapely.multipolygons(parts)


def _cleaned(reed: np.ndarray, known: np.ndarray, grid: Grid, min_area: float, min_hole: float) -> np.ndarray:
    """Without small gaps of known height, then without small patches."""
    cell = grid.resolution**2
    window = _window(reed)
    if window is None:
        return reed
    part = reed[window]
    if min_hole > cell:
        part = part | _small_gaps(part, known[window], min_hole / cell * (1 - 1e-9))
    if min_area > cell:
        patches, number = ndimage.label(part)
        large = np.bincount(patches.ravel(), minlength=number + 1) >= min_area / cell * (1 - 1e-9)
        large[0] = False
        part = large[patches]
    cleaned = np.zeros_like(reed)
    cleaned[window] = part
    return cleaned


def _window(mask: np.ndarray) -> tuple[slice, slice] | None:
    """Rows and columns around all that is true, and one beyond, so that what encloses it is seen."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return None
    return slice(max(rows[0] - 1, 0), rows[-1] + 2), slice(max(columns[0] - 1, 0), columns[-1] + 2)


def _small_gaps(reed: np.ndarray, known: np.ndarray, cells: float) -> np.ndarray:
    """Gaps of fewer cells that are enclosed by reed and hold no unknown cell."""
    # What surrounds four-connected patches is eight-connected.
    gaps, number = ndimage.label(~reed, structure=_ALL_NEIGHBOURS)
    small = np.bincount(gaps.ravel(), minlength=number + 1) < cells
    small[np.unique(gaps[~known])] = False
    for edge in (gaps[0], gaps[-1], gaps[:, 0], gaps[:, -1]):
        small[np.unique(edge)] = False
    small[0] = False
    return small[gaps]


def _polygons(mask: np.ndarray, grid: Grid) -> np.ndarray:
    """Polygons of the four-connected patches of a mask."""
    shapes = rasterio.features.shapes(
        mask.view(np.uint8), mask=mask, connectivity=4, transform=grid.transform
    )
    patches = [shape["coordinates"] for shape, _ in shapes]
    if not patches:
        return np.array([], dtype=object)
    loops = [loop for patch in patches for loop in patch]
    sizes = np.array([len(loop) for loop in loops])
    corners = np.fromiter(chain.from_iterable(chain.from_iterable(loops)), dtype=float).reshape(-1, 2)
    rings = shapely.linearrings(corners, indices=np.repeat(np.arange(len(loops)), sizes))
    # The first ring of a patch is its outline, the others are its holes.
    patch = np.repeat(np.arange(len(patches)), [len(loops) for loops in patches])
    return shapely.polygons(rings, indices=patch)


def _cut(patches: np.ndarray, lake: BaseGeometry, min_area: float, sliver_width: float) -> np.ndarray:
    """Parts of the patches on the lake side; of those that the cut changed, only the large and wide."""
    if not len(patches):
        return patches
    shapely.prepare(lake)
    whole = shapely.contains_properly(lake, patches)
    cut = shapely.get_parts(shapely.intersection(patches[~whole], lake))
    cut = cut[
        (shapely.get_type_id(cut) == 3)
        & (shapely.area(cut) >= min_area * (1 - 1e-9))
        & ~shapely.is_empty(cut)
    ]
    if sliver_width > 0 and len(cut):
        thin = 2 * shapely.area(cut) < 4 * sliver_width * shapely.length(cut)
        thin[thin] = shapely.is_empty(shapely.buffer(cut[thin], -sliver_width / 2))
        cut = cut[~thin]
    return np.concatenate([patches[whole], cut])
