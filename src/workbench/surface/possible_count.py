"""How many pairs could have measured a cell: the frames of both photographs hold it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from workbench.cameras import Camera
from workbench.cameras.view import project, view_table
from workbench.compiled import compiled
from workbench.matching.levels import ground_height
from workbench.matching.pairs import StereoPair, select_pairs
from workbench.orientation import Block
from workbench.params import MatchParameters
from workbench.rasters import Grid, new_raster
from workbench.surface.filling import FilledHeights, fill_heights

_LEVEL = 0.05  # Rays that fall by less do not meet the ground anywhere near.


def possible_pairs(block: Block, parameters: MatchParameters) -> list[StereoPair]:
    """The pairs that the match stage was asked for."""
    return select_pairs(
        block, inflight=parameters.inflight, across=parameters.across, ground=ground_height(block)
    )


class PossibleCount:
    """Maximum possible count of every cell, on the surface itself, by window [thesis 3.2.1].

    A cell counts for a pair if its point on the surface falls into both frames. A crown near the
    camera is in fewer frames than the ground below; holes of the surface are closed smoothly for
    the purpose. Occlusion is not considered, as in the thesis.

    Parameters
    ----------
    pairs
        Pairs that were to be matched.
    heights
        Surface with CRS, metres.
    """

    def __init__(self, pairs: Sequence[StereoPair], heights: FilledHeights) -> None:
        photographs = list({p.name: p for pair in pairs for p in (pair.left, pair.right)}.values())
        number = {photograph.name: k for k, photograph in enumerate(photographs)}
        self._heights, self._grid = heights, heights.grid
        self._members = np.array([[number[pair.left.name], number[pair.right.name]] for pair in pairs])
        self._table = view_table(photographs, self._grid)
        self._centres = np.array([p.pose.centre for p in photographs])
        self._rays = np.array([p.pose.to_world(p.camera.rays(_outline(p.camera))) for p in photographs])

    def window(self, rows: slice, columns: slice) -> np.ndarray:
        """Possible count (rows, columns) uint8."""
        z, _ = self._heights.window(rows, columns)
        near = self._near(self._grid.window(rows, columns), float(z.min()), float(z.max()))
        members = self._members[near[self._members].all(axis=1)]
        place = np.cumsum(near) - 1
        return _count(z, self._table[near], place[members], self._grid.resolution, rows.start, columns.start)

    def _near(self, part: Grid, low: float, high: float) -> np.ndarray:
        """Photographs, bool, whose footprint between two heights can touch a part of the grid."""
        west, south, east, north = part.bounds
        down = np.minimum(self._rays[..., 2], -_LEVEL)
        every = []
        for height in (low, high):
            reach = (height - self._centres[:, 2])[:, None] / down
            every.append(self._centres[:, None, :2] + self._rays[..., :2] * reach[..., None])
        places = np.concatenate(every, axis=1)
        touching = (places.min(axis=1) < (east, north)) & (places.max(axis=1) > (west, south))
        # A frame that shows the horizon has no bounded footprint.
        return touching.all(axis=1) | (self._rays[..., 2] > -_LEVEL).any(axis=1)


def count_possible(pairs: Sequence[StereoPair], surface: xr.DataArray) -> xr.DataArray:
    """The whole of :class:`PossibleCount` as a raster (y, x) uint8."""
    grid = Grid.of(surface)
    possible = PossibleCount(pairs, fill_heights(surface))
    count = np.zeros(grid.shape, np.uint8)
    for tile in grid.tiles(1024):
        count[tile.core] = possible.window(*tile.core)
    return new_raster(count, grid, name="possible_count", units="pairs", long_name="pairs that see the cell")


def _outline(camera: Camera) -> np.ndarray:
    """Positions along the border of a frame, px."""
    edge = np.linspace(0, 1, 9)
    zero, one = np.zeros(9), np.ones(9)
    sides = ((edge, zero), (edge, one), (zero, edge), (one, edge))
    return np.concatenate([np.stack(side, axis=1) for side in sides]) * (camera.width, camera.height)


@compiled(nogil=True)
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
