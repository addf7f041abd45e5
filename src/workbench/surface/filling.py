"""Heights without holes, where a hole would be in the way; which of them were measured stays known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from workbench.errors import SurfaceError
from workbench.rasters import Grid, tiles

_COARSE = 8  # Holes are closed on cells this many times larger: a hole has no detail to keep.


@dataclass(frozen=True, eq=False)
class FilledHeights:
    """A surface whose holes are closed smoothly, read by window."""

    surface: xr.DataArray
    """The surface with its holes, NaN."""
    coarse: np.ndarray
    """Closed surface on cells eight times larger, (rows, columns) float32."""

    @property
    def grid(self) -> Grid:
        """Grid of the surface."""
        return Grid.of(self.surface)

    def window(self, rows: slice, columns: slice) -> tuple[np.ndarray, np.ndarray]:
        """Heights (rows, columns) float32 without NaN, and whether each was measured (bool)."""
        heights = self.surface.isel(y=rows, x=columns).values.astype(np.float32)
        measured = np.isfinite(heights)
        if not measured.all():
            filled = _sample(self.coarse, rows, columns)
            heights = np.where(measured, heights, filled)
        return heights, measured


def fill_heights(surface: xr.DataArray, *, tile_size: int = 2048) -> FilledHeights:
    """Close the holes of a surface by averages of growing size (push-pull on a pyramid).

    Raises
    ------
    SurfaceError
        If the surface holds no height at all.
    """
    shape = surface.sizes["y"], surface.sizes["x"]
    sums = np.zeros([-(-n // _COARSE) for n in shape])
    counts = np.zeros_like(sums)
    for tile in tiles(shape, size=tile_size - tile_size % _COARSE):
        rows, columns = tile.core
        values = surface.isel(y=rows, x=columns).values
        target = np.s_[
            rows.start // _COARSE : -(-rows.stop // _COARSE),
            columns.start // _COARSE : -(-columns.stop // _COARSE),
        ]
        sums[target] = _blocks(np.nan_to_num(values), _COARSE)
        counts[target] = _blocks(np.isfinite(values).astype(float), _COARSE)
    if not counts.any():
        raise SurfaceError(f"Surface {surface.name} holds no height: nothing to fill its holes from.")
    return FilledHeights(surface, _push_pull(sums, counts).astype(np.float32))


def _push_pull(sums: np.ndarray, counts: np.ndarray) -> np.ndarray:
    if counts.all():
        return sums / counts
    if max(sums.shape) == 1:
        return np.full(sums.shape, sums.sum() / counts.sum())
    # Each coarser level counts a block once, however full it is, so that rims do not weigh double.
    known = counts > 0
    means = np.divide(sums, counts, out=np.zeros_like(sums), where=known)
    coarser = _push_pull(_blocks(means, 2), _blocks(known.astype(float), 2))
    rows, columns = (slice(0, n) for n in sums.shape)
    return np.where(known, means, _sample(coarser, rows, columns, factor=2))


def _blocks(values: np.ndarray, size: int) -> np.ndarray:
    pad = [(0, -n % size) for n in values.shape]
    padded = np.pad(values.astype(float), pad)
    rows, columns = (n // size for n in padded.shape)
    return padded.reshape(rows, size, columns, size).sum(axis=(1, 3))


def _sample(coarse: np.ndarray, rows: slice, columns: slice, factor: int = _COARSE) -> np.ndarray:
    """Bilinear values of a coarse raster at the cells of a window of the fine one."""

    def places(window: slice, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        position = np.clip((np.arange(window.start, window.stop) + 0.5) / factor - 0.5, 0, count - 1)
        low = np.floor(position).astype(int)
        return low, np.minimum(low + 1, count - 1), position - low

    top, bottom, down = places(rows, coarse.shape[0])
    left, right, across = places(columns, coarse.shape[1])
    upper = coarse[top][:, left] * (1 - across) + coarse[top][:, right] * across
    lower = coarse[bottom][:, left] * (1 - across) + coarse[bottom][:, right] * across
    return upper * (1 - down[:, None]) + lower * down[:, None]
