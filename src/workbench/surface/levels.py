"""The surface of one downscale: all its pairs, gridded and fused tile by tile."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from workbench.matching.store import MatchedPair
from workbench.params import SurfaceParameters
from workbench.rasters import Grid
from workbench.surface.fusion import fuse_pairs
from workbench.surface.gridding import grid_pair

_DEFAULTS = SurfaceParameters()


@dataclass(frozen=True, eq=False)
class Level:
    """Surface of one downscale."""

    height: np.ndarray
    """(rows, columns) float32, metres, NaN where nothing was measured."""
    count: np.ndarray
    """(rows, columns) uint8: pairs that measured and were used."""
    spread: np.ndarray
    """(rows, columns) float32: robust standard deviation of the used heights, metres."""


def grid_level(
    pairs: Sequence[Callable[[], MatchedPair]],
    grid: Grid,
    heights: tuple[float, float],
    parameters: SurfaceParameters = _DEFAULTS,
) -> Level:
    """Grid and fuse all pairs of a downscale.

    Pairs are opened one at a time and only the tiles that they reach are touched, so that memory
    holds one pair and the heights of one band of tiles.

    Parameters
    ----------
    pairs
        One function a pair that loads it.
    grid
        Cells of the surface.
    heights
        Lowest and highest possible height, metres.
    parameters
        Tolerance, least count and confidence, patch size.
    """
    height = np.full(grid.shape, np.nan, np.float32)
    count = np.zeros(grid.shape, np.uint8)
    spread = np.full(grid.shape, np.nan, np.float32)
    for tile in grid.tiles(parameters.tile_size):
        window = grid.window(*tile.core)
        gridded, trust, precision = [], [], []
        for load in pairs:
            pair = load()
            found = grid_pair(pair, window, heights, least_confidence=parameters.least_confidence)
            if found is not None and np.isfinite(found[0]).any():
                gridded.append(found[0])
                trust.append(found[1])
                precision.append(pair.rectification.height_precision(float(np.nanmedian(found[0]))))
        if gridded:
            fused = fuse_pairs(
                np.stack(gridded), np.stack(trust), np.array(precision), tolerance=parameters.tolerance
            )
            height[tile.core], count[tile.core], spread[tile.core] = fused
    few = count < parameters.min_count
    height[few] = np.nan
    remove_specks(height, parameters.min_patch / grid.resolution**2, parameters.patch_step)
    empty = np.isnan(height)
    count[empty], spread[empty] = 0, np.nan
    return Level(height, count, spread)


def remove_specks(height: np.ndarray, least_cells: float, step: float) -> None:
    """Empty, in place, connected patches of fewer cells; neighbours within a step (metres) connect."""
    if least_cells <= 1:
        return
    labels = patches(height, step)
    sizes = np.bincount(labels.ravel())
    small = sizes < least_cells
    small[0] = False
    height[small[labels]] = np.nan


def patches(height: np.ndarray, step: float) -> np.ndarray:
    """Labels (rows, columns) from 1 of connected patches; 0 where there is no height."""
    # Doubling the grid puts the link between two cells into a cell of its own.
    rows, columns = height.shape
    links = np.zeros((2 * rows - 1, 2 * columns - 1), np.uint8)
    known = np.isfinite(height)
    links[::2, ::2] = known
    with np.errstate(invalid="ignore"):
        links[1::2, ::2] = np.abs(np.diff(height, axis=0)) <= step
        links[::2, 1::2] = np.abs(np.diff(height, axis=1)) <= step
    _, labels = cv2.connectedComponents(links, connectivity=4, ltype=cv2.CV_32S)
    return labels[::2, ::2]
