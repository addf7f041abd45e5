"""Values of coarse cells on a finer grid."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from workbench.rasters import Grid

Window = tuple[slice, slice]


def refine(values: np.ndarray, coarse: Grid, fine: Grid, *, step: float | None = None) -> np.ndarray:
    """Values of coarse cells at the centres of fine ones, for rasters in memory.

    See :func:`refine_window`.
    """
    result = np.empty(fine.shape, values.dtype)
    for tile in fine.tiles(2048):
        result[tile.core] = refine_window(values.__getitem__, coarse, fine, tile.core, step=step)
    return result


def refine_window(
    read: Callable[[Window], np.ndarray],
    coarse: Grid,
    fine: Grid,
    window: Window,
    *,
    step: float | None = None,
) -> np.ndarray:
    """Values of coarse cells at the centres of the fine cells of a window.

    Without ``step`` every fine cell takes the value of the coarse cell that it lies in. With it,
    heights are interpolated bilinearly between the four nearest coarse cells where all are known and
    differ by no more than the step (metres): never across the edge of a crown.

    Parameters
    ----------
    read
        Gives the values of a window (rows, columns) of the coarse grid.
    coarse, fine
        The grids; the fine one lies within the coarse one.
    window
        Rows and columns of the fine grid.
    step
        Largest difference to interpolate over, metres.

    Returns
    -------
    ndarray (rows, columns)
        Of the type of the coarse values; the same for every way to cut the grid into windows.
    """
    x = (fine.x[window[1]] - coarse.west) / coarse.resolution
    y = (coarse.north - fine.y[window[0]]) / coarse.resolution
    columns = np.clip(np.floor(x).astype(int), 0, coarse.width - 1)
    rows = np.clip(np.floor(y).astype(int), 0, coarse.height - 1)
    left, right, across = _between(x, coarse.width)
    top, bottom, down = _between(y, coarse.height)
    first_row, first_column = int(top.min()), int(left.min())
    values = read((slice(first_row, int(bottom.max()) + 1), slice(first_column, int(right.max()) + 1)))
    nearest = values[np.ix_(rows - first_row, columns - first_column)]
    if step is None:
        return nearest
    corners = np.stack(
        [values[np.ix_(a - first_row, b - first_column)] for a in (top, bottom) for b in (left, right)]
    )
    weight_x, weight_y = across[None, :], down[:, None]
    smooth = (corners[0] * (1 - weight_x) + corners[1] * weight_x) * (1 - weight_y)
    smooth += (corners[2] * (1 - weight_x) + corners[3] * weight_x) * weight_y
    with np.errstate(invalid="ignore"):
        even = np.isfinite(smooth) & (corners.max(axis=0) - corners.min(axis=0) <= step)
    return np.where(even & np.isfinite(nearest), smooth, nearest)


def _between(position: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The two cell centres around a position (in cells) and the weight of the second."""
    centre = np.clip(position - 0.5, 0, count - 1)
    low = np.floor(centre).astype(int)
    return low, np.minimum(low + 1, count - 1), (centre - low).astype(np.float32)
