"""How often cells were measured, and how often they could have been: the count layer's statistics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr

from workbench.errors import SurfaceError
from workbench.rasters import Grid, new_raster, require_same_grid

NO_CLASS = 255
"""Class of a cell that no pair could have measured."""

RATIO_CLASSES = ("0", *(f"({low},{low + 10}]" for low in range(0, 100, 10)))
"""Names of the 11 classes of V, per cent: exactly 0, then tenths."""


@dataclass(frozen=True, eq=False)
class CountStatistics:
    """The six statistics of the count layer [thesis 3.2.1], for the area and inside a mask."""

    histogram: pd.DataFrame
    """Long table: ``scope`` (area, mask), ``statistic`` (count, ratio), ``value`` (the count, or a class
    of V), ``cells``, ``percent`` of the cells that could have been measured."""
    summary: pd.DataFrame
    """One row per ``scope`` and ``statistic`` (count, ratio, shortfall = possible count minus count):
    ``cells``, ``mean``, ``minimum``, ``maximum``, ``range``, ``standard_deviation``."""

    def _repr_html_(self) -> str:
        return str(self.summary.round(3).to_html(index=False))


def count_ratio_classes(count: xr.DataArray, possible: xr.DataArray) -> xr.DataArray:
    """V = count / possible count in 11 classes: 0 is exactly 0, k is (10 (k - 1), 10 k] per cent.

    A cell that was measured more often than the frames allow (it lies at a frame's very edge)
    counts as 100 per cent; where nothing was possible the class is :data:`NO_CLASS`.

    Raises
    ------
    RasterError
        If the rasters lie on different grids.
    SurfaceError
        If a count is negative or not a whole number.
    """
    require_same_grid(count, possible)
    return new_raster(
        ratio_classes(count.values, possible.values),
        Grid.of(count),
        name="count_ratio",
        units="1",
        long_name="class of count / possible count",
        nodata=NO_CLASS,
    )


def ratio_classes(count: np.ndarray, possible: np.ndarray) -> np.ndarray:
    """The classes of :func:`count_ratio_classes` for arrays of whole numbers, uint8."""
    counted, limit = _whole(count, "count"), _whole(possible, "possible count")
    # Whole numbers keep the limits of the classes exact: 3 of 10 is in (20,30].
    tenths = -(-10 * np.minimum(counted, limit) // np.maximum(limit, 1))
    return np.where(limit > 0, tenths, NO_CLASS).astype(np.uint8)


def count_statistics(
    count: xr.DataArray, possible: xr.DataArray, mask: xr.DataArray | None = None
) -> CountStatistics:
    """Statistics of count, V and shortfall for the area and inside a mask [thesis 3.2.1].

    Parameters
    ----------
    count
        Pairs that measured each cell (y, x), whole numbers.
    possible
        Pairs that could have; cells with 0 are outside the area.
    mask
        True or 1 inside (trees, for example).

    Raises
    ------
    RasterError
        If the rasters lie on different grids.
    SurfaceError
        If counts are negative or not whole, or no cell could have been measured.
    """
    require_same_grid(count, possible)
    counted, limit = _whole(count.values, "count"), _whole(possible.values, "possible count")
    area = limit > 0
    if not area.any():
        raise SurfaceError("No cell could have been measured by any pair: check the pairs and the grid.")
    scopes = {"area": area}
    if mask is not None:
        require_same_grid(count, mask)
        scopes["mask"] = area & (np.nan_to_num(mask.values.astype(float)) > 0)
    classes = ratio_classes(counted, limit)
    histogram, summary = [], []
    for scope, cells in scopes.items():
        total = int(cells.sum())
        counts = np.bincount(counted[cells], minlength=1)
        tenths = np.bincount(classes[cells], minlength=len(RATIO_CLASSES))
        named = [("count", str(value), n) for value, n in enumerate(counts)]
        named += [("ratio", name, n) for name, n in zip(RATIO_CLASSES, tenths, strict=True)]
        for statistic, value, n in named:
            histogram.append((scope, statistic, value, int(n), 100 * n / total if total else np.nan))
        ratio = np.minimum(counted, limit)[cells] / limit[cells]
        for statistic, values in (
            ("count", counted[cells]),
            ("ratio", ratio),
            ("shortfall", limit[cells] - counted[cells]),
        ):
            summary.append((scope, statistic, total, *_moments(values)))
    return CountStatistics(
        pd.DataFrame(histogram, columns=["scope", "statistic", "value", "cells", "percent"]),
        pd.DataFrame(
            summary,
            columns=["scope", "statistic", "cells"]
            + ["mean", "minimum", "maximum", "range", "standard_deviation"],
        ),
    )


def _moments(values: np.ndarray) -> tuple[float, float, float, float, float]:
    if not values.size:
        return (np.nan,) * 5
    low, high = float(values.min()), float(values.max())
    return float(values.mean()), low, high, high - low, float(values.std())


def _whole(values: np.ndarray, name: str) -> np.ndarray:
    known = np.nan_to_num(np.asarray(values, dtype=np.float64))
    if (known < 0).any() or (known != np.floor(known)).any():
        raise SurfaceError(f"The {name} layer holds values that are no counts: give whole numbers from 0.")
    return known.astype(np.int64)
