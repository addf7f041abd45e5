"""First pass of an orthophoto: which photograph gives each cell, tile by tile and from geometry alone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import islice

import cv2
import geopandas as gpd
import numpy as np
from rasterio.features import geometry_mask

from workbench.cameras.view import view_table
from workbench.mosaic.scratch import Scratch, Window
from workbench.mosaic.views import best_views, steepest_tangent
from workbench.orientation import Block
from workbench.params import MosaicParameters
from workbench.rasters import Grid, Tile
from workbench.surface.filling import FilledHeights

NOT_SEEN, MEASURED, INTERPOLATED, HIDDEN, UNCOVERED = range(5)
"""Values of ``validity.tif``: outside all photographs; shown on a measured height; shown on an interpolated
height; inside a photograph, but hidden from all; hidden, but so narrow that it is shown all the same."""

_TILE = 1024
_THREADS = 2


@dataclass
class Sources:
    """Photograph and validity of every cell of an orthophoto."""

    source: Scratch
    """uint16: number of the photograph, from 1 in the order of the block; 0 none."""
    validity: Scratch
    """uint8: see :data:`NOT_SEEN` and its neighbours."""
    cells: np.ndarray = field(default_factory=lambda: np.zeros(5, np.int64))
    """Cells of each validity."""
    windows: dict[int, Window] = field(default_factory=dict)
    """Rows and columns that hold the cells of each photograph (from 0) that gives any."""

    def note(self, chosen: np.ndarray, flags: np.ndarray, window: Window) -> None:
        """Keep a tile."""
        self.source.write(chosen, window)
        self.validity.write(flags, window)
        self.cells += np.bincount(flags.ravel(), minlength=len(self.cells))
        for number in np.unique(chosen[chosen > 0]):
            i, j = (np.flatnonzero((chosen == number).any(axis=axis)) for axis in (1, 0))
            part = (
                slice(window[0].start + int(i[0]), window[0].start + int(i[-1]) + 1),
                slice(window[1].start + int(j[0]), window[1].start + int(j[-1]) + 1),
            )
            before = self.windows.get(int(number) - 1)
            self.windows[int(number) - 1] = part if before is None else _around(before, part)


class Sight:
    """What the photographs of a block see of a surface, window by window of another grid.

    Sight is tested on the cells of the surface; a cell of the grid has what the cell of the surface at
    its centre has.
    """

    def __init__(
        self, block: Block, heights: FilledHeights, grid: Grid, parameters: MosaicParameters
    ) -> None:
        self.heights, self.grid, self.surface = heights, grid, heights.grid
        self.table = view_table(block.photographs, self.surface)
        self.tolerance = parameters.visibility_tolerance if parameters.visibility else None
        self.specks = parameters.hidden_specks if parameters.visibility else 0
        self.levels = parameters.blending_levels
        relief = float(heights.coarse.max() - heights.coarse.min()) + 5.0
        reach = math.ceil(relief * steepest_tangent(self.table) / self.surface.resolution)
        self.margin = reach if parameters.visibility else 0

    def choose(self, window: Window, labels: np.ndarray, coarse: Grid) -> tuple[np.ndarray, np.ndarray]:
        """Photograph and validity of the cells of a window, preferred ones as ``labels`` on ``coarse``."""
        rows, columns, pick = self._cells(window)
        # Around the cells by the width of a speck, so that its shape does not depend on the tile.
        wanted = _padded((rows, columns), self.specks, self.surface.shape)
        padded = _padded(wanted, self.margin, self.surface.shape)
        inner = _within(wanted, padded)
        z, measured = self.heights.window(*padded)
        wish = labels[_lookup(self.surface, coarse, *padded)]
        decide = np.zeros(z.shape, bool)
        decide[inner] = True
        chosen = self._best(z, padded, wish, decide, self.tolerance)
        flags = np.where(chosen > 0, np.where(measured, MEASURED, INTERPOLATED), NOT_SEEN).astype(np.uint8)
        hidden = (chosen == 0) & (wish > 0) & decide
        flags[hidden] = HIDDEN
        if self.specks and hidden.any():
            speck = np.zeros_like(hidden)
            speck[inner] = hidden[inner] & ~_opened(hidden[inner], self.specks)
            shown = self._best(z, padded, wish, speck, None)
            chosen = np.where(speck, shown, chosen)
            flags[speck & (shown > 0)] = UNCOVERED
        here = _within((rows, columns), padded)
        return chosen[here][pick], flags[here][pick]

    def seen(self, index: int, window: Window) -> np.ndarray:
        """Cells (rows, columns) bool of a window that one photograph sees."""
        rows, columns, pick = self._cells(window)
        padded = _padded((rows, columns), self.margin, self.surface.shape)
        z, _ = self.heights.window(*padded)
        decide = np.zeros(z.shape, bool)
        here = _within((rows, columns), padded)
        decide[here] = True
        nothing = np.zeros(z.shape, np.uint16)
        table = self.table[index : index + 1]
        return self._best(z, padded, nothing, decide, self.tolerance, table)[here][pick] > 0

    def _best(
        self,
        z: np.ndarray,
        window: Window,
        wish: np.ndarray,
        wanted: np.ndarray,
        tolerance: float | None,
        table: np.ndarray | None = None,
    ) -> np.ndarray:
        return best_views(
            z,
            self.table if table is None else table,
            resolution=self.surface.resolution,
            first_row=window[0].start,
            first_column=window[1].start,
            preferred=wish,
            wanted=wanted,
            tolerance=tolerance,
        )

    def _cells(self, window: Window) -> tuple[slice, slice, tuple[np.ndarray, ...]]:
        """Window of the surface below a window of the grid, and which of its cells each cell takes."""
        part = self.grid.window(*window)
        i = np.floor((self.surface.north - part.y) / self.surface.resolution)
        j = np.floor((part.x - self.surface.west) / self.surface.resolution)
        i = np.clip(i, 0, self.surface.height - 1).astype(int)
        j = np.clip(j, 0, self.surface.width - 1).astype(int)
        rows, columns = (slice(int(k.min()), int(k.max()) + 1) for k in (i, j))
        return rows, columns, np.ix_(i - rows.start, j - columns.start)


def find_sources(sight: Sight, labels: np.ndarray, coarse: Grid, sources: Sources) -> None:
    """Decide on all tiles; memory holds a few of them at a time."""

    def decide(tile: Tile) -> tuple[np.ndarray, np.ndarray]:
        return sight.choose(tile.core, labels, coarse)

    with ThreadPoolExecutor(_THREADS) as pool:
        for some in _some(sight.grid.tiles(_TILE)):
            for tile, (chosen, flags) in zip(some, pool.map(decide, some), strict=True):
                sources.note(chosen, flags, tile.core)


def clip_sources(sources: Sources, area: gpd.GeoDataFrame, grid: Grid) -> Sources:
    """The same inside of an area; outside of it no photograph gives a cell."""
    kept = Sources(sources.source, sources.validity)
    shapes = list(area.geometry)
    for tile in grid.tiles(_TILE):
        part = grid.window(*tile.core)
        inside = geometry_mask(shapes, part.shape, part.transform, invert=True)
        chosen, flags = sources.source.read(tile.core), sources.validity.read(tile.core)
        kept.note(
            np.where(inside, chosen, 0).astype(np.uint16),
            np.where(inside, flags, NOT_SEEN).astype(np.uint8),
            tile.core,
        )
    return kept


def _some(tiles: Iterable[Tile]) -> Iterator[tuple[Tile, ...]]:
    iterator = iter(tiles)
    while some := tuple(islice(iterator, 2 * _THREADS)):
        yield some


def _opened(mask: np.ndarray, size: int) -> np.ndarray:
    """What a square of a size fits into; beyond the border the mask goes on."""
    square = np.ones((size, size), np.uint8)
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, square).astype(bool)


def _padded(window: Window, margin: int, shape: tuple[int, int]) -> Window:
    rows, columns = (
        slice(max(part.start - margin, 0), min(part.stop + margin, size))
        for part, size in zip(window, shape, strict=True)
    )
    return rows, columns


def _within(window: Window, outer: Window) -> Window:
    rows, columns = (slice(a.start - b.start, a.stop - b.start) for a, b in zip(window, outer, strict=True))
    return rows, columns


def _around(a: Window, b: Window) -> Window:
    rows, columns = (slice(min(p.start, q.start), max(p.stop, q.stop)) for p, q in zip(a, b, strict=True))
    return rows, columns


def _lookup(fine: Grid, coarse: Grid, rows: slice, columns: slice) -> tuple[np.ndarray, ...]:
    """Index arrays of the coarse cells that hold the centres of a window of the fine grid."""
    window = fine.window(rows, columns)
    i = np.clip(np.floor((coarse.north - window.y) / coarse.resolution), 0, coarse.height - 1)
    j = np.clip(np.floor((window.x - coarse.west) / coarse.resolution), 0, coarse.width - 1)
    return np.ix_(i.astype(int), j.astype(int))
