"""Growth of all crowns at once, one ring after the other; no crown profits from being named first."""

from __future__ import annotations

import numpy as np

from workbench.compiled import compiled
from workbench.trees.criteria import DIRECTIONS, SECTORS

_LEVEL = 255


@compiled(nogil=True)
def grow(
    steps: np.ndarray,
    surface: np.ndarray,
    aspect: np.ndarray,
    top_rows: np.ndarray,
    top_columns: np.ndarray,
    ranks: np.ndarray,
    squared_reach: np.ndarray,
    least_height: np.ndarray,
    max_aspect: np.ndarray,
    rounds: int,
) -> np.ndarray:
    """Number of the crown of each cell, -1 none.

    In every round all crowns look at the free neighbours of the cells that they took in the round
    before. A cell that several may take goes to the one whose top is nearest; of equally near tops to
    the higher one, then to the northern, then to the western (this order is ``ranks``). So the result
    is a function of the tops as a set, and a cell depends on nothing further away than ``rounds`` cells.

    Parameters
    ----------
    steps
        (rows, columns) uint8: the allowed steps of :mod:`workbench.trees.criteria`.
    surface
        Heights above ground.
    aspect
        Sectors of :func:`aspect_sectors`, or any array of shape (1, 1) where aspect is not used.
    top_rows, top_columns
        (n,) cells of the tops.
    ranks
        (n,) place of each top in the order of preference, each one different.
    squared_reach
        (n,) squared largest distance from the top, in cells.
    least_height
        (n,) least height of a cell of the crown.
    max_aspect
        (n,) largest difference of aspect in sectors; -1: not used.
    rounds
        Number of rounds.
    """
    rows, columns = steps.shape
    owner = np.full((rows, columns), -1, np.int32)
    # Rows and columns of the cells that were taken last: parting a flat place costs a division a cell.
    front = np.empty((max(len(top_rows), 16), 2), np.int32)
    size = 0
    for t in range(len(top_rows)):
        i, j = top_rows[t], top_columns[t]
        # Two tops in one cell: the preferred one.
        if owner[i, j] < 0:
            front[size, 0], front[size, 1] = i, j
            size += 1
            owner[i, j] = t
        elif ranks[t] < ranks[owner[i, j]]:
            owner[i, j] = t
    # Claims of a round are kept apart from the cells that are owned: -2 - t.
    for _ in range(rounds):
        claimed = np.empty((max(2 * size, 16), 2), np.int32)
        claims = 0
        for n in range(size):
            i, j = front[n, 0], front[n, 1]
            t, bits = owner[i, j], steps[i, j]
            top_i, top_j = top_rows[t], top_columns[t]
            reach, least = squared_reach[t], least_height[t]
            for k in range(8):
                if not bits & (1 << k):
                    continue
                y, x = i + DIRECTIONS[k, 0], j + DIRECTIONS[k, 1]
                holder = owner[y, x]
                if holder >= 0 or holder == -2 - t:
                    continue
                distance = (y - top_i) ** 2 + (x - top_j) ** 2
                if distance > reach or not surface[y, x] >= least:
                    continue
                if max_aspect[t] >= 0 and distance > 2:
                    turn = _turn(aspect[y, x], y - top_i, x - top_j)
                    if turn > max_aspect[t]:
                        continue
                if holder == -1:
                    if claims == len(claimed):
                        more = np.empty((2 * claims, 2), np.int32)
                        more[:claims] = claimed
                        claimed = more
                    claimed[claims, 0], claimed[claims, 1] = y, x
                    claims += 1
                    owner[y, x] = -2 - t
                else:
                    other = -2 - holder
                    rival = (y - top_rows[other]) ** 2 + (x - top_columns[other]) ** 2
                    if distance < rival or (distance == rival and ranks[t] < ranks[other]):
                        owner[y, x] = -2 - t
        if claims == 0:
            break
        for n in range(claims):
            i, j = claimed[n, 0], claimed[n, 1]
            owner[i, j] = -2 - owner[i, j]
        front, size = claimed, claims
    return owner


@compiled(nogil=True)
def _turn(sector: int, down: int, right: int) -> int:
    """Difference in sectors between an aspect and the direction of an offset; level ground has none."""
    if sector == _LEVEL:
        return 0
    direction = int(np.round(np.arctan2(float(right), float(-down)) / (2 * np.pi / SECTORS))) % SECTORS
    difference = abs(direction - sector)
    return min(difference, SECTORS - difference)


@compiled(nogil=True)
def trim(owner: np.ndarray, top_rows: np.ndarray, top_columns: np.ndarray, largest: int) -> None:
    """Leave every crown its ``largest`` cells nearest to the top (of equals the northern), in place."""
    n = len(top_rows)
    count = np.zeros(n + 1, np.int64)
    rows, columns = owner.shape
    for i in range(rows):
        for j in range(columns):
            if owner[i, j] >= 0:
                count[owner[i, j] + 1] += 1
    if count.max() <= largest:
        return
    start = np.cumsum(count)
    filled = start[:-1].copy()
    cells = np.empty(start[-1], np.int64)
    for i in range(rows):
        for j in range(columns):
            t = owner[i, j]
            if t >= 0:
                cells[filled[t]] = i * columns + j
                filled[t] += 1
    for t in range(n):
        if start[t + 1] - start[t] <= largest:
            continue
        mine = cells[start[t] : start[t + 1]]
        far = (mine // columns - top_rows[t]) ** 2 + (mine % columns - top_columns[t]) ** 2
        # A stable order: cells of one distance stay in the order of rows and columns.
        for cell in mine[np.argsort(far, kind="mergesort")][largest:]:
            owner[cell // columns, cell % columns] = -1
