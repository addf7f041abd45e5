"""Search windows for tree tops, as values: how far around a cell nothing may be higher."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import geopandas as gpd
import numpy as np
import shapely

from workbench.errors import TreesError
from workbench.params import TreesParameters

_DEFAULTS = TreesParameters()
_SAMPLES = 2001


@runtime_checkable
class Window(Protocol):
    """What a search window answers; any class with these two methods is one."""

    def radii(self, heights: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Radius (n,) in metres of the disc around cells of a height (n,) above ground at places (n,)."""
        ...

    def largest(self, height: float) -> float:
        """Largest radius, metres, for any surface up to a height."""
        ...


@dataclass(frozen=True)
class ConstantWindow:
    """One radius everywhere [thesis 3.3.2]."""

    radius: float
    """Metres."""

    def __post_init__(self) -> None:
        _require_radius(self.radius, "radius")

    def radii(self, heights: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :class:`Window`."""
        return np.full(len(heights), self.radius)

    def largest(self, height: float) -> float:
        """See :class:`Window`."""
        return self.radius


@dataclass(frozen=True)
class GrowingWindow:
    """Radius that grows with height: ``start + growth * height``, within ``smallest`` and ``limit``."""

    start: float = _DEFAULTS.window_start
    """Radius at height zero, metres; may be negative."""
    growth: float = _DEFAULTS.window_growth
    """Metres of radius per metre of height."""
    smallest: float = _DEFAULTS.window_smallest
    """Smallest radius, metres."""
    limit: float = _DEFAULTS.window_largest
    """Largest radius, metres."""

    def __post_init__(self) -> None:
        _require_radius(self.smallest, "smallest radius")
        _require_radius(self.limit, "limit")
        if self.growth < 0 or self.smallest > self.limit:
            raise TreesError(
                f"A window of {self.start} m + {self.growth} x height within {self.smallest} and "
                f"{self.limit} m does not grow: give growth >= 0 and smallest <= limit."
            )

    def radii(self, heights: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :class:`Window`."""
        grown = self.start + self.growth * np.asarray(heights, np.float64)
        return np.clip(grown, self.smallest, self.limit)

    def largest(self, height: float) -> float:
        """See :class:`Window`."""
        return float(np.clip(self.start + self.growth * max(height, 0.0), self.smallest, self.limit))


@dataclass(frozen=True)
class CombinedWindow:
    """Several radii for mixed stands: each from its height on, as the thesis runs several discs [3.3.2].

    Running two discs over the same cells and keeping the tops of both adds nothing (every top of the
    larger disc is one of the smaller), so that the discs must share the trees out: by their height.
    """

    radii_m: tuple[float, ...]
    """Radii, metres, from the smallest trees to the tallest."""
    from_heights: tuple[float, ...]
    """Height from which each radius holds, rising; the first one also holds below, metres."""

    def __post_init__(self) -> None:
        if not self.radii_m or len(self.radii_m) != len(self.from_heights):
            raise TreesError(
                f"{len(self.radii_m)} radii need as many heights, not {len(self.from_heights)}: one for each."
            )
        for radius in self.radii_m:
            _require_radius(radius, "radius")
        if list(self.from_heights) != sorted(set(self.from_heights)):
            raise TreesError(f"Heights {self.from_heights} must rise.")

    def radii(self, heights: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :class:`Window`."""
        place = np.searchsorted(np.asarray(self.from_heights), heights, side="right") - 1
        return np.asarray(self.radii_m)[np.maximum(place, 0)]

    def largest(self, height: float) -> float:
        """See :class:`Window`."""
        return max(self.radii_m)


@dataclass(frozen=True)
class FunctionWindow:
    """Radius as any function of the height above ground, vectorised over heights."""

    function: Callable[[np.ndarray], np.ndarray]
    """From heights (n,) in metres to radii (n,) in metres."""

    def radii(self, heights: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :class:`Window`."""
        values = np.broadcast_to(np.asarray(self.function(heights), dtype=np.float64), heights.shape)
        if not np.all(np.isfinite(values)) or np.any(values <= 0):
            raise TreesError("The window function gives radii that are not positive: check its formula.")
        return values

    def largest(self, height: float) -> float:
        """See :class:`Window`; a steep function is sampled, with a margin of a twentieth."""
        samples = np.linspace(0.0, max(height, 0.0), _SAMPLES)[1:] if height > 0 else np.array([1.0])
        return 1.05 * float(np.max(self.radii(samples, samples, samples)))


@dataclass(frozen=True)
class StandWindow:
    """A window per stand type, by polygons; cells in no polygon take the window ``otherwise``."""

    stands: gpd.GeoDataFrame
    """Polygons with a column ``stand_type``, in the CRS of the surface."""
    windows: dict[str, Window]
    """Window of each stand type."""
    otherwise: Window
    """Window outside all stands, and of types without one."""

    def radii(self, heights: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :class:`Window`."""
        result = np.asarray(self.otherwise.radii(heights, x, y), dtype=np.float64).copy()
        for name, window in self.windows.items():
            area = self.stands.geometry[self.stands["stand_type"] == name].union_all()
            shapely.prepare(area)
            inside = shapely.intersects_xy(area, x, y)
            result[inside] = window.radii(heights[inside], x[inside], y[inside])
        return result

    def largest(self, height: float) -> float:
        """See :class:`Window`."""
        return max(window.largest(height) for window in (*self.windows.values(), self.otherwise))


def as_window(radius: float | Callable | Window | None, cell: float = 0.0) -> Window:
    """Window of what a user may give: metres, a function of height, a window, or nothing (growing).

    The window that nobody asked for looks at least at the eight neighbours, whatever the ``cell``
    (metres); one that was asked for is taken as it is.

    Raises
    ------
    TreesError
        If it is none of these.
    """
    if radius is None:
        smallest = max(_DEFAULTS.window_smallest, math.sqrt(2.0) * cell)
        return GrowingWindow(smallest=smallest, limit=max(_DEFAULTS.window_largest, smallest))
    if isinstance(radius, int | float | np.integer | np.floating):
        return ConstantWindow(float(radius))
    if isinstance(radius, Window):
        return radius
    if callable(radius):
        return FunctionWindow(radius)
    raise TreesError(f"{radius!r} is no search window: give metres, a function of height, or a Window.")


def _require_radius(radius: float, name: str) -> None:
    if not (np.isfinite(radius) and radius > 0):
        raise TreesError(f"A {name} of {radius} m holds no cell: give a positive radius.")
