"""Terrain below vegetation and buildings, and heights above it."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator

import CSF
import numpy as np
import xarray as xr
from rasterio.warp import transform
from scipy import ndimage
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from threadpoolctl import threadpool_limits

from workbench.compiled import compiled
from workbench.errors import SurfaceError
from workbench.params import SurfaceParameters
from workbench.rasters import Grid, match_grid, new_raster, require_heights

_DEFAULTS = SurfaceParameters()
_LEAST_POINTS = 10
_NODES = 32


def ground_filter(
    surface: xr.DataArray,
    *,
    cell: float = _DEFAULTS.ground_cell,
    rigidness: int = _DEFAULTS.ground_rigidness,
    threshold: float = _DEFAULTS.ground_threshold,
    trusted: Callable[[tuple[slice, slice]], np.ndarray] | None = None,
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
    trusted
        Gives, for a window of rows and columns, the cells (bool) that may be ground: a false match
        below the ground would draw the cloth down. All by default.

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
    lowest = _lowest(surface, cell, trusted)
    rows, columns = np.nonzero(np.isfinite(lowest.values))
    if len(rows) < _LEAST_POINTS:
        raise SurfaceError(f"Surface {surface.name} has {len(rows)} heights: too few to find the ground.")
    grid = Grid.of(lowest)
    xyz = np.stack([grid.x[columns] - grid.west, grid.y[rows] - grid.north, lowest.values[rows, columns]], 1)
    ground = _cloth(xyz.astype(float), cell, rigidness, threshold)
    if ground.sum() < 3:
        ground = xyz[:, 2] <= np.percentile(xyz[:, 2], 5)
    seen = np.zeros(grid.shape, np.uint8)
    seen[rows[ground], columns[ground]] = 1
    terrain = filled_from_rims(np.where(seen == 1, lowest.values, np.float32(np.nan)))
    return (
        new_raster(terrain, grid, name="dtm", units="m", long_name="terrain height", vertical_datum=datum),
        new_raster(seen, grid, name="ground_seen", units="1", long_name="ground was measured"),
    )


class UserTerrain:
    """A terrain raster of the user, any CRS and cell, on the grid of a surface, by window.

    Heights are interpolated bilinearly at the cell centres; a cell beside or between missing cells of
    the terrain is missing.

    Parameters
    ----------
    dtm
        Terrain, metres.
    surface
        Whose grid and datum are wanted.

    Raises
    ------
    SurfaceError
        If its datum differs from the surface's.
    RasterError
        If it has no CRS or states no vertical datum.
    """

    def __init__(self, dtm: xr.DataArray, surface: xr.DataArray) -> None:
        ours, theirs = require_heights(surface), require_heights(dtm)
        if ours != theirs:
            raise SurfaceError(
                f"Terrain {dtm.name} refers to '{theirs}', the surface to '{ours}': transform one of them, "
                "or state the same datum if they are the same."
            )
        self._dtm, self._source = dtm, Grid.of(dtm)
        self.grid = Grid.of(surface)
        self._measured = self._lacking = 0

    def window(self, rows: slice, columns: slice) -> np.ndarray:
        """Terrain heights (rows, columns) float32, NaN outside the terrain."""
        row, column = self._places(rows, columns)
        first_row, last_row = int(np.floor(row.min())) - 1, int(np.ceil(row.max())) + 2
        first_column, last_column = int(np.floor(column.min())) - 1, int(np.ceil(column.max())) + 2
        part = (
            slice(max(first_row, 0), min(last_row, self._source.height)),
            slice(max(first_column, 0), min(last_column, self._source.width)),
        )
        if part[0].start >= part[0].stop or part[1].start >= part[1].stop:
            return np.full(row.shape, np.nan, np.float32)
        values = self._dtm.isel(y=part[0], x=part[1]).values.astype(np.float32)
        if self._dtm.rio.nodata is not None:
            values[values == self._dtm.rio.nodata] = np.nan
        return _bilinear(
            values,
            row - part[0].start,
            column - part[1].start,
            self._source.shape,
            part[0].start,
            part[1].start,
        )

    def check(self, surface: np.ndarray, terrain: np.ndarray) -> None:
        """Note how much of the measured surface of a window has no terrain."""
        measured = np.isfinite(surface)
        self._measured += int(measured.sum())
        self._lacking += int((measured & ~np.isfinite(terrain)).sum())

    def require_cover(self) -> None:
        """Refuse a terrain that lacks any of what :meth:`check` saw.

        Raises
        ------
        SurfaceError
            If it covers less than the whole measured area.
        """
        if self._lacking:
            raise SurfaceError(
                f"Terrain {self._dtm.name} does not cover {self._lacking / self._measured:.1%} of the "
                "measured area: extend it, or leave it out so that the ground is filtered from the surface."
            )

    def _places(self, rows: slice, columns: slice) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the terrain, counted from the first cell's centre, of cell centres."""
        # Every 32nd cell is transformed; between them a projection is a plane to within micrometres.
        row_nodes = np.arange(rows.start // _NODES, (rows.stop - 1) // _NODES + 2) * _NODES
        column_nodes = np.arange(columns.start // _NODES, (columns.stop - 1) // _NODES + 2) * _NODES
        grid, source = self.grid, self._source
        x, y = np.meshgrid(
            grid.west + (column_nodes + 0.5) * grid.resolution,
            grid.north - (row_nodes + 0.5) * grid.resolution,
        )
        if source.crs != grid.crs:
            moved = transform(grid.crs, source.crs, x.ravel(), y.ravel())
            x, y = (np.reshape(axis, x.shape) for axis in moved)
        down, across = (
            (np.arange(part.start, part.stop) - nodes[0]) / _NODES
            for part, nodes in ((rows, row_nodes), (columns, column_nodes))
        )
        return (
            _between_nodes((source.north - y) / source.resolution - 0.5, down, across),
            _between_nodes((x - source.west) / source.resolution - 0.5, down, across),
        )


def user_terrain(dtm: xr.DataArray, surface: xr.DataArray) -> xr.DataArray:
    """A terrain raster of the user on the grid of the surface, in memory.

    Raises
    ------
    SurfaceError
        If its datum differs from the surface's, or it covers less than the whole measured area.
    RasterError
        If it has no CRS or states no vertical datum.
    """
    terrain = UserTerrain(dtm, surface)
    grid = terrain.grid
    values = terrain.window(slice(0, grid.height), slice(0, grid.width))
    terrain.check(surface.values, values)
    terrain.require_cover()
    datum = surface.attrs["vertical_datum"]
    return new_raster(values, grid, name="dtm", units="m", long_name="terrain", vertical_datum=datum)


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


def _between_nodes(values: np.ndarray, down: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Bilinear values at positions counted in nodes."""
    top, left = np.floor(down).astype(int), np.floor(across).astype(int)
    weight_y, weight_x = (down - top)[:, None], (across - left)[None, :]
    upper = values[np.ix_(top, left)] * (1 - weight_x) + values[np.ix_(top, left + 1)] * weight_x
    lower = values[np.ix_(top + 1, left)] * (1 - weight_x) + values[np.ix_(top + 1, left + 1)] * weight_x
    return upper * (1 - weight_y) + lower * weight_y


@compiled(nogil=True)
def _bilinear(
    values: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    shape: tuple[int, int],
    first_row: int,
    first_column: int,
) -> np.ndarray:
    """Bilinear values at places counted from the centre of the window's first cell; NaN outside the raster.

    Within half a cell of the raster's border the nearest row or column is taken.
    """
    result = np.full(rows.shape, np.float32(np.nan), np.float32)
    for i in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            row, column = rows[i, j] + first_row, columns[i, j] + first_column
            if not (-0.5 <= row <= shape[0] - 0.5 and -0.5 <= column <= shape[1] - 0.5):
                continue
            row = min(max(row, 0.0), shape[0] - 1.0)
            column = min(max(column, 0.0), shape[1] - 1.0)
            top, left = int(row), int(column)
            down, across = row - top, column - left
            top, left = top - first_row, left - first_column
            total = 0.0
            # A neighbour without weight may be missing.
            for step_y, weight_y in ((0, 1 - down), (1, down)):
                for step_x, weight_x in ((0, 1 - across), (1, across)):
                    if weight_y * weight_x > 1e-9:
                        total += weight_y * weight_x * values[top + step_y, left + step_x]
            result[i, j] = total
    return result


def _lowest(
    surface: xr.DataArray, cell: float, trusted: Callable[[tuple[slice, slice]], np.ndarray] | None
) -> xr.DataArray:
    grid = Grid.of(surface)
    coarse = Grid.from_bounds(grid.crs, grid.bounds, max(cell, grid.resolution))
    rows = np.clip(((coarse.north - grid.y) / coarse.resolution).astype(int), 0, coarse.height - 1)
    columns = np.clip(((grid.x - coarse.west) / coarse.resolution).astype(int), 0, coarse.width - 1)
    lowest = np.full(coarse.shape, np.inf, np.float32)
    for tile in grid.tiles(2048):
        values = surface.isel(y=tile.core[0], x=tile.core[1]).values
        usable = np.isfinite(values)
        if trusted is not None:
            usable &= trusted(tile.core)
        row, column = np.nonzero(usable)
        places = rows[tile.core[0]][row], columns[tile.core[1]][column]
        np.minimum.at(lowest, places, values[row, column])
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
    # Its threads wait for each other busily: beside other work two take ten times as long as one.
    with threadpool_limits(1, user_api="openmp"), _silence():
        cloth.do_filtering(ground, other, False)
    mask = np.zeros(len(xyz), bool)
    mask[np.array(ground, dtype=int)] = True
    return mask


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keep the library, which is not Python, from printing its progress to the standard output."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def filled_from_rims(terrain: np.ndarray) -> np.ndarray:
    """A terrain without holes: linear between the cells around a hole, nearest where nothing is around.

    Only the rims of holes are triangulated: with all cells, time and memory of large areas go there.
    """
    missing = np.isnan(terrain)
    if not missing.any():
        return terrain
    rim = ~missing & ndimage.binary_dilation(missing, np.ones((3, 3), bool))
    cells, heights, holes = np.argwhere(rim), terrain[rim], np.argwhere(missing)
    nearest = NearestNDInterpolator(cells, heights)
    # Exact for whole numbers, without the decomposition of a matrix of all cells.
    offset = cells - cells[0]
    farthest = offset[np.abs(offset).sum(axis=1).argmax()]
    on_a_line = not (offset[:, 0] * farthest[1] - offset[:, 1] * farthest[0]).any()
    heights_there = nearest(holes) if on_a_line else LinearNDInterpolator(cells, heights)(holes)
    beyond = np.isnan(heights_there)
    heights_there[beyond] = nearest(holes[beyond])
    filled = terrain.copy()
    filled[missing] = heights_there
    return filled
