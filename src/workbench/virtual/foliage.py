"""Foliage of a photograph: leaves, branches and reed stems that replace what lies behind them."""

from __future__ import annotations

import math

import numpy as np

from workbench.virtual.above import REED
from workbench.virtual.compiled import inner, kernel
from workbench.virtual.noise import hash2
from workbench.virtual.particles import (
    CLUMPS,
    LEAF,
    TH,
    TRED,
    TX,
    TY,
    TZ,
    clump_frame,
    clump_offset,
    clump_particles,
    jitter,
    leaf_in_clump,
    stem,
    stem_detail,
    stem_leaf,
    stems_in_cell,
)
from workbench.virtual.shade import half_vector, shade_leaf, sunlit_leaf
from workbench.virtual.trees3d import AO, DX, DY, DZ, KIND, LINE, RA, RB, RC, SHADE, X, Y, Z
from workbench.virtual.views import camera_axes, canopy_shade, leaf_on_tile, on_tile, to_image, towards
from workbench.virtual.wind import gust, own_sway
from workbench.virtual.world import Cover

_DEEP = 0.5
"""Share of the sky below which foliage is drawn with fewer and larger particles: crowns hide most of it."""
_WOOD = np.array([0.150, 0.130, 0.110, 0.26], dtype=np.float32)
_DEAD_WOOD = np.array([0.26, 0.24, 0.22, 0.34], dtype=np.float32)
_REED_GREEN = np.array([0.098, 0.158, 0.044, 0.44], dtype=np.float32)
_REED_BROWN = np.array([0.215, 0.180, 0.100, 0.31], dtype=np.float32)
_PANICLE = np.array([0.150, 0.105, 0.085, 0.27], dtype=np.float32)


@kernel
def paint_trees(world, wind, light, view, scale, chosen, tile):
    """Leaves, branches and stems of the chosen trees."""
    rows, columns = tile.depth.shape
    plants = world.plants
    out = np.zeros(4, dtype=np.float32)
    half_focal = np.float32(0.25 * (view.focal[0] + view.focal[1]))
    for index in chosen:
        tree = plants.trees[index]
        sway_x, sway_y = own_sway(wind, np.uint64(index), tree[TH])
        base, first = plants.row[index], plants.first[index]
        wood = _DEAD_WOOD if world.tree_cover[index] == Cover.DEAD_TREE.value else _WOOD
        for k in range(int(tree[CLUMPS])):
            clump, c = plants.clumps[base + k], first + k
            lift = min(max(clump[Z] / tree[TH], np.float32(0)), np.float32(1))
            lift = lift * np.float32(math.sqrt(lift))
            x, y, z = tree[TX] + clump[X], tree[TY] + clump[Y], tree[TZ] + clump[Z]
            gx, gy = gust(wind, x, y)
            x += lift * (gx * wind.crown + sway_x)
            y += lift * (gy * wind.crown + sway_y)
            column, row, depth = to_image(view, x, y, z)
            if depth < 0:
                continue
            edge = np.float32(depth * scale)
            reach = (max(max(clump[RA], clump[RB]), clump[RC]) + np.float32(0.25)) * np.float32(1.3) / edge
            column -= tile.column
            row -= tile.row
            if column + reach < 0 or row + reach < 0 or column - reach > columns or row - reach > rows:
                continue
            frame = clump_frame(clump)
            open_sky = clump[AO] * canopy_shade(world, x, y, z)
            number, size = clump_particles(clump, c, tree[LEAF], edge, open_sky < np.float32(_DEEP))
            start = int(hash2(np.uint64(c), np.uint64(9)))
            key = hash2(wind.seed, np.uint64(c))
            is_wood = clump[KIND] == np.float32(LINE)
            tone = wood if is_wood else tree[TRED : TRED + 4]
            toward = towards(view, x, y, z)
            half = half_vector(light, toward)
            origin = camera_axes(view, x, y, z)
            axes = _clump_in_camera(view.lens, clump, frame)
            for i in range(number):
                a, b, d, leaf = leaf_in_clump(clump, plants.leaves, start, i, number)
                jx, jy, flutter = np.float32(0), np.float32(0), np.float32(0)
                if not is_wood:
                    jx, jy, flutter = jitter(wind, key, i)
                pc, pr, near = _leaf_on_tile(view.lens, tile, origin, axes, a, b, d, jx, jy)
                radius = size * half_focal / near
                if _hidden(tile, pc, pr, near, radius):
                    continue
                ox, oy, oz = clump_offset(clump, frame, a, b, d)
                n = plants.leaves.normal[leaf]
                normal = toward if is_wood else (n[0], n[1], n[2])
                lit = sunlit_leaf(light, x + ox + jx, y + oy + jy, z + oz)
                # The lower leaves of a clump lie in the shade of the upper ones.
                share = np.float32(0.68) + np.float32(0.32) * plants.leaves.position[leaf, 2]
                bright = clump[SHADE] * plants.leaves.bright[leaf] * (np.float32(1) + flutter)
                shade_leaf(light, tone, bright, lit * share, open_sky * share, normal, toward, half, out)
                if radius == 0:
                    _write(tile, int(pr), int(pc), near, index, out)
                    continue
                tilt = (np.float32(1), np.float32(0), np.float32(1))
                if radius > 0 and not is_wood:
                    tilt = _tilt(view, normal)
                _paint(tile, pc, pr, near, radius, tilt, index, out)


@inner
def _clump_in_camera(lens, clump, frame):
    """The three axes of a clump in camera axes."""
    m = lens.turn
    bx, by, cx, cy, cz = frame
    return (
        m[0, 0] * clump[DX] + m[0, 1] * clump[DY] + m[0, 2] * clump[DZ],
        m[1, 0] * clump[DX] + m[1, 1] * clump[DY] + m[1, 2] * clump[DZ],
        m[2, 0] * clump[DX] + m[2, 1] * clump[DY] + m[2, 2] * clump[DZ],
        m[0, 0] * bx + m[0, 1] * by,
        m[1, 0] * bx + m[1, 1] * by,
        m[2, 0] * bx + m[2, 1] * by,
        m[0, 0] * cx + m[0, 1] * cy + m[0, 2] * cz,
        m[1, 0] * cx + m[1, 1] * cy + m[1, 2] * cz,
        m[2, 0] * cx + m[2, 1] * cy + m[2, 2] * cz,
    )


@inner
def _leaf_on_tile(lens, tile, origin, axes, a, b, c, jx, jy):
    """Column and row on the tile and depth of a leaf at (a, b, c) on the axes of its clump.

    (jx, jy) is its own displacement east and north, m.
    """
    m = lens.turn
    p = origin[0] + a * axes[0] + b * axes[3] + c * axes[6] + jx * m[0, 0] + jy * m[0, 1]
    q = origin[1] + a * axes[1] + b * axes[4] + c * axes[7] + jx * m[1, 0] + jy * m[1, 1]
    w = origin[2] + a * axes[2] + b * axes[5] + c * axes[8] + jx * m[2, 0] + jy * m[2, 1]
    column, row = on_tile(lens, tile, p, q, w)
    return column, row, w


@kernel
def paint_reed(world, wind, light, view, scale, window, tile):
    """Stems of the reed cells within (first row, last row, first column, last column)."""
    rows, columns = tile.depth.shape
    reed = world.reed
    out = np.zeros(4, dtype=np.float32)
    half_focal = np.float32(0.25 * (view.focal[0] + view.focal[1]))
    i0, i1, j0, j1 = window
    for i in range(i0, i1):
        for j in range(j0, j1):
            if reed.density[i, j] <= 0:
                continue
            cx = reed.west + (j + 0.5) * reed.step
            cy = reed.south + (i + 0.5) * reed.step
            column, row, depth = to_image(view, cx, cy, reed.foot[i, j] + 0.5 * reed.height[i, j])
            if depth < 0:
                continue
            edge = np.float32(depth * scale)
            # Nothing of a cell is farther from the middle of its stems than this, in metres.
            reach = (0.8 * reed.height[i, j] + 1.5) / edge
            column, row = column - tile.column, row - tile.row
            if column + reach < 0 or row + reach < 0 or column - reach > columns or row - reach > rows:
                continue
            crowd = min(reed.density[i, j] / np.float32(45), np.float32(1))
            toward = towards(view, cx, cy, reed.foot[i, j] + reed.height[i, j])
            half = half_vector(light, toward)
            for s in range(stems_in_cell(reed, i, j)):
                x, y, foot, tall, green, h = stem(reed, i, j, s)
                gx, gy = gust(wind, x, y)
                number, size = stem_detail(tall, edge, h)
                key = hash2(wind.seed, h)
                tone = _REED_GREEN if green else _REED_BROWN
                own = np.float32(0.8) + np.float32(0.4) * np.float32(h & np.uint64(0xFF)) / np.float32(255)
                origin = camera_axes(view, x, y, foot)
                for k in range(number):
                    ox, oy, oz, nx, ny, nz, share, part = stem_leaf(h, tall, k, number)
                    lift = share * np.float32(math.sqrt(share)) * wind.reed
                    jx, jy, flutter = jitter(wind, key, k)
                    ox, oy = ox + gx * lift + jx, oy + gy * lift + jy
                    pc, pr, near = leaf_on_tile(view.lens, tile, origin, ox, oy, oz)
                    radius = size * half_focal / near
                    if _hidden(tile, pc, pr, near, radius):
                        continue
                    normal = (nx, ny, nz)
                    lit = sunlit_leaf(light, x + ox, y + oy, foot + oz)
                    sunk = np.float32(1) - np.float32(0.75) * crowd * (np.float32(1) - share)
                    colour = _PANICLE if part == 1 else tone
                    shade_leaf(light, colour, own * (1 + flutter), lit, sunk, normal, toward, half, out)
                    _paint(tile, pc, pr, near, radius, _tilt(view, normal), REED, out)


@inner
def _hidden(tile, column, row, depth, radius):
    """Whether nothing of a particle would show: it lies outside the tile or behind what is there."""
    rows, columns = tile.depth.shape
    if radius == 0:
        if column < 0 or row < 0 or column >= columns or row >= rows:
            return True
        return depth >= tile.depth[int(row), int(column)]
    if radius < 0:
        i, j = int(math.floor(row)), int(math.floor(column))
        if i < -1 or j < -1 or i >= rows or j >= columns:
            return True
        for k in range(max(i, 0), min(i + 2, rows)):
            for n in range(max(j, 0), min(j + 2, columns)):
                if depth < tile.depth[k, n]:
                    return False
        return True
    if column + radius < 0 or row + radius < 0 or column - radius >= columns or row - radius >= rows:
        return True
    i0, i1 = max(int(row - radius), 0), min(int(row + radius) + 1, rows)
    j0, j1 = max(int(column - radius), 0), min(int(column + radius) + 1, columns)
    for i in range(i0, i1):
        for j in range(j0, j1):
            if depth < tile.depth[i, j]:
                return False
    return True


@inner
def _paint(tile, column, row, depth, radius, tilt, owner, out):
    """Write a particle where it is nearest: an ellipse whose short axis is the tilt of the leaf."""
    rows, columns = tile.depth.shape
    if radius <= 0:
        # One sample, or a block of 2 x 2 that is cut at the border of the tile as everything is.
        i1 = min(int(math.floor(row)) + (1 if radius == 0 else 2), rows)
        j1 = min(int(math.floor(column)) + (1 if radius == 0 else 2), columns)
        for i in range(max(int(math.floor(row)), 0), i1):
            for j in range(max(int(math.floor(column)), 0), j1):
                if depth < tile.depth[i, j]:
                    _write(tile, i, j, depth, owner, out)
        return
    tx, ty, squeeze = tilt
    i0, i1 = max(int(math.floor(row - radius)), 0), min(int(math.floor(row + radius)) + 1, rows)
    j0, j1 = max(int(math.floor(column - radius)), 0), min(int(math.floor(column + radius)) + 1, columns)
    for i in range(i0, i1):
        for j in range(j0, j1):
            if depth >= tile.depth[i, j]:
                continue
            u, v = np.float32(j + 0.5 - column), np.float32(i + 0.5 - row)
            along = (u * tx + v * ty) * squeeze
            across = v * tx - u * ty
            if along * along + across * across <= radius * radius:
                _write(tile, i, j, depth, owner, out)


@inner
def _write(tile, i, j, depth, owner, out):
    """Let a particle be what one subpixel sees."""
    tile.depth[i, j] = depth
    tile.owner[i, j] = owner
    for band in range(4):
        tile.colour[i, j, band] = out[band]


@inner
def _tilt(view, normal):
    """Direction in the image in which a leaf looks narrow, and one over its apparent width."""
    m = view.rotation
    a = np.float32(m[0, 0]) * normal[0] + np.float32(m[0, 1]) * normal[1] + np.float32(m[0, 2]) * normal[2]
    b = np.float32(m[1, 0]) * normal[0] + np.float32(m[1, 1]) * normal[1] + np.float32(m[1, 2]) * normal[2]
    flat = np.float32(math.sqrt(a * a + b * b))
    if flat < np.float32(1e-3):
        return np.float32(1), np.float32(0), np.float32(1)
    narrow = np.float32(math.sqrt(max(np.float32(1) - flat * flat, np.float32(0.0))))
    return a / flat, b / flat, np.float32(1) / max(narrow, np.float32(0.25))
