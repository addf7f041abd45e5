"""What a cell of a study is asked for: groups of numbers from the products of its chain."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from scipy.stats import spearmanr

from workbench.assessment import height_errors
from workbench.errors import StudyError
from workbench.params import Parameters
from workbench.rasters import Grid, match_grid, read_raster
from workbench.site import Site
from workbench.site.tables import read_table
from workbench.stages import FOLDERS, read_json
from workbench.studies.tree_responses import crowns, tops
from workbench.surface.filling import fill_heights
from workbench.surface.statistics import RATIO_CLASSES, count_statistics

Response = tuple[str, float, str]
"""Name, value, unit."""
Group = Callable[[Site, Site, Parameters], Iterator[Response]]
"""The products of a cell, the site with its truth, and the parameters of the cell."""

LARGEST_COUNT = 11
"""The largest count in the tables of the thesis (4.9)."""
RIGHT_WITHIN = 0.5
"""A cell is right if it was measured and is no farther than this from the truth, m."""
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
    cells = tree_mask(site, Grid.of(count))
    trees = None if cells is None else count.copy(data=cells)
    if trees is not None:
        # Beyond the scene nothing grows and nothing is known.
        known = _known(site, Grid.of(count))
        possible = possible.copy(data=np.where(known, possible.to_numpy(), 0))
    statistics = count_statistics(count, possible, trees)
    table = statistics.histogram.set_index(["scope", "statistic", "value"])["percent"]
    for scope in ("area", "mask"):
        if scope not in table.index.get_level_values("scope"):
            continue
        for value in range(LARGEST_COUNT + 1):
            share = table.get((scope, "count", str(value)), 0.0)
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
    """Errors of the surface by land cover, against the mean true height of each cell.

    ``right_trees`` is the share of tree cells that were measured within :data:`RIGHT_WITHIN`: it falls with
    lost matches and with wrong heights alike.
    """
    truth = _truth(site, "heights")
    surface = read_raster(run.products / FOLDERS["surface"] / "dsm.tif")
    grid = Grid.of(surface)
    cover = match_grid(read_raster(truth / "cover.tif"), grid, resampling="nearest")
    true = match_grid(read_raster(truth / "dsm_mean.tif"), grid)
    for row in height_errors(surface, true, cover, cover_names(site)).to_dict("records"):
        yield f"coverage_{row['cover']}", 100 * row["coverage"], "%"
        for name in ("bias_m", "nmad_m", "rmse_m"):
            yield f"{name.removesuffix('_m')}_{row['cover']}", row[name], "m"
    trees = tree_mask(site, grid)
    if trees is not None and trees.any():
        error = np.abs(surface.to_numpy() - true.to_numpy())[trees]
        measured = error[np.isfinite(error)]
        yield "right_trees", 100 * float((error <= RIGHT_WITHIN).mean()), "%"
        yield "p68_trees", float(np.quantile(measured, 0.683)) if measured.size else float("nan"), "m"


def filling(run: Site, site: Site, parameters: Parameters) -> Iterator[Response]:
    """Holes of the finest downscale: their heights from coarser ones against interpolation [thesis 5.1].

    Both are judged in the same cells: not measured at the finest downscale, measured at a coarser one.
    Nothing where only one downscale was matched.
    """
    folder = run.products / FOLDERS["surface"]
    provenance = read_raster(folder / "provenance.tif")
    finest, *coarser = sorted(int(path.stem.removeprefix("dsm_ds")) for path in folder.glob("dsm_ds*.tif"))
    if not coarser:
        return
    grid = Grid.of(provenance)
    true = match_grid(read_raster(_truth(site, "filling") / "dsm_mean.tif"), grid).to_numpy()
    cells = np.isin(provenance.to_numpy(), coarser) & np.isfinite(true)
    whole = slice(0, grid.height), slice(0, grid.width)
    interpolated, _ = fill_heights(read_raster(folder / f"dsm_ds{finest}.tif")).window(*whole)
    fused = read_raster(folder / "dsm.tif").to_numpy()
    yield "filled_cells", float(cells.sum()), "1"
    for name, values in (("fused", fused), ("interpolated", interpolated)):
        error = (values - true)[cells]
        yield f"rmse_{name}", float(np.sqrt(np.mean(error**2))) if error.size else float("nan"), "m"


def tie_points(run: Site, site: Site, parameters: Parameters) -> Iterator[Response]:
    """Errors of the check points at every threshold of the tie points [orthomosaic paper 2.4]."""
    table = pd.read_csv(run.products / FOLDERS["orient"] / "optimisation.csv")
    for row in table.to_dict("records"):
        for name in ("check_xy", "check_z"):
            yield f"{name}@{row['threshold_px']:g}", float(row[f"{name}_m"]), "m"
        yield f"tie_points@{row['threshold_px']:g}", float(row["tie_points"]), "1"


def reed(run: Site, site: Site, parameters: Parameters) -> Iterator[Response]:
    """Every number that the reed stage reports, and its agreement with the depth and fray that are true."""
    folder = run.products / FOLDERS["reed"]
    yield from _numbers(read_json(folder / "metrics.json"), "")
    if (folder / "heights.csv").exists():
        points = pd.read_csv(folder / "heights.csv").dropna(subset=["field_m", "surface_m", "water_depth_m"])
        for name in ("field_m", "surface_m"):
            rho = spearmanr(points["water_depth_m"], points[name]).statistic if len(points) > 2 else np.nan
            yield f"depth_rank_{name.removesuffix('_m')}", float(rho), "1"
    if site.plots is not None and site.field_points is not None:
        yield "depth_rank_stems", _depth_and_stems(site.field_points, site.plots), "1"
    sections = pd.read_csv(folder / "sections.csv")
    for aoi, part in sections.groupby("aoi", sort=False):
        yield f"sinuosity.{aoi}", float(part["sinuosity"].mean()), "1"


def _depth_and_stems(field_points: Path, field_plots: Path) -> float:
    """Rank correlation of water depth and stems per square metre over the plots of the campaign."""
    points = pd.read_csv(field_points).dropna(subset=["water_depth_m"])
    plots = pd.read_csv(field_plots)
    if len(points) < 3 or len(plots) < 3:
        return float("nan")
    _, nearest = cKDTree(points[["x", "y"]]).query(plots[["x", "y"]])
    depth = points["water_depth_m"].to_numpy()[nearest]
    return float(spearmanr(depth, plots["stems_per_m2"], nan_policy="omit").statistic)


GROUPS: dict[str, tuple[Group, tuple[str, ...]]] = {
    "tie_points": (tie_points, ("orient",)),
    "geometry": (geometry, ("match",)),
    "counts": (counts, ("surface",)),
    "downscales": (downscales, ("surface",)),
    "heights": (heights, ("surface",)),
    "filling": (filling, ("surface",)),
    "tops": (tops, ("trees",)),
    "crowns": (crowns, ("trees",)),
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
    """Cells of a grid within the scene: beyond it the matched raster holds no code of a land cover."""
    cover = match_grid(read_raster(_truth(site, "counts") / "cover.tif"), grid, resampling="nearest")
    return np.isin(cover.to_numpy(), [code for code in cover_names(site) if code > 0])


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
