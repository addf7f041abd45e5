"""Local correlation of two rasters in a moving window."""

from __future__ import annotations

from typing import Literal

import numpy as np

from workbench.compiled import compiled
from workbench.errors import StudyError

Method = Literal["pearson", "spearman"]

_LEAST_PAIRS = 3


def local_correlation(
    a: np.ndarray, b: np.ndarray, window: int = 5, method: Method = "pearson"
) -> np.ndarray:
    """Correlation of two arrays in a square window around every cell.

    The semantics are those of R ``raster::corLocal``: cells beyond the border count as missing;
    missing values are removed pairwise; at least three pairs are needed; a cell that is missing
    itself has a value where its neighbours allow one; without variance there is no value.

    Parameters
    ----------
    a, b
        (rows, columns) or (bands, rows, columns), any type, NaN = missing. Bands are never mixed.
    window
        Edge of the window, odd, cells.
    method
        ``pearson``, or ``spearman`` (Pearson of the ranks within the window; ties share their mean rank).

    Returns
    -------
    ndarray of float64
        -1..1, of the shape of ``a``; NaN where there is no value.

    Raises
    ------
    StudyError
        If shapes differ, the window is even or not positive, or the method is unknown.
    """
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if a.shape != b.shape or a.ndim not in (2, 3):
        raise StudyError(f"Arrays of shape {a.shape} and {b.shape} have no common cells: align them first.")
    if window < 1 or window % 2 == 0:
        raise StudyError(f"Window of {window} cells has no centre: choose an odd number.")
    if method not in ("pearson", "spearman"):
        raise StudyError(f"Unknown correlation {method!r}: choose 'pearson' or 'spearman'.")
    if a.ndim == 3:
        return np.stack([local_correlation(x, y, window, method) for x, y in zip(a, b, strict=True)])
    missing = np.isnan(a) | np.isnan(b)
    a, b = np.where(missing, np.nan, a), np.where(missing, np.nan, b)
    return _correlate(np.ascontiguousarray(a), np.ascontiguousarray(b), window // 2, method == "spearman")


@compiled(nogil=True)
def _correlate(a: np.ndarray, b: np.ndarray, reach: int, ranked: bool) -> np.ndarray:
    rows, columns = a.shape
    size = (2 * reach + 1) ** 2
    x, y = np.empty(size), np.empty(size)
    ranks_x, ranks_y = np.empty(size), np.empty(size)
    result = np.full((rows, columns), np.nan)
    for row in range(rows):
        top, bottom = max(row - reach, 0), min(row + reach + 1, rows)
        for column in range(columns):
            left, right = max(column - reach, 0), min(column + reach + 1, columns)
            count = 0
            for i in range(top, bottom):
                for j in range(left, right):
                    value = a[i, j]
                    if value == value:
                        x[count], y[count] = value, b[i, j]
                        count += 1
            if count < _LEAST_PAIRS:
                continue
            if ranked:
                _rank(x, ranks_x, count)
                _rank(y, ranks_y, count)
                result[row, column] = _pearson(ranks_x, ranks_y, count)
            else:
                result[row, column] = _pearson(x, y, count)
    return result


@compiled(inline="always")
def _pearson(x: np.ndarray, y: np.ndarray, count: int) -> float:
    """Two passes in float64: no cancellation, however large the values."""
    mean_x = mean_y = 0.0
    same_x = same_y = True
    for k in range(count):
        mean_x += x[k]
        mean_y += y[k]
        same_x &= x[k] == x[0]
        same_y &= y[k] == y[0]
    if same_x or same_y:
        return np.nan
    mean_x /= count
    mean_y /= count
    xx = yy = xy = 0.0
    for k in range(count):
        dx, dy = x[k] - mean_x, y[k] - mean_y
        xx += dx * dx
        yy += dy * dy
        xy += dx * dy
    if xx == 0.0 or yy == 0.0:
        return np.nan
    return min(max(xy / np.sqrt(xx * yy), -1.0), 1.0)


@compiled()
def _rank(values: np.ndarray, ranks: np.ndarray, count: int) -> None:
    for k in range(count):
        below = equal = 0
        for m in range(count):
            below += values[m] < values[k]
            equal += values[m] == values[k]
        ranks[k] = below + (equal + 1) / 2
