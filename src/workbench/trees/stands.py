"""Stands: the table of an inventory from single trees, and the type of a stand per tree."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from workbench.errors import TreesError
from workbench.params import TreesParameters

_DEFAULTS = TreesParameters()
StandClassifier = Callable[[gpd.GeoDataFrame], np.ndarray]
"""From tops to their stand types, (n,) texts; any function of this form may take its place."""


def stand_types(tops: gpd.GeoDataFrame, stands: gpd.GeoDataFrame | StandClassifier | None) -> np.ndarray:
    """Type of stand of every top: ``conifer``, ``broadleaf`` or any other word; empty where unknown.

    Parameters
    ----------
    tops
        Points.
    stands
        Polygons with a column ``stand_type`` in any CRS (of several the first one), a function from tops
        to types, or None.

    Raises
    ------
    TreesError
        If polygons lack the column, or a function answers with another number of types.
    """
    if stands is None:
        return np.full(len(tops), "", dtype=object)
    if callable(stands):
        types = np.asarray(stands(tops), dtype=object)
        if types.shape != (len(tops),):
            raise TreesError(f"The classifier gives {types.shape} types for {len(tops)} tops: one for each.")
        return types
    polygons = cast(gpd.GeoDataFrame, stands)
    if "stand_type" not in polygons:
        raise TreesError(f"Stands need a column stand_type; theirs are {sorted(polygons.columns)}.")
    polygons = polygons.to_crs(tops.crs)
    types = np.full(len(tops), "", dtype=object)
    x, y = tops.geometry.x.to_numpy(), tops.geometry.y.to_numpy()
    for shape, name in zip(polygons.geometry[::-1], polygons["stand_type"][::-1], strict=True):
        types[shapely.intersects_xy(shape, x, y)] = name
    return types


def stand_table(
    tops: gpd.GeoDataFrame,
    crowns: gpd.GeoDataFrame,
    areas: gpd.GeoDataFrame,
    *,
    name: str = "stand",
    height_class: float = _DEFAULTS.height_class,
) -> pd.DataFrame:
    """Stems per hectare, heights and crown cover of every area.

    Parameters
    ----------
    tops, crowns
        Of :func:`find_tops` and :func:`grow_crowns`.
    areas
        Polygons with a column ``name``; their whole area counts, with trees or not.
    name
        Column that names the areas.
    height_class
        Width of the height classes, metres.

    Returns
    -------
    DataFrame
        A row an area: ``stand``, ``area_ha``, ``stems``, ``stems_per_ha``, ``height_mean_m``,
        ``height_sd_m``, ``height_top_m`` (mean of the 100 tallest stems per hectare; where there are
        fewer, as in parks and savannas, of the tallest fifth of the stems),
        ``crown_cover`` (share of the area under crowns, 0..1), ``crown_diameter_m`` (mean),
        ``interpolated`` (share of tops on interpolated cells), and a column per height class, as
        ``stems_per_ha_5_10``.

    Raises
    ------
    TreesError
        If the column is missing, the class has no width, or CRS differ.
    """
    if name not in areas:
        raise TreesError(f"Areas need a column {name}; theirs are {sorted(areas.columns)}.")
    if not height_class > 0:
        raise TreesError(f"Height classes of {height_class} m hold no tree: give a positive width.")
    if crowns.crs != tops.crs:
        raise TreesError(f"Tops are in {tops.crs}, crowns in {crowns.crs}: bring both to one CRS.")
    areas = areas.to_crs(tops.crs)
    highest = float(tops["height_m"].max()) if len(tops) else height_class
    edges = np.arange(0.0, highest + height_class, height_class)
    shapes = crowns.geometry.to_numpy()
    rows = []
    for shape, label in zip(areas.geometry, areas[name], strict=True):
        shapely.prepare(shape)
        inside = tops[shapely.intersects_xy(shape, tops.geometry.x, tops.geometry.y)]
        mine = crowns[crowns["tree_id"].isin(inside["tree_id"])]
        touching = shapes[shapely.intersects(shapes, shape)]
        covered = float(shapely.area(shapely.intersection(touching, shape)).sum())
        heights = np.sort(inside["height_m"].to_numpy(float))[::-1]
        hectares = shape.area / 1e4
        dominant = heights[: _dominant(len(heights), hectares)]
        row = {
            "stand": label,
            "area_ha": hectares,
            "stems": len(heights),
            "stems_per_ha": len(heights) / hectares,
            "height_mean_m": heights.mean() if len(heights) else np.nan,
            "height_sd_m": heights.std(ddof=1) if len(heights) > 1 else np.nan,
            "height_top_m": dominant.mean() if len(heights) else np.nan,
            "crown_cover": covered / shape.area,
            "crown_diameter_m": mine["diameter_m"].mean(),
            "interpolated": inside["interpolated"].mean() if "interpolated" in inside else np.nan,
        }
        counts = np.histogram(heights, edges)[0]
        for low, count in zip(edges[:-1], counts, strict=True):
            row[f"stems_per_ha_{low:g}_{low + height_class:g}"] = count / hectares
        rows.append(row)
    return pd.DataFrame(rows)


def _dominant(stems: int, hectares: float) -> int:
    """Number of stems that make the top height: after Assmann 100 per hectare, else Weise's fifth."""
    number = round(100 * hectares)
    return max(number if stems > number else round(stems / 5), 1)
