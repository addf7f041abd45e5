"""Two dates of one shore: change of the extent and retreat of the front."""

from __future__ import annotations

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from workbench.errors import ReedError
from workbench.reed.measure import ReedMetrics


@dataclass(frozen=True, eq=False)
class ReedChange:
    """What changed between two dates on ground that is known on both."""

    totals: dict[str, float]
    """``lost_m2``, ``gained_m2``, ``kept_m2``, ``unknown_m2`` (known on one date at most, m²)."""
    areas: gpd.GeoDataFrame
    """``change`` (lost, gained, kept) and its polygon."""
    sections: gpd.GeoDataFrame
    """Per section: ``aoi, section, retreat_m`` (mean over its width, positive towards the shore, NaN
    where a date has no front)``, lost_m2, gained_m2, arsi_before, arsi_after, status_before,
    status_after``."""


def compare_dates(before: ReedMetrics, after: ReedMetrics) -> ReedChange:
    """Compare the reed of two dates.

    The retreat of a section is the area lost minus the area gained within the boxes of both dates over
    the straight length of the front: the mean distance by which the front moved, independent of how
    ragged it is. Islets and holes that come or go count with their area.

    Parameters
    ----------
    before, after
        Measured with the same transects or shore; surfaces may lie on different grids of one CRS.

    Raises
    ------
    ReedError
        If the surfaces have different CRS or no section in common.
    """
    if before.extent.grid.crs != after.extent.grid.crs:
        raise ReedError(
            f"The dates are in {before.extent.grid.crs} and {after.extent.grid.crs}: reproject one surface."
        )
    known = shapely.intersection(before.extent.lake, after.extent.lake)
    dark = shapely.union(before.extent.unknown, after.extent.unknown)
    known = shapely.difference(known, dark)
    first, second = (shapely.intersection(m.extent.reed, known) for m in (before, after))
    shapes = {
        "lost": shapely.difference(first, second),
        "gained": shapely.difference(second, first),
        "kept": shapely.intersection(first, second),
    }
    areas = gpd.GeoDataFrame(
        {"change": list(shapes), "area_m2": [shape.area for shape in shapes.values()]},
        geometry=list(shapes.values()),
        crs=before.extent.grid.crs,
    )
    totals = {f"{name}_m2": shape.area for name, shape in shapes.items()} | {"unknown_m2": dark.area}
    return ReedChange(totals, areas, _sections(before, after, shapes["lost"], shapes["gained"]))


def _sections(
    before: ReedMetrics, after: ReedMetrics, lost: shapely.Geometry, gained: shapely.Geometry
) -> gpd.GeoDataFrame:
    keys = ["aoi", "section"]
    columns = [*keys, "straight_m", "arsi", "status", "geometry"]
    both = before.sections[columns].merge(after.sections[columns], on=keys, suffixes=("_before", "_after"))
    if both.empty:
        raise ReedError("The two dates have no section in common: measure both with the same transects.")
    boxes = shapely.union(both.geometry_before.to_numpy(), both.geometry_after.to_numpy())
    less, more = (shapely.area(shapely.intersection(boxes, shape)) for shape in (lost, gained))
    width = (both.straight_m_before + both.straight_m_after).to_numpy() / 2
    fronts = (both.straight_m_before > 0) & (both.straight_m_after > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        retreat = np.where(fronts, (less - more) / width, np.nan)
    table = pd.DataFrame(both[keys]).assign(retreat_m=retreat, lost_m2=less, gained_m2=more)
    for name in ("arsi", "status"):
        for date in ("before", "after"):
            table[f"{name}_{date}"] = both[f"{name}_{date}"].to_numpy()
    return gpd.GeoDataFrame(table, geometry=boxes, crs=before.sections.crs)
