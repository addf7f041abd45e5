"""The compiled heart of a photograph: a tile of subpixels with their depth, radiance and owner.

Ground first gives every subpixel a depth, then bodies and foliage replace it where they are nearer, and
what ground is left visible is shaded last. A tile sees every particle that touches it, so that the
photograph does not depend on how it is cut.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from workbench.virtual.above import NOTHING, REED, SOLID
from workbench.virtual.noise import hash2
from workbench.virtual.particles import (
    CENTRE,
    CLUMPS,
    FIRST,
    LEAF,
    REACH,
    TH,
    TRED,
    TX,
    TY,
    TZ,
    clump_frame,
    clump_leaf,
    clump_particles,
    ground_height,
    jitter,
    stem,
    stem_detail,
    stem_leaf,
    stems_in_cell,
)
from workbench.virtual.shade import (
    ground_colour,
    ground_cover,
    half_vector,
    place_hash,
    plain_cover,
    shade_leaf,
    solid_colour,
    sunlit_ground,
    sunlit_leaf,
    target_colour,
)
from workbench.virtual.solids import hit_solid
from workbench.virtual.texture import TEXEL, level_of
from workbench.virtual.trees3d import AO, KIND, LINE, RA, RB, RC, SHADE, X, Y, Z
from workbench.virtual.water import shade_water
from workbench.virtual.wind import gust, own_sway
from workbench.virtual.world import Cover

_DEEP = 0.72
"""Share of the sky below which foliage is drawn with fewer and larger particles: crowns hide most of it."""
_WOOD = np.array([0.150, 0.130, 0.110, 0.26], dtype=np.float32)
_DEAD_WOOD = np.array([0.26, 0.24, 0.22, 0.34], dtype=np.float32)
_REED_GREEN = np.array([0.098, 0.158, 0.044, 0.44], dtype=np.float32)
_REED_BROWN = np.array([0.215, 0.180, 0.100, 0.31], dtype=np.float32)
_PANICLE = np.array([0.150, 0.105, 0.085, 0.27], dtype=np.float32)


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


@numba.njit(error_model="numpy", fastmath=True)
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
    column, row = _image_of(view, u, v, 1.0)
    return column, row, w


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
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


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def paint_solids(world, textures, light, view, scale, chosen, tile):
    """Bodies that are nearer than what a subpixel shows so far."""
    rows, columns = tile.depth.shape
    ox, oy, oz = view.centre
    base = np.zeros(4, dtype=np.float32)
    for body, i0, i1, j0, j1 in chosen:
        for i in range(max(i0 - tile.row, 0), min(i1 - tile.row, rows)):
            for j in range(max(j0 - tile.column, 0), min(j1 - tile.column, columns)):
                dx = tile.place[i, j, 0] - ox
                dy = tile.place[i, j, 1] - oy
                dz = tile.place[i, j, 2] - oz
                enter, leave, plane = hit_solid(world.solids, body, ox, oy, oz, dx, dy, dz)
                if enter >= leave or enter <= 0:
                    continue
                m = view.rotation
                reach = m[2, 0] * dx + m[2, 1] * dy + m[2, 2] * dz
                depth = np.float32(enter * reach)
                if depth >= tile.depth[i, j]:
                    continue
                x, y, z = ox + enter * dx, oy + enter * dy, oz + enter * dz
                nx, ny, nz, _ = world.solids.planes[plane]
                footprint = np.float32(depth * scale)
                solid_colour(world, textures, body, plane, x, y, z, footprint, base)
                facing = nx * light.sun[0] + ny * light.sun[1] + nz * light.sun[2]
                lit = np.float32(0)
                if facing > 0:
                    # Off the face by a cell of the shadow map, so that it does not shade itself.
                    off = 1.5 * light.cell
                    lit = np.float32(facing) * sunlit_ground(
                        light,
                        np.float32(x + off * nx),
                        np.float32(y + off * ny),
                        np.float32(z + off * max(nz, 0.0) + 0.05),
                        place_hash(x + z, y),
                    )
                sky = np.float32(0.5 + 0.5 * nz)
                for band in range(4):
                    tile.colour[i, j, band] = base[band] * (
                        light.direct[band] * lit + light.diffuse[band] * sky
                    )
                tile.depth[i, j] = depth
                tile.owner[i, j] = SOLID - body


@numba.njit(error_model="numpy", fastmath=True)
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
                    tile.depth[i, j] = depth
                    tile.owner[i, j] = owner
                    for band in range(4):
                        tile.colour[i, j, band] = out[band]
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
                tile.depth[i, j] = depth
                tile.owner[i, j] = owner
                for band in range(4):
                    tile.colour[i, j, band] = out[band]


@numba.njit(error_model="numpy", fastmath=True)
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


@numba.njit(error_model="numpy", fastmath=True)
def _towards(view, x, y, z):
    """Unit vector from a point to the camera."""
    dx, dy, dz = view.centre[0] - x, view.centre[1] - y, view.centre[2] - z
    n = 1 / math.sqrt(dx * dx + dy * dy + dz * dz)
    return np.float32(dx * n), np.float32(dy * n), np.float32(dz * n)


@numba.njit(error_model="numpy", fastmath=True)
def _canopy_shade(world, x, y, z):
    """Share of the sky that neighbouring crowns leave to a place at height z, 0.2..1."""
    terrain = world.terrain
    column, row = (x - terrain.west) / terrain.step, (y - terrain.south) / terrain.step
    canopy = bilinear_pair(world.ground.canopy, terrain.height, column, row)
    sunk = max(canopy - z, np.float32(0))
    closure = bilinear_one(world.ground.closure, column, row)
    return np.float32(1) - np.float32(0.8) * closure * (
        np.float32(1) - np.float32(math.exp(-sunk * np.float32(0.22)))
    )


@numba.njit(error_model="numpy", fastmath=True)
def bilinear_pair(a, b, column, row):
    """Nearest value of the sum of two rasters."""
    i = min(max(int(row + np.float32(0.5)), 0), a.shape[0] - 1)
    j = min(max(int(column + np.float32(0.5)), 0), a.shape[1] - 1)
    return a[i, j] + b[i, j]


@numba.njit(error_model="numpy", fastmath=True)
def bilinear_one(a, column, row):
    """Nearest value of a raster."""
    i = min(max(int(row + np.float32(0.5)), 0), a.shape[0] - 1)
    j = min(max(int(column + np.float32(0.5)), 0), a.shape[1] - 1)
    return a[i, j]


@numba.njit(error_model="numpy", fastmath=True)
def _image_of(view, a, b, w):
    """Subpixel column and row of camera coordinates in front of the camera."""
    u, v = a / w, b / w
    k = view.distortion
    r2 = u * u + v * v
    radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    if view.rational:
        radial /= 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    du = u * radial + 2 * k[2] * u * v + k[3] * (r2 + 2 * u * u)
    dv = v * radial + k[2] * (r2 + 2 * v * v) + 2 * k[3] * u * v
    return view.focal[0] * du + view.principal[0], view.focal[1] * dv + view.principal[1]


@numba.njit(error_model="numpy", fastmath=True)
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


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def paint_trees(world, wind, light, view, scale, chosen, tile):
    """Leaves, branches and stems of the chosen trees."""
    rows, columns = tile.depth.shape
    plants, m = world.plants, view.rotation
    out = np.zeros(4, dtype=np.float32)
    focal = 0.5 * (view.focal[0] + view.focal[1])
    for index in chosen:
        tree = plants.trees[index]
        sway_x, sway_y = own_sway(wind, np.uint64(index))
        first = int(tree[FIRST])
        wood = _DEAD_WOOD if world.tree_cover[index] == Cover.DEAD_TREE.value else _WOOD
        for c in range(first, first + int(tree[CLUMPS])):
            clump = plants.clumps[c]
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
            shaded = _canopy_shade(world, x, y, z)
            number, size = clump_particles(clump, c, tree[LEAF], edge, shaded < np.float32(_DEEP))
            start = int(hash2(np.uint64(c), np.uint64(9)))
            key = hash2(wind.seed, np.uint64(c))
            is_wood = clump[KIND] == np.float32(LINE)
            tone = wood if is_wood else tree[TRED : TRED + 4]
            toward = _towards(view, x, y, z)
            half = half_vector(light, toward)
            open_sky = clump[AO] * shaded
            dx, dy, dz = x - view.centre[0], y - view.centre[1], z - view.centre[2]
            ca = m[0, 0] * dx + m[0, 1] * dy + m[0, 2] * dz
            cb = m[1, 0] * dx + m[1, 1] * dy + m[1, 2] * dz
            cw = m[2, 0] * dx + m[2, 1] * dy + m[2, 2] * dz
            for i in range(number):
                ox, oy, oz, leaf = clump_leaf(clump, frame, plants.leaves, start, i, number)
                flutter = np.float32(0)
                if not is_wood:
                    jx, jy, flutter = jitter(wind, key, i)
                    ox += jx
                    oy += jy
                a = ca + m[0, 0] * ox + m[0, 1] * oy + m[0, 2] * oz
                b = cb + m[1, 0] * ox + m[1, 1] * oy + m[1, 2] * oz
                w = cw + m[2, 0] * ox + m[2, 1] * oy + m[2, 2] * oz
                pc, pr = _image_of(view, a, b, w)
                pc -= tile.column
                pr -= tile.row
                radius, near = 0.5 * size * focal / w, np.float32(w)
                if _hidden(tile, pc, pr, near, radius):
                    continue
                n = plants.leaves.normal[leaf]
                normal = toward if is_wood else (n[0], n[1], n[2])
                lit = sunlit_leaf(light, x + ox, y + oy, z + oz)
                # The lower leaves of a clump lie in the shade of the upper ones.
                share = np.float32(0.68) + np.float32(0.32) * plants.leaves.position[leaf, 2]
                bright = clump[SHADE] * plants.leaves.bright[leaf] * (np.float32(1) + flutter)
                shade_leaf(light, tone, bright, lit * share, open_sky * share, normal, toward, half, out)
                tilt = (np.float32(1), np.float32(0), np.float32(1))
                if radius > 0 and not is_wood:
                    tilt = _tilt(view, normal)
                _paint(tile, pc, pr, near, radius, tilt, index, out)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def paint_reed(world, wind, light, view, scale, window, tile):
    """Stems of the reed cells within (first row, last row, first column, last column)."""
    rows, columns = tile.depth.shape
    reed, m = world.reed, view.rotation
    out = np.zeros(4, dtype=np.float32)
    focal = 0.5 * (view.focal[0] + view.focal[1])
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
            toward = _towards(view, cx, cy, reed.foot[i, j] + reed.height[i, j])
            half = half_vector(light, toward)
            for s in range(stems_in_cell(reed, i, j)):
                x, y, foot, tall, green, h = stem(reed, i, j, s)
                gx, gy = gust(wind, x, y)
                number, size = stem_detail(tall, edge, h)
                key = hash2(wind.seed, h)
                tone = _REED_GREEN if green else _REED_BROWN
                own = np.float32(0.8) + np.float32(0.4) * np.float32(h & np.uint64(0xFF)) / np.float32(255)
                dx, dy, dz = x - view.centre[0], y - view.centre[1], foot - view.centre[2]
                ca = m[0, 0] * dx + m[0, 1] * dy + m[0, 2] * dz
                cb = m[1, 0] * dx + m[1, 1] * dy + m[1, 2] * dz
                cw = m[2, 0] * dx + m[2, 1] * dy + m[2, 2] * dz
                for k in range(number):
                    ox, oy, oz, nx, ny, nz, share, part = stem_leaf(h, tall, k, number)
                    lift = share * np.float32(math.sqrt(share)) * wind.reed
                    jx, jy, flutter = jitter(wind, key, k)
                    ox, oy = ox + gx * lift + jx, oy + gy * lift + jy
                    a = ca + m[0, 0] * ox + m[0, 1] * oy + m[0, 2] * oz
                    b = cb + m[1, 0] * ox + m[1, 1] * oy + m[1, 2] * oz
                    w = cw + m[2, 0] * ox + m[2, 1] * oy + m[2, 2] * oz
                    pc, pr = _image_of(view, a, b, w)
                    pc -= tile.column
                    pr -= tile.row
                    radius, near = 0.5 * size * focal / w, np.float32(w)
                    if _hidden(tile, pc, pr, near, radius):
                        continue
                    normal = (nx, ny, nz)
                    lit = sunlit_leaf(light, x + ox, y + oy, foot + oz)
                    sunk = np.float32(1) - np.float32(0.75) * crowd * (np.float32(1) - share)
                    colour = _PANICLE if part == 1 else tone
                    shade_leaf(light, colour, own * (1 + flutter), lit, sunk, normal, toward, half, out)
                    _paint(tile, pc, pr, near, radius, _tilt(view, normal), REED, out)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def paint_ground(world, textures, light, waves, view, scale, s, cover, tile):
    """Land and lake where nothing stands in front; ``cover`` receives their codes.

    What changes slowly (slope, share of the sky, nearness of a target) is found once a pixel, the rest
    for each of its ``s`` x ``s`` subpixels.
    """
    rows, columns = tile.depth.shape
    base = np.zeros(4, dtype=np.float32)
    for top in range(0, rows, s):
        for left in range(0, columns, s):
            bare = 0
            for i in range(top, top + s):
                for j in range(left, left + s):
                    bare += tile.owner[i, j] == NOTHING
            if bare == 0:
                continue
            x, y, z = tile.place[top, left, 0], tile.place[top, left, 1], tile.place[top, left, 2]
            xf, yf = np.float32(x), np.float32(y)
            facing = _facing(world.terrain, light, xf, yf)
            sky = _canopy_shade(world, xf, yf, np.float32(z))
            toward = _towards(view, x, y, z)
            footprint = np.float32(tile.depth[top, left] * scale)
            level = level_of(footprint, np.float32(TEXEL))
            signal = _target_near(world, x, y, s * footprint)
            plain = plain_cover(world, xf, yf, np.float32(z)) if s * footprint < 0.2 else -1
            for i in range(top, top + s):
                for j in range(left, left + s):
                    if tile.owner[i, j] != NOTHING:
                        continue
                    x, y, z = tile.place[i, j, 0], tile.place[i, j, 1], np.float32(tile.place[i, j, 2])
                    xf, yf = np.float32(x), np.float32(y)
                    lit = sunlit_ground(light, xf, yf, z, place_hash(x, y))
                    code = plain
                    level_here = z <= world.water_level + 1e-3
                    if code < 0 and level_here and ground_height(world.terrain, xf, yf) < world.water_level:
                        code = Cover.WATER.value
                    if code == Cover.WATER.value:
                        shade_water(world, light, textures, waves, xf, yf, toward, footprint, lit, base)
                        cover[i, j] = code
                        for band in range(4):
                            tile.colour[i, j, band] = base[band]
                        continue
                    if signal and target_colour(world, x, y, base):
                        code = Cover.TARGET.value
                    else:
                        if code < 0:
                            code = ground_cover(world, textures, xf, yf, z, level)
                        ground_colour(textures, code, xf, yf, level, base)
                    cover[i, j] = code
                    for band in range(4):
                        incoming = light.direct[band] * facing * lit + light.diffuse[band] * sky
                        tile.colour[i, j, band] = base[band] * incoming


@numba.njit(error_model="numpy", fastmath=True)
def _facing(terrain, light, x, y):
    """Cosine between the normal of the terrain and the sun, not below 0."""
    step = terrain.step
    east = ground_height(terrain, x + step, y) - ground_height(terrain, x - step, y)
    north = ground_height(terrain, x, y + step) - ground_height(terrain, x, y - step)
    gx, gy = -east / (2 * step), -north / (2 * step)
    cosine = (gx * light.sun[0] + gy * light.sun[1] + light.sun[2]) / math.sqrt(gx * gx + gy * gy + 1)
    return np.float32(max(cosine, 0.0))


@numba.njit(error_model="numpy", fastmath=True)
def _target_near(world, x, y, margin):
    """Whether a target lies within its size and a margin of a place."""
    for k in range(world.targets.shape[0]):
        reach = world.targets[k, 2] + margin
        if abs(x - world.targets[k, 0]) < reach and abs(y - world.targets[k, 1]) < reach:
            return True
    return False


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def resolve(tile, cover, tree_cover, solid_cover, s, radiance, depth, cover_out, tree_out, row, column):
    """Average the subpixels of every pixel; depth, cover and tree are those of its central subpixel."""
    rows, columns = tile.depth.shape[0] // s, tile.depth.shape[1] // s
    weight = np.float32(1.0 / (s * s))
    for i in range(rows):
        for j in range(columns):
            for band in range(4):
                total = np.float32(0)
                for a in range(s):
                    for b in range(s):
                        total += tile.colour[i * s + a, j * s + b, band]
                radiance[band, row + i, column + j] = total * weight
            ci, cj = i * s + s // 2, j * s + s // 2
            depth[row + i, column + j] = tile.depth[ci, cj]
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


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
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
