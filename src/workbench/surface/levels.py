"""The surface of one downscale: all its pairs, gridded and fused tile by tile."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from workbench.matching.levels import common_extent
from workbench.matching.store import MatchedPair, StoredPair
from workbench.params import SurfaceParameters
from workbench.rasters import Grid, ScratchArrays, Tile
from workbench.surface.fusion import fuse_pairs
from workbench.surface.gridding import grid_pair
from workbench.surface.refine import Window, refine_window
from workbench.surface.specks import SpeckFinder

_DEFAULTS = SurfaceParameters()
_CACHE = 300_000_000  # Bytes of pairs that are kept open: those that neighbouring tiles share.


class Level:
    """Surface of one downscale on disk, read by window.

    Made by :func:`grid_level`; its files vanish when it is closed.
    """

    def __init__(self, downscale: int, grid: Grid, folder: Path) -> None:
        self.downscale = downscale
        """Factor by which the photographs were reduced."""
        self.grid = grid
        """Cells of the surface."""
        self.arrays = ScratchArrays(
            folder, grid.shape, {"height": "float32", "count": "uint8", "spread": "float32", "sure": "uint8"}
        )
        """``height`` (float32, metres, NaN where nothing was measured), ``count`` (uint8: pairs that
        measured and were used), ``spread`` (float32: robust standard deviation of the used heights,
        metres), ``sure`` (uint8: 1 where two pairs, or one at a small angle, vouch for the height)."""

    def window(self, name: str, grid: Grid, window: Window, *, step: float | None = None) -> np.ndarray:
        """One of the arrays in a window of a grid of the same or of finer cells.

        Heights are refined smoothly up to a ``step`` (metres) between neighbours; without it a fine
        cell takes the value of the coarse cell.
        """
        if grid == self.grid:
            return self.arrays.read(name, window)
        return refine_window(lambda part: self.arrays.read(name, part), self.grid, grid, window, step=step)

    def __enter__(self) -> Level:
        return self

    def __exit__(self, *_: object) -> None:
        self.arrays.__exit__()


@dataclass(frozen=True, eq=False)
class FusedWindow:
    """All downscales together in one window, (rows, columns) each."""

    height: np.ndarray
    """float32, metres, NaN where no downscale measured."""
    provenance: np.ndarray
    """uint8: the downscale that measured the cell, 0 none."""
    count: np.ndarray
    """uint8: pairs that measured the cell at that downscale."""
    spread: np.ndarray
    """float32: robust standard deviation of their heights, metres."""
    levels: dict[int, np.ndarray]
    """float32 heights of each downscale alone."""


def grid_level(
    pairs: Sequence[StoredPair],
    downscale: int,
    grid: Grid,
    heights: tuple[float, float],
    folder: Path,
    parameters: SurfaceParameters = _DEFAULTS,
) -> Level:
    """Grid and fuse all pairs of a downscale.

    Memory holds one tile of the pairs that reach it; whatever covers the whole area is on disk.

    Parameters
    ----------
    pairs
        Pairs on disk.
    downscale
        Of these pairs.
    grid
        Cells of the surface.
    heights
        Lowest and highest possible height, metres.
    folder
        Existing folder for scratch files.
    parameters
        Tolerance, least count and confidence, patch size, tile size.

    Returns
    -------
    Level
        To be closed by the caller.
    """
    level = Level(downscale, grid, folder)
    stored = _Pairs(pairs, heights)
    cell = grid.resolution**2
    least, alone = parameters.min_patch / cell, parameters.min_single_patch / cell
    specks = SpeckFinder(grid.shape, least, parameters.largest_step(grid.resolution), alone)
    tiles = list(grid.tiles(parameters.tile_size))
    for tile in tiles:
        height, count, spread, agreed = _fuse_tile(stored, grid, tile, heights, parameters)
        height[count < parameters.min_count] = np.nan
        specks.add(tile, height, agreed)
        _store(level, tile, height, count, spread, agreed)
    specks.finish()
    for tile in tiles:
        height = level.arrays.read("height", tile.core)
        if specks.clean(tile, height):
            others = (level.arrays.read(name, tile.core) for name in ("count", "spread", "sure"))
            _store(level, tile, height, *others)
    return level


def level_grid(grid: Grid, downscale: int, finest: int) -> Grid:
    """Cells of a downscale on a grid that fits the finest one: as much larger as its pixels are."""
    factor = max(round(downscale / finest), 1)
    return grid if factor == 1 else Grid.from_bounds(grid.crs, grid.bounds, grid.resolution * factor)


def fuse_levels(levels: Sequence[Level], grid: Grid, window: Window, step: float) -> FusedWindow:
    """Holes of each downscale filled with measured cells of the next one [thesis 4.2.1, 5.1].

    What two pairs agree on, or one at a small angle saw, comes first, from the finest to the coarsest:
    more detail does not make up for a second witness. The rest is filled by what one wide pair measured.

    Parameters
    ----------
    levels
        Finest first.
    grid, window
        Rows and columns of a grid as fine as the finest level.
    step
        Coarser heights are refined smoothly between neighbours that differ by no more, metres.
    """
    alone = {level.downscale: level.window("height", grid, window, step=step) for level in levels}
    shape = next(iter(alone.values())).shape
    fused = FusedWindow(
        np.full(shape, np.nan, np.float32),
        np.zeros(shape, np.uint8),
        np.zeros(shape, np.uint8),
        np.full(shape, np.nan, np.float32),
        alone,
    )
    sure = {level.downscale: level.window("sure", grid, window) > 0 for level in levels}
    for level, witnessed in [(level, True) for level in levels] + [(level, False) for level in levels]:
        new = np.isnan(fused.height) & np.isfinite(alone[level.downscale])
        if witnessed:
            new &= sure[level.downscale]
        if new.any():
            fused.height[new] = alone[level.downscale][new]
            fused.provenance[new] = level.downscale
            fused.count[new] = level.window("count", grid, window)[new]
            fused.spread[new] = level.window("spread", grid, window)[new]
    return fused


class _Pairs:
    """The pairs of a level: which of them reach a tile, and the latest of them kept open."""

    def __init__(self, pairs: Sequence[StoredPair], heights: tuple[float, float]) -> None:
        self._pairs = pairs
        extents = [[common_extent([pair.rectification], z) for z in heights] for pair in pairs]
        self._extents = np.array(extents).reshape(len(pairs), 2, 4)
        self._kept: OrderedDict[int, MatchedPair] = OrderedDict()

    def reaching(self, grid: Grid) -> np.ndarray:
        """Numbers of the pairs whose extent at the lowest and highest height touches a grid."""
        west, south, east, north = grid.bounds
        low, high = self._extents[:, :, :2].min(axis=1), self._extents[:, :, 2:].max(axis=1)
        return np.flatnonzero(((low < (east, north)) & (high > (west, south))).all(axis=1))

    def load(self, number: int) -> MatchedPair:
        if number in self._kept:
            self._kept.move_to_end(number)
            return self._kept[number]
        loaded = self._kept[number] = self._pairs[number].load()
        while len(self._kept) > 1 and sum(p.disparity.nbytes for p in self._kept.values()) > _CACHE:
            self._kept.popitem(last=False)
        return loaded


def _fuse_tile(
    pairs: _Pairs, grid: Grid, tile: Tile, heights: tuple[float, float], parameters: SurfaceParameters
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Height, count, spread; and the cells that two pairs, or one at a small angle, vouch for."""
    part = grid.window(*tile.core)
    numbers = pairs.reaching(part)
    height, trust, precision = np.empty((3, len(numbers), *part.shape), np.float32)
    highest = []  # Heights, metres, below which each pair meets at a small angle.
    found = 0
    for number in numbers:
        pair = pairs.load(number)
        seen = grid_pair(pair, grid, heights, window=tile.core, least_confidence=parameters.least_confidence)
        if seen is not None and np.isfinite(seen[0]).any():
            height[found], trust[found] = seen
            r = pair.rectification
            precision[found] = r.height_precision(seen[0])
            highest.append(r.centre[2] - r.base / math.tan(math.radians(parameters.single_angle)))
            found += 1
    fused, count, spread = fuse_pairs(
        height[:found], trust[:found], precision[:found], tolerance=parameters.tolerance
    )
    agreed = count >= 2
    for own, limit in zip(height[:found], highest, strict=True):
        agreed |= (np.abs(own - fused) <= parameters.tolerance) & (own <= limit)
    return fused, count, spread, agreed


def _store(
    level: Level, tile: Tile, height: np.ndarray, count: np.ndarray, spread: np.ndarray, sure: np.ndarray
) -> None:
    """Write a tile; where there is no height, nothing counts."""
    empty = np.isnan(height)
    count[empty], spread[empty], sure[empty] = 0, np.nan, 0
    for name, values in (("height", height), ("count", count), ("spread", spread), ("sure", sure)):
        level.arrays.write(name, values, tile.core)
