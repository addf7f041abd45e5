"""Layers of an orthophoto on the grid of a surface."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

from workbench.rasters import Grid, match_grid, new_raster, read_raster
from workbench.trees.indices import brightness

_TILE = 512  # Of the coarser grid; an orthophoto of centimetres has ten times as many pixels along an edge.
_BESIDE = 2  # Pixels beyond a tile that still lie in one of its cells.
_CHUNK = 1024


def read_index(path: Path, grid: Grid) -> xr.DataArray:
    """An index, averaged over the cells of a grid."""
    return _averaged(path, grid, lambda part: part)


def read_brightness(path: Path, grid: Grid) -> xr.DataArray:
    """Mean of the bands of an orthophoto, averaged over the cells of a grid; NaN where all bands are 0."""
    return _averaged(path, grid, _brightness)


def _averaged(path: Path, grid: Grid, values: Callable[[xr.DataArray], xr.DataArray]) -> xr.DataArray:
    """Values of a raster on a grid, read by tiles: an orthophoto need not fit into memory."""
    source = read_raster(path, chunks=_CHUNK)
    fine = Grid.of(source)
    if fine.crs != grid.crs:
        return match_grid(values(source.compute()), grid, resampling="average")
    result = np.full(grid.shape, np.nan, np.float32)
    for tile in grid.tiles(_TILE):
        window = _covering(fine, grid.window(*tile.core))
        if window is None:
            continue
        part = values(source[..., window[0], window[1]].compute())
        result[tile.core] = match_grid(part, grid.window(*tile.core), resampling="average").values
    return new_raster(
        result,
        grid,
        name=path.stem,
        units=str(source.attrs.get("units", "1")),
        long_name=str(source.attrs.get("long_name", path.stem)),
    )


def _covering(fine: Grid, part: Grid) -> tuple[slice, slice] | None:
    """Rows and columns of a grid that cover a part of another one in the same CRS."""
    west, south, east, north = part.bounds
    rows = slice(
        max(int((fine.north - north) / fine.resolution) - _BESIDE, 0),
        min(int((fine.north - south) / fine.resolution) + 1 + _BESIDE, fine.height),
    )
    columns = slice(
        max(int((west - fine.west) / fine.resolution) - _BESIDE, 0),
        min(int((east - fine.west) / fine.resolution) + 1 + _BESIDE, fine.width),
    )
    return (rows, columns) if rows.start < rows.stop and columns.start < columns.stop else None


def _brightness(ortho: xr.DataArray) -> xr.DataArray:
    bands = ortho if ortho.ndim == 3 else ortho.expand_dims("band")
    mean = bands.isel(band=0, drop=True)
    mean = mean.copy(data=brightness(*bands.values).astype(np.float32))
    return mean.where((bands > 0).any("band")).rio.write_nodata(np.nan)
