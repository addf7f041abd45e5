"""Tree mask: vegetation that is higher than the least height of a tree [thesis 3.3.1]."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
import xarray as xr
from scipy import ndimage

from workbench.errors import TreesError
from workbench.params import TreesParameters
from workbench.rasters import Grid, map_tiles, new_raster, require_same_grid

_DEFAULTS = TreesParameters()
_GROUND_CELL = 1.0


def tree_mask(
    height: xr.DataArray,
    *,
    ndvi: xr.DataArray | None = None,
    gli: xr.DataArray | None = None,
    min_height: float = _DEFAULTS.min_height,
    min_ndvi: float = _DEFAULTS.min_ndvi,
    min_gli: float = _DEFAULTS.min_gli,
    close: float = _DEFAULTS.mask_close,
    open: float = _DEFAULTS.mask_open,
    min_area: float = _DEFAULTS.mask_min_area,
    tile_size: int = _DEFAULTS.tile_size,
) -> xr.DataArray:
    """Where trees are: high enough, green enough, and in patches of a stated size.

    Parameters
    ----------
    height
        Height above ground (y, x), metres, NaN missing; from a terrain, or where there is none from
        :func:`height_over_surroundings`.
    ndvi, gli
        Indices on the same grid, -1..1; each one that is given must reach its limit. A cell without
        index (NaN) is not vegetation.
    min_height
        Least height, metres.
    min_ndvi, min_gli
        Least index of vegetation.
    close, open
        Radius of the disc, metres, that closes gaps, then opens: removes what is too narrow; 0: not done.
    min_area
        Smaller patches (of eight neighbours) are removed, square metres; 0: not done.
    tile_size
        Edge of a tile, cells; the mask does not depend on it.

    Returns
    -------
    DataArray
        uint8 (y, x): 1 tree, 0 none.

    Raises
    ------
    RasterError
        If the rasters lie on different grids.
    TreesError
        If a size is negative.
    """
    if min(close, open, min_area) < 0:
        raise TreesError(f"Sizes of the mask ({close}, {open} m, {min_area} m2) must not be negative.")
    grid = Grid.of(height)
    indices = [(raster, least) for raster, least in ((ndvi, min_ndvi), (gli, min_gli)) if raster is not None]
    for raster, _ in indices:
        require_same_grid(height, raster)
    clean = partial(
        _clean_tile,
        least=(min_height, *[least for _, least in indices]),
        close=close / grid.resolution,
        open=open / grid.resolution,
    )
    # Closing and opening look as far as both their discs, there and back.
    margin = int(np.ceil(2 * (close + open) / grid.resolution)) + 2
    cleaned = map_tiles(
        clean,
        height,
        *[raster for raster, _ in indices],
        margin=margin,
        tile_size=max(tile_size, margin),
    )
    values = _without_small(cleaned.values, min_area / grid.resolution**2)
    return new_raster(values, grid, name="mask", units="1", long_name="1 tree, 0 none")


def height_over_surroundings(surface: xr.DataArray, radius: float = _DEFAULTS.surroundings) -> xr.DataArray:
    """Height over the lowest surface around, for sites without terrain.

    On cells of a metre, the lowest height within the radius is taken, then the highest of these within
    the radius (a grey opening, which follows slopes), and subtracted. Ground must be visible somewhere
    within the radius; in a closed stand it is not, and heights are too small.

    Parameters
    ----------
    surface
        Heights (y, x), metres.
    radius
        Metres.

    Raises
    ------
    TreesError
        If the radius is not positive.
    """
    if not radius > 0:
        raise TreesError(f"Surroundings of {radius} m hold no ground: give a positive radius.")
    grid = Grid.of(surface)
    factor = max(round(_GROUND_CELL / grid.resolution), 1)
    rows, columns = -(-grid.height // factor), -(-grid.width // factor)
    padded = np.full((rows * factor, columns * factor), np.inf, np.float32)
    values = surface.values.astype(np.float32)
    padded[: grid.height, : grid.width] = np.where(np.isfinite(values), values, np.inf)
    lowest = padded.reshape(rows, factor, columns, factor).min(axis=(1, 3))
    size = 2 * max(round(radius / (factor * grid.resolution)), 1) + 1
    ground = ndimage.minimum_filter(lowest, size, mode="nearest")
    ground = np.where(np.isfinite(ground), ground, -np.inf)
    ground = ndimage.maximum_filter(ground, size, mode="nearest")
    fine = np.repeat(np.repeat(ground, factor, 0), factor, 1)[: grid.height, : grid.width]
    above = np.where(np.isfinite(fine), values - fine, np.nan).astype(np.float32)
    return new_raster(above, grid, name="height", units="m", long_name="height over the surroundings")


def _clean_tile(height: np.ndarray, *indices: np.ndarray, least: tuple, close: float, open: float):
    found = height >= least[0]
    for values, limit in zip(indices, least[1:], strict=True):
        found &= values >= limit
    found = ~_grown(~_grown(found, close), close)
    found = _grown(~_grown(~found, open), open)
    return found.astype(np.uint8)


def _grown(mask: np.ndarray, radius: float) -> np.ndarray:
    """Mask with everything within a radius in cells; beyond the border nothing is assumed."""
    if radius < 1 or not mask.any():
        return mask
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return distance <= radius + 1e-4


def _without_small(mask: np.ndarray, cells: float) -> np.ndarray:
    if cells <= 1 or not mask.any():
        return mask
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    large = statistics[:, cv2.CC_STAT_AREA] >= cells
    large[0] = False
    return large[labels].astype(np.uint8)
