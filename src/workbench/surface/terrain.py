"""Terrain below vegetation and buildings, and heights above it."""

from __future__ import annotations

import contextlib
import os

import CSF
import numpy as np
import xarray as xr
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from workbench.errors import SurfaceError
from workbench.params import SurfaceParameters
from workbench.rasters import Grid, match_grid, new_raster, require_heights

_DEFAULTS = SurfaceParameters()
_LEAST_POINTS = 10


def ground_filter(
    surface: xr.DataArray,
    *,
    cell: float = _DEFAULTS.ground_cell,
    rigidness: int = _DEFAULTS.ground_rigidness,
    threshold: float = _DEFAULTS.ground_threshold,
) -> tuple[xr.DataArray, xr.DataArray]:
    """Terrain by cloth simulation (Zhang et al. 2016) on the lowest height of coarse cells.

    Under closed canopy no ground was seen; the terrain there is interpolated from its rim, and the
    second result says so.

    Parameters
    ----------
    surface
        Heights (y, x), metres.
    cell
        Cloth and lowest heights, metres.
    rigidness
        1 steep, 2 with relief, 3 flat.
    threshold
        Points within this distance of the cloth are ground, metres.

    Returns
    -------
    terrain : DataArray (y, x) float32
        Metres, on the coarse cells, complete.
    ground_seen : DataArray (y, x) uint8
        On the same cells: 1 where ground was measured, 0 where the terrain is interpolated.

    Raises
    ------
    SurfaceError
        If the surface has fewer than ten heights.
    """
    datum = require_heights(surface)
    lowest = _lowest(surface, cell)
    rows, columns = np.nonzero(np.isfinite(lowest.values))
    if len(rows) < _LEAST_POINTS:
        raise SurfaceError(f"Surface {surface.name} has {len(rows)} heights: too few to find the ground.")
    grid = Grid.of(lowest)
    xyz = np.stack([grid.x[columns] - grid.west, grid.y[rows] - grid.north, lowest.values[rows, columns]], 1)
    ground = _cloth(xyz.astype(float), cell, rigidness, threshold)
    if ground.sum() < 3:
        ground = xyz[:, 2] <= np.percentile(xyz[:, 2], 5)
    terrain = _interpolate(xyz[ground], grid)
    seen = np.zeros(grid.shape, np.uint8)
    seen[rows[ground], columns[ground]] = 1
    return (
        new_raster(terrain, grid, name="dtm", units="m", long_name="terrain height", vertical_datum=datum),
        new_raster(seen, grid, name="ground_seen", units="1", long_name="ground was measured"),
    )


def user_terrain(dtm: xr.DataArray, surface: xr.DataArray) -> xr.DataArray:
    """A terrain raster of the user on the grid of the surface.

    Raises
    ------
    SurfaceError
        If its datum differs from the surface's, or it covers less than the whole measured area.
    RasterError
        If it has no CRS or states no vertical datum.
    """
    ours, theirs = require_heights(surface), require_heights(dtm)
    if ours != theirs:
        raise SurfaceError(
            f"Terrain {dtm.name} refers to '{theirs}', the surface to '{ours}': transform one of them, or "
            "state the same datum if they are the same."
        )
    terrain = match_grid(dtm, Grid.of(surface))
    measured = np.isfinite(surface.values)
    lacking = float((measured & ~np.isfinite(terrain.values)).sum() / max(measured.sum(), 1))
    if lacking > 0:
        raise SurfaceError(
            f"Terrain {dtm.name} does not cover {lacking:.1%} of the measured area: extend it, or leave "
            "it out so that the ground is filtered from the surface."
        )
    return terrain


def height_above(surface: xr.DataArray, terrain: xr.DataArray) -> xr.DataArray:
    """Surface minus terrain (resampled to the surface's grid), metres: the nDSM."""
    if Grid.of(terrain) != Grid.of(surface):
        terrain = match_grid(terrain, Grid.of(surface))
    difference = (surface.values - terrain.values).astype(np.float32)
    return new_raster(
        difference,
        Grid.of(surface),
        name="ndsm",
        units="m",
        long_name="height above terrain",
        vertical_datum="height above terrain",
    )


def _lowest(surface: xr.DataArray, cell: float) -> xr.DataArray:
    grid = Grid.of(surface)
    coarse = Grid.from_bounds(grid.crs, grid.bounds, max(cell, grid.resolution))
    rows = np.clip(((coarse.north - grid.y) / coarse.resolution).astype(int), 0, coarse.height - 1)
    columns = np.clip(((grid.x - coarse.west) / coarse.resolution).astype(int), 0, coarse.width - 1)
    lowest = np.full(coarse.shape, np.inf, np.float32)
    for row in range(grid.height):
        values = surface.values[row]
        known = np.isfinite(values)
        np.minimum.at(lowest[rows[row]], columns[known], values[known])
    lowest[np.isinf(lowest)] = np.nan
    return new_raster(lowest, coarse, name="lowest", units="m")


def _cloth(xyz: np.ndarray, cell: float, rigidness: int, threshold: float) -> np.ndarray:
    cloth = CSF.CSF()
    cloth.params.bSloopSmooth = True
    cloth.params.cloth_resolution = 2 * cell
    cloth.params.rigidness = rigidness
    cloth.params.class_threshold = threshold
    cloth.params.interations = 500
    cloth.setPointCloud(xyz)
    ground, other = CSF.VecInt(), CSF.VecInt()
    # The library prints its progress without being asked.
    with open(os.devnull, "w") as silence, contextlib.redirect_stdout(silence):  # noqa: PTH123
        cloth.do_filtering(ground, other, False)
    mask = np.zeros(len(xyz), bool)
    mask[np.array(ground, dtype=int)] = True
    return mask


def _interpolate(points: np.ndarray, grid: Grid) -> np.ndarray:
    x, y = np.meshgrid(grid.x - grid.west, grid.y - grid.north)
    nearest = NearestNDInterpolator(points[:, :2], points[:, 2])(x, y)
    if np.linalg.matrix_rank(points[:, :2] - points[0, :2]) < 2:
        return nearest.astype(np.float32)
    linear = LinearNDInterpolator(points[:, :2], points[:, 2])(x, y)
    return np.where(np.isfinite(linear), linear, nearest).astype(np.float32)
