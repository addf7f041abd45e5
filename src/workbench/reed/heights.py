"""Heights of reed above the water, and how well they agree with the field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pyproj
import xarray as xr
from numpy.typing import ArrayLike

from workbench.errors import ReedError
from workbench.params import ReedParameters
from workbench.rasters import VERTICAL_DATUM, Grid, new_raster
from workbench.site.places import utm_zone

_DEFAULTS = ReedParameters()
_METRES = ("", "1", "m", "metre", "metres", "meter", "meters")  # "1" and "": the file does not say.
_ABYSS = 100.0  # Ground so far below the water is none, m.
_SKY = 10_000.0  # Nothing is so far above the water, m.
_ROWS = 512  # Rows subtracted at once in double precision.


def object_height(dsm: xr.DataArray, water_level: float) -> xr.DataArray:
    """Object height model: the surface above the water [reed 2.5.1].

    Parameters
    ----------
    dsm
        Surface heights (y, x), m, with a CRS; NaN where unknown.
    water_level
        Of the day of the flight, m in the vertical datum of the surface.

    Returns
    -------
    DataArray
        Metres above the water, float32, on the grid of the surface. It states the datum if the surface does.

    Raises
    ------
    RasterError
        If the surface has no CRS.
    ReedError
        If the surface is no single band in metres, the water level is not a number or above all of it, or
        a number that stands for "no height" is not declared as such.
    """
    dsm = known_heights(dsm)
    grid, datum = Grid.of(dsm), dsm.attrs.get(VERTICAL_DATUM)
    if not np.isfinite(water_level):
        raise ReedError(
            f"The water level is {water_level}: state it in metres, in {datum or 'the datum of the surface'}."
        )
    values = dsm.values
    heights = np.empty(grid.shape, dtype=np.float32)
    for top in range(0, grid.height, _ROWS):
        rows = slice(top, top + _ROWS)
        heights[rows] = values[rows].astype(np.float64) - float(water_level)
    heights[np.isinf(heights)] = np.nan
    if np.isnan(heights).all():
        raise ReedError("The surface holds no height at all: has it been computed?")
    if not np.fmax.reduce(heights, axis=None) > 0:
        highest = np.fmax.reduce(values, axis=None)
        raise ReedError(
            f"The water level {water_level:g} m is above everything in the surface (up to {highest:g} m): "
            f"is it in {datum or 'the datum of the surface'}, of the right lake and day?"
        )
    _refuse_filler(values, heights, water_level)
    return new_raster(
        heights, grid, name="ohm", units="m", long_name="height above water", vertical_datum=datum
    )


def known_heights(dsm: xr.DataArray) -> xr.DataArray:
    """A surface (y, x) as any program writes it, with NaN where its nodata value stands.

    Raises
    ------
    RasterError
        If it has no CRS.
    ReedError
        If it has several bands, or its places or heights are not in metres.
    """
    if dsm.ndim != 2:
        raise ReedError(
            f"The surface has the dimensions {dsm.dims} of {dsm.shape}: give one band (y, x) of heights, "
            "for example dsm.isel(band=0), or gdal_translate -b 1."
        )
    _require_metres(Grid.of(dsm), str(dsm.attrs.get("units", "")))
    nodata = dsm.rio.nodata
    if nodata is None or np.isnan(nodata):
        return dsm
    return dsm.where(dsm != nodata).rio.write_nodata(np.nan)


def _require_metres(grid: Grid, units: str) -> None:
    crs = pyproj.CRS.from_wkt(grid.crs.to_wkt())
    if crs.is_geographic:
        west, south, east, north = grid.bounds
        zone = utm_zone((west + east) / 2, (north + south) / 2).to_epsg()
        raise ReedError(
            f"The surface is in degrees ({crs.name}); areas and distances need metres: reproject it, "
            f"for example with gdalwarp -t_srs EPSG:{zone} -tr 0.2 0.2 (UTM, cells of 0.2 m)."
        )
    across, up = crs.axis_info[0], crs.axis_info[2] if len(crs.axis_info) > 2 else None
    if abs(across.unit_conversion_factor - 1) > 1e-9:
        raise ReedError(
            f"Places of the surface are in {across.unit_name} ({crs.name}): reproject it to a CRS in metres, "
            "for example UTM, with gdalwarp -t_srs."
        )
    if up is not None and abs(up.unit_conversion_factor - 1) > 1e-9:
        units = up.unit_name
    if units.strip().lower() not in _METRES:
        raise ReedError(
            f"The heights of the surface are in '{units}': convert them to metres, for example with "
            "gdal_calc.py, and state the water level in metres, too."
        )


def _refuse_filler(values: np.ndarray, heights: np.ndarray, water_level: float) -> None:
    """Refuse a surface whose cells without a height hold a number that is not declared as nodata."""
    if np.fmin.reduce(heights, axis=None) >= -_ABYSS and np.fmax.reduce(heights, axis=None) <= _SKY:
        return
    with np.errstate(invalid="ignore"):
        beyond = values[(heights < -_ABYSS) | (heights > _SKY)]
    numbers, counts = np.unique(beyond, return_counts=True)
    filler, count = numbers[np.argmax(counts)], int(counts.max())
    if count > 1 and 2 * count > len(beyond):
        raise ReedError(
            f"{count} cells of the surface hold exactly {filler:g}, with the water at {water_level:g} m: if "
            f"that stands for no height, declare it with gdal_edit.py -a_nodata {filler:g}; if the heights "
            "are right, the water level is not."
        )


def height_at_points(
    ohm: xr.DataArray, x: ArrayLike, y: ArrayLike, *, radius: float = _DEFAULTS.point_radius
) -> np.ndarray:
    """Highest cell within a distance of each point [reed 2.5.1].

    A cell counts if its centre lies within the disc (border included); the disc is not rounded to cells.

    Parameters
    ----------
    ohm
        Heights (y, x), m; NaN is left out.
    x, y
        (n,) coordinates in the CRS of the raster.
    radius
        Of the disc, m.

    Returns
    -------
    ndarray
        (n,) float64, NaN where no known cell lies in the disc.
    """
    grid = Grid.of(ohm)
    x, y = np.atleast_1d(np.asarray(x, dtype=float)), np.atleast_1d(np.asarray(y, dtype=float))
    # Cell coordinates in which the centre of cell (i, j) is (i, j).
    column = (x - grid.west) / grid.resolution - 0.5
    row = (grid.north - y) / grid.resolution - 0.5
    reach = radius / grid.resolution
    steps = np.arange(-int(np.ceil(reach)) - 1, int(np.ceil(reach)) + 2)
    rows = np.round(row)[:, None, None] + steps[None, :, None]
    columns = np.round(column)[:, None, None] + steps[None, None, :]
    distance2 = (rows - row[:, None, None]) ** 2 + (columns - column[:, None, None]) ** 2
    inside = distance2 <= reach**2 * (1 + 1e-9)
    inside = inside & (rows >= 0) & (rows < grid.height) & (columns >= 0) & (columns < grid.width)
    rows, columns, inside = np.broadcast_arrays(rows, columns, inside)
    found = np.full(inside.shape, -np.inf)
    found[inside] = ohm.values[rows[inside].astype(int), columns[inside].astype(int)]
    highest = np.where(np.isnan(found), -np.inf, found).max(axis=(1, 2))
    return np.where(np.isfinite(highest), highest, np.nan)


@dataclass(frozen=True)
class HeightAgreement:
    """How heights from the surface agree with those of the field, for one area or all."""

    n: int
    """Points compared."""
    rmse: float
    """Root mean square of surface minus field, m [reed table 1]."""
    bias: float
    """Mean of surface minus field, m."""
    r2: float
    """Squared correlation: what a fitted line explains, as in the figure of the authors, 0..1."""
    efficiency: float
    """1 - residual / total sum of squares about the line 1:1, at most 1; negative if the mean did better."""
    slope: float
    """Of surface on field, m/m."""
    intercept: float
    """Of surface on field, m."""

    @classmethod
    def of(cls, field: ArrayLike, surface: ArrayLike) -> HeightAgreement:
        """Compare (n,) heights in metres; pairs with NaN are left out."""
        observed, predicted = np.asarray(field, dtype=float), np.asarray(surface, dtype=float)
        known = np.isfinite(observed) & np.isfinite(predicted)
        observed, predicted = observed[known], predicted[known]
        n = len(observed)
        if n == 0:
            return cls(0, *[float("nan")] * 6)
        error = predicted - observed
        spread = float(np.sum((observed - observed.mean()) ** 2))
        rmse, bias = float(np.sqrt(np.mean(error**2))), float(error.mean())
        if n < 2 or spread == 0:
            return cls(n, rmse, bias, *[float("nan")] * 4)
        covariance = float(np.sum((observed - observed.mean()) * (predicted - predicted.mean())))
        total = float(np.sum((predicted - predicted.mean()) ** 2))
        slope = covariance / spread
        return cls(
            n=n,
            rmse=rmse,
            bias=bias,
            r2=covariance**2 / (spread * total) if total > 0 else float("nan"),
            efficiency=1 - float(np.sum(error**2)) / spread,
            slope=slope,
            intercept=float(predicted.mean() - slope * observed.mean()),
        )


def compare_heights(
    ohm: xr.DataArray, points: pd.DataFrame, *, radius: float = _DEFAULTS.point_radius
) -> pd.DataFrame:
    """Field height above the water beside the surface's at every field point with reed.

    Field height is stem height minus water depth [reed 2.5.1].

    Parameters
    ----------
    ohm
        Heights above the water, m.
    points
        Columns ``aoi, transect, point, x, y, stem_height_m, water_depth_m`` as
        :func:`workbench.reed.read_field_points` gives them.
    radius
        See :func:`height_at_points`.

    Returns
    -------
    DataFrame
        Rows with a stem: ``aoi, transect, point, x, y, water_depth_m, field_m, surface_m``; ``field_m``
        is NaN without a depth, ``surface_m`` where the surface is unknown.
    """
    reed = points[np.isfinite(points.stem_height_m)]
    table = reed[["aoi", "transect", "point", "x", "y", "water_depth_m"]].reset_index(drop=True)
    table["field_m"] = (reed.stem_height_m - reed.water_depth_m).to_numpy()
    table["surface_m"] = height_at_points(ohm, table.x, table.y, radius=radius) if len(table) else np.nan
    return table


def agreement_by_area(compared: pd.DataFrame) -> pd.DataFrame:
    """One row an area and a last row ``total``: the fields of :class:`HeightAgreement`."""
    rows: list[dict[str, Any]] = []
    for aoi, part in compared.groupby("aoi", sort=False):
        rows.append({"aoi": str(aoi), **vars(HeightAgreement.of(part.field_m, part.surface_m))})
    rows.append({"aoi": "total", **vars(HeightAgreement.of(compared.field_m, compared.surface_m))})
    return pd.DataFrame(rows)
