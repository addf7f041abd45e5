"""Responses of the tree stage: tops and crowns against the true trees of a virtual scene."""

from __future__ import annotations

from collections.abc import Iterator

import geopandas as gpd
import numpy as np
import shapely

from workbench.assessment import compare_crowns, match_trees
from workbench.errors import StudyError
from workbench.params import Parameters
from workbench.rasters import Grid, read_raster
from workbench.site import Site
from workbench.stages import FOLDERS
from workbench.surface import bilateral
from workbench.surface.fusion import INTERPOLATED
from workbench.trees.tops import find_tops
from workbench.trees.windows import GrowingWindow
from workbench.vectors import read_vector

FREE_FROM = 1.0
"""A tree is free-standing if the crown of no other tree is nearer to its own than this, m."""


def tops(run: Site, site: Site, parameters: Parameters) -> Iterator[tuple[str, float, str]]:
    """Completeness and correctness of the tops within the scene [thesis 4.18-4.20].

    ``visible``: trees that are seen from above, the reference of all that follows; ``all``: hidden ones too;
    ``free`` and ``closed``: free-standing and the others (completeness only, over all visible matches);
    ``interpolated`` and ``measured``: by the source of the height at the true top; ``filtered``: tops
    sought on the bilateral-filtered surface.
    """
    folder = run.products / FOLDERS["surface"]
    found = read_vector(run.products / FOLDERS["trees"] / "trees.gpkg", layer="tops")
    trees, area = true_trees(site, parameters, found.crs)
    for name, chosen in (("visible", trees[trees["visible"]]), ("all", trees)):
        match = _match(found, chosen, area, parameters)
        for score in ("completeness", "correctness", "f1"):
            yield f"{score}_{name}", 100 * getattr(match, score), "%"
    visible = trees[trees["visible"]].reset_index(drop=True)
    hit = np.isin(np.arange(len(visible)), _match(found, visible, area, parameters).pairs["reference"])
    inside = shapely.intersects(area, visible.geometry.to_numpy())
    free = free_standing(visible)
    provenance = read_raster(folder / "provenance.tif")
    filled = _at(provenance, visible) == INTERPOLATED
    parts = {"free": free, "closed": ~free, "interpolated": filled, "measured": ~filled}
    for name, part in parts.items():
        chosen = hit[part & inside]
        yield f"completeness_{name}", 100 * float(chosen.mean()) if chosen.size else float("nan"), "%"
        yield f"trees_{name}", float(chosen.size), "1"
    options = parameters.trees
    height = read_raster(folder / "ndsm.tif")
    smooth = height.copy(
        data=bilateral(height.to_numpy(), options.smoothing_size, sigma_range=options.smoothing_sigma)
    )
    window = GrowingWindow(
        options.window_start, options.window_growth, options.window_smallest, options.window_largest
    )
    smoothed = find_tops(
        smooth,
        read_raster(run.products / FOLDERS["trees"] / "mask.tif"),
        min_height=options.min_height,
        window=window,
        working_resolution=options.working_resolution,
    )
    filtered = _match(smoothed, visible, area, parameters)
    yield "completeness_filtered", 100 * filtered.completeness, "%"
    yield "f1_filtered", 100 * filtered.f1, "%"


def crowns(run: Site, site: Site, parameters: Parameters) -> Iterator[tuple[str, float, str]]:
    """Crowns against the true crowns of visible trees within the scene [thesis 3.4.2]."""
    found = read_vector(run.products / FOLDERS["trees"] / "trees.gpkg", layer="crowns")
    trees, area = true_trees(site, parameters, found.crs)
    true = trees[trees["visible"]].set_geometry("crown")
    inside = true[true.geometry.centroid.within(area)].reset_index(drop=True)
    result = compare_crowns(found, inside[["tree_id", "crown"]].rename_geometry("geometry"))
    # Crowns that no top found count as an overlap of nothing: else few, easy crowns would win.
    iou = float(result.pairs["iou"].sum()) / result.reference if result.reference else float("nan")
    yield "crown_iou", 100 * iou, "%"
    yield "crown_iou_of_pairs", 100 * result.mean_iou, "%"
    yield "crown_completeness", 100 * result.completeness, "%"


def true_trees(site: Site, parameters: Parameters, crs: object) -> tuple[gpd.GeoDataFrame, shapely.Polygon]:
    """Living and dead trees of at least the stage's height, as points of their tops, and the scene's area.

    The column ``crown`` holds the outlines.

    Raises
    ------
    StudyError
        If the site has no truth.
    """
    if site.truth is None:
        raise StudyError(f"Site {site.name} has no truth to judge its trees by: ask for other responses.")
    trees = read_vector(site.truth / "trees.gpkg", crs=crs)
    trees = trees[trees["height_m"] >= parameters.trees.min_height].reset_index(drop=True)
    trees["crown"] = trees.geometry
    points = gpd.points_from_xy(trees["top_x"], trees["top_y"], crs=crs)
    area = shapely.box(*Grid.of(read_raster(site.truth / "cover.tif")).bounds)
    return trees.set_geometry(points), area


def free_standing(trees: gpd.GeoDataFrame) -> np.ndarray:
    """Whether the crown of each tree (column ``crown``) stands away from all others, bool."""
    outlines = trees["crown"].to_numpy()
    first, second = shapely.STRtree(outlines).query(outlines, predicate="dwithin", distance=FREE_FROM)
    free = np.ones(len(trees), dtype=bool)
    free[first[first != second]] = False
    return free


def _match(found: gpd.GeoDataFrame, trees: gpd.GeoDataFrame, area: shapely.Polygon, parameters: Parameters):
    own = parameters.assess
    return match_trees(
        found, trees.reset_index(drop=True), own.match_distance, method=own.match_method, area=area
    )


def _at(raster, points: gpd.GeoDataFrame) -> np.ndarray:
    """Values of a raster at points; 0 outside."""
    grid = Grid.of(raster)
    columns = np.floor((points.geometry.x.to_numpy() - grid.west) / grid.resolution).astype(int)
    rows = np.floor((grid.north - points.geometry.y.to_numpy()) / grid.resolution).astype(int)
    inside = (rows >= 0) & (rows < grid.height) & (columns >= 0) & (columns < grid.width)
    values = np.zeros(len(points), dtype=raster.dtype)
    values[inside] = raster.to_numpy()[rows[inside], columns[inside]]
    return values
