"""Wind: how far crowns and reed are bent at the moment of an exposure.

Displacement of a leaf at height z of a plant of height H:

    gust(x, y) * amplitude * (z / H)^1.5 + sway(plant) * (z / H)^1.5 + jitter(leaf)

The gust field has two components (east, north), each a sum of two Gaussian fields of 25 m (60 % of the
variance) and 9 m (40 %) correlation length. It goes on from exposure to exposure: eddies drift with the
mean wind (Taylor's frozen turbulence) and live about as long as they take to turn over. Each tree also
swings at its natural frequency, in a narrow band around it. Leaves flutter too fast to be followed: every
exposure draws them anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from workbench.errors import SceneError
from workbench.virtual.compiled import inner, kernel
from workbench.virtual.noise import Motion, bilinear, gaussian_field, hash2, hash3, uniform

REFERENCE_SPEED = 4.0
"""Wind speed, m/s, at which the amplitudes hold; drag and with it displacement grow with its square."""
TURBULENCE = 0.4
"""Standard deviation of the wind over its mean above a canopy: an eddy of size L lives L / (0.4 speed)."""
_RASTER_STEP = 2.0
_LARGE_SHARE = 0.6
_FREQUENCY = np.float32(6.5)  # Hz m: a tree of 25 m swings at 0.26 Hz, the measured order for conifers.
_BAND = np.float32(0.1)  # Relative width of the band of frequencies: damping of about 10 %.


@dataclass(frozen=True)
class Wind:
    """Strength and pattern of the wind."""

    speed: float = REFERENCE_SPEED
    """Mean speed, m/s; 0 freezes leaves, crowns, reed and ripples."""
    direction: float = 250.0
    """Where the wind comes from, degrees clockwise from grid north; the prevailing one of central Europe."""
    crown_amplitude: float = 0.30
    """Standard deviation of the gust displacement at the tree top in x and in y, m, at 4 m/s."""
    sway_amplitude: float = 0.10
    """Standard deviation of the sway of each tree for itself, m, at 4 m/s."""
    reed_amplitude: float = 0.15
    """Standard deviation of the gust displacement at the top of a reed stem, m, at 4 m/s."""
    leaf_amplitude: float = 0.05
    """Half range of the jitter of a leaf, m, at 4 m/s."""
    flutter: float = 0.3
    """Half range of the brightness of a turning leaf, as a share, at 4 m/s."""
    large_correlation: float = 25.0
    """Correlation length of the large gusts, m."""
    small_correlation: float = 9.0
    """Correlation length of the small gusts, m."""
    seed: int = 0
    """Another seed is another afternoon of the same wind."""

    def __post_init__(self) -> None:
        lengths = min(self.large_correlation, self.small_correlation)
        amplitudes = (
            self.speed,
            self.crown_amplitude,
            self.sway_amplitude,
            self.reed_amplitude,
            self.leaf_amplitude,
            self.flutter,
        )
        if min(amplitudes) < 0 or not lengths > 0:
            raise SceneError(
                "Wind with a negative speed or amplitude, or without correlation length, is impossible: "
                f"{self}."
            )

    @classmethod
    def calm(cls) -> Wind:
        """No wind: every exposure sees the same scene."""
        return cls(speed=0.0)

    @property
    def bend(self) -> float:
        """Factor on displacements: 1 at 4 m/s, growing with the square of the speed."""
        return (self.speed / REFERENCE_SPEED) ** 2

    @property
    def velocity(self) -> tuple[float, float]:
        """With which eddies drift, east and north, m/s."""
        towards = math.radians(self.direction + 180)
        return self.speed * math.sin(towards), self.speed * math.cos(towards)


class WindField(NamedTuple):
    """One exposure's wind in the form that compiled loops read."""

    east: np.ndarray
    """(rows, columns) float32, gusts to the east, standard deviation 1; rows run north."""
    north: np.ndarray
    """The same to the north."""
    west: np.float32
    """x of the first column, m."""
    south: np.float32
    """y of the first row, m."""
    step: np.float32
    """Spacing of the samples, m."""
    crown: np.float32
    """Gust displacement at a tree top, m."""
    sway: np.float32
    """Sway of a tree of its own, m."""
    reed: np.float32
    """Gust displacement at a stem top, m."""
    leaf: np.float32
    """Half range of leaf jitter, m."""
    flutter: np.float32
    """Half range of leaf brightness, share."""
    seed: np.uint64
    """Number of the exposure, mixed with the seed of the wind; 0 in calm air."""
    plants: np.uint64
    """Seed of the sway of trees, the same in all exposures."""
    seconds: float
    """Moment of the exposure."""


def wind_field(
    wind: Wind, exposure: int, bounds: tuple[float, float, float, float], *, seconds: float = 0.0
) -> WindField:
    """Wind at one exposure over (west, south, east, north), metres in scene coordinates.

    The field at a place does not depend on the bounds. ``seconds`` is the moment, counted from any
    fixed one: gusts and sway of two exposures are as similar as the time between them says.
    """
    west, south, east, north = bounds
    x, y = _samples(west, east), _samples(south, north)
    bend = wind.bend
    if wind.speed == 0:
        still = np.zeros((2, 2), dtype=np.float32)
        gusts, seed = [still, still], 0
    else:
        generator = np.random.default_rng([wind.seed, 0x5EED])
        gusts = [_gusts(wind, x, y, seconds, generator) for _ in range(2)]
        seed = 1 + (wind.seed * 1_000_003 + exposure) % 2**31
    return WindField(
        gusts[0],
        gusts[1],
        np.float32(x[0]),
        np.float32(y[0]),
        np.float32(_RASTER_STEP),
        np.float32(wind.crown_amplitude * bend),
        np.float32(wind.sway_amplitude * bend),
        np.float32(wind.reed_amplitude * bend),
        np.float32(wind.leaf_amplitude * wind.speed / REFERENCE_SPEED),
        np.float32(wind.flutter * min(wind.speed / REFERENCE_SPEED, 1.0)),
        np.uint64(seed),
        np.uint64(wind.seed % 2**31),
        float(seconds),
    )


def displacement(
    wind: Wind,
    seconds: float,
    x: np.ndarray,
    y: np.ndarray,
    height: np.ndarray,
    plant_height: float,
) -> np.ndarray:
    """Gust displacement (n, 2), m east and north, of points at a height above the foot of their tree."""
    field = wind_field(wind, 0, (np.min(x), np.min(y), np.max(x), np.max(y)), seconds=seconds)
    lift = (np.clip(height / plant_height, 0, 1)) ** 1.5 * float(field.crown)
    columns = (np.asarray(x) - field.west) / field.step
    rows = (np.asarray(y) - field.south) / field.step
    east = _sample(field.east, columns, rows)
    north = _sample(field.north, columns, rows)
    return np.stack([east * lift, north * lift], axis=-1)


@inner
def gust(field, x, y):
    """Gusts (east, north) at a place, standard deviation 1."""
    column = (x - field.west) / field.step
    row = (y - field.south) / field.step
    return bilinear(field.east, column, row), bilinear(field.north, column, row)


@inner
def own_sway(field, plant, height):
    """Sway (east, north) of one tree at its top, m: three oscillations near its natural frequency."""
    natural = np.float64(_FREQUENCY / max(height, np.float32(1)))
    east, north = np.float32(0), np.float32(0)
    for k in range(3):
        h = hash3(field.plants, plant, 11 + k)
        detune = uniform(h) + uniform(hash2(h, 1)) + uniform(hash2(h, 2)) - np.float32(1.5)
        cycles = natural * (1 + 2 * _BAND * detune) * field.seconds
        part = np.float32(cycles - math.floor(cycles))
        east += math.cos(np.float32(2 * math.pi) * (part + uniform(hash2(h, 3))))
        north += math.cos(np.float32(2 * math.pi) * (part + uniform(hash2(h, 4))))
    scale = field.sway * np.float32(math.sqrt(2 / 3))
    return scale * east, scale * north


def _samples(low: float, high: float) -> np.ndarray:
    """Whole multiples of the raster step around an interval."""
    return np.arange(np.floor(low / _RASTER_STEP), np.ceil(high / _RASTER_STEP) + 2) * _RASTER_STEP


def _gusts(
    wind: Wind, x: np.ndarray, y: np.ndarray, seconds: float, generator: np.random.Generator
) -> np.ndarray:
    large, small = (
        gaussian_field(
            x[None, :],
            y[:, None],
            length,
            generator,
            motion=Motion(wind.velocity, length / (TURBULENCE * wind.speed), seconds),
        )
        for length in (wind.large_correlation, wind.small_correlation)
    )
    return (math.sqrt(_LARGE_SHARE) * large + math.sqrt(1 - _LARGE_SHARE) * small).astype(np.float32)


@kernel
def _sample(values, columns, rows):
    result = np.empty(columns.size)
    for i in range(columns.size):
        result[i] = bilinear(values, np.float32(columns.flat[i]), np.float32(rows.flat[i]))
    return result.reshape(columns.shape)
