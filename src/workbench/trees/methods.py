"""Ways to find crowns, as values behind one interface: region growing, watershed, Dalponte & Coomes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from skimage.segmentation import watershed

from workbench.compiled import compiled
from workbench.errors import TreesError
from workbench.params import TreesParameters
from workbench.trees.criteria import Ground, Reach, Slope, StepCriterion, aspect_sectors, combined
from workbench.trees.growing import grow

_DEFAULTS = TreesParameters()


@dataclass(frozen=True, eq=False)
class Tops:
    """Tops as the methods see them, on one part of the raster."""

    rows: np.ndarray
    """(n,) row of each top."""
    columns: np.ndarray
    """(n,) column of each top."""
    heights: np.ndarray
    """(n,) heights above ground, metres."""
    ranks: np.ndarray
    """(n,) order of preference over the whole raster: the higher, northern, western first."""
    values: dict[str, np.ndarray]
    """Columns of the table of tops that the method asked for."""

    def value(self, given: float | str) -> np.ndarray:
        """(n,) values: a column, or one number for all."""
        return self.values[given] if isinstance(given, str) else np.full(len(self.rows), float(given))


class CrownMethod(Protocol):
    """What a way to find crowns answers; any class with these is one."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the tops that it reads."""
        ...

    @property
    def layers(self) -> tuple[str, ...]:
        """Rasters that it reads beside the surface."""
        ...

    @property
    def smooths(self) -> bool:
        """Whether it looks at the smoothed surface."""
        ...

    def margin(self, cell: float, tops_values: dict[str, np.ndarray]) -> int | None:
        """Cells that a crown may depend on around a cell; None: on the whole raster."""
        ...

    def label(self, tops: Tops, ground: Ground) -> np.ndarray:
        """Number of the top of every cell, int32 (rows, columns), -1 none."""
        ...


@dataclass(frozen=True)
class RegionGrowing:
    """Breadth-first growth from all tops at once [thesis 3.3.3], independent of their order."""

    steps: tuple[StepCriterion, ...] = ()
    """Criteria on neighbouring cells; all must hold."""
    reach: Reach = field(default_factory=Reach)
    """Limits that depend on the top."""

    @property
    def columns(self) -> tuple[str, ...]:
        """See :class:`CrownMethod`."""
        given = (self.reach.radius, self.reach.share, self.reach.aspect)
        return tuple(value for value in given if isinstance(value, str))

    @property
    def layers(self) -> tuple[str, ...]:
        """See :class:`CrownMethod`."""
        return tuple(step.layer for step in self.steps if hasattr(step, "layer"))

    @property
    def smooths(self) -> bool:
        """See :class:`CrownMethod`."""
        return self.reach.aspect != -1 or any(isinstance(step, Slope) for step in self.steps)

    def margin(self, cell: float, tops_values: dict[str, np.ndarray]) -> int:
        """See :class:`CrownMethod`."""
        radius = self.reach.radius
        largest = float(np.max(tops_values[radius], initial=0)) if isinstance(radius, str) else radius
        if not (math.isfinite(largest) and largest >= 0):
            raise TreesError(f"A crown radius of {largest} m is impossible: give a finite one.")
        return math.ceil(self.reach.winding * largest / cell) + 1

    def label(self, tops: Tops, ground: Ground) -> np.ndarray:
        """See :class:`CrownMethod`."""
        aspect = tops.value(self.reach.aspect).astype(np.int64)
        radius = tops.value(self.reach.radius) / ground.cell
        return grow(
            combined(self.steps, ground),
            ground.surface,
            aspect_sectors(ground.smooth) if (aspect >= 0).any() else np.zeros((1, 1), np.uint8),
            tops.rows,
            tops.columns,
            tops.ranks,
            radius**2 * (1 + 1e-9),
            (tops.value(self.reach.share) * tops.heights).astype(np.float64),
            aspect,
            self.margin(ground.cell, tops.values) - 1,
        )


@dataclass(frozen=True)
class MarkerWatershed:
    """Watershed of the inverted surface from the tops, as a comparison; it fills the mask."""

    share: float = _DEFAULTS.crown_min_share
    """A cell has at least this share of the height of the top."""
    radius: float = _DEFAULTS.max_diameter / 2
    """Largest distance from the top, metres."""
    columns: tuple[str, ...] = ()
    """See :class:`CrownMethod`."""
    layers: tuple[str, ...] = ()
    """See :class:`CrownMethod`."""
    smooths: bool = False
    """See :class:`CrownMethod`."""

    def margin(self, cell: float, tops_values: dict[str, np.ndarray]) -> None:
        """Floods come from anywhere: the whole raster."""
        return

    def label(self, tops: Tops, ground: Ground) -> np.ndarray:
        """See :class:`CrownMethod`."""
        known = np.isfinite(ground.surface)
        markers = np.zeros(known.shape, np.int32)
        # From the least preferred to the most, so that in a shared cell the preferred one stays.
        for t in np.argsort(-tops.ranks):
            markers[tops.rows[t], tops.columns[t]] = t + 1
        basins = watershed(-np.where(known, ground.surface, 0), markers, mask=known) - 1
        owned = np.flatnonzero(basins.ravel() >= 0)
        t = basins.ravel()[owned]
        rows, columns = np.divmod(owned, known.shape[1])
        far = np.hypot(rows - tops.rows[t], columns - tops.columns[t]) * ground.cell > self.radius
        low = ground.surface.ravel()[owned] < self.share * tops.heights[t]
        basins.ravel()[owned[far | low]] = -1
        return basins.astype(np.int32)


@dataclass(frozen=True)
class Dalponte:
    """Growth of Dalponte & Coomes (2016) over four neighbours, as a comparison."""

    top_share: float = _DEFAULTS.dalponte_top_share
    """A cell is higher than this share of the top."""
    mean_share: float = _DEFAULTS.dalponte_mean_share
    """A cell is higher than this share of the mean of the crown so far."""
    radius: float = _DEFAULTS.max_diameter / 2
    """Largest distance from the top in each axis, metres."""
    columns: tuple[str, ...] = ()
    """See :class:`CrownMethod`."""
    layers: tuple[str, ...] = ()
    """See :class:`CrownMethod`."""
    smooths: bool = False
    """See :class:`CrownMethod`."""

    def margin(self, cell: float, tops_values: dict[str, np.ndarray]) -> None:
        """The mean of a crown depends on all its cells: the whole raster."""
        return

    def label(self, tops: Tops, ground: Ground) -> np.ndarray:
        """See :class:`CrownMethod`."""
        order = np.argsort(tops.ranks)
        owner = _dalponte(
            ground.surface,
            tops.rows[order],
            tops.columns[order],
            tops.heights[order].astype(np.float64),
            self.top_share,
            self.mean_share,
            self.radius / ground.cell,
        )
        return np.where(owner >= 0, order[owner], -1).astype(np.int32)


@compiled(nogil=True)
def _dalponte(
    surface: np.ndarray,
    top_rows: np.ndarray,
    top_columns: np.ndarray,
    heights: np.ndarray,
    top_share: float,
    mean_share: float,
    reach: float,
) -> np.ndarray:
    """Rings in the order of the cells that were taken; the mean is that of the ring before."""
    rows, columns = surface.shape
    owner = np.full((rows, columns), -1, np.int64)
    total, count = heights.copy(), np.ones(len(heights))
    front = np.empty(rows * columns, np.int64)
    first, last = 0, 0
    for t in range(len(top_rows)):
        if owner[top_rows[t], top_columns[t]] < 0:
            owner[top_rows[t], top_columns[t]] = t
            front[last] = top_rows[t] * columns + top_columns[t]
            last += 1
    while first < last:
        ring = last
        mean = total / count
        for n in range(first, ring):
            i, j = front[n] // columns, front[n] % columns
            t = owner[i, j]
            for dy, dx in ((-1, 0), (0, -1), (0, 1), (1, 0)):
                y, x = i + dy, j + dx
                if y < 0 or y >= rows or x < 0 or x >= columns or owner[y, x] >= 0:
                    continue
                z = surface[y, x]
                # Cells a little higher than the top are tolerated, as in the original.
                good = z > top_share * heights[t] and z > mean_share * mean[t] and z <= 1.05 * heights[t]
                if good and abs(y - top_rows[t]) < reach and abs(x - top_columns[t]) < reach:
                    owner[y, x] = t
                    total[t] += z
                    count[t] += 1
                    front[last] = y * columns + x
                    last += 1
        first = ring
    return owner
