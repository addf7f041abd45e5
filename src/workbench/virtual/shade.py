"""Radiance of leaves, ground and hard bodies under sun and sky, with soft shadows."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from workbench.virtual.compiled import inner, kernel
from workbench.virtual.noise import bilinear, hash2, hash3, uniform
from workbench.virtual.solids import GLASS, ROOF_FLAT, ROOF_TILES, STONE
from workbench.virtual.texture import (
    ASPHALT,
    GRASS,
    GRAVEL,
    LITTER,
    NOISE,
    TEXEL,
    Tap,
    level_of,
    mottle,
    mottle_taps,
    sample,
    tap_of,
)
from workbench.virtual.world import Cover

_BLOCK = 16
"""Cells of the shadow map along the edge of a cell of its coarse version."""
_SUN_WIDTH = 0.0093
"""Angular diameter of the sun, rad: width of a half-shadow over the distance to what casts it."""
_LEAF_BIAS, _GROUND_BIAS = 0.06, 0.06
_GRASS_GREEN = np.array([0.098, 0.152, 0.034, 0.46], dtype=np.float32)
_GRASS_DRY = np.array([0.205, 0.185, 0.085, 0.36], dtype=np.float32)
_CLOVER = np.array([0.052, 0.105, 0.024, 0.50], dtype=np.float32)
_LITTER = np.array([0.088, 0.072, 0.048, 0.20], dtype=np.float32)
_MOSS = np.array([0.055, 0.075, 0.022, 0.30], dtype=np.float32)
_ASPHALT = np.array([0.205, 0.200, 0.205, 0.225], dtype=np.float32)
_GRAVEL = np.array([0.320, 0.275, 0.235, 0.345], dtype=np.float32)
_MUD = np.array([0.235, 0.200, 0.145, 0.270], dtype=np.float32)
_TAPS = np.array([[0.41, 0.0], [-0.52, 0.48], [0.08, -0.91]], dtype=np.float32)
_PLAIN = np.float32(0.5)
_WHITE, _BLACK = np.float32(0.80), np.float32(0.03)
# An F that reads right only if nothing is mirrored; rows from north to south, columns from west to east.
_LETTER = np.array(
    [
        [0, 0, 0, 0, 0, 0, 0],
        [0, 1, 1, 1, 1, 1, 0],
        [0, 1, 0, 0, 0, 0, 0],
        [0, 1, 1, 1, 0, 0, 0],
        [0, 1, 0, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 0],
    ],
    dtype=np.int64,
)


class LightMap(NamedTuple):
    """Light of an exposure with its shadow map."""

    sun: np.ndarray
    """(3,) float32 unit vector towards the sun."""
    direct: np.ndarray
    """(4,) float32, sunlight on a surface that faces it."""
    diffuse: np.ndarray
    """(4,) float32, light of the sky."""
    top: np.ndarray
    """(rows, columns) float32: highest object per cell, local m."""
    coarse: np.ndarray
    """The largest values of blocks of 16 x 16 cells and their neighbours."""
    west: np.float32
    """x of the left edge, m."""
    north: np.float32
    """y of the upper edge, m."""
    cell: np.float32
    """Edge of a cell, m."""
    shear_x: np.float32
    """Eastward over upward component of the direction to the sun."""
    shear_y: np.float32
    """Northward over upward component."""


def coarsen(top: np.ndarray) -> np.ndarray:
    """Largest value of every block of the shadow map and of its eight neighbours."""
    rows, columns = (-(-size // _BLOCK) for size in top.shape)
    padded = np.full((rows * _BLOCK, columns * _BLOCK), -1e9, dtype=np.float32)
    padded[: top.shape[0], : top.shape[1]] = top
    blocks = padded.reshape(rows, _BLOCK, columns, _BLOCK).max(axis=(1, 3))
    framed = np.pad(blocks, 1, constant_values=-1e9)
    shifts = [framed[i : i + rows, j : j + columns] for i in range(3) for j in range(3)]
    return np.max(shifts, axis=0)


@inner
def _highest(light, column, row):
    i, j = int(np.floor(row)), int(np.floor(column))
    if i < 0 or j < 0 or i >= light.top.shape[0] or j >= light.top.shape[1]:
        return np.float32(-1e9)
    return light.top[i, j]


@inner
def sunlit_leaf(light, x, y, z):
    """Share of the sun that reaches a leaf: less the deeper it lies below the outermost leaves."""
    column = (x - z * light.shear_x - light.west) / light.cell
    row = (light.north - y + z * light.shear_y) / light.cell
    below = _highest(light, column, row) - z
    # Within one cell of the map a sloping crown differs in height by about the cell.
    if below < np.float32(_LEAF_BIAS) + light.cell:
        return np.float32(1)
    return np.float32(0.36) * np.float32(math.exp(-below * np.float32(0.55)))


@inner
def sunlit_ground(light, x, y, z, h):
    """Share of the sun that reaches the ground or a wall; half-shadow widens with the distance."""
    column = (x - z * light.shear_x - light.west) / light.cell
    row = (light.north - y + z * light.shear_y) / light.cell
    i, j = int(np.floor(row)) // _BLOCK, int(np.floor(column)) // _BLOCK
    if i < 0 or j < 0 or i >= light.coarse.shape[0] or j >= light.coarse.shape[1]:
        return np.float32(1)
    over = light.coarse[i, j] - z
    limit = z + np.float32(_GROUND_BIAS)
    if over < np.float32(_GROUND_BIAS):
        return np.float32(1)
    spread = np.float32(0.5) + np.float32(0.5 * _SUN_WIDTH) * over / (light.sun[2] * light.cell)
    # Three taps on a spiral, turned by a random angle, cover the half-shadow.
    turn = np.float32(6.2832) * uniform(h)
    c, s = spread * np.float32(math.cos(turn)), spread * np.float32(math.sin(turn))
    lit = np.float32(0)
    for tap in range(3):
        a, b = _TAPS[tap, 0], _TAPS[tap, 1]
        if _highest(light, column + a * c - b * s, row + a * s + b * c) <= limit:
            lit += np.float32(1)
    return lit / np.float32(3)


@inner
def half_vector(light, view):
    """Unit vector halfway between the camera and the sun: what a mirror would have to face."""
    x, y, z = view[0] + light.sun[0], view[1] + light.sun[1], view[2] + light.sun[2]
    scale = np.float32(1) / np.float32(math.sqrt(x * x + y * y + z * z + np.float32(1e-6)))
    return x * scale, y * scale, z * scale


@inner
def shade_leaf(light, colour, bright, sunlit, open_sky, normal, view, halfway, out):
    """Radiance of a leaf: reflected on the lit side, transmitted on the other, sheen towards the sun."""
    facing = normal[0] * light.sun[0] + normal[1] * light.sun[1] + normal[2] * light.sun[2]
    seen = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    same = facing * seen > 0
    strength = np.float32(0.22) + np.float32(0.78) * abs(facing)
    if not same:
        strength *= np.float32(0.55)
    half = abs(halfway[0] * normal[0] + halfway[1] * normal[1] + halfway[2] * normal[2])
    sheen = np.float32(0)
    if same and half > np.float32(0.8):
        s = half * half * half * half
        s = s * s
        sheen = np.float32(0.055) * s * s * sunlit
    sky = open_sky * (np.float32(0.65) + np.float32(0.35) * abs(normal[2]))
    for band in range(4):
        # Near infrared passes several leaves; light between leaves fills their shade.
        fill = np.float32(0.10) if band == 3 else np.float32(0.02)
        through = np.float32(1.25) if (not same and band < 2) else np.float32(1)
        light_in = light.direct[band] * (strength * through * sunlit + fill * open_sky)
        out[band] = colour[band] * bright * (light_in + light.diffuse[band] * sky)
        out[band] += sheen * light.direct[band]


class GroundTaps(NamedTuple):
    """Levels of the textures of bare ground for one size of subpixels."""

    fine: Tap
    tuft: Tap
    mid: tuple[Tap, Tap]
    big: Tap
    ragged: Tap


@inner
def ground_taps(textures, footprint):
    """Levels for subpixels of this edge, m; the finest texture sets it, the others are coarser."""
    level = level_of(footprint, np.float32(TEXEL))
    # log2 of the ratio of a texel to the finest.
    return GroundTaps(
        tap_of(textures, np.float32(TEXEL), level),
        tap_of(textures, np.float32(0.0131), level - np.float32(1.711)),
        mottle_taps(textures, np.float32(0.037), level - np.float32(3.209)),
        tap_of(textures, np.float32(0.31), level - np.float32(6.276)),
        tap_of(textures, np.float32(0.008), level - np.float32(1)),
    )


@inner
def ground_cover(world, textures, x, y, z, taps):
    """Land cover code of bare ground at a place."""
    terrain = world.terrain
    column, row = (x - terrain.west) / terrain.step, (y - terrain.south) / terrain.step
    ragged = sample(textures, NOISE, x, y, taps.ragged)
    if bilinear(world.ground.road, column, row) < np.float32(0.03) * ragged:
        return Cover.ROAD.value
    if bilinear(world.ground.path, column, row) < np.float32(0.10) * ragged:
        return Cover.PATH.value
    wet = z - np.float32(world.water_level)
    if wet < np.float32(0.18) + np.float32(0.05) * ragged:
        return Cover.SHORE.value
    if bilinear(world.ground.floor, column, row) + np.float32(0.12) * ragged > np.float32(0.5):
        return Cover.FOREST_FLOOR.value
    return Cover.MEADOW.value


@inner
def plain_cover(world, x, y, z):
    """Land cover code where no border is within about half a metre, otherwise -1."""
    terrain, level = world.terrain, np.float32(world.water_level)
    column, row = (x - terrain.west) / terrain.step, (y - terrain.south) / terrain.step
    road = bilinear(world.ground.road, column, row)
    path = bilinear(world.ground.path, column, row)
    if road < -_PLAIN:
        return Cover.ROAD.value
    if road < _PLAIN or abs(path) < _PLAIN:
        return -1
    if path < 0:
        return Cover.PATH.value
    height = bilinear(terrain.height, column, row)
    if height < level - np.float32(0.1):
        return Cover.WATER.value
    floor = bilinear(world.ground.floor, column, row)
    if z < level + np.float32(0.5) or abs(floor - np.float32(0.5)) < np.float32(0.42):
        return -1
    return Cover.FOREST_FLOOR.value if floor > np.float32(0.5) else Cover.MEADOW.value


@inner
def ground_colour(textures, cover, x, y, taps, out):
    """Reflectance of bare ground: material, its own texture, and mottling at three scales."""
    # Bent coordinates: the finest tile repeats nowhere exactly.
    xr, yr = x * np.float32(0.8) - y * np.float32(0.6), x * np.float32(0.6) + y * np.float32(0.8)
    xs, ys = x * np.float32(0.39) + y * np.float32(0.92), y * np.float32(0.39) - x * np.float32(0.92)
    big = sample(textures, NOISE, xs, ys, taps.big)
    mid = mottle(textures, xr, yr, taps.mid)
    xf, yf = x + np.float32(0.5) * big, y - np.float32(0.5) * big
    one = np.float32(1)
    if cover == Cover.ROAD.value:
        fine = sample(textures, ASPHALT, xf, yf, taps.fine)
        value = one + np.float32(0.16) * fine + np.float32(0.055) * mid + np.float32(0.06) * big
        for band in range(4):
            out[band] = _ASPHALT[band] * max(value, np.float32(0.2))
    elif cover == Cover.PATH.value or cover == Cover.SHORE.value:
        fine = sample(textures, GRAVEL, xf, yf, taps.fine)
        value = one + np.float32(0.20) * fine + np.float32(0.10) * mid + np.float32(0.07) * big
        for band in range(4):
            base = _GRAVEL[band] if cover == Cover.PATH.value else _MUD[band]
            out[band] = base * max(value, np.float32(0.15))
    elif cover == Cover.FOREST_FLOOR.value:
        fine = sample(textures, LITTER, xf, yf, taps.fine)
        moss = min(max(np.float32(0.5) + np.float32(0.5) * mid + np.float32(0.4) * big, np.float32(0)), one)
        value = max(one + np.float32(0.32) * fine + np.float32(0.12) * mid, np.float32(0.12))
        for band in range(4):
            out[band] = (_LITTER[band] + moss * (_MOSS[band] - _LITTER[band])) * value
    else:
        fine = sample(textures, GRASS, xf, yf, taps.fine)
        # Tufts: the same blades at three times the size, in another direction.
        tuft = sample(textures, GRASS, yr + big, xr - big, taps.tuft)
        dry = min(max(np.float32(0.22) * big + np.float32(0.16) * mid + np.float32(0.06), np.float32(0)), one)
        weed = min(max(np.float32(0.5) * mid - np.float32(0.45) * big - np.float32(0.45), np.float32(0)), one)
        value = one + np.float32(0.24) * fine + np.float32(0.12) * tuft + np.float32(0.07) * mid
        value = max(value + np.float32(0.05) * big, np.float32(0.12))
        for band in range(4):
            base = _GRASS_GREEN[band] + dry * (_GRASS_DRY[band] - _GRASS_GREEN[band])
            out[band] = (base + weed * (_CLOVER[band] - base)) * value


@inner
def target_colour(world, x, y, out, width=1e-6):
    """Whether a place lies on a target; then its reflectance is written, as the mean over a ``width``.

    Edges are averaged, so that the middle of a target does not follow the raster of the samples.
    """
    for k in range(world.targets.shape[0]):
        tx, ty, edge, azimuth, kind = world.targets[k]
        dx, dy = x - tx, y - ty
        if abs(dx) > edge or abs(dy) > edge:
            continue
        c, s = math.cos(math.radians(azimuth)), math.sin(math.radians(azimuth))
        u, v = (dx * c - dy * s) / edge, (dx * s + dy * c) / edge
        if abs(u) > 0.5 or abs(v) > 0.5:
            continue
        if kind == 0:
            side = 2 * edge / width
            across, along = min(max(u * side, -1.0), 1.0), min(max(v * side, -1.0), 1.0)
            white = np.float32(0.5 + 0.5 * across * along)
        else:
            row, column = min(int((0.5 - v) * 7), 6), min(int((u + 0.5) * 7), 6)
            white = np.float32(_LETTER[row, column] == 1)
        for band in range(4):
            out[band] = _BLACK + white * (_WHITE - _BLACK)
        return True
    return False


@inner
def solid_colour(world, textures, body, plane, x, y, z, footprint, out):
    """Reflectance of a hard body: roofs with rows of tiles, stone with speckle, smooth paint."""
    solids = world.solids
    normal = solids.planes[plane]
    upward = normal[2] > 0.12
    surface = solids.surface[body]
    rough = np.float32(0.03)
    along, down = np.float32(x), np.float32(y)
    if surface == ROOF_TILES and upward:
        flat = max(math.hypot(normal[0], normal[1]), 1e-6)
        down = np.float32((normal[0] * x + normal[1] * y) / flat / max(normal[2], 0.2))
        along = np.float32((-normal[1] * x + normal[0] * y) / flat)
        rough = np.float32(0.12)
    elif surface in (ROOF_FLAT, STONE):
        rough = np.float32(0.14)
    elif not upward:
        along, down = np.float32(x + y), np.float32(z)
        rough = np.float32(0.08)
    grain, patch = np.float32(0.006), np.float32(0.013)
    fine = sample(textures, GRAVEL, along, down, tap_of(textures, grain, level_of(footprint, grain)))
    mid = sample(textures, NOISE, down, along, tap_of(textures, patch, level_of(footprint, patch)))
    value = np.float32(1) + rough * fine + np.float32(0.08) * mid * (rough > np.float32(0.05))
    if surface == ROOF_TILES and upward:
        # Courses of tiles, every 0.33 m; each tile, 0.25 m wide, has a tone of its own.
        course = math.floor(down / 0.33)
        tile = math.floor(along / 0.25 + 0.5 * (course % 2))
        tone = uniform(hash3(np.uint64(body), np.uint64(course + 50000), np.uint64(tile + 50000)))
        visible = min(max(np.float32(0.12) / footprint - np.float32(0.6), np.float32(0)), np.float32(1))
        part = np.float32(down / 0.33 - course)
        edge = np.float32(-0.35) if part > np.float32(0.86) else np.float32(0.057)
        value += visible * (edge + np.float32(0.22) * (tone - np.float32(0.5)))
    for band in range(4):
        base = solids.colour[body, 0, band] if upward else solids.colour[body, 1, band]
        out[band] = base * max(value, np.float32(0.1))
    if surface == GLASS and not upward:
        for band in range(4):
            out[band] = np.float32(0.04)


@inner
def place_hash(x, y):
    """Hash of a place to a tenth of a millimetre, so that dither does not depend on tiles."""
    return hash2(np.uint64(np.int64(np.floor(x * 1e4))), np.uint64(np.int64(np.floor(y * 1e4))))


@kernel
def cover_below(world, textures, x, y, footprint):
    """Land cover codes (y, x) of ground and water at local places, as if nothing stood on them."""
    codes = np.zeros((y.size, x.size), dtype=np.uint8)
    colour = np.zeros(4, dtype=np.float32)
    terrain = world.terrain
    taps = ground_taps(textures, np.float32(footprint))
    for i in range(y.size):
        for j in range(x.size):
            xf, yf = np.float32(x[j]), np.float32(y[i])
            column, row = (xf - terrain.west) / terrain.step, (yf - terrain.south) / terrain.step
            z = bilinear(terrain.height, column, row)
            if z < world.water_level:
                codes[i, j] = Cover.WATER.value
            elif target_colour(world, x[j], y[i], colour):
                codes[i, j] = Cover.TARGET.value
            else:
                codes[i, j] = ground_cover(world, textures, xf, yf, z, taps)
    return codes
