"""Several dates of one place: what is reproducible in all of them, and how far objects shift."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import geopandas as gpd
import numpy as np
import pandas as pd
import xarray as xr

from workbench.errors import StudyError
from workbench.rasters import Grid, new_raster, require_same_grid
from workbench.studies.reproducibility import NOT_COMPARED, Reproducibility


@dataclass(frozen=True, eq=False)
class ObjectShifts:
    """How far digitised objects move between dates."""

    table: gpd.GeoDataFrame
    """A row an object and pair of dates: object, from_date, to_date, east_m, north_m, shift_m, and the
    arrow between the centres of the bounding boxes."""

    @property
    def mean_m(self) -> float:
        """Mean shift, metres."""
        return float(self.table.shift_m.mean())

    @property
    def maximum_m(self) -> float:
        """Largest shift, metres."""
        return float(self.table.shift_m.max())


def reproducible_dates(dates: Sequence[Reproducibility]) -> xr.DataArray:
    """Number of dates at which a pixel is identical in all pairs [orthomosaic paper 2.7].

    Returns
    -------
    DataArray of uint16
        0..number of dates; 65535 where any date has nothing to compare.

    Raises
    ------
    StudyError
        Without any date.
    RasterError
        If the dates lie on different grids.
    """
    if not dates:
        raise StudyError("No dates: a time series needs at least one reproducibility layer.")
    first = dates[0].layer
    total = np.zeros(first.shape, np.uint16)
    known = np.ones(first.shape, bool)
    for date in dates:
        require_same_grid(first, date.layer)
        known &= date.layer.values != NOT_COMPARED
        total += date.layer.values == date.pairs
    return new_raster(
        np.where(known, total, np.uint16(NOT_COMPARED)),
        Grid.of(first),
        name="reproducible_dates",
        units="1",
        long_name="dates at which a pixel is reproducible",
        nodata=NOT_COMPARED,
    )


def object_shifts(
    dates: Mapping[str, gpd.GeoDataFrame], *, key: str = "object", consecutive: bool = False
) -> ObjectShifts:
    """Shift of the centre of each object's bounding box between dates [orthomosaic paper 2.7].

    Parameters
    ----------
    dates
        Digitised objects by date, in order; the column ``key`` names an object.
    key
        Column that names an object.
    consecutive
        Compare each date with the next one only, instead of all pairs.

    Raises
    ------
    StudyError
        If fewer than two dates are given, the CRS differ or are geographic, the column is missing or
        not unique, or no object occurs twice.
    """
    names = list(dates)
    if len(names) < 2:
        raise StudyError(f"{len(names)} date(s): a shift needs at least two.")
    centres = {name: _centres(dates[name], name, key) for name in names}
    crs = dates[names[0]].crs
    for name in names:
        if dates[name].crs != crs:
            raise StudyError(f"Objects of {name} are in {dates[name].crs}, others in {crs}: reproject them.")
    pairs = pairwise(names) if consecutive else combinations(names, 2)
    parts = []
    for first, second in pairs:
        both = centres[first].join(centres[second], how="inner", lsuffix="_from", rsuffix="_to")
        both = both.assign(from_date=first, to_date=second)
        parts.append(both.reset_index(names="object"))
    table = pd.concat(parts, ignore_index=True)
    if table.empty:
        raise StudyError(f"No object occurs at two dates: give the same object the same '{key}'.")
    table["east_m"], table["north_m"] = table.x_to - table.x_from, table.y_to - table.y_from
    table["shift_m"] = np.hypot(table.east_m, table.north_m)
    arrows = [f"LINESTRING ({row.x_from} {row.y_from}, {row.x_to} {row.y_to})" for row in table.itertuples()]
    columns = ["object", "from_date", "to_date", "east_m", "north_m", "shift_m"]
    return ObjectShifts(gpd.GeoDataFrame(table[columns], geometry=gpd.GeoSeries.from_wkt(arrows), crs=crs))


def _centres(objects: gpd.GeoDataFrame, date: str, key: str) -> pd.DataFrame:
    if key not in objects.columns:
        raise StudyError(f"Objects of {date} have no column '{key}': it names which object is which.")
    if objects[key].duplicated().any():
        twice = sorted(objects.loc[objects[key].duplicated(), key].astype(str))
        raise StudyError(f"Objects of {date}: {', '.join(twice)} occur(s) more than once.")
    if objects.crs is None or objects.crs.is_geographic:
        raise StudyError(f"Objects of {date} need a projected CRS in metres.")
    bounds = objects.bounds
    return pd.DataFrame(
        {"x": (bounds.minx + bounds.maxx) / 2, "y": (bounds.miny + bounds.maxy) / 2}
    ).set_index(pd.Index(objects[key], name=key))
