"""The reed paper on a virtual lake: fourteen areas flown with the 3K rig, through the whole chain.

``python benchmarks/reed_lake.py ROOT --fly`` makes two sites below ROOT, ``chiemsee14`` (the rig of three
cameras, three strips, so that each camera sees the shore once) and ``chiemsee14_nadir`` (its nadir camera
alone), and runs orientation (by recorded positions, as the authors did), matching, surface and orthophoto:
about half an hour on two cores; what is there already is kept. ``--areas 3`` flies the first three areas
only, ``--seed 77`` another lake of the same kind. Without ``--fly`` it prints, of the sites that are there:
heights by area beside table 1, error matrices beside tables 2 to 4 (thresholds of the paper, and tuned on
the odd areas and tested on the even ones, and the other way round), what limits them, and the numbers behind
R01 to R10.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
import yaml
from scipy.spatial import cKDTree
from scipy.stats import spearmanr

import workbench.virtual
from workbench.params import Parameters, ReedParameters
from workbench.rasters import Grid, new_raster, read_raster
from workbench.reed import (
    ReedMetrics,
    ReedModel,
    References,
    agreement_by_area,
    agreements,
    compare_heights,
    load_model,
    load_references,
    of_areas,
    tune_thresholds,
)
from workbench.reed.findings import (
    coverage_finding,
    depth_findings,
    front_finding,
    height_findings,
    matrix_findings,
)
from workbench.site import Site, load_site
from workbench.vectors import read_vector
from workbench.virtual import load_scene, simulate_scene

SCENE = "chiemsee14"
RIG = {"camera": "3K", "frame": (900, 3328), "strips": 3, "side_overlap": 0.75}
SITES = {SCENE: RIG, f"{SCENE}_nadir": {}}
ODD = [str(area) for area in range(1, 15, 2)]
EVEN = [str(area) for area in range(2, 15, 2)]
WAYS = {
    "defaults": ReedParameters(),
    "outlines along pixels as the authors drew them": ReedParameters(front_smoothing=0.0),
    "outlines along pixels, front at half the height of the stand": ReedParameters(
        front_smoothing=0.0, edge_share=0.5
    ),
}
VARIANCE_CUTS = (0.001, 0.002, 0.003, 0.005, 0.007, 0.01, 0.015, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3)
ARSI_CUTS = tuple(np.arange(4.0, 20.1, 0.5))
AIMS = {"extent": 93.0, "density": 75.0, "status": 88.0}
PUBLISHED = Path(__file__).parents[1] / "data" / "published"


def fly(root: Path, inflight: int, areas: int, seed: int | None) -> None:
    """Make both sites, and their products up to the orthophoto."""
    from workbench.matching import match_site
    from workbench.mosaic import mosaic_site
    from workbench.orientation import orient_site
    from workbench.surface import surface_site

    parameters = Parameters()
    parameters = parameters.model_copy(
        update={
            "orient": parameters.orient.model_copy(update={"georeference": "positions"}),
            "match": parameters.match.model_copy(update={"inflight": inflight}),
        }
    )
    stages = {
        "orientation": orient_site,
        "matching": match_site,
        "surface": surface_site,
        "mosaic": mosaic_site,
    }
    for name, overrides in SITES.items():
        if not (root / "data" / "sites" / name / "site.yaml").exists():
            simulate_scene(
                part_of_scene(root, areas, seed),
                root,
                parameters,
                flight_overrides=overrides,
                site_name=name,
            )
        site = load_site(name, root)
        for folder, stage in stages.items():
            if not (site.products / folder / "metrics.json").exists():
                start = time.perf_counter()
                stage(site, parameters)
                print(f"{name} {folder}: {time.perf_counter() - start:.0f} s", flush=True)


def part_of_scene(root: Path, areas: int, seed: int | None = None) -> str | Path:
    """The scene, or a file with its first areas only, or with other reed and ground of the same kind."""
    scene = yaml.safe_load((Path(workbench.virtual.__file__).parent / "scenes" / f"{SCENE}.yaml").read_text())
    if areas >= len(scene["reed"]) and seed is None:
        return SCENE
    if areas < len(scene["reed"]):
        scene["reed"] = scene["reed"][:areas]
        length = scene["reed"][-1]["along"][1] + scene["lake"]["outline"][0][0] + 20.0
        scene["size"][0] = length
        scene["targets"] = [target for target in scene["targets"] if target["x"] < length - 5]
    scene["seed"] = scene["seed"] if seed is None else seed
    file = root / f"{SCENE}_{areas}{'' if seed is None else f'_{seed}'}.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(yaml.safe_dump(scene))
    return file


def heights(compared: pd.DataFrame) -> None:
    """Table 1 beside the published one."""
    table = agreement_by_area(compared).set_index("aoi")
    published = pd.read_csv(PUBLISHED / "reed_table1_height_rmse.csv", dtype={"aoi": str}).set_index("aoi")
    table = table.join(published[["rmse_cm", "r2"]].rename(columns={"r2": "r2_published"}))
    table["rmse_published"] = table.pop("rmse_cm") / 100
    show("Heights by area (table 1), m", table.round(2))


def matrices(model: ReedModel, references: References, options: ReedParameters, title: str) -> None:
    """Tables 2 to 4 beside the published ones."""
    published = pd.read_csv(PUBLISHED / "error_matrix_scores.csv")
    published = published[published.source == "reed"]
    published.index = published.table.str.split().str[1]
    rows = []
    for name, agreement in agreements(model.measure(options), references).items():
        matrix = agreement.matrix
        interval = matrix.intervals().set_index("score").loc["overall_accuracy"]
        rows.append(
            {
                "matrix": name,
                "overall_pct": 100 * matrix.overall_accuracy,
                "low": 100 * interval.low,
                "high": 100 * interval.high,
                "kappa": matrix.kappa,
                "published_pct": published.overall_accuracy_pct[name],
                "published_kappa": published.kappa[name],
                "aim_pct": AIMS[name],
                "n": int(matrix.total),
                "left_out": agreement.left_out,
                "producer": " ".join(f"{100 * v:.0f}" for v in matrix.producer_accuracy),
                "user": " ".join(f"{100 * v:.0f}" for v in matrix.user_accuracy),
                "counts": matrix.counts.astype(int).tolist(),
            }
        )
    table = pd.DataFrame(rows).set_index("matrix").round(2)
    show(f"{title} (tables 2 to 4)", table.drop(columns="counts"))
    for row in rows:
        print(f"  {row['matrix']}: rows classified, columns reference {row['counts']}")


def tuned(model: ReedModel, references: References, start: ReedParameters) -> None:
    """Thresholds of one half of the areas, tested on the other."""
    for name, train, test in (("odd", ODD, EVEN), ("even", EVEN, ODD)):
        options = tune_thresholds(model, of_areas(references, train), start)
        cuts = (
            f"b {options.min_height:g} m, variance {options.variance_cut:g} m2, mean {options.mean_cut:g} m"
        )
        matrices(
            model,
            of_areas(references, test),
            options,
            f"Tuned on the {name} areas ({cuts}, aRSI {options.arsi_cut:.2f}), tested on the others",
        )


def status_factors(site: Site, model: ReedModel, options: ReedParameters, title: str) -> None:
    """Status with one part of the aRSI after the other from the truth, at the cut and at the best cut."""
    key = {"aoi": str, "section": int}
    true = pd.DataFrame(read_vector(site.truth / "reed.gpkg", layer="sections")).astype(key)
    reference = pd.DataFrame(read_vector(site.reference_status)).astype(key)[["aoi", "section", "status"]]
    seen = like(model, read_raster(site.truth / "dsm_mean.tif"))
    tables = [pd.DataFrame(m.measure(options).sections).astype(key) for m in (model, seen)]
    parts = ["aoi", "section", "sinuosity", "islets", "holes", "sparse_m2", "dense_m2"]
    both = tables[0][parts].merge(tables[1][parts], on=["aoi", "section"], suffixes=("", "_seen"))
    both = both.merge(true[["aoi", "section", "sinuosity", "islets", "holes"]], on=["aoi", "section"])
    both = both.rename(columns={f"{p}_x": p for p in parts} | {f"{p}_y": f"{p}_true" for p in parts})
    both = both.merge(reference, on=["aoi", "section"]).dropna(subset=["sinuosity", "sinuosity_true"])
    stressed = (both.status == "stressed").to_numpy()
    measured = {p: both[p].to_numpy() for p in ("sinuosity", "islets", "holes")}
    truth = {p: both[f"{p}_true"].to_numpy() for p in measured}
    with np.errstate(divide="ignore", invalid="ignore"):
        measured["density"] = (both.sparse_m2 / both.dense_m2).to_numpy()
        truth["density"] = (both.sparse_m2_seen / both.dense_m2_seen).to_numpy()
    rows = []
    for replaced in ([], ["sinuosity"], ["islets"], ["holes"], ["density"], ["islets", "holes"], list(truth)):
        part = measured | {name: truth[name] for name in replaced}
        index = 3 * part["sinuosity"] + part["islets"] + part["holes"] + np.nan_to_num(part["density"])
        scores = [((index >= cut) == stressed).mean() for cut in np.unique(index)]
        rows.append(
            {
                "true": ", ".join(replaced) or "nothing",
                f"cut {options.arsi_cut:g}": 100 * ((index >= options.arsi_cut) == stressed).mean(),
                "best cut": float(np.unique(index)[int(np.argmax(scores))]),
                "at best cut": 100 * max(scores),
                "median": float(np.median(index)),
            }
        )
    show(f"Status with parts from the truth, {title}", pd.DataFrame(rows).set_index("true").round(1))
    ranks = {name: pd.Series(measured[name]).rank().corr(pd.Series(truth[name]).rank()) for name in measured}
    print("  rank correlation with the true part: " + ", ".join(f"{k} {v:.2f}" for k, v in ranks.items()))


def limits(site: Site, model: ReedModel, references: References) -> None:
    """One disturbance after the other taken away: what is left of the errors."""
    rows = []
    moved = replace(
        references,
        points=at_true_places(site, references.points),
        plots=at_true_places(site, references.plots),
    )
    truth = {name: read_raster(site.truth / f"{name}.tif") for name in ("dsm", "dsm_mean")}
    seen = like(model, coarser(truth["dsm_mean"], 0.14))
    cases = [
        ("surface of the chain", model, references),
        ("the same, variance of the surface alone", like(model, model.dsm), references),
        ("the same, field positions without GNSS error", model, moved),
        ("true surface seen from above, cells of 0.1 m", like(model, truth["dsm_mean"]), references),
        ("the same, cells of 0.14 m", seen, references),
        ("the same, field positions without GNSS error", seen, moved),
        ("the same, averaged over 0.7 m", like(model, blurred(truth["dsm_mean"], 7)), moved),
        ("highest tip in a cell of 0.1 m, without GNSS error", like(model, truth["dsm"]), moved),
    ]
    for number, (name, case, reference) in enumerate(cases, start=1):
        metrics = case.measure()
        total = (
            agreement_by_area(compare_heights(metrics.ohm, reference.points)).set_index("aoi").loc["total"]
        )
        found = agreements(metrics, reference)
        scores = {key: 100 * agreement.matrix.overall_accuracy for key, agreement in found.items()}
        rows.append(
            {"case": f"{number} {name}", "rmse": total.rmse, "bias": total.bias, "r2": total.r2} | scores
        )
    show("What limits it (thresholds of the paper)", pd.DataFrame(rows).set_index("case").round(2))


def at_true_places(site: Site, table: pd.DataFrame) -> pd.DataFrame:
    """Field records moved by what the receiver was off at their transect."""
    recorded = read_vector(site.transects)
    true = read_vector(site.truth / "reed.gpkg", layer="transects")
    both = recorded.merge(pd.DataFrame(true), on=["aoi", "transect"], suffixes=("", "_true"))
    first = [
        (t.coords[0][0] - r.coords[0][0], t.coords[0][1] - r.coords[0][1])
        for r, t in zip(both.geometry, both.geometry_true, strict=True)
    ]
    shift = pd.DataFrame(first, columns=["dx", "dy"]).assign(
        aoi=both.aoi.astype(str), transect=both.transect.astype(str)
    )
    joined = table.astype({"aoi": str, "transect": str}).merge(shift, on=["aoi", "transect"], how="left")
    return joined.assign(x=joined.x + joined.dx, y=joined.y + joined.dy).drop(columns=["dx", "dy"])


def like(model: ReedModel, dsm: xr.DataArray, spread: xr.DataArray | None = None) -> ReedModel:
    """The same lake with another surface."""
    places = {"areas": model.areas, "transects": model.transects}
    return ReedModel(dsm, model.water_level, model.shoreline, spread=spread, **places)


def cut_out(model: ReedModel, margin: float = 15.0) -> ReedModel:
    """The surface around the areas of interest: oblique photographs see far beyond."""
    west, south, east, north = model.areas.total_bounds
    x, y = model.dsm.x.values, model.dsm.y.values
    columns = (x > west - margin) & (x < east + margin)
    rows = (y > south - margin) & (y < north + margin)
    parts = [
        None if layer is None else layer.isel(x=columns.nonzero()[0], y=rows.nonzero()[0])
        for layer in (model.dsm, model.spread)
    ]
    return like(
        model, *(p if p is None else p.rio.write_transform(p.rio.transform(recalc=True)) for p in parts)
    )


def coarser(dsm: xr.DataArray, resolution: float) -> xr.DataArray:
    """Averaged over larger cells."""
    old = Grid.of(dsm)
    grid = Grid.from_bounds(old.crs, old.bounds, resolution)
    moved = dsm.rio.reproject(
        grid.crs,
        shape=grid.shape,
        transform=grid.transform,
        resampling=5,  # average
    )
    return new_raster(
        moved.values, grid, name="dsm", units="m", vertical_datum=dsm.attrs.get("vertical_datum")
    )


def blurred(dsm: xr.DataArray, cells: int) -> xr.DataArray:
    """Mean of a square window, as matching windows see it."""
    from scipy.ndimage import uniform_filter

    return dsm.copy(data=uniform_filter(dsm.values, cells, mode="nearest"))


def findings(site: Site, model: ReedModel, references: References) -> None:
    """Numbers behind R01 to R06 and R08; R07 needs flights in other winds."""
    metrics = model.measure()
    compared = compare_heights(metrics.ohm, references.points)
    numbers = {"R01 R02": height_findings(compared), "R03": depth_findings(compared, metrics, references)}
    numbers["R03"] |= depth_within_areas(metrics, references)
    numbers["R04 R05 R06"] = matrix_findings(agreements(metrics, references))
    fray = {belt.aoi: belt.fray for belt in load_scene(SCENE).reed}
    numbers["R08"] = {"fray_to_sinuosity": front_finding(metrics, fray)}
    true = read_vector(site.truth / "reed.gpkg", layer="sections").groupby("aoi").sinuosity.mean()
    numbers["R08"]["true_to_measured_sinuosity_by_area"] = front_finding(metrics, true.to_dict())
    print("\n## Findings")
    for name, values in numbers.items():
        print(f"{name}: " + ", ".join(f"{key} {value:.2f}" for key, value in values.items()))


def depth_within_areas(metrics: ReedMetrics, references: References) -> dict[str, float]:
    """R03 without what differs from area to area: ranks of plots within theirs, and all cells."""
    points = references.points.dropna(subset="water_depth_m")
    tree = cKDTree(points[["x", "y"]])
    plots = references.plots.copy()
    plots["depth"] = points.water_depth_m.to_numpy()[tree.query(plots[["x", "y"]])[1]]
    ranks = plots.groupby("aoi")[["depth", "stems_per_m2"]].rank(pct=True)
    cells = metrics.cells[metrics.cells.density != "unknown"]
    middles = cells.geometry.centroid
    distance, nearest = tree.query(np.column_stack([middles.x, middles.y]))
    depth, sparse = points.water_depth_m.to_numpy()[nearest], (cells.density == "sparse").to_numpy()
    near = distance < 3.0
    return {
        "depth_to_stems_within_areas": float(spearmanr(ranks.depth, ranks.stems_per_m2).statistic),
        "depth_to_sparse_of_all_cells": float(spearmanr(depth[near], sparse[near]).statistic),
        "median_depth_of_sparse_m": float(np.median(depth[near & sparse])),
        "median_depth_of_dense_m": float(np.median(depth[near & ~sparse])),
    }


def thresholds_over_gsd(model: ReedModel, references: References, title: str) -> None:
    """R10: best cuts on the surface averaged to coarser cells, and how sure they are over areas.

    The variance is that of the surface alone: the spread of pairs would stay when cells grow.
    """
    rows = []
    options = ReedParameters(cell_spread=False)
    for factor in (1, 2, 4):
        resolution = model.grid.resolution * factor
        case = model if factor == 1 else like(model, coarser(model.dsm, resolution))
        row: dict[str, float | str] = {"cell_m": resolution}
        for name, values, right in (
            ("variance_cut", VARIANCE_CUTS, right_density(case, references, options)),
            ("arsi_cut", ARSI_CUTS, right_status(case, references, options)),
        ):
            best, low, high = best_over_areas(np.array(values), right)
            row |= {name: best, f"{name}_80_pct": f"{low:g} to {high:g}"}
        rows.append(row)
    show(f"R10: best cuts over the resolution, {title}", pd.DataFrame(rows).set_index("cell_m").round(3))


def right_density(case: ReedModel, references: References, options: ReedParameters) -> pd.DataFrame:
    """Whether each plot is right with every variance cut (columns); rows by area and class."""
    found = {}
    for cut in VARIANCE_CUTS:
        metrics = case.measure(options.model_copy(update={"variance_cut": cut}))
        found[cut] = agreements(metrics, references)["density"].samples
    return _right(found).drop(index="water", level="reference")


def right_status(case: ReedModel, references: References, options: ReedParameters) -> pd.DataFrame:
    """Whether each section is right with every aRSI cut (columns); rows by area and class."""
    found = {}
    for cut in ARSI_CUTS:
        metrics = case.measure(options.model_copy(update={"arsi_cut": cut}))
        found[cut] = agreements(metrics, references)["status"].samples
    return _right(found)


def _right(found: dict[float, pd.DataFrame]) -> pd.DataFrame:
    table = pd.DataFrame({cut: samples.classified == samples.reference for cut, samples in found.items()})
    samples = next(iter(found.values()))
    table.index = pd.MultiIndex.from_arrays([samples.aoi.astype(str), samples.reference])
    return table.astype(float)


def best_over_areas(cuts: np.ndarray, right: pd.DataFrame, draws: int = 1000) -> tuple[float, float, float]:
    """Cut with the best mean of the producer's accuracies (of equally good ones their middle).

    On all areas, and the 10th and 90th percentile over areas drawn anew.
    """
    rng = np.random.default_rng(1)
    areas = right.index.get_level_values("aoi").unique()
    picks = rng.integers(len(areas), size=(draws, len(areas)))
    weights = np.vstack([np.ones(len(areas)), [np.bincount(pick, minlength=len(areas)) for pick in picks]])
    scores = np.zeros((len(weights), len(cuts)))
    for _, part in right.groupby(level="reference"):
        by_area = part.groupby(level="aoi")
        hits, number = by_area.sum().reindex(areas, fill_value=0), by_area.size().reindex(areas, fill_value=0)
        scores += (weights @ hits.to_numpy()) / np.maximum(weights @ number.to_numpy(), 1)[:, None]
    best = np.array([np.median(cuts[row >= row.max() - 1e-12]) for row in scores])
    return float(best[0]), *(float(value) for value in np.percentile(best[1:], [10, 90]))


def show(title: str, table: pd.DataFrame) -> None:
    """A table as text."""
    with pd.option_context("display.width", 200, "display.max_columns", 30):
        print(f"\n## {title}\n{table.to_string()}")


def main() -> None:
    """Fly if asked, then print the tables of every site that is there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("root", type=Path)
    parser.add_argument("--fly", action="store_true", help="make the sites and their products first")
    parser.add_argument("--inflight", type=int, default=1, help="photographs before and after to match with")
    parser.add_argument("--areas", type=int, default=14, help="fly the first so many areas of the scene only")
    parser.add_argument("--seed", type=int, help="of the scene: other reed of the same kind")
    arguments = parser.parse_args()
    if arguments.fly:
        fly(arguments.root, arguments.inflight, arguments.areas, arguments.seed)
    rows = {}
    for name in SITES:
        if not (arguments.root / "data" / "products" / name / "surface" / "dsm.tif").exists():
            continue
        site = load_site(name, arguments.root)
        model, references = cut_out(load_model(site)), load_references(site)
        metrics = model.measure()
        compared = compare_heights(metrics.ohm, references.points)
        rows[name] = coverage_finding(metrics, compared) | {
            key: 100 * agreement.matrix.overall_accuracy
            for key, agreement in agreements(metrics, references).items()
        }
        print(f"\n# {name}")
        heights(compared)
        for title, options in WAYS.items():
            matrices(model, references, options, f"Thresholds of the paper, {title}")
            if name == SCENE and model.areas.shape[0] > 3:
                tuned(model, references, options)
        if name == SCENE:
            for title, options in WAYS.items():
                status_factors(site, model, options, title)
            limits(site, model, references)
            findings(site, model, references)
            thresholds_over_gsd(model, references, "surface of the chain")
            seen = like(model, read_raster(site.truth / "dsm_mean.tif"))
            thresholds_over_gsd(seen, references, "true surface seen from above")
    show("R09: rig of three cameras and nadir camera alone", pd.DataFrame(rows).T.round(3))


if __name__ == "__main__":
    main()
