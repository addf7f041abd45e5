"""Views of a scene: projection to subpixels, the tile that is being drawn, its ground and its pixels.

A tile sees every particle that touches it, so that the photograph does not depend on how it is cut.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from workbench.virtual.above import REED, SOLID
from workbench.virtual.compiled import inner, kernel
from workbench.virtual.particles import CENTRE, REACH, TX, TY, TZ, ground_height
from workbench.virtual.world import Cover


class Lens(NamedTuple):
    """The projection in single precision, for offsets from a point that was placed in double."""

    turn: np.ndarray
    """(3, 3) float32 world to camera."""
    bend: np.ndarray
    """(8,) float32 distortion."""
    scale: np.ndarray
    """(4,) float32 focal lengths and principal point, subpixels."""
    rational: bool
    """Whether k4, k5 or k6 differ from 0."""


class View(NamedTuple):
    """Projection of a photograph to subpixels."""

    rotation: np.ndarray
    """(3, 3) world to camera."""
    centre: np.ndarray
    """(3,) projection centre, local m."""
    focal: np.ndarray
    """(2,) focal lengths, subpixels."""
    principal: np.ndarray
    """(2,) principal point, subpixels from the corner of the first."""
    distortion: np.ndarray
    """(8,) k1 k2 p1 p2 k3 k4 k5 k6."""
    rational: bool
    """Whether k4, k5 or k6 differ from 0."""
    limit: float
    """Largest squared radius in the plane z = 1 that the photograph holds, with a margin."""
    lens: Lens
    """The same in single precision."""


class Tile(NamedTuple):
    """Subpixels of one part of the photograph."""

    row: int
    """First row, subpixels."""
    column: int
    """First column, subpixels."""
    depth: np.ndarray
    """(rows, columns) float32: distance along the optical axis, m."""
    owner: np.ndarray
    """(rows, columns) int32: tree, ``REED``, ``SOLID - body`` or ``NOTHING`` for ground."""
    colour: np.ndarray
    """(rows, columns, 4) float32 radiance."""
    place: np.ndarray
    """(rows, columns, 3) float64: where the ray meets the ground, local m."""


@inner
def to_image(view, x, y, z):
    """Subpixel column, row and depth of a local point; depth -1 where it is behind or far outside."""
    dx, dy, dz = x - view.centre[0], y - view.centre[1], z - view.centre[2]
    m = view.rotation
    w = m[2, 0] * dx + m[2, 1] * dy + m[2, 2] * dz
    if w <= 0.01:
        return 0.0, 0.0, -1.0
    u = (m[0, 0] * dx + m[0, 1] * dy + m[0, 2] * dz) / w
    v = (m[1, 0] * dx + m[1, 1] * dy + m[1, 2] * dz) / w
    r2 = u * u + v * v
    if r2 > view.limit:
        return 0.0, 0.0, -1.0
    du, dv = _distorted(view, u, v)
    return view.focal[0] * du + view.principal[0], view.focal[1] * dv + view.principal[1], w


@inner
def _distorted(view, u, v):
    """Position in the plane z = 1 behind the lens of one before it, in the precision of ``u``."""
    k = view.distortion
    r2 = u * u + v * v
    radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    if view.rational:
        radial /= 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    du = u * radial + 2 * k[2] * u * v + k[3] * (r2 + 2 * u * u)
    dv = v * radial + k[2] * (r2 + 2 * v * v) + 2 * k[3] * u * v
    return du, dv


@inner
def camera_axes(view, x, y, z):
    """A local point in camera axes, single precision."""
    m = view.rotation
    dx, dy, dz = x - view.centre[0], y - view.centre[1], z - view.centre[2]
    return (
        np.float32(m[0, 0] * dx + m[0, 1] * dy + m[0, 2] * dz),
        np.float32(m[1, 0] * dx + m[1, 1] * dy + m[1, 2] * dz),
        np.float32(m[2, 0] * dx + m[2, 1] * dy + m[2, 2] * dz),
    )


@inner
def leaf_on_tile(lens, tile, origin, ox, oy, oz):
    """Column and row on the tile and depth of a particle at an offset from a plant's own origin.

    ``origin`` is in camera axes. Single precision is enough: 0.002 subpixels at most.
    """
    m = lens.turn
    p = origin[0] + m[0, 0] * ox + m[0, 1] * oy + m[0, 2] * oz
    q = origin[1] + m[1, 0] * ox + m[1, 1] * oy + m[1, 2] * oz
    w = origin[2] + m[2, 0] * ox + m[2, 1] * oy + m[2, 2] * oz
    column, row = on_tile(lens, tile, p, q, w)
    return column, row, w


@inner
def on_tile(lens, tile, p, q, w):
    """Column and row on the tile of a place in camera axes, single precision."""
    over = np.float32(1) / w
    u, v = p * over, q * over
    k = lens.bend
    r2 = u * u + v * v
    one, two = np.float32(1), np.float32(2)
    radial = one + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    if lens.rational:
        radial /= one + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    du = u * radial + two * k[2] * u * v + k[3] * (r2 + two * u * u)
    dv = v * radial + k[2] * (r2 + two * v * v) + two * k[3] * u * v
    column = lens.scale[0] * du + lens.scale[2]
    row = lens.scale[1] * dv + lens.scale[3]
    return column - np.float32(tile.column), row - np.float32(tile.row)


@inner
def towards(view, x, y, z):
    """Unit vector from a point to the camera."""
    dx, dy, dz = view.centre[0] - x, view.centre[1] - y, view.centre[2] - z
    n = 1 / math.sqrt(dx * dx + dy * dy + dz * dz)
    return np.float32(dx * n), np.float32(dy * n), np.float32(dz * n)


@inner
def canopy_shade(world, x, y, z):
    """Share of the sky that neighbouring crowns leave to a place at height z, 0.2..1."""
    terrain = world.terrain
    column, row = (x - terrain.west) / terrain.step, (y - terrain.south) / terrain.step
    canopy = _nearest_sum(world.ground.canopy, terrain.height, column, row)
    sunk = max(canopy - z, np.float32(0))
    closure = _nearest(world.ground.closure, column, row)
    return np.float32(1) - np.float32(0.8) * closure * (
        np.float32(1) - np.float32(math.exp(-sunk * np.float32(0.22)))
    )


@inner
def _nearest_sum(a, b, column, row):
    """Nearest value of the sum of two rasters."""
    i = min(max(int(row + np.float32(0.5)), 0), a.shape[0] - 1)
    j = min(max(int(column + np.float32(0.5)), 0), a.shape[1] - 1)
    return a[i, j] + b[i, j]


@inner
def _nearest(a, column, row):
    """Nearest value of a raster."""
    i = min(max(int(row + np.float32(0.5)), 0), a.shape[0] - 1)
    j = min(max(int(column + np.float32(0.5)), 0), a.shape[1] - 1)
    return a[i, j]


@kernel
def meet_ground(world, view, rays, step, tile):
    """Where the rays of all subpixels meet land or lake: fills ``place`` and ``depth``.

    ``rays`` are directions in camera axes at lattice nodes every ``step`` subpixels, the first at the
    corner of the tile. On every node the height is iterated; between nodes the place is interpolated
    along with the inverse of the depth, which is exact on a plane.
    """
    rows, columns = tile.depth.shape
    nodes = np.empty((rays.shape[0], rays.shape[1], 4))
    m, level = view.rotation, world.water_level
    for i in range(rays.shape[0]):
        for j in range(rays.shape[1]):
            a, b, c = rays[i, j]
            dx = m[0, 0] * a + m[1, 0] * b + m[2, 0] * c
            dy = m[0, 1] * a + m[1, 1] * b + m[2, 1] * c
            dz = m[0, 2] * a + m[1, 2] * b + m[2, 2] * c
            dz = min(dz, -1e-3)
            z = max(np.float64(ground_height(world.terrain, view.centre[0], view.centre[1])), level)
            t = 0.0
            for _ in range(12):
                t = max((z - view.centre[2]) / dz, 0.01)
                ground = ground_height(world.terrain, view.centre[0] + t * dx, view.centre[1] + t * dy)
                new = max(np.float64(ground), level)
                if abs(new - z) < 1e-4:
                    break
                z = 0.5 * (z + new) if _ > 5 else new
            nodes[i, j, 0], nodes[i, j, 1] = view.centre[0] + t * dx, view.centre[1] + t * dy
            nodes[i, j, 2], nodes[i, j, 3] = view.centre[2] + t * dz, t
    for i in range(rows):
        p = (i + 0.5) / step
        i0 = int(p)
        p -= i0
        for j in range(columns):
            q = (j + 0.5) / step
            j0 = int(q)
            q -= j0
            w00 = (1 - p) * (1 - q) / nodes[i0, j0, 3]
            w01 = (1 - p) * q / nodes[i0, j0 + 1, 3]
            w10 = p * (1 - q) / nodes[i0 + 1, j0, 3]
            w11 = p * q / nodes[i0 + 1, j0 + 1, 3]
            total = w00 + w01 + w10 + w11
            tile.depth[i, j] = 1 / total
            for k in range(3):
                low = w00 * nodes[i0, j0, k] + w01 * nodes[i0, j0 + 1, k]
                high = w10 * nodes[i0 + 1, j0, k] + w11 * nodes[i0 + 1, j0 + 1, k]
                tile.place[i, j, k] = (low + high) / total


@kernel
def resolve(tile, cover, tree_cover, solid_cover, air, s, radiance, depth, cover_out, tree_out, row, column):
    """Average the subpixels of every pixel and look at them through the air.

    Depth, cover and tree are those of the central subpixel.
    """
    rows, columns = tile.depth.shape[0] // s, tile.depth.shape[1] // s
    weight = np.float32(1.0 / (s * s))
    for i in range(rows):
        for j in range(columns):
            ci, cj = i * s + s // 2, j * s + s // 2
            way = tile.depth[ci, cj]
            for band in range(4):
                total = np.float32(0)
                for a in range(s):
                    for b in range(s):
                        total += tile.colour[i * s + a, j * s + b, band]
                clear = np.float32(math.exp(-air[0, band] * way))
                radiance[band, row + i, column + j] = total * weight * clear + air[1, band] * way
            depth[row + i, column + j] = way
            owner = tile.owner[ci, cj]
            code = cover[ci, cj]
            if owner >= 0:
                code = tree_cover[owner]
            elif owner == REED:
                code = Cover.REED.value
            elif owner <= SOLID:
                code = solid_cover[SOLID - owner]
            cover_out[row + i, column + j] = code
            tree_out[row + i, column + j] = owner if owner >= 0 else -1


@kernel
def reach_of_trees(world, view, scale):
    """First and last row and column (n, 4), subpixels, that each tree can touch; empty if outside."""
    trees = world.plants.trees
    boxes = np.zeros((trees.shape[0], 4))
    for k in range(trees.shape[0]):
        tree = trees[k]
        column, row, depth = to_image(view, tree[TX], tree[TY], tree[TZ] + tree[CENTRE])
        # Half as much again for a lens that stretches its corners, a metre for the wind.
        reach = 1.5 * (tree[REACH] + 1.0) / (max(depth - tree[REACH], 1.0) * scale)
        boxes[k] = (row - reach, row + reach, column - reach, column + reach)
        if depth < 0:
            boxes[k] = (1e9, -1e9, 1e9, -1e9)
    return boxes
