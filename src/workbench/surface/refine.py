"""Coarser cells on a finer grid."""

from __future__ import annotations

import numpy as np

from workbench.rasters import Grid


def refine(values: np.ndarray, coarse: Grid, fine: Grid, *, step: float | None = None) -> np.ndarray:
    """Values of coarse cells at the centres of fine ones.

    Without ``step`` every fine cell takes the value of the coarse cell that it lies in. With it,
    heights are interpolated bilinearly between the four nearest coarse cells where all are known and
    differ by no more than the step (metres): never across the edge of a crown.

    Parameters
    ----------
    values
        (rows, columns) on the coarse grid.
    coarse, fine
        The grids; the fine one lies within the coarse one.
    step
        Largest difference to interpolate over, metres.

    Returns
    -------
    ndarray (rows, columns)
        On the fine grid, of the type of ``values``.
    """
    result = np.empty(fine.shape, values.dtype)
    x = (fine.x - coarse.west) / coarse.resolution
    columns = np.clip(np.floor(x).astype(int), 0, coarse.width - 1)
    left, right, across = _between(x, coarse.width)
    for tile in fine.tiles(2048):
        y = (coarse.north - fine.y[tile.core[0]]) / coarse.resolution
        part = tile.core[1]
        rows = np.clip(np.floor(y).astype(int), 0, coarse.height - 1)
        nearest = values[np.ix_(rows, columns[part])]
        if step is None:
            result[tile.core] = nearest
            continue
        top, bottom, down = _between(y, coarse.height)
        corners = np.stack([values[np.ix_(a, b[part])] for a in (top, bottom) for b in (left, right)])
        weight_x, weight_y = across[part][None, :], down[:, None]
        smooth = (corners[0] * (1 - weight_x) + corners[1] * weight_x) * (1 - weight_y)
        smooth += (corners[2] * (1 - weight_x) + corners[3] * weight_x) * weight_y
        with np.errstate(invalid="ignore"):
            even = np.isfinite(smooth) & (corners.max(axis=0) - corners.min(axis=0) <= step)
        result[tile.core] = np.where(even & np.isfinite(nearest), smooth, nearest)
    return result


def _between(position: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The two cell centres around a position (in cells) and the weight of the second."""
    centre = np.clip(position - 0.5, 0, count - 1)
    low = np.floor(centre).astype(int)
    return low, np.minimum(low + 1, count - 1), (centre - low).astype(np.float32)
