"""Randomness that depends on a place or a number and on nothing else: integer hashes and smooth fields.

A hash of (seed, cell, leaf ...) gives the same leaf in every photograph, in every tile and on every
thread, without storing it. The mixing function is a 32-bit finaliser of the multiply-xorshift family.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workbench.virtual.compiled import inner

_MASK = np.uint64(0xFFFFFFFF)
_M1 = np.uint64(0x7FEB352D)
_M2 = np.uint64(0x846CA68B)
_GOLDEN = np.uint64(0x9E3779B9)
_S15, _S16, _S8 = np.uint64(15), np.uint64(16), np.uint64(8)
_UNIT = np.float32(1 / 16777216)


@inner
def mix(value):
    """Scramble the low 32 bits of a uint64; numba widens uint32 products, hence the masks."""
    x = np.uint64(value) & _MASK
    x ^= x >> _S16
    x = (x * _M1) & _MASK
    x ^= x >> _S15
    x = (x * _M2) & _MASK
    x ^= x >> _S16
    return x


@inner
def hash2(a, b):
    """Hash of two integers, uint64 with 32 random bits."""
    return mix((mix(np.uint64(a) + _GOLDEN) ^ np.uint64(b)) & _MASK)


@inner
def hash3(a, b, c):
    """Hash of three integers, uint64 with 32 random bits."""
    return hash2(hash2(a, b), c)


@inner
def uniform(h):
    """Float32 in 0..1 (1 excluded) from a hash."""
    return np.float32(np.float32((np.uint64(h) & _MASK) >> _S8) * _UNIT)


@inner
def bilinear(values, column, row):
    """Value of a 2-D array between its samples; positions outside are clamped to the border."""
    rows, columns = values.shape
    c = min(max(column, np.float32(0)), np.float32(columns - 1.001))
    r = min(max(row, np.float32(0)), np.float32(rows - 1.001))
    i, j = int(r), int(c)
    v, u = np.float32(r - i), np.float32(c - j)
    top = values[i, j] + u * (values[i, j + 1] - values[i, j])
    low = values[i + 1, j] + u * (values[i + 1, j + 1] - values[i + 1, j])
    return np.float32(top + v * (low - top))


@dataclass(frozen=True)
class Motion:
    """How a field drifts and changes until the moment that is asked for."""

    velocity: tuple[float, float]
    """Drift in x and y, m/s."""
    lifetime: float
    """In the drifting frame the correlation falls to 0.61 within this time, s."""
    seconds: float
    """The moment, s."""


def gaussian_field(
    x: np.ndarray,
    y: np.ndarray,
    correlation_length: float,
    generator: np.random.Generator,
    *,
    modes: int = 96,
    motion: Motion | None = None,
) -> np.ndarray:
    """Random field with mean 0, variance 1 and correlation ``exp(-d^2 / (2 L^2))``.

    A sum of cosines with normally distributed wave vectors (spectral method): it has no cell, no
    border and no period, so that any part of the plane can be asked for separately.

    Parameters
    ----------
    x, y
        Positions (...), metres; arrays that broadcast against each other.
    correlation_length
        L, metres: the correlation falls to 0.61 at this distance.
    generator
        Source of the wave vectors and phases.
    modes
        Number of cosines.
    motion
        Drift and change with time; None for a field that stands still.

    Returns
    -------
    ndarray
        Float64 of the broadcast shape.
    """
    waves = generator.normal(0.0, 1.0 / correlation_length, (modes, 2))
    phases = generator.uniform(0.0, 2 * np.pi, modes)
    if motion is not None:
        rates = generator.normal(0.0, 1.0 / motion.lifetime, modes) - waves @ np.array(motion.velocity)
        phases = (phases + rates * motion.seconds) % (2 * np.pi)
    total = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))
    for (kx, ky), phase in zip(waves, phases, strict=True):
        # cos(a + b) from the factors of a and b: on a grid x and y stay one-dimensional.
        a, b = kx * x + phase, ky * y
        total += np.cos(a) * np.cos(b) - np.sin(a) * np.sin(b)
    return total * np.sqrt(2 / modes)


def fractal_field(
    x: np.ndarray,
    y: np.ndarray,
    longest: float,
    shortest: float,
    generator: np.random.Generator,
    *,
    gain: float = 0.5,
) -> np.ndarray:
    """Sum of Gaussian fields whose correlation length halves from octave to octave; variance 1."""
    total = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))
    length, amplitude, variance = longest, 1.0, 0.0
    while length >= shortest or variance == 0.0:
        total += amplitude * gaussian_field(x, y, length, generator, modes=48)
        variance += amplitude**2
        length, amplitude = length / 2, amplitude * gain
    return total / np.sqrt(variance)
