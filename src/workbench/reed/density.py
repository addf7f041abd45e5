"""Density of reed: variance and mean of the heights in square cells [reed 2.5.3]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import geopandas as gpd
import numpy as np
import rasterio.features
import shapely
import xarray as xr
from scipy import sparse
from shapely.geometry.base import BaseGeometry

from workbench.errors import ReedError
from workbench.params import ReedParameters
from workbench.rasters import Grid

_DEFAULTS = ReedParameters()
_BAND = 32  # Rows of cells that are computed at once; the result does not depend on it.

Weights = Literal["area", "centre"]
Variance = Literal["population", "sample"]


@dataclass(frozen=True, eq=False)
class CellStatistics:
    """Zonal statistics of heights in square cells.

    Cells lie on whole multiples of their size in the CRS, so that those of two dates or of two pieces
    of one surface are the same; cells at the border of the raster may reach beyond it.
    """

    grid: Grid
    """The cells."""
    mean: np.ndarray
    """(rows, columns) m, NaN without a height."""
    variance: np.ndarray
    """(rows, columns) m², NaN without a height (sample: with one or less)."""
    known: np.ndarray
    """(rows, columns) share of a cell with a height, 0..1."""


def cell_statistics(
    ohm: xr.DataArray,
    *,
    spread: xr.DataArray | None = None,
    cell_size: float = _DEFAULTS.cell_size,
    weights: Weights = _DEFAULTS.cell_weights,
    variance: Variance = _DEFAULTS.cell_variance,
    band: int = _BAND,
) -> CellStatistics:
    """Mean and variance of all known heights of every cell, gaps between stems included.

    Cells and pixels share their axes, so that the area of a pixel in a cell is a product of two lengths:
    sums over cells are two small sparse matrix products.

    A surface fused from many pairs of photographs keeps one height a pixel and leaves out how far the pairs
    disagree, which between stems and gaps is most of what the variance is meant to tell. With their spread,
    the variance of a cell is that of all measured heights: the variance between pixels plus the mean variance
    within them.

    Parameters
    ----------
    ohm
        Heights (y, x), m.
    spread
        Standard deviation of the heights measured in every pixel, on the same pixels, m; NaN counts as 0.
    cell_size
        Edge of a cell, m.
    weights
        ``area``: pixels count by the area that lies in the cell; ``centre``: wholly, in the cell that
        holds their centre (on its west and south side, where it is on the border).
    variance
        ``population``: divided by the weight of the pixels; ``sample``: by that weight, in pixels, less 1.
    band
        Rows of cells computed at once.

    Raises
    ------
    ReedError
        If a cell is smaller than a pixel, or the spread lies on other pixels.
    """
    pixels = Grid.of(ohm)
    if spread is not None and Grid.of(spread) != pixels:
        raise ReedError(
            "The spread of the surface lies on other pixels than its heights: give it on the same."
        )
    if not cell_size >= pixels.resolution * (1 - 1e-9):
        raise ReedError(
            f"Density cells of {cell_size} m are smaller than the pixels of {pixels.resolution:g} m."
        )
    cells = Grid.from_bounds(pixels.crs, _inward(pixels), cell_size)
    across = _lengths(pixels.west - cells.west, pixels, pixels.width, cell_size, cells.width, weights)
    down = _lengths(cells.north - pixels.north, pixels, pixels.height, cell_size, cells.height, weights)
    sums = np.zeros((4, *cells.shape))
    for top in range(0, cells.height, band):
        rows = slice(top, min(top + band, cells.height))
        part = down[rows]
        used = np.unique(part.indices)
        if not len(used):
            continue
        first, last = int(used[0]), int(used[-1]) + 1
        heights = ohm.values[first:last].astype(np.float64)
        known = np.isfinite(heights)
        filled = np.where(known, heights, 0.0)
        part = part[:, first:last]
        layers = [known.astype(np.float64), filled, filled * filled]
        if spread is not None:
            within = np.nan_to_num(spread.values[first:last].astype(np.float64))
            layers.append(np.where(known, within * within, 0.0))
        for index, layer in enumerate(layers):
            sums[index, rows] = (across @ (part @ layer).T).T
    area, total, squares, within_pixels = sums
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(area > 0, total / area, np.nan)
        between = np.maximum(squares / area - mean**2, 0.0)
        if variance == "sample":
            count = area / pixels.resolution**2
            between = np.where(count > 1 + 1e-9, between * count / (count - 1), np.nan)
        found = np.where(area > 0, between + within_pixels / area, np.nan)
    return CellStatistics(cells, mean, found, area / cell_size**2)


def density_cells(
    ohm: xr.DataArray,
    extent: gpd.GeoDataFrame | gpd.GeoSeries | BaseGeometry,
    cell_size: float = _DEFAULTS.cell_size,
    variance: float = _DEFAULTS.variance_cut,
    mean_height: float = _DEFAULTS.mean_cut,
    *,
    spread: xr.DataArray | None = None,
    weights: Weights = _DEFAULTS.cell_weights,
    divisor: Variance = _DEFAULTS.cell_variance,
    min_known: float = _DEFAULTS.cell_known,
) -> gpd.GeoDataFrame:
    """Dense and sparse reed in square cells.

    Parameters
    ----------
    ohm
        Heights above the water (y, x), m.
    extent
        Of the reed: a frame in any CRS, or polygons in that of the raster.
    cell_size
        Edge of a cell, m.
    variance, mean_height
        Sparse is a cell with a variance above (m²) and a mean below (m); on a cut it is dense.
    spread, weights, divisor
        See :func:`cell_statistics`.
    min_known
        Cells with heights on less than this share are unknown, 0..1.

    Returns
    -------
    GeoDataFrame
        Every cell with reed: ``row, column`` (of the cell grid of the raster), ``mean_m``,
        ``variance_m2``, ``known`` (share, 0..1), ``reed_m2`` (area of reed in it), ``density`` (sparse,
        dense, unknown), squares. Reed is counted by pixels whose centre lies in the extent.

    Raises
    ------
    ReedError
        If a cell is smaller than a pixel, or the extent is a frame without CRS.
    """
    statistics = cell_statistics(ohm, spread=spread, cell_size=cell_size, weights=weights, variance=divisor)
    area = reed_area(Grid.of(ohm), extent, statistics.grid)
    return classify_cells(statistics, area, variance=variance, mean_height=mean_height, min_known=min_known)


def reed_area(
    pixels: Grid, extent: gpd.GeoDataFrame | gpd.GeoSeries | BaseGeometry, cells: Grid
) -> np.ndarray:
    """Area of reed in every cell (rows, columns), m²."""
    if isinstance(extent, BaseGeometry):
        shapes = [extent]
    elif extent.crs is None:
        raise ReedError("The extent has no CRS: set it, for example with .set_crs().")
    else:
        shapes = list(extent.geometry.to_crs(pixels.crs))
    shapes = [shape for shape in shapes if shape is not None and not shape.is_empty]
    if not shapes:
        return np.zeros(cells.shape)
    mask = rasterio.features.rasterize(
        shapes, out_shape=pixels.shape, transform=pixels.transform, dtype="uint8"
    )
    across = _lengths(pixels.west - cells.west, pixels, pixels.width, cells.resolution, cells.width, "area")
    down = _lengths(cells.north - pixels.north, pixels, pixels.height, cells.resolution, cells.height, "area")
    return (across @ (down @ mask).T).T


def classify_cells(
    statistics: CellStatistics,
    area: np.ndarray,
    *,
    variance: float = _DEFAULTS.variance_cut,
    mean_height: float = _DEFAULTS.mean_cut,
    min_known: float = _DEFAULTS.cell_known,
) -> gpd.GeoDataFrame:
    """Classes of the cells with reed; see :func:`density_cells`."""
    cells = statistics.grid
    rows, columns = np.nonzero(area > 1e-6)
    mean, spread = statistics.mean[rows, columns], statistics.variance[rows, columns]
    known = statistics.known[rows, columns]
    density = np.where((spread > variance) & (mean < mean_height), "sparse", "dense").astype(object)
    density[(known < min_known - 1e-9) | ~np.isfinite(mean)] = "unknown"
    west, north = cells.west + columns * cells.resolution, cells.north - rows * cells.resolution
    squares = shapely.box(west, north - cells.resolution, west + cells.resolution, north)
    return gpd.GeoDataFrame(
        {
            "row": rows,
            "column": columns,
            "mean_m": mean,
            "variance_m2": spread,
            "known": known,
            "reed_m2": area[rows, columns],
            "density": density,
        },
        geometry=squares,
        crs=cells.crs,
    )


def _inward(grid: Grid) -> tuple[float, float, float, float]:
    """Bounds drawn in by a rounding error, so that they open no cell beyond."""
    west, south, east, north = grid.bounds
    little = 1e-6 * grid.resolution
    return west + little, south + little, east - little, north - little


def _lengths(
    offset: float, pixels: Grid, count: int, cell_size: float, cells: int, weights: Weights
) -> sparse.csr_array:
    """(cells, pixels) length of every pixel in every cell along one axis, m.

    ``offset`` is the distance of the first pixel's edge from the first cell's.
    """
    step = pixels.resolution
    start = offset + np.arange(count) * step
    if weights == "centre":
        cell = np.clip(np.floor((start + step / 2) / cell_size + 1e-9).astype(int), 0, cells - 1)
        return sparse.csr_array((np.full(count, step), (cell, np.arange(count))), shape=(cells, count))
    first = np.floor(start / cell_size + 1e-9).astype(int)
    entries = []
    # A pixel is no larger than a cell, so that it lies in two cells at most.
    for cell in (first, first + 1):
        length = np.minimum(start + step, (cell + 1) * cell_size) - np.maximum(start, cell * cell_size)
        used = (length > 1e-9 * step) & (cell >= 0) & (cell < cells)
        entries.append((length[used], cell[used], np.arange(count)[used]))
    length, cell, pixel = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return sparse.csr_array((length, (cell, pixel)), shape=(cells, count))
