"""Surfaces of virtual flights against the truth of every cell: by land cover, by provenance, in filled holes.

    python benchmarks/surface_truth.py meadow lake                       # the scenes' own flights
    python benchmarks/surface_truth.py pines --gsd 0.15 --forward 0.8    # conifers at 5 degrees

Photographs are oriented by their true poses, so that the errors are those of matching and fusion. The
reference is the surface seen from above, averaged over a cell (what a camera can measure at best).

Tables: errors by land cover and by the downscale that measured a cell; the cells that downscale 1 left
empty and a coarser one filled, against linear, inverse-distance and thin-plate-spline interpolation of
downscale 1 in the same cells (finding T13); conifer tops.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import xarray as xr
from scipy import ndimage
from scipy.interpolate import LinearNDInterpolator, RBFInterpolator
from scipy.spatial import cKDTree

import workbench.studies
from workbench.assessment.surfaces import height_errors
from workbench.matching import match_site
from workbench.params import Parameters
from workbench.rasters import Grid, read_raster
from workbench.site import Site
from workbench.studies.known_poses import orient_by_truth
from workbench.surface import surface_site
from workbench.surface.fusion import NO_DATA
from workbench.virtual import simulate_scene
from workbench.virtual.scene import build_scene, load_scene
from workbench.virtual.truth import scene_truth
from workbench.virtual.world import Cover

NEIGHBOURS = 12
"""Measured cells that inverse distance looks at; the spline takes twice as many."""
MOST = 40_000
"""Filled cells that are interpolated for the comparison (splines are slow)."""
NAMES = {int(code): code.name.lower() for code in Cover if code != Cover.NOTHING}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenes", nargs="+", help="scenes of the package or of the shipped studies")
    parser.add_argument("--root", type=Path, help="keep the sites here; a temporary folder by default")
    parser.add_argument("--gsd", type=float)
    parser.add_argument("--forward", type=float, help="forward overlap, 0..1")
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--csv", type=Path, help="also write the errors by cover here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = options.root or Path(folder)
        tables = [judge(scene, root, options) for scene in options.scenes]
    if options.csv:
        pd.concat(tables).to_csv(options.csv, index=False)


def judge(name: str, root: Path, options: argparse.Namespace) -> pd.DataFrame:
    """Simulate, match and compare one scene."""
    shipped = Path(workbench.studies.__file__).parent / "shipped" / "scenes" / f"{name}.yaml"
    source = shipped if shipped.exists() else name
    flight = {"gsd": options.gsd, "forward_overlap": options.forward}
    flight = {key: value for key, value in flight.items() if value is not None}
    parameters = Parameters()
    site = simulate_scene(source, root, parameters, flight_overrides=flight, seed=options.seed)
    orient_by_truth(site, parameters)
    matched, made = match_site(site, parameters), surface_site(site, parameters)
    folder = site.products / "surface"
    dsm, count = read_raster(folder / "dsm.tif"), read_raster(folder / "possible_count.tif")
    truth = scene_truth(build_scene(load_scene(source)), Grid.of(dsm))
    seen = inside(site, dsm) & (count.values >= 1)
    truth["dsm_mean"].values[~seen] = np.nan
    print(
        f"\n== {name}: {len(site.photographs)} photographs, GSD {matched['ground_resolution_m']:.3f} m, "
        f"angle {matched['angle_median_deg']:.1f} degrees, cells of {made['cells_m']:.3f} m"
    )
    by_cover = height_errors(dsm, truth["dsm_mean"], truth["cover"], NAMES)
    print(by_cover.round(3).to_string(index=False))
    provenance = read_raster(folder / "provenance.tif")
    codes = {int(v): f"downscale {v}" for v in np.unique(provenance.values) if v != NO_DATA}
    by_source = height_errors(dsm, truth["dsm_mean"], provenance, codes)
    print(by_source[by_source["cover"] != "all"].round(3).to_string(index=False))
    finest = min(matched["downscales"])
    print_filled(read_raster(folder / f"dsm_ds{finest}.tif"), dsm, provenance, truth, finest)
    print_tops(site, dsm, truth, seen)
    return by_cover.assign(
        scene=name, gsd_m=matched["ground_resolution_m"], angle=matched["angle_median_deg"]
    )


def inside(site: Site, dsm: xr.DataArray) -> np.ndarray:
    """Cells of a surface that lie within the scene, where the truth knows trees."""
    west, south, east, north = Grid.of(read_raster(site.truth / "cover.tif")).bounds
    grid = Grid.of(dsm)
    return ((grid.y > south) & (grid.y < north))[:, None] & (grid.x > west) & (grid.x < east)


def print_filled(
    finest: xr.DataArray, dsm: xr.DataArray, provenance: xr.DataArray, truth: xr.Dataset, downscale: int
) -> None:
    """Coarser measurements against interpolation, in the cells that the finest downscale left empty."""
    true = truth["dsm_mean"].values
    filled = np.isfinite(dsm.values) & (provenance.values != downscale) & np.isfinite(true)
    cells = np.argwhere(filled)
    if len(cells) < 100:
        print(f"filled: {len(cells)} cells only")
        return
    if len(cells) > MOST:
        cells = cells[np.sort(np.random.default_rng(0).choice(len(cells), MOST, replace=False))]
    measured = np.isfinite(finest.values)
    # What surrounds a hole is all that an interpolation of it uses.
    rim = np.argwhere(measured & ndimage.binary_dilation(~measured, iterations=4))
    places, heights = rim.astype(float), finest.values[tuple(rim.T)].astype(float)
    wanted = cells.astype(float)
    distance, near = cKDTree(places).query(wanted, NEIGHBOURS)
    weights = 1 / distance**2
    guesses = {
        "measured at a coarser downscale": dsm.values[tuple(cells.T)],
        "linear": LinearNDInterpolator(places, heights)(wanted),
        "inverse distance": (weights * heights[near]).sum(axis=1) / weights.sum(axis=1),
        "thin-plate spline": RBFInterpolator(places, heights, neighbors=2 * NEIGHBOURS)(wanted),
    }
    rows = []
    for cover, chosen in (("all", np.ones(len(cells), bool)), *_covers(truth, cells)):
        for method, values in guesses.items():
            error = (values - true[tuple(cells.T)])[chosen]
            error = error[np.isfinite(error)]
            if error.size >= 100:
                rows.append(
                    {
                        "cover": cover,
                        "filled by": method,
                        "cells": error.size,
                        "rmse_m": np.sqrt(np.mean(error**2)),
                        "mean_abs_m": np.mean(np.abs(error)),
                        "bias_m": np.median(error),
                    }
                )
    print(f"filled cells ({filled.sum()}):")
    print(pd.DataFrame(rows).round(3).to_string(index=False))


def _covers(truth: xr.Dataset, cells: np.ndarray) -> list[tuple[str, np.ndarray]]:
    codes = truth["cover"].values[tuple(cells.T)]
    return [(NAMES[code], codes == code) for code in np.unique(codes) if code in NAMES]


def print_tops(site: Site, dsm: xr.DataArray, truth: xr.Dataset, seen: np.ndarray) -> None:
    """Highest measured cell of each conifer's crown against its true top."""
    trees = gpd.read_file(site.truth / "trees.gpkg")
    conifers = trees[trees["species_group"] == "conifer"] if "species_group" in trees else trees.iloc[:0]
    number = truth["tree_id"].values
    rows = []
    for tree_id in conifers["tree_id"]:
        crown = (number == tree_id) & seen
        if crown.sum() < 20:
            continue  # Hidden below others, or at the border.
        at = np.unravel_index(np.argmax(np.where(crown, truth["dsm"].values, -np.inf)), crown.shape)
        near = dsm.values[max(at[0] - 3, 0) : at[0] + 4, max(at[1] - 3, 0) : at[1] + 4]
        rows.append(np.nanmax(near) - truth["dsm"].values[at] if np.isfinite(near).any() else np.nan)
    if rows:
        error = np.array(rows)
        known = error[np.isfinite(error)]
        spread = 1.4826 * np.median(np.abs(known - np.median(known)))
        print(
            f"conifer tops: {len(error)} seen, {np.isfinite(error).mean():.1%} with a height within 3 cells, "
            f"{(np.abs(known) <= 0.5).sum() / len(error):.1%} within 0.5 m; "
            f"error median {np.median(known):+.2f} m, NMAD {spread:.2f} m"
        )


if __name__ == "__main__":
    main()
