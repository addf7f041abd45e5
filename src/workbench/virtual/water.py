"""The lake as a camera sees it: sky reflected by ripples, glint of the sun, bottom through shallow water.

Ripples are slopes, not heights. The mean square slope follows the measurements of Cox and Munk (1954):
0.003 + 0.00512 times the wind speed; slopes finer than a subpixel widen the glint instead of moving it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from workbench.virtual.compiled import inner
from workbench.virtual.noise import bilinear
from workbench.virtual.texture import (
    GRAVEL,
    NOISE,
    WAVE_EAST,
    WAVE_NORTH,
    Tap,
    level_of,
    mottle,
    mottle_taps,
    sample,
    tap_of,
)
from workbench.virtual.wind import Wind

_FINE_TEXEL, _COARSE_TEXEL = np.float32(0.011), np.float32(0.043)
_ATTENUATION = np.array([0.85, 0.42, 0.62, 4.0], dtype=np.float32)
"""Loss of light on the way down, 1/m, red, green, blue, nir: a clear, slightly green lake."""
_VOLUME = np.array([0.010, 0.026, 0.027, 0.003], dtype=np.float32)
_BOTTOM = np.array([0.20, 0.18, 0.12, 0.24], dtype=np.float32)
_SUN_SPREAD = 0.0006


class Ripples(NamedTuple):
    """State of the water surface at one exposure."""

    shift: np.ndarray
    """(2, 2) float32: offset of the fine and the coarse waves, m."""
    slope: np.float32
    """Root mean square slope."""


def ripples(wind: Wind, exposure: int) -> Ripples:
    """Ripples of an exposure: waves of another phase each time, frozen in calm air."""
    shift = np.zeros((2, 2))
    if wind.speed > 0:
        shift = np.random.default_rng([wind.seed, exposure, 0xACE]).uniform(0, 40, (2, 2))
    return Ripples(shift.astype(np.float32), np.float32(math.sqrt(0.003 + 0.00512 * wind.speed)))


class Lake(NamedTuple):
    """The lake within one pixel: what changes slowly."""

    fine: Tap
    """Level of the short waves."""
    coarse: Tap
    """Level of the long waves."""
    stones: Tap
    """Level of the pebbles on the bed."""
    weed: tuple[Tap, Tap]
    """Levels of the plants on the bed."""
    shift: np.ndarray
    """As in :class:`Ripples`."""
    half: np.float32
    """Root mean square slope of each kind of waves."""
    rough: np.float32
    """Square slope of the waves that are finer than a subpixel."""
    through: tuple[np.float32, np.float32, np.float32, np.float32]
    """Share of light that comes up again from the bed."""


@inner
def lake_at(world, textures, waves, x, y, footprint):
    """The lake around a place, for subpixels of this edge, m."""
    fine_level, coarse_level = level_of(footprint, _FINE_TEXEL), level_of(footprint, _COARSE_TEXEL)
    # Gusts roughen the water in patches.
    patch = np.float32(1) + np.float32(0.35) * sample(
        textures, NOISE, x + waves.shift[0, 0], y, _tap(textures, np.float32(0.11), footprint)
    )
    half = waves.slope * np.float32(0.5) * min(max(patch, np.float32(0.3)), np.float32(1.8))
    kept = np.float32(0.5) * (
        textures.variance[WAVE_EAST, min(int(fine_level), 10)]
        + textures.variance[WAVE_EAST, min(int(coarse_level), 10)]
    )
    column = (x - world.terrain.west) / world.terrain.step
    row = (y - world.terrain.south) / world.terrain.step
    depth = max(np.float32(world.water_level) - bilinear(world.terrain.height, column, row), np.float32(0))
    weed = np.float32(0.025)
    return Lake(
        tap_of(textures, _FINE_TEXEL, fine_level),
        tap_of(textures, _COARSE_TEXEL, coarse_level),
        _tap(textures, np.float32(0.012), footprint),
        mottle_taps(textures, weed, level_of(footprint, weed)),
        waves.shift,
        np.float32(half),
        np.float32(half * half * np.float32(2) * (np.float32(1) - kept) + np.float32(_SUN_SPREAD)),
        (_through(0, depth), _through(1, depth), _through(2, depth), _through(3, depth)),
    )


@inner
def _tap(textures, texel, footprint):
    return tap_of(textures, texel, level_of(footprint, texel))


@inner
def _through(band, depth):
    """Share of light left after the way down to the bed and up again."""
    return np.float32(math.exp(-np.float32(2.1) * _ATTENUATION[band] * depth))


@inner
def shade_water(light, textures, lake, x, y, view, sunlit, out):
    """Radiance of the lake at a place; ``view`` points to the camera. Adds nothing, overwrites ``out``."""
    xf, yf = x + lake.shift[0, 0], y + lake.shift[0, 1]
    xc, yc = x * np.float32(0.83) + y * np.float32(0.56), y * np.float32(0.83) - x * np.float32(0.56)
    xc, yc = xc + lake.shift[1, 0], yc + lake.shift[1, 1]
    sx = sample(textures, WAVE_EAST, xf, yf, lake.fine) + sample(textures, WAVE_EAST, xc, yc, lake.coarse)
    sy = sample(textures, WAVE_NORTH, xf, yf, lake.fine) + sample(textures, WAVE_NORTH, xc, yc, lake.coarse)
    sx, sy = lake.half * sx, lake.half * sy
    norm = np.float32(1) / np.float32(math.sqrt(sx * sx + sy * sy + 1))
    nx, ny, nz = -sx * norm, -sy * norm, norm
    facing = max(nx * view[0] + ny * view[1] + nz * view[2], np.float32(0.05))
    away = np.float32(1) - facing
    fresnel = np.float32(0.02) + np.float32(0.98) * away * away * away * away * away
    up = max(np.float32(2) * facing * nz - view[2], np.float32(0))
    sky = np.float32(0.8) + np.float32(1.3) * (np.float32(1) - up) * (np.float32(1) - up)
    hx, hy, hz = view[0] + light.sun[0], view[1] + light.sun[1], view[2] + light.sun[2]
    gx, gy = -hx / hz - sx, -hy / hz - sy
    glint = math.exp(-(gx * gx + gy * gy) / lake.rough) / (np.float32(math.pi) * lake.rough)
    glint *= fresnel * sunlit / (np.float32(4) * max(view[2], np.float32(0.2)))
    stones = sample(textures, GRAVEL, x + sx, y + sy, lake.stones)
    weed = mottle(textures, x, y, lake.weed)
    bed = max(np.float32(1) + np.float32(0.12) * stones + np.float32(0.25) * weed, np.float32(0.15))
    for band in range(4):
        through = lake.through[band]
        body = _BOTTOM[band] * bed * through + _VOLUME[band] * (np.float32(1) - through)
        incoming = light.direct[band] * light.sun[2] * sunlit + light.diffuse[band]
        out[band] = (np.float32(1) - fresnel) * body * incoming
        out[band] += fresnel * sky * light.diffuse[band] + glint * light.direct[band]
