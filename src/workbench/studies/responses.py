"""What a cell of a study is asked for: groups of numbers from the products of its chain."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from workbench.assessment import height_errors, match_trees
from workbench.errors import StudyError
from workbench.params import Parameters
from workbench.rasters import Grid, match_grid, read_raster
from workbench.site import Site
from workbench.site.tables import read_table
from workbench.stages import FOLDERS, read_json
from workbench.surface.statistics import RATIO_CLASSES, count_statistics
from workbench.vectors import read_vector

Response = tuple[str, float, str]
"""Name, value, unit."""
Group = Callable[[Site, Site, Parameters], Iterator[Response]]
"""The products of a cell, the site with its truth, and the parameters of the cell."""

TREE_COVERS = ("broadleaf", "conifer", "dead_tree")


def geometry(run: Site, site: Site, parameters: Parameters) -> Iterator[Response]:
    """What was really flown: intersection angle on the ground and ground resolution."""
    metrics = read_json(run.products / FOLDERS["match"] / "metrics.json")
    yield "angle", float(metrics["angle_median_deg"]), "degree"
    yield "ground_resolution", float(metrics["ground_resolution_m"]), "m"
    yield "pairs", float(metrics["pairs"]), "1"
    yield "photographs", float(len(run.photographs)), "1"


def counts(run: Site, site: Site, parameters: Parameters) -> Iterator[Response]:
    """Count layer of the area and inside the true tree mask [thesis 3.2.1, tables 4.1-4.12]."""
    folder = run.products / FOLDERS["surface"]
    count, possible = read_raster(folder / "count.tif"), read_raster(folder / "possible_count.tif")
    trees = tree_mask(site, Grid.of(count))
    if trees is not None:
        # Beyond the scene nothing grows and nothing is known.
        known = _known(site, Grid.of(count))
        possible = possible.copy(data=np.where(known, possible.to_numpy(), 0))
        trees = count.copy(data=trees)
    statistics = count_statistics(count, possible, trees)
    table = statistics.histogram.set_index(["scope", "statistic", "value"])["percent"]
    for scope in ("area", "mask"):
        if scope not in table.index.get_level_values("scope"):
            continue
        for value in ("0", "1", "2", "3"):
            share = table.get((scope, "count", value), 0.0)
            yield f"count_{value}_{scope}", float(share), "%"
        for name in RATIO_CLASSES:
            yield f"v_{name}_{scope}", float(table[scope, "ratio", name]), "%"
    summary = statistics.summary.set_index(["scope", "statistic"])
    for scope in summary.index.get_level_values("scope").unique():
        yield f"count_mean_{scope}", float(summary.loc[(scope, "count"), "mean"]), "1"
        yield f"v_mean_{scope}", float(100 * summary.loc[(scope, "ratio"), "mean"]), "%"


def downscales(run: Site, site: Site, parameters: Parameters) -> Iterator[Response]:
    """Unmatched share of each downscale, and what the fused surface leaves [thesis table 4.11]."""
    metrics = read_json(run.products / FOLDERS["surface"] / "metrics.json")
    for name, share in metrics["unmatched_share"].items():
        yield f"unmatched_{name}", 100 * float(share), "%"
    yield "no_data", 100 * float(metrics["no_data_share"]), "%"


def heights(run: Site, site: Site, parameters: Parameters) -> Iterator[Response]:
    """Errors of the surface by land cover, against the mean true height of each cell."""
    truth = _truth(site, "heights")
    surface = read_raster(run.products / FOLDERS["surface"] / "dsm.tif")
    grid = Grid.of(surface)
    cover = match_grid(read_raster(truth / "cover.tif"), grid, resampling="nearest")
    true = match_grid(read_raster(truth / "dsm_mean.tif"), grid)
    for row in height_errors(surface, true, cover, cover_names(site)).to_dict("records"):
        yield f"coverage_{row['cover']}", 100 * row["coverage"], "%"
        for name in ("bias_m", "nmad_m", "rmse_m"):
            yield f"{name.removesuffix('_m')}_{row['cover']}", row[name], "m"


def tops(run: Site, site: Site, parameters: Parameters) -> Iterator[Response]:
    """Completeness and correctness of the tops over visible and over all trees [thesis 4.18-4.20]."""
    truth = _truth(site, "tops")
    found = read_vector(run.products / FOLDERS["trees"] / "trees.gpkg", layer="tops")
    trees = read_vector(truth / "trees.gpkg", crs=found.crs)
    trees = trees[trees["height_m"] >= parameters.trees.min_height]
    points = trees.set_geometry(
        trees.set_crs(found.crs, allow_override=True).geometry.from_xy(
            trees["top_x"], trees["top_y"], crs=found.crs
        )
    )
    area = trees.union_all().buffer(1.0)
    for name, chosen in (("visible", points[points["visible"]]), ("all", points)):
        match = match_trees(
            found,
            chosen.reset_index(drop=True),
            parameters.assess.match_distance,
            method=parameters.assess.match_method,
            area=area,
        )
        for score in ("completeness", "correctness", "f1"):
            yield f"{score}_{name}", 100 * getattr(match, score), "%"


def reed(run: Site, site: Site, parameters: Parameters) -> Iterator[Response]:
    """Every number that the reed stage reports."""
    metrics = read_json(run.products / FOLDERS["reed"] / "metrics.json")
    yield from _numbers(metrics, "")


GROUPS: dict[str, tuple[Group, tuple[str, ...]]] = {
    "geometry": (geometry, ("match",)),
    "counts": (counts, ("surface",)),
    "downscales": (downscales, ("surface",)),
    "heights": (heights, ("surface",)),
    "tops": (tops, ("mosaic", "trees")),
    "reed": (reed, ("reed",)),
}
"""Group of responses -> function, and the last stages that it needs."""


def require_groups(names: list[str]) -> None:
    """Refuse groups that no stage gives.

    Raises
    ------
    StudyError
        With the groups that there are.
    """
    unknown = [name for name in names if name not in GROUPS]
    if unknown:
        raise StudyError(f"No responses {', '.join(unknown)}: choose from {', '.join(GROUPS)}.")


def tree_mask(site: Site, grid: Grid) -> np.ndarray | None:
    """True tree mask on the cells of a grid, bool; None where the site has no truth."""
    if site.truth is None:
        return None
    cover = match_grid(read_raster(site.truth / "cover.tif"), grid, resampling="nearest")
    codes = [code for code, name in cover_names(site).items() if name in TREE_COVERS]
    return np.isin(cover.to_numpy(), codes)


def cover_names(site: Site) -> dict[int, str]:
    """Land cover of each code of the truth."""
    path = _truth(site, "land cover") / "cover.csv"
    return {int(row["code"]): row["cover"] for _, row in read_table(path, ["code", "cover"])}


def _known(site: Site, grid: Grid) -> np.ndarray:
    cover = match_grid(read_raster(_truth(site, "counts") / "cover.tif"), grid, resampling="nearest")
    return cover.to_numpy() > 0


def _truth(site: Site, what: str):
    if site.truth is None:
        raise StudyError(f"Site {site.name} has no truth to judge its {what} by: ask for other responses.")
    return site.truth


def _numbers(values: dict, prefix: str) -> Iterator[Response]:
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _numbers(value, f"{prefix}{name}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield f"{prefix}{name}", float(value), "1"
