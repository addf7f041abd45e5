"""Heights of one matched pair on the cells of a grid."""

from __future__ import annotations

import math

import numpy as np

from workbench.compiled import compiled
from workbench.matching.store import MatchedPair
from workbench.rasters import Grid

_JOIN = 1.0  # Neighbours whose disparities differ by more (px) do not lie on one surface.


def grid_pair(
    pair: MatchedPair,
    grid: Grid,
    heights: tuple[float, float],
    *,
    window: tuple[slice, slice] | None = None,
    least_confidence: int = 0,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Interpolate a pair's points at cell centres.

    Four neighbouring matched pixels whose disparities differ by at most one pixel span a piece of
    surface; a cell whose centre lies in it gets its height, the highest where several lie above each
    other. A height is therefore never invented across a step or a hole.

    Parameters
    ----------
    pair
        Disparities and geometry.
    grid
        Cells of the surface.
    heights
        Lowest and highest possible height, metres: limits the part of the pair to look at.
    window
        Rows and columns of the grid that are wanted, usually a tile; all by default. The heights of a
        cell do not depend on the window that it is asked for in.
    least_confidence
        Pixels below are left out, 0..255.

    Returns
    -------
    height, confidence : ndarray (rows, columns) float32
        NaN and 0 where the pair measured nothing; None if it does not reach the window.
    """
    rows, columns = window or (slice(0, grid.height), slice(0, grid.width))
    seen = _seen(pair, grid.window(rows, columns), heights)
    if seen is None:
        return None
    r = pair.rectification
    height = np.full((rows.stop - rows.start, columns.stop - columns.start), np.nan, np.float32)
    confidence = np.zeros_like(height)
    _rasterise(
        pair.disparity,
        pair.confidence,
        least_confidence,
        seen[0],
        seen[1],
        r.focal * r.base,
        r.shift,
        r.focal,
        r.principal[0],
        r.principal[1],
        np.ascontiguousarray(r.rotation),
        r.centre - (grid.west, grid.north, 0.0),
        grid.resolution,
        rows.start,
        columns.start,
        height,
        confidence,
    )
    return height, confidence


def _seen(
    pair: MatchedPair, grid: Grid, heights: tuple[float, float]
) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Rows and columns of the rectified image that can show the grid."""
    west, south, east, north = grid.bounds
    edge = np.linspace(0, 1, 3)
    x, y, z = np.meshgrid(west + edge * (east - west), south + edge * (north - south), heights)
    r = pair.rectification
    seen = (np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1) - r.centre) @ r.rotation.T
    seen = seen[seen[:, 2] > 0]
    if not len(seen):
        return None
    columns = seen[:, 0] / seen[:, 2] * r.focal + r.principal[0]
    rows = seen[:, 1] / seen[:, 2] * r.focal + r.principal[1]
    top, bottom = max(int(rows.min()) - 2, 0), min(int(rows.max()) + 3, r.shape[0])
    left, right = max(int(columns.min()) - 2, 0), min(int(columns.max()) + 3, r.shape[1])
    if bottom - top < 2 or right - left < 2:
        return None
    return (top, bottom), (left, right)


@compiled(nogil=True)
def _rasterise(
    disparity: np.ndarray,
    confidence: np.ndarray,
    least: int,
    row_window: tuple[int, int],
    column_window: tuple[int, int],
    focal_base: float,
    shift: float,
    focal: float,
    principal_column: float,
    principal_row: float,
    rotation: np.ndarray,
    origin: np.ndarray,
    resolution: float,
    first_row: int,
    first_column: int,
    height: np.ndarray,
    trust: np.ndarray,
) -> None:
    count = column_window[1] - column_window[0]
    points = np.empty((2, count, 3))
    for i in range(row_window[0], row_window[1]):
        now = i % 2
        v = (i + 0.5 - principal_row) / focal
        for j in range(count):
            column = column_window[0] + j
            d = disparity[i, column]
            if d != d or confidence[i, column] < least:
                points[now, j, 0] = math.nan
                continue
            depth = focal_base / (d + shift)
            u = (column + 0.5 - principal_column) / focal
            for k in range(3):
                points[now, j, k] = (
                    origin[k] + (u * rotation[0, k] + v * rotation[1, k] + rotation[2, k]) * depth
                )
            # Whole cells are taken off without rounding: every window gives the same heights.
            points[now, j, 0] = points[now, j, 0] / resolution - first_column
            points[now, j, 1] = points[now, j, 1] / -resolution - first_row
        if i == row_window[0]:
            continue
        before = 1 - now
        for j in range(count - 1):
            column = column_window[0] + j
            if (
                math.isnan(points[before, j, 0])
                or math.isnan(points[before, j + 1, 0])
                or math.isnan(points[now, j, 0])
                or math.isnan(points[now, j + 1, 0])
            ):
                continue
            a, b = disparity[i - 1, column], disparity[i - 1, column + 1]
            c, d = disparity[i, column], disparity[i, column + 1]
            if max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) > _JOIN:
                continue
            value = min(
                min(confidence[i - 1, column], confidence[i - 1, column + 1]),
                min(confidence[i, column], confidence[i, column + 1]),
            )
            p, q, r, s = points[before, j], points[before, j + 1], points[now, j], points[now, j + 1]
            _fill(p, q, r, value, height, trust)
            _fill(q, s, r, value, height, trust)


@compiled(inline="always")
def _fill(
    p: np.ndarray, q: np.ndarray, r: np.ndarray, value: float, height: np.ndarray, trust: np.ndarray
) -> None:
    """Cells whose centres lie in a triangle; x and y in cells from the upper left corner."""
    rows, columns = height.shape
    left = max(int(math.ceil(min(min(p[0], q[0]), r[0]) - 0.5)), 0)
    right = min(int(math.floor(max(max(p[0], q[0]), r[0]) - 0.5)), columns - 1)
    top = max(int(math.ceil(min(min(p[1], q[1]), r[1]) - 0.5)), 0)
    bottom = min(int(math.floor(max(max(p[1], q[1]), r[1]) - 0.5)), rows - 1)
    if left > right or top > bottom:
        return
    area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
    if abs(area) < 1e-12:
        return
    for row in range(top, bottom + 1):
        y = row + 0.5
        for column in range(left, right + 1):
            x = column + 0.5
            b = ((x - p[0]) * (r[1] - p[1]) - (y - p[1]) * (r[0] - p[0])) / area
            c = ((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])) / area
            if b < -1e-9 or c < -1e-9 or b + c > 1 + 1e-9:
                continue
            z = p[2] + b * (q[2] - p[2]) + c * (r[2] - p[2])
            if not height[row, column] >= z:
                height[row, column] = z
                trust[row, column] = value + 1.0
