"""Connected patches of disparity, and the removal of those that are too small."""

from __future__ import annotations

import numpy as np

from workbench.compiled import compiled


@compiled(nogil=True)
def small_segments(disparity: np.ndarray, known: np.ndarray, least: int, step: float) -> np.ndarray:
    """Pixels of patches with fewer than ``least`` pixels, (rows, columns) bool.

    Parameters
    ----------
    disparity
        float32 (rows, columns), px.
    known
        Pixels that belong to any patch, bool.
    least
        Smallest patch to keep, px.
    step
        The four neighbours of a pixel belong to its patch if they differ by no more, px.
    """
    rows, columns = disparity.shape
    parent = np.empty(rows * columns, np.int32)
    size = np.zeros(rows * columns, np.int32)
    for row in range(rows):
        for column in range(columns):
            here = row * columns + column
            parent[here] = here
            if not known[row, column]:
                continue
            value = disparity[row, column]
            if column > 0 and known[row, column - 1] and abs(disparity[row, column - 1] - value) <= step:
                parent[here] = _root(parent, here - 1)
            if row > 0 and known[row - 1, column] and abs(disparity[row - 1, column] - value) <= step:
                a, b = _root(parent, here), _root(parent, here - columns)
                parent[max(a, b)] = min(a, b)
    small = np.zeros((rows, columns), np.bool_)
    for row in range(rows):
        for column in range(columns):
            if known[row, column]:
                size[_root(parent, row * columns + column)] += 1
    for row in range(rows):
        for column in range(columns):
            if known[row, column]:
                small[row, column] = size[_root(parent, row * columns + column)] < least
    return small


@compiled()
def _root(parent: np.ndarray, node: int) -> int:
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node
