"""The surface that is searched: cut with the mask and averaged to the working resolution, tile by tile."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import dask
import numpy as np
import xarray as xr
from scipy import ndimage

from workbench.compiled import compiled
from workbench.rasters import Grid, Tile, tiles
from workbench.trees.maxima import MISSING

_TRUNCATE = 3.0  # Standard deviations of a Gaussian that count.


@dataclass(frozen=True)
class WorkingGrid:
    """Cells of the source put together in squares of ``factor``; the last row and column may be partial."""

    source: Grid
    """Grid of the surface."""
    factor: int
    """Source cells along the edge of a working cell."""

    @classmethod
    def of(cls, source: Grid, resolution: float | None) -> WorkingGrid:
        """Working grid nearest to a resolution in metres; never finer than the source."""
        factor = 1 if resolution is None else max(round(resolution / source.resolution), 1)
        return cls(source, factor)

    @property
    def resolution(self) -> float:
        """Edge of a working cell, metres."""
        return self.source.resolution * self.factor

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of working cells."""
        return -(-self.source.height // self.factor), -(-self.source.width // self.factor)

    def tiles(self, size: int, margin: int) -> list[Tile]:
        """Tiles of working cells."""
        return list(tiles(self.shape, size=max(size, margin), margin=margin))

    @property
    def grid(self) -> Grid:
        """The working cells as a grid; partial cells count as whole ones."""
        source = self.source
        rows, columns = self.shape
        return Grid(source.crs, source.west, source.north, self.resolution, columns, rows)

    def average(self, values: np.ndarray) -> np.ndarray:
        """Mean (float32) of the finite source cells in each working cell, NaN where there is none."""
        values = values.astype(np.float32, copy=False)
        if self.factor == 1:
            return values
        mean = _block_mean(np.where(np.isfinite(values), values, MISSING), self.factor)
        return np.where(mean > MISSING, mean, np.float32(np.nan))

    def centres(self, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """x and y of the centres of working cells."""
        return (
            self.source.west + (columns + 0.5) * self.resolution,
            self.source.north - (rows + 0.5) * self.resolution,
        )

    def window(self, part: tuple[slice, slice]) -> tuple[slice, slice]:
        """Source rows and columns of a part of the working grid."""
        rows, columns = (
            slice(s.start * self.factor, min(s.stop * self.factor, limit))
            for s, limit in zip(part, self.source.shape, strict=True)
        )
        return rows, columns


@dataclass(frozen=True, eq=False)
class Part:
    """A part of the surface, ready to be searched; :data:`MISSING` where there is no tree."""

    work: np.ndarray
    """Surface on working cells, float32."""
    work_height: np.ndarray
    """Height above ground on working cells."""
    surface: np.ndarray
    """Surface on source cells."""
    height: np.ndarray
    """Height above ground on source cells."""

    def apexes(self, rows: np.ndarray, columns: np.ndarray, factor: int) -> tuple[np.ndarray, np.ndarray]:
        """Row and column of the highest source cell in working cells; of equals the northern, western."""
        if factor == 1:
            return rows, columns
        return _highest_within(self.surface, rows, columns, factor)

    def smoothed(self, sigma: float) -> Part:
        """With the working cells averaged by a Gaussian of a standard deviation in cells; 0 none."""
        if sigma == 0:
            return self
        work = _gaussian(self.work, sigma)
        height = work if self.work_height is self.work else _gaussian(self.work_height, sigma)
        return replace(self, work=work, work_height=height)


def reach_of_gaussian(sigma: float) -> int:
    """Cells that a Gaussian of a standard deviation in cells looks at around a cell."""
    return math.ceil(_TRUNCATE * sigma)


def _gaussian(values: np.ndarray, sigma: float) -> np.ndarray:
    """Weighted mean of the cells that are there; missing ones stay missing."""
    known = values > MISSING
    radius = reach_of_gaussian(sigma)
    weights, total = (
        ndimage.gaussian_filter(part, sigma, mode="constant", radius=radius)
        for part in (known.astype(np.float64), np.where(known, values, 0.0).astype(np.float64))
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(known, total / weights, MISSING).astype(np.float32)


@dataclass(frozen=True, eq=False)
class CutSurface:
    """Step 1 of the search: what of a surface may be a tree."""

    surface: xr.DataArray
    """Heights, metres."""
    mask: xr.DataArray | None
    """Where trees may be."""
    terrain: xr.DataArray | None
    """Ground; None where the surface is above ground already."""
    min_height: float
    """Least height above ground, metres."""
    grid: WorkingGrid
    """Working cells."""

    def load(self, part: tuple[slice, slice]) -> Part:
        """Values of a part of the working grid."""
        rows, columns = self.grid.window(part)
        window = {"y": rows, "x": columns}
        surface = self.surface.isel(window).values.astype(np.float32, copy=False)
        mask = np.ones((1, 1), np.bool_) if self.mask is None else self.mask.isel(window).values == 1
        if self.terrain is None:
            cut = _cut(surface, surface, mask, self.min_height)
            work = _average(cut, self.grid.factor)
            return Part(work, work, cut, cut)
        above = surface - self.terrain.isel(window).values.astype(np.float32, copy=False)
        cut = _cut(surface, above, mask, self.min_height)
        height = _cut(above, above, mask, self.min_height)
        factor = self.grid.factor
        return Part(_average(cut, factor), _average(height, factor), cut, height)

    def highest(self, tile_size: int) -> float:
        """Largest height above ground of what was cut out, metres; 0 where nothing was."""
        size = max(tile_size // self.grid.factor, 1)
        parts = dask.compute(*[dask.delayed(self._highest_in)(tile) for tile in self.grid.tiles(size, 0)])
        return max((float(part) for part in parts), default=0.0)

    def _highest_in(self, tile: Tile) -> float:
        height = self.load(tile.core).height
        return max(float(height.max()), 0.0)


@compiled(nogil=True)
def _cut(values: np.ndarray, above: np.ndarray, mask: np.ndarray, least: float) -> np.ndarray:
    """Values where the height is enough (NaN and infinity are not) and the mask true; else missing."""
    rows, columns = values.shape
    everywhere = mask.shape != values.shape
    result = np.empty(values.shape, np.float32)
    for i in range(rows):
        for j in range(columns):
            good = above[i, j] >= least and above[i, j] < np.inf and (everywhere or mask[i, j])
            result[i, j] = values[i, j] if good else MISSING
    return result


def _average(values: np.ndarray, factor: int) -> np.ndarray:
    return values if factor == 1 else _block_mean(values, factor)


@compiled(nogil=True)
def _block_mean(values: np.ndarray, factor: int) -> np.ndarray:
    """Mean of the cells that are there, in squares of ``factor`` cells."""
    rows, columns = values.shape
    shape = (rows + factor - 1) // factor, (columns + factor - 1) // factor
    result = np.empty(shape, np.float32)
    for i in range(shape[0]):
        for j in range(shape[1]):
            total, n = 0.0, 0
            for y in range(i * factor, min((i + 1) * factor, rows)):
                for x in range(j * factor, min((j + 1) * factor, columns)):
                    if values[y, x] > MISSING:
                        total += values[y, x]
                        n += 1
            result[i, j] = total / n if n else MISSING
    return result


@compiled(nogil=True)
def _highest_within(
    values: np.ndarray, rows: np.ndarray, columns: np.ndarray, factor: int
) -> tuple[np.ndarray, np.ndarray]:
    top_rows, top_columns = np.empty_like(rows), np.empty_like(columns)
    for n in range(len(rows)):
        best = MISSING
        for y in range(rows[n] * factor, min((rows[n] + 1) * factor, values.shape[0])):
            for x in range(columns[n] * factor, min((columns[n] + 1) * factor, values.shape[1])):
                if values[y, x] > best:
                    best, top_rows[n], top_columns[n] = values[y, x], y, x
    return top_rows, top_columns
