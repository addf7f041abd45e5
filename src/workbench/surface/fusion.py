"""Fusion: one height per cell from all pairs, and from all downscales."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from workbench.compiled import compiled
from workbench.errors import SurfaceError
from workbench.rasters import require_same_grid

NO_DATA, INTERPOLATED = 0, 255
"""Values of ``provenance.tif`` beside the downscales themselves."""


def fuse_pairs(
    heights: np.ndarray, confidence: np.ndarray, precision: np.ndarray, *, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Robust height of each cell from the heights of several pairs.

    The heights of a cell are sorted and cut where a gap is wider than the tolerance; the group with
    the largest weight wins, the higher one of two equal. So a cell at the edge of a crown, where
    some pairs saw the crown and others the ground, gets one of the two and not a mean. Within the
    group, which holds no outlier any more, the weighted mean is the height (on Brighton Beach its noise
    is a sixth less than that of a median). Weight = confidence / precision, not precision^2: only the
    noise of matching falls with the base. Residuals of the orientation do not, and wide pairs see a rough
    surface from more different sides (docs/surface.md has what was measured).

    Parameters
    ----------
    heights
        (pairs, rows, columns) metres, NaN where a pair measured nothing.
    confidence
        The same shape, larger is better.
    precision
        Standard deviation of the heights, metres: (pairs,), or (pairs, rows, columns).
    tolerance
        Widest gap within a group, metres, but at least three times the largest precision in the cell.

    Returns
    -------
    height : ndarray (rows, columns) float32
    count : ndarray (rows, columns) uint8
        Pairs whose heights were used.
    spread : ndarray (rows, columns) float32
        1.4826 times the median absolute deviation of the used heights, metres; NaN with fewer than two.
    """
    precision = np.asarray(precision, dtype=np.float32)
    if precision.ndim == 1:
        precision = np.broadcast_to(precision[:, None, None], heights.shape)
    return _fuse(
        np.ascontiguousarray(heights, dtype=np.float32),
        np.ascontiguousarray(confidence, dtype=np.float32),
        precision,
        tolerance,
    )


def fuse_downscales(surfaces: Sequence[xr.DataArray], downscales: Sequence[int] | None = None) -> xr.Dataset:
    """Fill the holes of each downscale with measured cells of the next one [thesis 4.2.1, 5.1].

    Parameters
    ----------
    surfaces
        Heights (y, x) on one grid, finest downscale first, NaN = not measured.
    downscales
        Their numbers; 1, 2, 3 ... if not given.

    Returns
    -------
    Dataset
        ``height`` (float32, metres, NaN = not measured at any downscale) and ``provenance`` (uint8:
        0 no data, n = the downscale it was measured at). Nothing is interpolated.

    Raises
    ------
    SurfaceError
        If no surface is given, or their numbers are not distinct and within 1..254.
    RasterError
        If the surfaces lie on different grids.
    """
    if not surfaces:
        raise SurfaceError("No surfaces to fuse: give at least that of downscale 1.")
    numbers = list(downscales) if downscales is not None else list(range(1, len(surfaces) + 1))
    if len(numbers) != len(surfaces) or len(set(numbers)) != len(numbers):
        raise SurfaceError(f"{len(surfaces)} surfaces need as many different downscales, not {numbers}.")
    if min(numbers) < 1 or max(numbers) >= INTERPOLATED:
        raise SurfaceError(f"Downscales {numbers} must lie within 1..254.")
    first = surfaces[0]
    height = np.full(first.shape, np.nan, np.float32)
    provenance = np.zeros(first.shape, np.uint8)
    for number, surface in zip(numbers, surfaces, strict=True):
        if surface is not first and surface.rio.crs is not None:
            require_same_grid(first, surface)
        values = surface.values
        if values.shape != height.shape:
            raise SurfaceError(f"Surfaces of shape {values.shape} and {height.shape} cannot be fused.")
        new = np.isnan(height) & np.isfinite(values)
        height[new] = values[new]
        provenance[new] = number
    attributes = dict(first.attrs)
    fused = xr.Dataset(
        {
            "height": (first.dims, height, attributes),
            "provenance": (first.dims, provenance, {"units": "1", "long_name": "downscale measured at"}),
        },
        coords={name: first[name] for name in first.dims if name in first.coords},
    )
    return fused if first.rio.crs is None else fused.rio.write_crs(first.rio.crs)


@compiled(nogil=True)
def _fuse(
    heights: np.ndarray, confidence: np.ndarray, precision: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    pairs, rows, columns = heights.shape
    fused = np.full((rows, columns), np.float32(np.nan), np.float32)
    count = np.zeros((rows, columns), np.uint8)
    spread = np.full((rows, columns), np.float32(np.nan), np.float32)
    z, w = np.empty(pairs), np.empty(pairs)
    for row in range(rows):
        for column in range(columns):
            n = 0
            limit = tolerance
            for pair in range(pairs):
                value = heights[pair, row, column]
                if value != value:
                    continue
                place = n
                while place > 0 and z[place - 1] > value:
                    z[place], w[place] = z[place - 1], w[place - 1]
                    place -= 1
                z[place] = value
                sd = precision[pair, row, column]
                w[place] = confidence[pair, row, column] / sd
                limit = max(limit, 3.0 * sd)
                n += 1
            if n == 0:
                continue
            start, best_start, best_stop, best_weight = 0, 0, 0, -1.0
            total = 0.0
            for k in range(n):
                total += w[k]
                if k == n - 1 or z[k + 1] - z[k] > limit:
                    if total >= best_weight:
                        best_start, best_stop, best_weight = start, k + 1, total
                    start, total = k + 1, 0.0
            mean = 0.0
            for k in range(best_start, best_stop):
                mean += w[k] * z[k]
            fused[row, column] = mean / best_weight
            used = best_stop - best_start
            count[row, column] = min(used, 255)
            if used > 1:
                deviations = np.sort(np.abs(z[best_start:best_stop] - fused[row, column]))
                spread[row, column] = 1.4826 * ((deviations[(used - 1) // 2] + deviations[used // 2]) / 2)
    return fused, count, spread
