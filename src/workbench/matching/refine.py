"""Sub-pixel refinement that does not lock to whole pixels: one step of least-squares matching.

A fit to census costs prefers whole pixels. Here the disparities of the matcher are smoothed over
neighbours of one surface, the right image is resampled with them, and the rest is found by least
squares in a window, together with gain and offset between the images [Lucas and Kanade 1981; with
radiometric terms as in Ackermann's least-squares matching].
"""

from __future__ import annotations

import cv2
import numpy as np

from workbench.compiled import compiled

_MEDIAN = 5
_REACH = 3  # The window of least squares is 7 x 7.
_NEAR = 1.0  # Neighbours within one pixel of disparity belong to one surface.
_NOISE = 4.0  # Variance of the grey value's gradient that is taken for noise, (1/255)².
_TERMS = 10


def smooth_disparity(disparity: np.ndarray, trusted: np.ndarray) -> np.ndarray:
    """Median of 5 x 5, then mean of 5 x 5 over neighbours within one pixel; both only where trusted.

    Parameters
    ----------
    disparity
        float32 (rows, columns), px, without NaN.
    trusted
        Where the disparity was measured, bool.
    """
    median = cv2.medianBlur(disparity, _MEDIAN)
    start = np.where(np.abs(median - disparity) <= _NEAR, median, disparity)
    return _mean_of_surface(start, trusted)


def refine(
    left: np.ndarray,
    right: np.ndarray,
    smooth: np.ndarray,
    trusted: np.ndarray,
    rows: slice,
    refined: np.ndarray,
    correlation: np.ndarray,
) -> None:
    """Refine the disparities of some rows, in place.

    Parameters
    ----------
    left, right
        Grey values 0..255, float32 (rows, columns).
    smooth
        Disparities to start from, float32, px.
    trusted
        Where they were measured, bool.
    rows
        Rows to refine.
    refined, correlation
        Results, float32 (rows, columns): disparity, and correlation -1..1 of the images there.
    """
    _refine(left, right, smooth, trusted, rows.start, rows.stop, refined, correlation)


@compiled(nogil=True, error_model="numpy")
def _mean_of_surface(start: np.ndarray, trusted: np.ndarray) -> np.ndarray:
    rows, columns = start.shape
    result = start.copy()
    total, count = np.empty(columns, np.float32), np.empty(columns, np.float32)
    for row in range(rows):
        total[:] = 0
        count[:] = 0
        centre = start[row]
        for other in range(max(row - 2, 0), min(row + 3, rows)):
            values, known = start[other], trusted[other]
            for shift in range(-2, 3):
                low, high = max(-shift, 0), columns - max(shift, 0)
                for column in range(low, high):
                    value = values[column + shift]
                    use = known[column + shift] & (abs(value - centre[column]) <= np.float32(_NEAR))
                    total[column] += value if use else np.float32(0)
                    count[column] += np.float32(1) if use else np.float32(0)
        for column in range(columns):
            if count[column] > 0 and trusted[row, column]:
                result[row, column] = total[column] / count[column]
    return result


@compiled(nogil=True, error_model="numpy", fastmath={"contract"})
def _refine(
    left: np.ndarray,
    right: np.ndarray,
    smooth: np.ndarray,
    trusted: np.ndarray,
    first: int,
    last: int,
    refined: np.ndarray,
    correlation: np.ndarray,
) -> None:
    rows, columns = left.shape
    size = 2 * _REACH + 1
    terms = np.zeros((size, _TERMS, columns), np.float32)
    sums = np.zeros((_TERMS, columns + 2 * _REACH), np.float32)
    window = np.zeros((_TERMS, columns), np.float32)
    for row in range(first - _REACH, last + _REACH):
        slot = terms[row % size]
        if 0 <= row < rows:
            _products(left[row], right[row], smooth[row], trusted[row], slot)
        else:
            slot[:] = 0
        centre = row - _REACH
        if centre < first:
            continue
        for term in range(_TERMS):
            line = sums[term, _REACH : _REACH + columns]
            line[:] = 0
            for k in range(size):
                part = terms[k, term]
                for column in range(columns):
                    line[column] += part[column]
            total = window[term]
            total[:] = 0
            for k in range(size):
                part = sums[term, k : k + columns]
                for column in range(columns):
                    total[column] += part[column]
        _solve(window, smooth[centre], refined[centre], correlation[centre])


@compiled(error_model="numpy", fastmath={"contract"})
def _products(
    left: np.ndarray, right: np.ndarray, smooth: np.ndarray, trusted: np.ndarray, terms: np.ndarray
) -> None:
    """Products of left value, resampled right value and its derivative along one row."""
    columns = len(left)
    for column in range(columns):
        place = np.float32(column) - smooth[column]
        base = int(np.floor(place))
        usable = trusted[column] and base >= 1 and base + 2 < columns
        base = min(max(base, 1), columns - 3)
        t = place - np.float32(base)
        a, b, c, d = right[base - 1], right[base], right[base + 1], right[base + 2]
        # Cubic convolution (Catmull-Rom), and its derivative.
        k1 = np.float32(0.5) * (c - a)
        k2 = a - np.float32(2.5) * b + np.float32(2.0) * c - np.float32(0.5) * d
        k3 = np.float32(0.5) * (d - a) + np.float32(1.5) * (b - c)
        value = b + t * (k1 + t * (k2 + t * k3)) - np.float32(128)
        slope = -(k1 + t * (np.float32(2) * k2 + np.float32(3) * k3 * t))
        weight = np.float32(1) if usable else np.float32(0)
        own = left[column] - np.float32(128)
        value *= weight
        slope *= weight
        own *= weight
        terms[0, column] = weight
        terms[1, column] = own
        terms[2, column] = value
        terms[3, column] = slope
        terms[4, column] = value * value
        terms[5, column] = value * slope
        terms[6, column] = slope * slope
        terms[7, column] = own * value
        terms[8, column] = own * slope
        terms[9, column] = own * own


@compiled(error_model="numpy", fastmath={"contract"})
def _solve(sums: np.ndarray, smooth: np.ndarray, refined: np.ndarray, correlation: np.ndarray) -> None:
    """Solve left = gain * right + shift * derivative + offset for every pixel of a row."""
    for column in range(len(smooth)):
        n = max(sums[0, column], np.float32(1))
        own, value, slope = sums[1, column] / n, sums[2, column] / n, sums[3, column] / n
        vv = sums[4, column] / n - value * value
        vs = sums[5, column] / n - value * slope
        ss = sums[6, column] / n - slope * slope + np.float32(_NOISE)
        ov = sums[7, column] / n - own * value
        os = sums[8, column] / n - own * slope
        determinant = vv * ss - vs * vs
        gain = ov * ss - os * vs
        shift = os * vv - ov * vs
        step = np.float32(0)
        if determinant > 0 and gain > 0:
            step = min(max(shift / gain, np.float32(-1)), np.float32(1))
        refined[column] = smooth[column] + step
        oo = sums[9, column] / n - own * own
        correlation[column] = ov / np.sqrt(max(vv * oo, np.float32(1e-6)))
