"""Single trees in the report: tops and crowns on the orthophoto, heights, stand table."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from workbench.figures.maps import draw_orthophoto, draw_values, figure
from workbench.figures.sections import Picture, Section, Table, facts, written
from workbench.rasters import read_overview
from workbench.site import Site
from workbench.stages import FOLDERS, read_json
from workbench.vectors import read_vector

_LABELS = {
    "ground": "heights are measured from",
    "indices": "vegetation by",
    "mask_share": "tree mask (share of the area)",
    "trees": "trees",
    "height_mean_m": "mean height (m)",
    "height_max_m": "greatest height (m)",
    "height_sd_median_m": "precision of a height, median (m)",
    "tops_interpolated": "tops on interpolated heights",
    "crowns": "crowns",
    "crown_diameter_mean_m": "mean crown diameter (m)",
    "crown_area_m2": "crown area (m2)",
}
_STAND = {
    "stand": "stand",
    "area_ha": "area (ha)",
    "stems": "stems",
    "stems_per_ha": "stems per ha",
    "height_mean_m": "mean height (m)",
    "height_sd_m": "standard deviation (m)",
    "height_top_m": "top height (m)",
    "crown_cover": "crown cover (share)",
    "crown_diameter_m": "crown diameter (m)",
}
_MANY = 1500  # More trees than this are dots, not outlines.
_MARGIN = 6.0


def trees_section(site: Site) -> Section:
    """Map of tops and crowns, distribution of heights, stand table."""
    folder = site.products / FOLDERS["trees"]
    metrics = read_json(folder / "metrics.json")
    if "skipped" in metrics:
        return Section("Single trees", f"Not measured: {metrics['skipped']}")
    tables = [facts(metrics, _LABELS, title="Mask, tops and crowns.")]
    if (folder / "stands.csv").exists():
        tables.append(_stands(folder / "stands.csv"))
    tops, crowns = (read_vector(folder / "trees.gpkg", layer=layer) for layer in ("tops", "crowns"))
    if tops.empty:
        return Section("Single trees", "No tree was found.", tables=tables)
    pictures = [
        _map(site, tops, crowns, on="ortho"),
        _map(site, tops, crowns, on="height"),
        _distribution(tops, crowns),
    ]
    return Section("Single trees", tables=tables, pictures=pictures)


def _stands(path: Path) -> Table:
    table = pd.read_csv(path)
    shown = {key: label for key, label in _STAND.items() if key in table}
    rows = [[written(value) for value in row] for row in table[list(shown)].itertuples(index=False)]
    return Table(rows, list(shown.values()), "Stands.")


def _map(site: Site, tops: gpd.GeoDataFrame, crowns: gpd.GeoDataFrame, *, on: str) -> Picture:
    ortho = site.products / FOLDERS["mosaic"] / "ortho.tif"
    ndsm = site.products / FOLDERS["surface"] / "ndsm.tif"
    drawing, axes = figure()
    if on == "ortho" and ortho.exists():
        draw_orthophoto(axes, read_overview(ortho, longest=2400))
        colour, what = "#ffd400", "true orthophoto"
    else:
        draw_values(
            axes, read_overview(ndsm, longest=2400), label="height above ground (m)", cmap="YlGn", vmin=0
        )
        colour, what = "#0b3d91", "height above ground"
    if len(tops) <= _MANY:
        crowns.boundary.plot(ax=axes, color=colour, lw=0.7)
    axes.scatter(tops.geometry.x, tops.geometry.y, s=_dot(len(tops)), c="#d1495b", marker="^", lw=0)
    west, south, east, north = tops.total_bounds
    axes.set_xlim(west - _MARGIN, east + _MARGIN)
    axes.set_ylim(south - _MARGIN, north + _MARGIN)
    outlines = " and outlines of crowns" if len(tops) <= _MANY else ""
    return Picture.of(drawing, f"Tree tops (triangles){outlines} on the {what}.")


def _distribution(tops: gpd.GeoDataFrame, crowns: gpd.GeoDataFrame) -> Picture:
    drawing = Figure(figsize=(6.2, 3.2), layout="constrained")
    left, right = drawing.subplots(1, 2)
    left.hist(tops.height_m, bins=_bins(tops.height_m.to_numpy()), color="#1f6f5c")
    left.set_xlabel("tree height (m)")
    left.set_ylabel("trees")
    both = crowns.merge(tops.drop(columns="geometry"), on="tree_id", suffixes=("", "_top"))
    right.scatter(both.height_m, both.diameter_m, s=8, alpha=0.6, color="#1f6f5c")
    right.set_xlabel("tree height (m)")
    right.set_ylabel("crown diameter (m)")
    return Picture.of(drawing, "Distribution of tree heights, and crown diameter by height.")


def _bins(values: np.ndarray) -> np.ndarray:
    top = float(np.ceil(values.max())) + 1
    return np.arange(0, top + 1, 1.0 if top <= 45 else 2.0)


def _dot(count: int) -> float:
    return 16.0 if count < 300 else 8.0 if count < _MANY else 2.0
