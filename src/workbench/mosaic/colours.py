"""Second pass of an orthophoto: each photograph once, its colours on the cells that it gives."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from workbench.cameras.view import view_table
from workbench.compiled import compiled
from workbench.errors import MosaicError
from workbench.mosaic.rectify import rectify
from workbench.mosaic.scratch import Scratch, Window
from workbench.mosaic.sources import Sources
from workbench.orientation import Block
from workbench.photographs import read_photograph
from workbench.rasters import Grid
from workbench.surface.filling import FilledHeights

_TILE = 1024
_THREADS = 2
_WALL = 2.0  # Neighbouring cells that differ by more than this many cells are steeper than 63 degrees.


def fill_colours(
    block: Block,
    heights: FilledHeights,
    grid: Grid,
    sources: Sources,
    gains: np.ndarray,
    colours: Scratch,
) -> None:
    """Put the colours of all photographs in their places.

    Parameters
    ----------
    gains
        (photographs, bands): factors.
    colours
        (bands, rows, columns) of the grid; measured zeros become 1, as 0 is no data.

    Raises
    ------
    MosaicError
        If photographs differ in bands or type.
    """
    table = view_table(block.photographs, grid)
    with ThreadPoolExecutor(_THREADS) as pool:
        for index, window in sorted(sources.windows.items()):
            image = same_kind(block, index, colours)

            def fill(part: Window, index: int = index, image: np.ndarray = image) -> None:
                wanted = sources.source.read(part) == index + 1
                if wanted.any():
                    values = rectified(image, table[index], heights, grid, part, wanted, gains[index])
                    shown = np.isfinite(values[0])
                    colours.write(to_digital(values, colours.dtype), part, where=shown)

            list(pool.map(fill, _parts(window)))


def same_kind(block: Block, index: int, colours: Scratch) -> np.ndarray:
    """A photograph, if it has the bands and type of the mosaic."""
    path = block.photographs[index].path
    image = read_photograph(path)
    bands, kind = colours.shape[0], colours.dtype
    if image.shape[-1] != bands or image.dtype != kind:
        raise MosaicError(
            f"{path}: {image.shape[-1]} bands of {image.dtype}, others have {bands} of {kind}: make one site "
            "for each kind of camera."
        )
    return image


def to_digital(values: np.ndarray, kind: np.dtype) -> np.ndarray:
    """Digital numbers of a type, 1 at least where there is a value; NaN becomes 0."""
    numbers = np.clip(np.rint(values), 1, np.iinfo(kind).max)
    return np.nan_to_num(numbers, nan=0.0).astype(kind)


def rectified(
    image: np.ndarray,
    view: np.ndarray,
    heights: FilledHeights,
    grid: Grid,
    window: Window,
    wanted: np.ndarray,
    gains: np.ndarray,
) -> np.ndarray:
    """Balanced colours (bands, rows, columns) float32 of the wanted cells of a window, NaN elsewhere."""
    z, _ = heights_at(heights, grid, *window)
    values = rectify(
        image,
        view,
        z,
        resolution=grid.resolution,
        first_row=window[0].start,
        first_column=window[1].start,
        wanted=wanted,
    )
    return np.moveaxis(values * gains.astype(np.float32), -1, 0)


def _parts(window: Window) -> Iterator[Window]:
    rows, columns = window
    for top in range(rows.start, rows.stop, _TILE):
        for left in range(columns.start, columns.stop, _TILE):
            yield (
                slice(top, min(top + _TILE, rows.stop)),
                slice(left, min(left + _TILE, columns.stop)),
            )


def heights_at(
    heights: FilledHeights, grid: Grid, rows: slice, columns: slice
) -> tuple[np.ndarray, np.ndarray]:
    """Heights at the cells of a window of another grid (bilinear), and whether they were measured."""
    base = heights.grid
    window = grid.window(rows, columns)
    y = np.clip((base.north - window.y) / base.resolution - 0.5, 0, base.height - 1)
    x = np.clip((window.x - base.west) / base.resolution - 0.5, 0, base.width - 1)
    top, left = int(y.min()), int(x.min())
    bottom, right = min(int(y.max()) + 2, base.height), min(int(x.max()) + 2, base.width)
    z, measured = heights.window(slice(top, bottom), slice(left, right))
    return _between(z, measured, y - top, x - left, _WALL * base.resolution)


@compiled(nogil=True)
def _between(
    z: np.ndarray, measured: np.ndarray, y: np.ndarray, x: np.ndarray, wall: float
) -> tuple[np.ndarray, np.ndarray]:
    """Bilinear heights at rows y and columns x (cells, from the first centre).

    Between the top and the foot of a wall there is no height: a cell there belongs to one of them.
    """
    rows, columns = z.shape
    heights = np.empty((len(y), len(x)), np.float32)
    known = np.empty((len(y), len(x)), np.bool_)
    for i in range(len(y)):
        top = int(y[i])
        bottom, down = min(top + 1, rows - 1), np.float32(y[i] - top)
        near_row = top if down < 0.5 else bottom
        for j in range(len(x)):
            left = int(x[j])
            right, across = min(left + 1, columns - 1), np.float32(x[j] - left)
            near_column = left if across < 0.5 else right
            a, b, c, d = z[top, left], z[top, right], z[bottom, left], z[bottom, right]
            known[i, j] = measured[near_row, near_column]
            if max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) > wall:
                heights[i, j] = z[near_row, near_column]
            else:
                upper, lower = a * (1 - across) + b * across, c * (1 - across) + d * across
                heights[i, j] = upper * (1 - down) + lower * down
    return heights, known
