"""Surfaces of trees whose tops and crowns are known exactly."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import xarray as xr

from workbench.rasters import Grid, new_raster

CRS = "EPSG:32633"


def raster(values, cell=0.2, *, west=0.0, south=0.0, crs=CRS, name="height") -> xr.DataArray:
    """Values as a raster whose lower left corner is at (west, south)."""
    values = np.asarray(values)
    grid = Grid(
        Grid.from_bounds(crs, (0, 0, 1, 1), 1.0).crs,
        west,
        south + values.shape[0] * cell,
        cell,
        *_wide(values),
    )
    return new_raster(values, grid, name=name, units="m")


def cones(trees, size, cell=0.2) -> xr.DataArray:
    """Cones (x, y, height, crown radius) on level ground, the highest wins."""
    return _surface(trees, size, cell, lambda far, height, radius: height * (1 - 0.8 * far / radius))


def ellipsoids(trees, size, cell=0.2) -> xr.DataArray:
    """Upper halves of ellipsoids on stems of half the height."""
    return _surface(
        trees,
        size,
        cell,
        lambda far, height, radius: height / 2 + height / 2 * np.sqrt(np.maximum(1 - (far / radius) ** 2, 0)),
    )


def tops_at(trees, crs=CRS) -> gpd.GeoDataFrame:
    """Tops (x, y, height, ...) as a table."""
    trees = np.asarray(trees, float).reshape(len(trees), -1)
    return gpd.GeoDataFrame(
        {"tree_id": np.arange(1, len(trees) + 1), "height_m": trees[:, 2]},
        geometry=gpd.points_from_xy(trees[:, 0], trees[:, 1]),
        crs=crs,
    )


def places(tops) -> set:
    """Rows and columns of tops."""
    return set(zip(tops["row"], tops["column"], strict=True))


def _surface(trees, size, cell, shape) -> xr.DataArray:
    cells = round(size / cell)
    axis = (np.arange(cells) + 0.5) * cell
    x, y = np.meshgrid(axis, axis[::-1])
    height = np.zeros((cells, cells), np.float32)
    for tree_x, tree_y, tall, radius in trees:
        far = np.hypot(x - tree_x, y - tree_y)
        height = np.where(far <= radius, np.maximum(height, shape(far, tall, radius)), height)
    return raster(height.astype(np.float32), cell)


def _wide(values) -> tuple[int, int]:
    return values.shape[1], values.shape[0]
