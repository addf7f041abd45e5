"""How reproducible a mosaic is, pixel by pixel, over repetitions of the same computation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import geopandas as gpd
import numpy as np
import pandas as pd
import rasterio.features
import xarray as xr
from scipy import ndimage

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

    def within(self, areas: Sequence[gpd.GeoDataFrame]) -> Reproducibility:
        """The same, compared only inside of all areas, such as the crop masks of the mosaics."""
        grid = Grid.of(self.layer)
        inside = np.ones(grid.shape, bool)
        for area in areas:
            shapes = list(area.to_crs(grid.crs).geometry)
            inside &= rasterio.features.geometry_mask(shapes, grid.shape, grid.transform, invert=True)
        kept = self.layer.copy(data=np.where(inside, self.layer.values, np.uint16(NOT_COMPARED)))
        return Reproducibility(kept, self.pairs)

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


def agreement(few: Reproducibility, many: Reproducibility) -> dict[str, float]:
    """Whether few repetitions find the regions that many find [orthomosaic paper 3.2, finding O07].

    Two kinds of regions: cells that any pair tells apart (which grow with the number of pairs), and cells
    that most pairs tell apart.

    Returns
    -------
    dict
        ``share_few`` and ``share_many`` (reproducible in all pairs); for both kinds ``found_<kind>`` (share
        of the region of many that few find) and ``overlap_<kind>`` (intersection over union; NaN without
        any); ``correlation`` of the shares of identical pairs, over all cells.

    Raises
    ------
    RasterError
        If both lie on different grids.
    """
    require_same_grid(few.layer, many.layer)
    both = (few.layer.values != NOT_COMPARED) & (many.layer.values != NOT_COMPARED)
    a, b = few.layer.values[both] / few.pairs, many.layer.values[both] / many.pairs
    result = {"share_few": float((a == 1).mean()), "share_many": float((b == 1).mean())}
    for kind, least in (("any", 1.0), ("most", 0.5)):
        x, y = a < least, b < least
        result[f"found_{kind}"] = float((x & y).sum() / y.sum()) if y.any() else float("nan")
        result[f"overlap_{kind}"] = float((x & y).sum() / (x | y).sum()) if (x | y).any() else float("nan")
    varied = a.size > 1 and np.ptp(a) > 0 and np.ptp(b) > 0
    result["correlation"] = float(np.corrcoef(a, b)[0, 1]) if varied else float("nan")
    return result


def share_by_distance(
    result: Reproducibility, gaps: xr.DataArray, area: xr.DataArray, *, edges: Sequence[float]
) -> pd.DataFrame:
    """Reproducibility by the distance to the nearest gap [orthomosaic paper 3.2, finding O08].

    Parameters
    ----------
    gaps
        Boolean: clearings and dead trees.
    area
        Boolean: cells that count, such as crowns.
    edges
        Ascending distances, metres; the last class is open.

    Returns
    -------
    DataFrame
        ``from_m``, ``to_m``, ``pixels``, ``share`` (reproducible in all pairs), ``identical`` (mean share of
        the pairs).

    Raises
    ------
    RasterError
        If the rasters lie on different grids.
    """
    require_same_grid(result.layer, gaps)
    require_same_grid(result.layer, area)
    distance = ndimage.distance_transform_edt(~gaps.values.astype(bool)) * Grid.of(gaps).resolution
    counts = (result.layer.values != NOT_COMPARED) & area.values.astype(bool)
    rows = []
    for low, high in pairwise([*edges, float("inf")]):
        inside = result.layer.values[counts & (distance >= low) & (distance < high)]
        rows.append(
            {
                "from_m": low,
                "to_m": high,
                "pixels": inside.size,
                "share": _share(inside, result.pairs),
                "identical": float(inside.mean() / result.pairs) if inside.size else float("nan"),
            }
        )
    return pd.DataFrame(rows)


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
