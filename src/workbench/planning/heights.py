"""Altitudes of a flight over a surface."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
import xarray as xr
from scipy import ndimage

from workbench.errors import PlanningError
from workbench.rasters import Grid

_CELLS = 2000  # Along the longer side of what is kept in memory: far finer than a flight can follow.
_SAMPLE = 0.25  # Of the base: distance of the heights along a line.


@dataclass(frozen=True, eq=False)
class Relief:
    """What is flown over: heights on a grid, or a plane."""

    heights: np.ndarray
    """(rows, columns) float64, m; the highest of each cell."""
    west: float
    north: float
    cell: float

    @classmethod
    def of(cls, surface: xr.DataArray, around: tuple[float, float, float, float]) -> Relief:
        """The part of a surface within bounds (west, south, east, north).

        Raises
        ------
        PlanningError
            If the surface does not reach there.
        """
        grid = Grid.of(surface)
        west, south, east, north = around
        columns = slice(
            max(math.floor((west - grid.west) / grid.resolution), 0),
            min(math.ceil((east - grid.west) / grid.resolution), grid.width),
        )
        rows = slice(
            max(math.floor((grid.north - north) / grid.resolution), 0),
            min(math.ceil((grid.north - south) / grid.resolution), grid.height),
        )
        if rows.start >= rows.stop or columns.start >= columns.stop:
            raise PlanningError(
                f"The surface ({grid.west:.0f}..{grid.west + grid.width * grid.resolution:.0f} east, up to "
                f"{grid.north:.0f} north) does not meet the area: another CRS or another place?"
            )
        values = np.asarray(surface[rows, columns].values, dtype=np.float64)
        step = max(math.ceil(max(values.shape) / _CELLS), 1)
        if step > 1:
            padded = np.pad(values, [(0, -n % step) for n in values.shape], constant_values=np.nan)
            filled = np.where(np.isfinite(padded), padded, -np.inf)
            blocks = filled.reshape(padded.shape[0] // step, step, padded.shape[1] // step, step)
            values = blocks.max(axis=(1, 3))
        return cls(
            np.where(np.isfinite(values), values, np.nan),
            grid.west + columns.start * grid.resolution,
            grid.north - rows.start * grid.resolution,
            grid.resolution * step,
        )

    @classmethod
    def flat(cls, height: float = 0.0) -> Relief:
        """A plane."""
        return cls(np.full((1, 1), height), 0.0, 0.0, math.inf)

    def at(self, places: np.ndarray) -> np.ndarray:
        """Heights (n,) at places (n, 2); NaN outside and in holes."""
        if math.isinf(self.cell):
            return np.full(len(places), self.heights[0, 0])
        columns = np.floor((places[:, 0] - self.west) / self.cell).astype(int)
        rows = np.floor((self.north - places[:, 1]) / self.cell).astype(int)
        inside = (rows >= 0) & (columns >= 0) & (rows < self.heights.shape[0])
        inside &= columns < self.heights.shape[1]
        found = np.full(len(places), np.nan)
        found[inside] = self.heights[rows[inside], columns[inside]]
        return found

    def highest_within(self, radius: float) -> Relief:
        """The highest of the surroundings of each cell; holes are taken for as high as what is around."""
        if math.isinf(self.cell):
            return self
        size = 2 * math.ceil(radius / self.cell) + 1
        known = np.where(np.isfinite(self.heights), self.heights, -np.inf)
        top = ndimage.maximum_filter(known, size=size, mode="nearest")
        return Relief(np.where(np.isfinite(top), top, np.nan), self.west, self.north, self.cell)

    def highest_along(self, way: np.ndarray) -> float:
        """Highest place below a way (n, 2)."""
        line = shapely.LineString(way)
        step = 10.0 if math.isinf(self.cell) else self.cell
        steps = np.linspace(0, line.length, max(math.ceil(line.length / step), 1) + 1)
        heights = self.at(shapely.get_coordinates(shapely.line_interpolate_point(line, steps)))
        return float(np.nanmax(heights)) if np.isfinite(heights).any() else math.nan


def follow(line: np.ndarray, relief: Relief, height: float, slope: float, tolerance: float) -> np.ndarray:
    """Way along a line at least ``height`` above the relief, no steeper than ``slope``.

    Parameters
    ----------
    line
        Releases (n, 2).
    relief
        Highest surroundings.
    height
        Above it, m.
    slope
        Steepest climb or descent, height over way.
    tolerance
        The way is reduced to corners from which it departs upwards by no more than this, m.

    Returns
    -------
    ndarray (m, 3)
        Corners with altitude, from the first to the last release.

    Raises
    ------
    PlanningError
        If the surface does not cover the line.
    """
    base = float(np.hypot(*(line[1] - line[0])))
    number = math.ceil((len(line) - 1) / _SAMPLE) + 1
    share = np.linspace(0, 1, number)[:, None]
    places = line[0] + share * (line[-1] - line[0])
    ground = relief.at(places)
    if not np.isfinite(ground).all():
        x, y = places[~np.isfinite(ground)][0]
        raise PlanningError(
            f"The surface has no height at {x:.0f} east, {y:.0f} north, below a flight line: lines reach a "
            f"base ({base:.0f} m) beyond the area. Give a surface that covers them."
        )
    altitude = ground + height
    rise = slope * base * (len(line) - 1) / (number - 1)
    for order in (range(1, number), range(number - 2, -1, -1)):
        back = -1 if order.step > 0 else 1
        for i in order:
            altitude[i] = max(altitude[i], altitude[i + back] - rise)
    way = np.stack([np.linspace(0, base * (len(line) - 1), number), altitude], axis=1)
    # Simplified by at most half the tolerance, then lifted by as much: never lower than asked for.
    half = tolerance / 2
    corners = shapely.get_coordinates(shapely.simplify(shapely.LineString(way), half / math.hypot(1, slope)))
    if np.ptp(altitude) > 0:
        corners[:, 1] += half
    part = corners[:, :1] / (base * (len(line) - 1))
    return np.concatenate([line[0] + part * (line[-1] - line[0]), corners[:, 1:]], axis=1)
