"""Maps of the highest surface along one parallel direction: the shadow map, and the truth from above.

A point (x, y, z) belongs to the cell where the line through it along the direction meets the plane
z = 0: ``(x - z * shear_x, y - z * shear_y)``. Straight down the shears are 0; for the sun they are its
horizontal over its vertical component, and what is not the highest in its cell lies in shadow.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from workbench.virtual.compiled import inner, kernel
from workbench.virtual.noise import hash2
from workbench.virtual.particles import (
    CENTRE,
    CLUMPS,
    LEAF,
    REACH,
    TH,
    TX,
    TY,
    TZ,
    clump_frame,
    clump_leaf,
    clump_particles,
    jitter,
    stem,
    stem_detail,
    stem_leaf,
    stems_in_cell,
)
from workbench.virtual.solids import hit_solid
from workbench.virtual.trees3d import KIND, LINE, RA, RB, RC, X, Y, Z
from workbench.virtual.wind import gust, own_sway

NOTHING, REED, SOLID = -1, -2, -10
"""Owners of a cell besides trees (0, 1, 2 ...): no object, reed, and body k as ``SOLID - k``."""
LOWEST = np.float32(-1e9)
_TILE = 512
_MARGIN = 1.5
_TALLEST_REED = 6.0


class Direction(NamedTuple):
    """A map's cells and the direction that it looks along."""

    west: float
    """x of the left edge, m, local."""
    north: float
    """y of the upper edge, m, local."""
    cell: float
    """Edge of a cell, m."""
    shear_x: float
    """Eastward component of the direction over its upward component."""
    shear_y: float
    """Northward component over upward."""


def map_from_above(
    world,
    grove,
    wind,
    direction: Direction,
    shape: tuple[int, int],
    *,
    owners: bool = True,
    threads: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Highest object per cell: height (rows, columns) float32, ``LOWEST`` without one, and its owner, int32.

    Ground and water are not objects here. Without ``owners`` those are not kept, for the sake of memory.
    The result does not depend on the number of threads.
    """
    top = np.full(shape, LOWEST, dtype=np.float32)
    owner = np.full(shape if owners else (0, 0), NOTHING, dtype=np.int32)
    boxes = _tree_boxes(grove.table, direction)
    windows = [
        (r, min(r + _TILE, shape[0]), c, min(c + _TILE, shape[1]))
        for r in range(0, shape[0], _TILE)
        for c in range(0, shape[1], _TILE)
    ]

    def fill(window: tuple[int, int, int, int]) -> None:
        r0, r1, c0, c1 = window
        inside = (boxes[:, 0] < c1) & (boxes[:, 1] >= c0) & (boxes[:, 2] < r1) & (boxes[:, 3] >= r0)
        chosen = np.flatnonzero(inside)
        high = top[r0:r1, c0:c1]
        tile = high, owner[r0:r1, c0:c1] if owners else np.empty(high.shape, dtype=np.int32)
        _fill_trees(grove.plants(chosen), chosen, wind, direction, r0, c0, *tile)
        _fill_reed(world.reed, wind, direction, r0, c0, *tile)
        _fill_solids(world.solids, direction, r0, c0, *tile)

    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        list(pool.map(fill, windows))
    return top, owner


def _tree_boxes(trees: np.ndarray, direction: Direction) -> np.ndarray:
    """First and last column and row (n, 4) that a tree can reach."""
    z = trees[:, TZ] + trees[:, CENTRE]
    column = (trees[:, TX] - z * direction.shear_x - direction.west) / direction.cell
    row = (direction.north - trees[:, TY] + z * direction.shear_y) / direction.cell
    stretch = np.hypot(1.0, np.hypot(direction.shear_x, direction.shear_y))
    reach = (trees[:, REACH] + _MARGIN) * stretch / direction.cell
    return np.stack([column - reach, column + reach, row - reach, row + reach], axis=1)


@inner
def _mark(top, owner, column, row, radius, z, name):
    """Raise the cells of a disc (or the one cell of a small particle) to a height."""
    rows, columns = top.shape
    if radius <= 0:
        j, i = int(np.floor(column)), int(np.floor(row))
        if i >= 0 and j >= 0 and i < rows and j < columns and top[i, j] < z:
            top[i, j] = z
            owner[i, j] = name
        return
    i0, i1 = max(int(np.floor(row - radius)), 0), min(int(np.floor(row + radius)) + 1, rows)
    j0, j1 = max(int(np.floor(column - radius)), 0), min(int(np.floor(column + radius)) + 1, columns)
    for i in range(i0, i1):
        for j in range(j0, j1):
            v, u = i + np.float32(0.5) - row, j + np.float32(0.5) - column
            if u * u + v * v <= radius * radius and top[i, j] < z:
                top[i, j] = z
                owner[i, j] = name


@kernel
def _fill_trees(plants, chosen, wind, direction, row0, column0, top, owner):
    rows, columns = top.shape
    cell = np.float32(direction.cell)
    sx, sy = np.float32(direction.shear_x), np.float32(direction.shear_y)
    west = np.float32(direction.west + column0 * direction.cell)
    north = np.float32(direction.north - row0 * direction.cell)
    stretch = np.float32(np.sqrt(1 + sx * sx + sy * sy))
    for index in chosen:
        tree = plants.trees[index]
        sway_x, sway_y = own_sway(wind, np.uint64(index), tree[TH])
        base, first = plants.row[index], plants.first[index]
        for k in range(int(tree[CLUMPS])):
            clump, c = plants.clumps[base + k], first + k
            lift = min(max(clump[Z] / tree[TH], np.float32(0)), np.float32(1))
            lift = lift * np.float32(np.sqrt(lift))
            x, y, z = tree[TX] + clump[X], tree[TY] + clump[Y], tree[TZ] + clump[Z]
            gx, gy = gust(wind, x, y)
            x += lift * (gx * wind.crown + sway_x)
            y += lift * (gy * wind.crown + sway_y)
            reach = (max(max(clump[RA], clump[RB]), clump[RC]) + np.float32(0.2)) * stretch / cell
            column = (x - z * sx - west) / cell
            row = (north - y + z * sy) / cell
            if column + reach < 0 or row + reach < 0 or column - reach > columns or row - reach > rows:
                continue
            frame = clump_frame(clump)
            number, size = clump_particles(clump, c, tree[LEAF], cell, False)
            start = int(hash2(np.uint64(c), np.uint64(9)))
            key = hash2(wind.seed, np.uint64(c))
            for i in range(number):
                ox, oy, oz, leaf = clump_leaf(clump, frame, plants.leaves, start, i, number)
                jx, jy, _ = jitter(wind, key, i)
                pz = z + oz
                pc = (x + ox + jx - pz * sx - west) / cell
                pr = (north - y - oy - jy + pz * sy) / cell
                facing = max(abs(plants.leaves.normal[leaf, 2]), np.float32(0.25))
                if clump[KIND] == np.float32(LINE):
                    facing = np.float32(1)
                radius = np.float32(0.5) * size / cell * np.float32(np.sqrt(facing))
                _mark(top, owner, pc, pr, radius, pz, index)


@kernel
def _fill_reed(reed, wind, direction, row0, column0, top, owner):
    rows, columns = top.shape
    if reed.density.size == 0:
        return
    cell = np.float32(direction.cell)
    sx, sy = np.float32(direction.shear_x), np.float32(direction.shear_y)
    west = np.float32(direction.west + column0 * direction.cell)
    north = np.float32(direction.north - row0 * direction.cell)
    south, east = north - rows * cell, west + columns * cell
    # A stem's foot may lie outside the tile by what its height is sheared and by its leaves and sway.
    low = reed.foot.min()
    high = reed.foot.max() + np.float32(_TALLEST_REED)
    pad = np.float32(1.2)
    x0, x1 = west + min(low * sx, high * sx) - pad, east + max(low * sx, high * sx) + pad
    y0, y1 = south + min(low * sy, high * sy) - pad, north + max(low * sy, high * sy) + pad
    j0 = max(int((x0 - reed.west) / reed.step), 0)
    j1 = min(int((x1 - reed.west) / reed.step) + 1, reed.density.shape[1])
    i0 = max(int((y0 - reed.south) / reed.step), 0)
    i1 = min(int((y1 - reed.south) / reed.step) + 1, reed.density.shape[0])
    for i in range(i0, i1):
        for j in range(j0, j1):
            count = stems_in_cell(reed, i, j)
            for s in range(count):
                x, y, foot, tall, _, h = stem(reed, i, j, s)
                gx, gy = gust(wind, x, y)
                number, size = stem_detail(tall, cell, h)
                key = hash2(wind.seed, h)
                for k in range(number):
                    ox, oy, oz, _, _, nz, share, _ = stem_leaf(h, tall, k, number)
                    lift = share * np.float32(np.sqrt(share)) * wind.reed
                    jx, jy, _ = jitter(wind, key, k)
                    z = foot + oz
                    column = (x + ox + gx * lift + jx - z * sx - west) / cell
                    row = (north - y - oy - gy * lift - jy + z * sy) / cell
                    radius = np.float32(0.5) * size / cell * np.float32(np.sqrt(max(nz, np.float32(0.35))))
                    _mark(top, owner, column, row, radius, z, REED)


@kernel
def _fill_solids(solids, direction, row0, column0, top, owner):
    rows, columns = top.shape
    west = direction.west + column0 * direction.cell
    north = direction.north - row0 * direction.cell
    for body in range(solids.bounds.shape[0]):
        x0, y0, z0, x1, y1, z1 = solids.bounds[body]
        left = x0 - max(z0 * direction.shear_x, z1 * direction.shear_x)
        right = x1 - min(z0 * direction.shear_x, z1 * direction.shear_x)
        low = y0 - max(z0 * direction.shear_y, z1 * direction.shear_y)
        high = y1 - min(z0 * direction.shear_y, z1 * direction.shear_y)
        j0 = max(int((left - west) / direction.cell), 0)
        j1 = min(int((right - west) / direction.cell) + 1, columns)
        i0 = max(int((north - high) / direction.cell), 0)
        i1 = min(int((north - low) / direction.cell) + 1, rows)
        for i in range(i0, i1):
            for j in range(j0, j1):
                x = west + (j + 0.5) * direction.cell
                y = north - (i + 0.5) * direction.cell
                enter, leave, _ = hit_solid(
                    solids, body, x, y, 0.0, direction.shear_x, direction.shear_y, 1.0
                )
                if enter < leave and leave > top[i, j]:
                    top[i, j] = np.float32(leave)
                    owner[i, j] = SOLID - body
