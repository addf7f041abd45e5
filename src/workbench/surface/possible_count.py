"""How many pairs could have measured a cell: the frames of both photographs hold it."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
import xarray as xr

from workbench.cameras.view import project, view_table
from workbench.matching.levels import ground_height
from workbench.matching.pairs import StereoPair, select_pairs
from workbench.orientation import Block
from workbench.params import MatchParameters
from workbench.rasters import Grid, new_raster
from workbench.surface.filling import fill_heights


def possible_pairs(block: Block, parameters: MatchParameters) -> list[StereoPair]:
    """The pairs that the match stage was asked for."""
    return select_pairs(
        block, inflight=parameters.inflight, across=parameters.across, ground=ground_height(block)
    )


def count_possible(pairs: Sequence[StereoPair], surface: xr.DataArray) -> xr.DataArray:
    """Maximum possible count of every cell, on the surface itself [thesis 3.2.1].

    A cell counts for a pair if its point on the surface falls into both frames. A crown near the
    camera is in fewer frames than the ground below; holes of the surface are closed smoothly for
    the purpose. Occlusion is not considered, as in the thesis.

    Parameters
    ----------
    pairs
        Pairs that were to be matched.
    surface
        Heights (y, x) with CRS, metres.

    Returns
    -------
    DataArray (y, x) uint8
    """
    grid = Grid.of(surface)
    photographs = list({p.name: p for pair in pairs for p in (pair.left, pair.right)}.values())
    number = {photograph.name: k for k, photograph in enumerate(photographs)}
    members = np.array([[number[pair.left.name], number[pair.right.name]] for pair in pairs])
    table = view_table(photographs, grid)
    heights = fill_heights(surface)
    count = np.zeros(grid.shape, np.uint8)
    for tile in grid.tiles(1024):
        z, _ = heights.window(*tile.core)
        count[tile.core] = _count(z, table, members, grid.resolution, tile.core[0].start, tile.core[1].start)
    return new_raster(count, grid, name="possible_count", units="pairs", long_name="pairs that see the cell")


@numba.njit(cache=True, nogil=True)
def _count(
    heights: np.ndarray,
    table: np.ndarray,
    members: np.ndarray,
    resolution: float,
    first_row: int,
    first_column: int,
) -> np.ndarray:
    rows, columns = heights.shape
    count = np.zeros((rows, columns), np.uint8)
    seen = np.empty(len(table), np.bool_)
    for i in range(rows):
        y = -(first_row + i + 0.5) * resolution
        for j in range(columns):
            x = (first_column + j + 0.5) * resolution
            for k in range(len(table)):
                u, _ = project(table[k], x, y, heights[i, j])
                seen[k] = u == u
            total = 0
            for pair in range(len(members)):
                total += seen[members[pair, 0]] and seen[members[pair, 1]]
            count[i, j] = min(total, 255)
    return count
