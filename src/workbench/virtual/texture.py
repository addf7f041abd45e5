"""Surface texture: square tiles of fine structure with their averages over 2, 4, 8 ... texels.

A tile repeats, but no surface shows it alone: the renderer adds one tile at three incommensurate scales
and directions, and bends the coordinates of the finest, so that no piece of ground has a twin that
photographs could be matched with. Sampling at the level whose texels are as wide
as a subpixel makes a coarse photograph the average of a fine one.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from workbench.virtual.compiled import inner

TILE = 1024
"""Texels along the edge of a tile."""
TEXEL = 0.004
"""Edge of a texel, m: below the finest ground sampling distance that is flown."""
NOISE, GRASS, GRAVEL, ASPHALT, LITTER, WAVE_EAST, WAVE_NORTH = range(7)
_LEVELS = 11


class Textures(NamedTuple):
    """Tiles with all their levels, mean 0 and standard deviation 1 at the finest level."""

    values: np.ndarray
    """(tile, sample) float32: levels one after the other, each row by row."""
    starts: np.ndarray
    """(level,) int64: first sample of a level."""
    variance: np.ndarray
    """(tile, level) float32: what is left of the variance at a level."""


@functools.cache
def textures() -> Textures:
    """The tiles: noise, grass, gravel, asphalt, litter, slopes of waves. Always the same."""
    makers = (_noise, _grass, _gravel, _asphalt, _litter, _wave_east, _wave_north)
    pyramids = [_pyramid(maker(np.random.default_rng(77))) for maker in makers]
    sizes = [(TILE >> level) ** 2 for level in range(_LEVELS)]
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    ends = [*starts[1:], pyramids[0].size]
    variance = [[part[a:b].var() for a, b in zip(starts, ends, strict=True)] for part in pyramids]
    return Textures(np.stack(pyramids), starts, np.array(variance, dtype=np.float32))


@inner
def level_of(footprint, texel):
    """Level (a float) whose texels are as wide as the footprint, both metres."""
    return np.float32(np.log2(max(footprint / texel, np.float32(1))))


class Tap(NamedTuple):
    """Where the samples of one level are, and how places become its rows and columns."""

    start: int
    """First sample of the level."""
    mask: int
    """Samples along its edge, less one."""
    scale: np.float32
    """Samples per metre."""


@inner
def tap_of(textures, texel, level):
    """The level nearest to ``level`` (a float) of a tile with texels of this edge, m."""
    k = min(max(int(level + np.float32(0.5)), 0), _LEVELS - 1)
    scale = np.float32(1) / (np.float32(texel) * np.float32(1 << k))
    return Tap(textures.starts[k], (TILE >> k) - 1, scale)


@inner
def sample(textures, tile, x, y, tap):
    """Texture at a place, m: bilinear between the samples of a level."""
    u, v = x * tap.scale - np.float32(0.5), y * tap.scale - np.float32(0.5)
    column, row = np.floor(u), np.floor(v)
    a, b = np.float32(u - column), np.float32(v - row)
    j, i = np.int64(column), np.int64(row)
    mask, edge = tap.mask, tap.mask + 1
    j0, j1 = j & mask, (j + 1) & mask
    row0, row1 = tap.start + (i & mask) * edge, tap.start + ((i + 1) & mask) * edge
    values = textures.values[tile]
    top = values[row0 + j0] + a * (values[row0 + j1] - values[row0 + j0])
    low = values[row1 + j0] + a * (values[row1 + j1] - values[row1 + j0])
    return np.float32(top + b * (low - top))


@inner
def mottle_taps(textures, texel, level):
    """The two levels that :func:`mottle` samples."""
    other = np.float32(texel) * np.float32(0.7937)
    return tap_of(textures, texel, level), tap_of(textures, other, level + np.float32(0.3333))


@inner
def mottle(textures, x, y, taps):
    """Noise as the mean of two tiles of other sizes and directions: where one repeats, the other does not."""
    u, v = x * np.float32(0.28) - y * np.float32(0.96), y * np.float32(0.28) + x * np.float32(0.96)
    other = sample(textures, NOISE, u, v, taps[1])
    return np.float32(0.7071) * (sample(textures, NOISE, x, y, taps[0]) + other)


def _pyramid(tile: np.ndarray) -> np.ndarray:
    tile = tile - ndimage.gaussian_filter(tile, TILE / 14, mode="wrap")
    tile = (tile - tile.mean()) / tile.std()
    level = np.clip(tile, -3.5, 3.5)
    level -= level.mean()
    parts = [level.ravel()]
    while level.shape[0] > 1:
        half = level.shape[0] // 2
        level = level.reshape(half, 2, half, 2).mean(axis=(1, 3))
        parts.append(level.ravel())
    return np.concatenate(parts).astype(np.float32)


def _noise(rng: np.random.Generator, power: float = 1.0) -> np.ndarray:
    """Noise whose amplitude falls with frequency: every octave has the same variance at power 1."""
    frequency = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.rfftfreq(TILE)[None, :])
    frequency[0, 0] = 1
    spectrum = np.fft.rfft2(rng.normal(size=(TILE, TILE))) / frequency**power
    spectrum[0, 0] = 0
    field = np.fft.irfft2(spectrum, s=(TILE, TILE))
    return field / field.std()


def _grass(rng: np.random.Generator) -> np.ndarray:
    """Blades of 4-14 cm in tufts, later ones over earlier ones, dark ground between them."""
    tile = np.full((TILE, TILE), -2.2)
    blades = 90_000
    x, y = rng.uniform(0, TILE, (2, blades))
    lay = _noise(rng)[y.astype(int), x.astype(int)]
    angle = rng.uniform(0, 2 * np.pi, blades) + 0.5 * lay
    length = rng.uniform(8, 30, blades)
    bright = rng.normal(0, 0.9, blades) + 0.3 * lay
    for t in np.linspace(0, 1, 22):
        columns = (x + t * length * np.cos(angle)).astype(int) % TILE
        rows = (y + t * length * np.sin(angle)).astype(int) % TILE
        tile[rows, columns] = bright + 1.0 * (t - 0.4)
    return ndimage.gaussian_filter(tile, 0.6, mode="wrap")


def _gravel(rng: np.random.Generator) -> np.ndarray:
    """Pebbles of 1-5 cm, each of one brightness, lit from one side, with dark joints."""
    return _cells(rng, 9000, edge=1.2) + 0.35 * _noise(rng, 0.6)


def _litter(rng: np.random.Generator) -> np.ndarray:
    """Fallen leaves and twigs on dark soil."""
    leaves = _cells(rng, 16000, edge=0.8)
    twigs = np.zeros((TILE, TILE))
    x, y = rng.uniform(0, TILE, (2, 700))
    angle, length = rng.uniform(0, np.pi, 700), rng.uniform(20, 160, 700)
    for t in np.linspace(0, 1, 200):
        rows = (y + t * length * np.sin(angle)).astype(int) % TILE
        twigs[rows, (x + t * length * np.cos(angle)).astype(int) % TILE] = 1.6
    return leaves + ndimage.gaussian_filter(twigs, 0.7, mode="wrap") + 0.8 * _noise(rng)


def _asphalt(rng: np.random.Generator) -> np.ndarray:
    """Speckle of single grains, blotches and a few cracks."""
    speckle = rng.normal(size=(TILE, TILE)) + 0.6 * _noise(rng, 0.5)
    cracks = np.abs(ndimage.gaussian_filter(_noise(rng, 1.6), 1.0, mode="wrap"))
    where = ndimage.gaussian_filter(rng.normal(size=(TILE, TILE)), 60, mode="wrap")
    return speckle - 4.0 * (cracks < 0.012) * (where > where.std() * 0.4)


def _wave_east(rng: np.random.Generator) -> np.ndarray:
    return _wave_slopes(rng)[0]


def _wave_north(rng: np.random.Generator) -> np.ndarray:
    return _wave_slopes(rng)[1]


def _wave_slopes(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of one wavy surface, 8 to 90 texels from crest to crest, mostly running east."""
    east, north = np.fft.rfftfreq(TILE)[None, :], np.fft.fftfreq(TILE)[:, None]
    frequency = np.hypot(east, north)
    band = np.exp(-((np.log(np.maximum(frequency, 1e-6) * 26)) ** 2) / 0.7)
    heading = 0.25 + np.cos(np.arctan2(north, east) - 0.35) ** 2
    spectrum = np.fft.rfft2(rng.normal(size=(TILE, TILE))) * band * heading
    slopes = [
        np.fft.irfft2(2j * np.pi * k * spectrum / np.maximum(frequency, 1e-6), s=(TILE, TILE))
        for k in (east, north)
    ]
    return slopes[0], slopes[1]


def _cells(rng: np.random.Generator, number: int, edge: float) -> np.ndarray:
    """Cells around random seeds, each with a brightness of its own and a dark rim; periodic."""
    seeds = np.zeros((TILE, TILE), dtype=bool)
    rows, columns = rng.integers(0, TILE, (2, number))
    seeds[rows, columns] = True
    pad = 96
    wrapped = np.pad(seeds, pad, mode="wrap")
    distance, (i, j) = ndimage.distance_transform_edt(~wrapped, return_indices=True)
    bright = np.pad(rng.normal(size=(TILE, TILE)), pad, mode="wrap")[i, j]
    rim = np.hypot(*np.gradient(bright))
    cell = bright - edge * (rim > 0.05) - 0.05 * distance
    return ndimage.gaussian_filter(cell, 0.7)[pad:-pad, pad:-pad]
