"""Reference trees: surveyed stems, brought to where their tops are seen from above."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import xarray as xr

from workbench.errors import AssessmentError
from workbench.params import AssessParameters
from workbench.rasters import Grid, read_raster
from workbench.site import Site
from workbench.site.tables import number, read_table
from workbench.stages import FOLDERS
from workbench.vectors import read_vector

_DEFAULTS = AssessParameters()
SMALLEST_DBH = {
    "broadleaf": _DEFAULTS.smallest_dbh_broadleaf,
    "conifer": _DEFAULTS.smallest_dbh_conifer,
}
"""Least diameter at breast height of a reference tree by species group, metres [thesis 3.4.1]."""
_STEM = ("x1", "y1", "z1", "x2", "y2", "z2")


def read_reference_trees(path: Path | str, crs: Any) -> gpd.GeoDataFrame:
    """Read surveyed trees from a vector file or a table.

    Parameters
    ----------
    path
        GeoPackage, shapefile ... with points, or CSV (comma or semicolon, decimal point or comma) with
        columns x and y, or x1 and y1.
    crs
        CRS of a table's coordinates, and of the result.

    Raises
    ------
    AssessmentError
        If a table has no coordinates.
    SiteError
        If a table cannot be read or a coordinate is no number, with the line.
    VectorError
        If a vector file cannot be read.
    """
    path = Path(path)
    if path.suffix.lower() not in (".csv", ".txt"):
        return read_vector(path, crs=crs)
    rows = read_table(path, [])
    pair = next((p for p in (("x", "y"), ("x1", "y1")) if rows and set(p) <= set(rows[0][1])), None)
    if pair is None:
        raise AssessmentError(f"{path}: needs a row of names with x and y (or x1 and y1), and trees.")
    places = [[number(row, key, path, line) for key in pair] for line, row in rows]
    columns = {name: [_number_or_text(row[name]) for _, row in rows] for name in rows[0][1]}
    return gpd.GeoDataFrame(columns, geometry=gpd.points_from_xy(*np.array(places).T), crs=crs)


def extrapolate_tops(stems: gpd.GeoDataFrame, surface: xr.DataArray) -> gpd.GeoDataFrame:
    """Move stems that were measured at two points to where they reach the surface [thesis 3.4.1].

    With (x1, y1, z1) and (x2, y2, z2) on the stem and the height z3 of the surface, the top is at
    ``x1 + a (x2 - x1), y1 + a (y2 - y1)`` with ``a = (z3 - z1) / (z2 - z1)``. The height is read where the
    stem stands, then once more at the place found, because a leaning stem ends under another cell.

    Parameters
    ----------
    stems
        Columns x1, y1, z1, x2, y2, z2 in the CRS and vertical datum of the surface; rows without them,
        or where the surface is unknown, keep their geometry.
    surface
        (y, x) heights in the vertical datum, not above ground.
    """
    if not set(_STEM) <= set(stems.columns):
        return stems
    x1, y1, z1, x2, y2, z2 = stems[list(_STEM)].to_numpy(dtype=float).T
    x, y = x1.copy(), y1.copy()
    for _ in range(2):
        with np.errstate(invalid="ignore", divide="ignore"):
            a = (_heights_at(surface, x, y) - z1) / (z2 - z1)
        known = np.isfinite(a)
        x[known] = (x1 + a * (x2 - x1))[known]
        y[known] = (y1 + a * (y2 - y1))[known]
    moved = stems.geometry.to_numpy().copy()
    moved[known] = gpd.points_from_xy(x[known], y[known])
    return stems.set_geometry(gpd.GeoSeries(moved, index=stems.index, crs=stems.crs))


def site_reference_trees(
    site: Site, options: AssessParameters, crs: Any, *, min_height: float = 3.0
) -> dict[str, gpd.GeoDataFrame]:
    """Reference trees of a site by kind, points at their tops.

    Returns
    -------
    dict
        ``surveyed``: stems of the site's table that are thick enough, moved to where they reach the
        surface; of a virtual site besides ``true``: all trees from ``min_height`` (metres) on, and
        ``visible``: those of them that are seen from above. Kinds that the site lacks are left out.

    Raises
    ------
    AssessmentError, SiteError, VectorError
        As :func:`read_reference_trees`.
    """
    references = {}
    if site.reference_trees is not None:
        stems = thick_enough(
            read_reference_trees(site.reference_trees, crs),
            {"broadleaf": options.smallest_dbh_broadleaf, "conifer": options.smallest_dbh_conifer},
        )
        dsm = site.products / FOLDERS["surface"] / "dsm.tif"
        references["surveyed"] = extrapolate_tops(stems, read_raster(dsm)) if dsm.exists() else stems
    if site.truth is not None:
        trees = read_vector(site.truth / "trees.gpkg", crs=crs)
        points = trees.set_geometry(gpd.points_from_xy(trees["top_x"], trees["top_y"], crs=crs))
        tall = points[points["height_m"] >= min_height].reset_index(drop=True)
        references["true"] = tall
        references["visible"] = tall[tall["visible"]].reset_index(drop=True)
    return references


def thick_enough(stems: gpd.GeoDataFrame, smallest: Mapping[str, float] = SMALLEST_DBH) -> gpd.GeoDataFrame:
    """Stems from a least diameter on, by ``species_group``; a stem without diameter is kept.

    Thinner trees seldom reach the canopy and cannot be seen from above [thesis 3.4.1].
    """
    if "dbh_m" not in stems:
        return stems
    group = stems["species_group"] if "species_group" in stems else pd.Series("", index=stems.index)
    least = group.map(smallest).fillna(min(smallest.values()))
    return stems[~(stems["dbh_m"] < least)].reset_index(drop=True)


def _heights_at(surface: xr.DataArray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    grid = Grid.of(surface)
    column = np.floor((x - grid.west) / grid.resolution)
    row = np.floor((grid.north - y) / grid.resolution)
    inside = (row >= 0) & (row < grid.height) & (column >= 0) & (column < grid.width)
    heights = np.full(x.shape, np.nan)
    heights[inside] = surface.to_numpy()[row[inside].astype(int), column[inside].astype(int)]
    return heights


def _number_or_text(cell: str) -> float | str:
    try:
        return float(cell.replace(",", ".")) if cell else float("nan")
    except ValueError:
        return cell
