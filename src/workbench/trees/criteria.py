"""Criteria of region growing, as values: when a crown may take the next cell [thesis 3.3.3].

Two kinds. A *step* criterion looks at the cell that a crown grows from and the cell it grows to; it
answers for all cells at once with eight bits, one a neighbour. A *reach* criterion looks at the top
as well; it is a number that the growing kernel knows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from workbench.compiled import compiled
from workbench.errors import TreesError
from workbench.params import TreesParameters

_DEFAULTS = TreesParameters()
DIRECTIONS = np.array([(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)], np.int64)
"""Row and column steps to the eight neighbours; bit k of a step raster is direction k."""
SECTORS = 16
"""Directions in which aspect is told apart [thesis 3.3]."""


@dataclass(frozen=True, eq=False)
class Ground:
    """What criteria may look at, on one part of the raster."""

    surface: np.ndarray
    """Heights above ground as they are, float32, NaN missing."""
    smooth: np.ndarray
    """The same after the bilateral filter: for slope and aspect."""
    layers: dict[str, np.ndarray]
    """Other rasters by the name that a criterion asked for."""
    cell: float
    """Edge of a cell, metres."""


class StepCriterion(Protocol):
    """A criterion on two neighbouring cells."""

    def steps(self, ground: Ground) -> np.ndarray:
        """Steps (rows, columns) uint8 that are allowed from each cell."""
        ...


@dataclass(frozen=True)
class Slope:
    """The smoothed surface falls within limits from one cell to the next."""

    smallest: float
    """Degrees, downward positive; -90 is no limit."""
    largest: float
    """Degrees; 90 is no limit."""

    def __post_init__(self) -> None:
        if not -90 <= self.smallest < self.largest <= 90:
            raise TreesError(f"Slopes from {self.smallest} to {self.largest} degrees allow nothing.")

    def steps(self, ground: Ground) -> np.ndarray:
        """See :class:`StepCriterion`."""
        # A vertical limit is none: its tangent is infinite but for rounding.
        low = -np.inf if self.smallest == -90 else np.tan(np.radians(self.smallest)) * ground.cell
        high = np.inf if self.largest == 90 else np.tan(np.radians(self.largest)) * ground.cell
        return _falls_within(ground.smooth, low, high)


@dataclass(frozen=True)
class Change:
    """A layer (NDVI, GLI) changes little from one cell to the next."""

    layer: str
    """Name under which the raster is given."""
    largest: float
    """Largest absolute difference."""

    def steps(self, ground: Ground) -> np.ndarray:
        """See :class:`StepCriterion`."""
        return _changes_at_most(ground.layers[self.layer].astype(np.float32), self.largest)


@dataclass(frozen=True)
class AtLeast:
    """A layer (brightness, index, height) reaches a value in the next cell."""

    layer: str
    """Name under which the raster is given."""
    least: float
    """Least value."""

    def steps(self, ground: Ground) -> np.ndarray:
        """See :class:`StepCriterion`."""
        return steps_into(ground.layers[self.layer] >= self.least)


@dataclass(frozen=True)
class Reach:
    """Limits that depend on the top. A text names a column of the tops that holds a value for each."""

    radius: float | str = _DEFAULTS.max_diameter / 2
    """Largest distance from the top, metres."""
    share: float | str = _DEFAULTS.crown_min_share
    """A cell has at least this share of the height of the top; 0 switches it off."""
    aspect: int | str = -1
    """Largest difference, in sixteenths of a turn, between the aspect of the smoothed surface and the
    direction away from the top; -1 switches it off. The cells beside the top are free."""
    area: float | None = None
    """Largest area, square metres: of larger crowns the cells nearest to the top stay."""
    winding: float = _DEFAULTS.crown_winding
    """Ways from the top may be this much longer than the radius, in steps: they bend but do not wander."""


@compiled(nogil=True)
def _falls_within(smooth: np.ndarray, low: float, high: float) -> np.ndarray:
    rows, columns = smooth.shape
    result = np.zeros(smooth.shape, np.uint8)
    for i in range(rows):
        for j in range(columns):
            bits = 0
            for k in range(8):
                y, x = i + DIRECTIONS[k, 0], j + DIRECTIONS[k, 1]
                if y < 0 or y >= rows or x < 0 or x >= columns:
                    continue
                fall = smooth[i, j] - smooth[y, x]
                far = np.sqrt(2.0) if DIRECTIONS[k, 0] != 0 and DIRECTIONS[k, 1] != 0 else 1.0
                if fall >= low * far and fall <= high * far:
                    bits |= 1 << k
            result[i, j] = bits
    return result


@compiled(nogil=True)
def _changes_at_most(layer: np.ndarray, largest: float) -> np.ndarray:
    rows, columns = layer.shape
    result = np.zeros(layer.shape, np.uint8)
    for i in range(rows):
        for j in range(columns):
            bits = 0
            for k in range(8):
                y, x = i + DIRECTIONS[k, 0], j + DIRECTIONS[k, 1]
                if y < 0 or y >= rows or x < 0 or x >= columns:
                    continue
                if abs(layer[i, j] - layer[y, x]) <= largest:
                    bits |= 1 << k
            result[i, j] = bits
    return result


@compiled(nogil=True)
def steps_into(good: np.ndarray) -> np.ndarray:
    """Steps (rows, columns) uint8 that end in a good cell."""
    rows, columns = good.shape
    result = np.zeros(good.shape, np.uint8)
    for i in range(rows):
        for j in range(columns):
            bits = 0
            for k in range(8):
                y, x = i + DIRECTIONS[k, 0], j + DIRECTIONS[k, 1]
                if 0 <= y < rows and 0 <= x < columns and good[y, x]:
                    bits |= 1 << k
            result[i, j] = bits
    return result


def aspect_sectors(smooth: np.ndarray) -> np.ndarray:
    """Direction in which a surface falls steepest: uint8, 0 north, clockwise in sixteenths; 255 level."""
    down, right = np.gradient(smooth.astype(np.float32))
    azimuth = np.arctan2(-right, down)
    sectors = np.mod(np.round(azimuth / (2 * np.pi / SECTORS)), SECTORS)
    level = ~np.isfinite(sectors) | ((down == 0) & (right == 0))
    return np.where(level, 255, np.nan_to_num(sectors)).astype(np.uint8)


def combined(criteria: Sequence[StepCriterion], ground: Ground) -> np.ndarray:
    """Steps that all criteria and the edge of what is known allow."""
    steps = steps_into(np.isfinite(ground.surface))
    for criterion in criteria:
        steps &= criterion.steps(ground)
    return steps
