"""How reproducible a mosaic is, pixel by pixel, over repetitions of the same computation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
import xarray as xr

from workbench.errors import StudyError
from workbench.params import StudyParameters
from workbench.rasters import Grid, map_tiles, new_raster, require_same_grid
from workbench.studies.correlation import Method, local_correlation

_DEFAULTS = StudyParameters()
NOT_COMPARED = 65535
"""Value of the layer where a pair of mosaics has nothing to compare."""


@dataclass(frozen=True, eq=False)
class Reproducibility:
    """Agreement of x repetitions in all n = x (x - 1) / 2 pairs."""

    layer: xr.DataArray
    """uint16: number of pairs in which a pixel is identical, 0..n; 65535 where it is not compared."""
    pairs: int
    """n, the number of pairs."""

    @property
    def share(self) -> float:
        """Share of the compared pixels that are identical in all pairs, 0..1; NaN without any."""
        return _share(self.layer.values, self.pairs)

    def share_by(self, cover: xr.DataArray, names: Mapping[int, str]) -> pd.DataFrame:
        """Table by land cover: class, pixels compared, share identical in all pairs.

        Raises
        ------
        RasterError
            If the land cover lies on another grid.
        """
        require_same_grid(self.layer, cover)
        rows = []
        for value, name in names.items():
            inside = self.layer.values[cover.values == value]
            compared = int((inside != NOT_COMPARED).sum())
            rows.append({"cover": name, "pixels": compared, "share": _share(inside, self.pairs)})
        rows.append(
            {
                "cover": "total",
                "pixels": int((self.layer.values != NOT_COMPARED).sum()),
                "share": self.share,
            }
        )
        return pd.DataFrame(rows)

    def histogram(self) -> pd.DataFrame:
        """Pixels and their share by number of identical pairs, 0..n."""
        compared = self.layer.values[self.layer.values != NOT_COMPARED]
        counts = np.bincount(compared, minlength=self.pairs + 1)
        return pd.DataFrame(
            {
                "identical_pairs": np.arange(self.pairs + 1),
                "pixels": counts,
                "share": counts / max(compared.size, 1),
            }
        )


def reproducibility(
    mosaics: Sequence[xr.DataArray],
    *,
    window: int = _DEFAULTS.correlation_window,
    threshold: float = _DEFAULTS.identical_from,
    method: Method = _DEFAULTS.correlation_method,
    tile_size: int = 1024,
) -> Reproducibility:
    """Compare repetitions of a mosaic in all pairs [orthomosaic paper 2.5, equation 2].

    Two mosaics are identical at a pixel if their local correlation reaches the threshold in every
    band. Where both are without variance in a band they are identical if they are equal there.

    Parameters
    ----------
    mosaics
        At least two, (band, y, x) or (y, x) on one grid; the nodata value or NaN is missing.
    window, threshold, method
        Of :func:`workbench.studies.local_correlation`, and the correlation from which on a pixel is
        identical.

    Raises
    ------
    StudyError
        If fewer than two mosaics are given.
    RasterError
        If they lie on different grids or CRS.
    """
    if len(mosaics) < 2:
        raise StudyError(f"{len(mosaics)} mosaic(s): reproducibility needs at least two repetitions.")
    nodata = [mosaic.rio.nodata for mosaic in mosaics]
    pairs = list(combinations(range(len(mosaics)), 2))

    def compare(*arrays: np.ndarray) -> np.ndarray:
        colours = [_as_float(array, missing) for array, missing in zip(arrays, nodata, strict=True)]
        known = np.logical_and.reduce([np.isfinite(colour).all(axis=0) for colour in colours])
        total = np.zeros(known.shape, np.uint16)
        for first, second in pairs:
            total += _identical(colours[first], colours[second], window, threshold, method)
        return np.where(known, total, np.uint16(NOT_COMPARED))

    layer = map_tiles(compare, *mosaics, margin=window // 2, tile_size=tile_size)
    grid = Grid.of(mosaics[0])
    raster = new_raster(
        layer.values,
        grid,
        name="reproducibility",
        units="1",
        long_name="pairs of repetitions in which a pixel is identical",
        nodata=NOT_COMPARED,
        pairs=len(pairs),
    )
    return Reproducibility(raster, len(pairs))


def _as_float(array: np.ndarray, nodata: float | None) -> np.ndarray:
    values = np.atleast_3d(array.T).T.astype(np.float64)
    if nodata is not None and not np.isnan(nodata):
        values[:, (values == nodata).all(axis=0)] = np.nan
    return values


def _identical(a: np.ndarray, b: np.ndarray, window: int, threshold: float, method: Method) -> np.ndarray:
    same = np.ones(a.shape[1:], bool)
    for x, y in zip(a, b, strict=True):
        correlation = local_correlation(x, y, window, method)
        same &= np.where(np.isnan(correlation), x == y, correlation >= threshold)
    return same


def _share(layer: np.ndarray, pairs: int) -> float:
    compared = layer != NOT_COMPARED
    return float((layer[compared] == pairs).mean()) if compared.any() else float("nan")
