"""Multi-band blending across seamlines [Burt & Adelson 1983]: optional, as it mixes photographs."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np

from workbench.cameras.view import view_table
from workbench.mosaic.colours import rectified, same_kind, to_digital
from workbench.mosaic.scratch import Scratch, Window
from workbench.mosaic.sources import Sight, Sources
from workbench.orientation import Block

_TILE = 1024
_DECODED = 6  # Photographs kept in memory: a tile and its neighbour share most of theirs.


def blend(
    block: Block, sight: Sight, sources: Sources, gains: np.ndarray, colours: Scratch, result: Scratch
) -> Scratch:
    """Blend the photographs of a mosaic across their seams.

    What is blended are differences: ``mosaic + sum_k blend(photograph_k - mosaic)``, with zero where
    photograph k does not see the cell. So nothing hidden shines through, cells far from seams keep
    their digital numbers, and without differences nothing changes.

    Parameters
    ----------
    colours
        The mosaic with hard seams (bands, rows, columns).
    result
        Takes the blended one.

    Returns
    -------
    Scratch
        ``result``.
    """
    grid, levels = sight.grid, sight.levels
    table = view_table(block.photographs, grid)
    # Twice the support of the coarsest band, in whole cells of it: a tile knows all that reaches it.
    margin = 8 << levels

    @lru_cache(_DECODED)
    def photograph(index: int) -> np.ndarray:
        return same_kind(block, index, colours)

    for tile in grid.tiles(_TILE, margin):
        window = tile.padded
        mosaic, source = colours.read(window), sources.source.read(window)

        def difference(index: int, cells: np.ndarray, window: Window = window, mosaic=mosaic) -> np.ndarray:
            wanted = cells & sight.seen(index, window)
            image = photograph(index)
            values = rectified(image, table[index], sight.heights, grid, window, wanted, gains[index])
            return np.moveaxis(np.nan_to_num(values - mosaic, nan=0.0), 0, -1).astype(np.float32)

        change = _blended(source, difference, levels)
        if change is not None:
            blended = to_digital(mosaic + np.moveaxis(change, -1, 0), colours.dtype)
            mosaic = np.where(source > 0, blended, mosaic)
        result.write(mosaic[(..., *tile.inner)], tile.core)
    return result


def _blended(
    source: np.ndarray, difference: Callable[[int, np.ndarray], np.ndarray], levels: int
) -> np.ndarray | None:
    """Sum of the blended differences (rows, columns, bands); None where one photograph gives everything."""
    numbers = np.unique(source[source > 0])
    if len(numbers) < 2:
        return None
    covered = _gaussians((source > 0).astype(np.float32), levels)
    bands: list[np.ndarray] | None = None
    for number in numbers:
        own = source == number
        near = _near(own, 4 << levels) & (source > 0) & ~own
        if not near.any():
            continue
        detail = _laplacians(difference(int(number) - 1, near), levels)
        weights = _gaussians(own.astype(np.float32), levels)
        parts = [
            d * (w / np.maximum(c, 1e-3))[..., None] for d, w, c in zip(detail, weights, covered, strict=True)
        ]
        bands = parts if bands is None else [b + p for b, p in zip(bands, parts, strict=True)]
    return None if bands is None else _collapse(bands)


def _near(mask: np.ndarray, distance: int) -> np.ndarray:
    square = np.ones((2 * distance + 1, 2 * distance + 1), np.uint8)
    return cv2.dilate(mask.astype(np.uint8), square).astype(bool)


def _gaussians(values: np.ndarray, levels: int) -> list[np.ndarray]:
    pyramid = [values]
    for _ in range(levels):
        pyramid.append(_bands_last(cv2.pyrDown(pyramid[-1]), values.ndim))
    return pyramid


def _laplacians(values: np.ndarray, levels: int) -> list[np.ndarray]:
    means = _gaussians(values, levels)
    return [fine - _up(coarse, fine) for fine, coarse in pairwise(means)] + means[-1:]


def _collapse(bands: list[np.ndarray]) -> np.ndarray:
    total = bands[-1]
    for band in reversed(bands[:-1]):
        total = band + _up(total, band)
    return total


def _up(coarse: np.ndarray, fine: np.ndarray) -> np.ndarray:
    return _bands_last(cv2.pyrUp(coarse, dstsize=(fine.shape[1], fine.shape[0])), fine.ndim)


def _bands_last(values: np.ndarray, dimensions: int) -> np.ndarray:
    """OpenCV drops a last axis of one band."""
    return values if values.ndim == dimensions else values[..., None]
