"""Tables of the reed field campaign [reed 2.4]: commas or semicolons, decimal points or commas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from workbench.errors import ReedError
from workbench.site.tables import number, read_table

_POINTS = ["aoi", "transect", "point", "x", "y", "stem_height_m", "water_depth_m"]
_PLOTS = ["aoi", "transect", "plot", "x", "y"]


def read_field_points(path: Path | str) -> pd.DataFrame:
    """Points along transects.

    Returns
    -------
    DataFrame
        ``aoi, transect, point`` (text), ``x, y`` (m), ``stem_height_m`` from the foot of a stem to its
        top (NaN: no reed there) and ``water_depth_m`` (NaN: not measured).

    Raises
    ------
    SiteError
        If the file is missing, lacks a column or holds something else than numbers.
    ReedError
        If a stem or depth is negative, or no row has a stem.
    """
    path = Path(path)
    table = _read(path, _POINTS, ["x", "y"], ["stem_height_m", "water_depth_m"])
    for column in ("stem_height_m", "water_depth_m"):
        if (table[column] < 0).any():
            row = table[table[column] < 0].iloc[0]
            raise ReedError(
                f"{path}: {column} of point {row['point']} in transect {row['transect']} of {row['aoi']} is "
                "negative: leave it empty where nothing was measured."
            )
    if not np.isfinite(table.stem_height_m).any():
        raise ReedError(f"{path}: no point has a stem_height_m. Is the column filled in?")
    return table


def read_plots(path: Path | str) -> pd.DataFrame:
    """Plots of a square metre.

    Returns
    -------
    DataFrame
        ``aoi, transect, plot`` (text), ``x, y`` (m), ``stems_per_m2`` (NaN: not counted), ``density``
        (sparse or dense as judged in the field; empty where it was not).

    Raises
    ------
    SiteError
        If the file is missing, lacks a column or holds something else than numbers.
    ReedError
        If it holds neither stems_per_m2 nor density, or a density is neither sparse nor dense.
    """
    path = Path(path)
    table = _read(path, _PLOTS, ["x", "y"], ["stems_per_m2"])
    unclear = table[~table.density.isin(["", "sparse", "dense"])]
    if len(unclear):
        row = unclear.iloc[0]
        raise ReedError(
            f"{path}: density of plot {row['plot']} in transect {row['transect']} of {row['aoi']} is "
            f"'{row['density']}': write sparse or dense."
        )
    if (table.density == "").all() and not np.isfinite(table.stems_per_m2).any():
        raise ReedError(f"{path}: neither stems_per_m2 nor density (sparse, dense) is filled in.")
    return table


def _read(path: Path, names: list[str], needed: list[str], optional: list[str]) -> pd.DataFrame:
    columns = names if names is _POINTS else [*names, *optional, "density"]
    rows = []
    for line, row in read_table(path, names):
        values: dict[str, object] = {name: row[name] for name in names[:3]}
        values |= {key: number(row, key, path, line) for key in needed}
        values |= {key: number(row, key, path, line, default=float("nan")) for key in optional}
        values["density"] = row.get("density", "").lower()
        rows.append(values)
    return pd.DataFrame(rows, columns=columns)
