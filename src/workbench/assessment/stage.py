"""The assess stage: every product of a site against the references that the site has."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import xarray as xr

from workbench.assessment.crowns import compare_crowns
from workbench.assessment.reference_trees import site_reference_trees
from workbench.assessment.sampling import mask_accuracy
from workbench.assessment.surfaces import height_errors
from workbench.assessment.tree_matching import TreeMatch, match_trees
from workbench.params import AssessParameters, Parameters
from workbench.rasters import Grid, match_grid, new_raster, read_raster
from workbench.site import Site
from workbench.site.tables import read_table
from workbench.stages import FOLDERS, Stage, open_stage
from workbench.vectors import read_vector, write_layers

_TREES = ("broadleaf", "conifer", "dead_tree")


def assess_site(site: Site, parameters: Parameters) -> dict:
    """Compare surface, tree mask, tops and crowns with what the site knows of the truth.

    What is compared depends on the references: a virtual site has all of them (``truth/``), a real one
    perhaps surveyed trees (``reference_trees``). Reed is judged in its own stage, point by point of the
    field campaign. Writes ``heights.csv``, ``trees.gpkg`` (layers found, missed, false), ``crowns.csv``,
    ``scores.csv`` (tidy: product, score, class, value, low, high) and ``metrics.json``.

    Returns
    -------
    dict
        The metrics: ``compared`` lists the products that had a reference.

    Raises
    ------
    AssessmentError
        If a product and its reference do not fit together.
    """
    own = parameters.assess
    with open_stage(site.products / FOLDERS["assess"], {"assess": own}) as stage:
        scores: list[pd.DataFrame] = []
        compared: dict[str, Callable[[Site, Stage, AssessParameters], pd.DataFrame | None]] = {
            "surface": _assess_surface,
            "tree_mask": _assess_mask,
            "tops": _assess_tops,
            "crowns": _assess_crowns,
        }
        done = []
        for name, assess in compared.items():
            table = assess(site, stage, own)
            if table is not None:
                done.append(name)
                scores.append(table.assign(product=name))
        columns = ["product", "score", "class", "value", "low", "high"]
        tidy = pd.concat(scores)[columns] if scores else pd.DataFrame(columns=columns)
        tidy.to_csv(stage.path("scores.csv"), index=False, lineterminator="\n", float_format="%.6g")
        stage.metrics["compared"] = done
        if not done:
            stage.metrics["warnings"] = ["The site has no reference to compare its products with."]
    return stage.metrics


def _assess_surface(site: Site, stage: Stage, own: AssessParameters) -> pd.DataFrame | None:
    """Heights against the mean true height of each cell, by land cover."""
    dsm = _product(site, "surface", "dsm.tif")
    if dsm is None or site.truth is None:
        return None
    surface = read_raster(dsm)
    grid = Grid.of(surface)
    # The mean over a cell is what a camera sees of a porous crown; the topmost leaf is not.
    truth = match_grid(read_raster(site.truth / "dsm_mean.tif"), grid)
    cover = match_grid(read_raster(site.truth / "cover.tif"), grid, resampling="nearest")
    names = _cover_names(site)
    table = height_errors(surface, truth, cover, names, gross=own.gross_error)
    table.to_csv(stage.path("heights.csv"), index=False, lineterminator="\n", float_format="%.6g")
    stage.metrics["surface"] = {row["cover"]: _without(row, "cover") for row in table.to_dict("records")}
    tidy = table.melt("cover", var_name="score", value_name="value").rename(columns={"cover": "class"})
    return tidy.assign(low=np.nan, high=np.nan)


def _assess_mask(site: Site, stage: Stage, own: AssessParameters) -> pd.DataFrame | None:
    """The tree mask at random points."""
    path = _product(site, "trees", "mask.tif")
    if path is None or site.truth is None:
        return None
    mask = read_raster(path)
    cover = match_grid(read_raster(site.truth / "cover.tif"), Grid.of(mask), resampling="nearest")
    code = cover.to_numpy()
    true = np.isin(code, [value for value, name in _cover_names(site).items() if name in _TREES])
    # Cover 0 lies outside the scene and is unknown.
    reference = _like(mask, np.where(code > 0, true, np.nan), "true trees")
    matrix = mask_accuracy(
        _like(mask, np.nan_to_num(mask.to_numpy()) > 0, "mask"),
        reference,
        own.mask_points,
        design=own.mask_design,
        seed=own.seed,
    )
    stage.metrics["tree_mask"] = matrix.scores | {"counts": matrix.counts.tolist()}
    return matrix.intervals()


def _assess_tops(site: Site, stage: Stage, own: AssessParameters) -> pd.DataFrame | None:
    """Tops against surveyed trees; against all true trees and those visible from above as well."""
    path = _product(site, "trees", "trees.gpkg")
    if path is None or (site.reference_trees is None and site.truth is None):
        return None
    tops = read_vector(path, layer="tops")
    references = site_reference_trees(site, own, tops.crs)
    tables: list[pd.DataFrame] = []
    layers: dict[str, gpd.GeoDataFrame] = {}
    for name, trees in references.items():
        if trees.empty:
            continue
        # Where trees were surveyed is not recorded: their hull, widened by the distance of a match.
        area = trees.geometry.union_all().convex_hull.buffer(own.match_distance)
        match = match_trees(
            tops,
            trees,
            own.match_distance,
            method=own.match_method,
            height_difference=own.height_difference,
            area=area,
        )
        stage.metrics.setdefault("tops", {})[name] = match.scores
        intervals = match.intervals(repetitions=own.bootstrap, seed=own.seed)
        tables.append(intervals.assign(**{"class": name}))
        layers = layers or _judged(match, tops, trees)
    if layers:
        write_layers(layers, stage.path("trees.gpkg"))
    return pd.concat(tables) if tables else None


def _assess_crowns(site: Site, stage: Stage, own: AssessParameters) -> pd.DataFrame | None:
    """Crowns against the true ones that are visible from above."""
    path = _product(site, "trees", "trees.gpkg")
    truth = None if site.truth is None else site.truth / "trees.gpkg"
    if path is None or truth is None:
        return None
    crowns = read_vector(path, layer="crowns")
    trees = read_vector(truth, crs=crowns.crs)
    result = compare_crowns(crowns, trees[trees["visible"]].reset_index(drop=True))
    result.pairs.to_csv(stage.path("crowns.csv"), index=False, lineterminator="\n", float_format="%.6g")
    stage.metrics["crowns"] = result.scores
    rows = [(score, value) for score, value in result.scores.items() if isinstance(value, float)]
    table = pd.DataFrame(rows, columns=["score", "value"])
    table["class"] = ""
    return table.assign(low=np.nan, high=np.nan)


def _judged(match: TreeMatch, tops: gpd.GeoDataFrame, trees: gpd.GeoDataFrame) -> dict:
    """Layers for a map: found and false tops, missed trees; only those that are not empty."""
    layers = {
        "found": tops.iloc[match.pairs["top"]],
        "false": tops.iloc[match.false],
        "missed": trees.iloc[match.missed],
    }
    return {name: layer.reset_index(drop=True) for name, layer in layers.items() if len(layer)}


def _product(site: Site, verb: str, name: str) -> Path | None:
    folder = site.products / FOLDERS[verb]
    # metrics.json is written last: without it the stage was interrupted.
    return folder / name if (folder / "metrics.json").exists() and (folder / name).exists() else None


def _cover_names(site: Site) -> dict[int, str]:
    path = (site.truth or site.folder) / "cover.csv"
    return {int(row["code"]): row["cover"] for _, row in read_table(path, ["code", "cover"])}


def _like(raster: xr.DataArray, values: np.ndarray, name: str) -> xr.DataArray:
    return new_raster(values, Grid.of(raster), name=name, units="1")


def _without(row: dict, key: str) -> dict:
    return {name: value for name, value in row.items() if name != key}
