"""Differential rectification: the colours of a photograph on the cells of a grid."""

from __future__ import annotations

import math

import numpy as np

from workbench.cameras.view import project
from workbench.compiled import compiled


def rectify(
    image: np.ndarray,
    view: np.ndarray,
    heights: np.ndarray,
    *,
    resolution: float,
    first_row: int = 0,
    first_column: int = 0,
    wanted: np.ndarray | None = None,
) -> np.ndarray:
    """Colours of the cells of a window, bilinear [thesis 2.3.1.2].

    Parameters
    ----------
    image
        (rows, columns, bands) of any type, possibly reduced against the photograph by a whole factor.
    view
        Row of :func:`workbench.cameras.view.view_table` (full photograph), relative to the grid's
        upper left corner.
    heights
        (rows, columns) of the window, metres.
    resolution
        Cell, metres.
    first_row, first_column
        Place of the window in the grid.
    wanted
        Cells to compute (rows, columns) bool; all by default.

    Returns
    -------
    ndarray (rows, columns, bands) float32
        NaN where not wanted or outside the photograph.
    """
    if wanted is None:
        wanted = np.ones(heights.shape, bool)
    return _rectify(
        np.ascontiguousarray(image),
        view,
        np.ascontiguousarray(heights, dtype=np.float32),
        resolution,
        first_row,
        first_column,
        np.ascontiguousarray(wanted),
    )


@compiled(nogil=True)
def _rectify(
    image: np.ndarray,
    view: np.ndarray,
    heights: np.ndarray,
    resolution: float,
    first_row: int,
    first_column: int,
    wanted: np.ndarray,
) -> np.ndarray:
    rows, columns = heights.shape
    image_rows, image_columns, bands = image.shape
    # A reduced photograph lacks the remainder of its last row and column: its pixels keep their scale.
    scale = 1.0 / max(round(view[24] / image_columns), 1)
    colours = np.full((rows, columns, bands), np.float32(np.nan), np.float32)
    for i in range(rows):
        y = -(first_row + i + 0.5) * resolution
        for j in range(columns):
            if not wanted[i, j]:
                continue
            u, v = project(view, (first_column + j + 0.5) * resolution, y, heights[i, j])
            if u != u:
                continue
            u = min(max(u * scale - 0.5, 0.0), image_columns - 1.0)
            v = min(max(v * scale - 0.5, 0.0), image_rows - 1.0)
            left, top = math.floor(u), math.floor(v)
            right, bottom = min(left + 1, image_columns - 1), min(top + 1, image_rows - 1)
            across, down = np.float32(u - left), np.float32(v - top)
            for band in range(bands):
                upper = image[top, left, band] * (1 - across) + image[top, right, band] * across
                lower = image[bottom, left, band] * (1 - across) + image[bottom, right, band] * across
                colours[i, j, band] = upper * (1 - down) + lower * down
    return colours
