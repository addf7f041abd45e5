"""Single trees on virtual forests: windows chosen on some seeds, judged on others, beside the thesis.

``choose [SITE ...]``: search windows, distances, smoothing and prominence by scores above chance on true
surfaces of the tuning seeds, and on sites flown over scenes of such a seed (a copy of the composition named
``baruth-101`` with that seed, ``workbench simulate FILE``); ``crowns``: limits of crowns on true surfaces.
``truth``: tables in the form of 4.18 and 4.19 on true surfaces of the judging seeds (errors of the method
alone), ``findings``: T17, T21, T22, T24, T25 on them. ``chain SITE``: the tables on the products of a site
that ran through the chain (``workbench simulate SCENE``, then ``workbench run``), whose errors are those of
surface and method. True surfaces are kept in ``--folder``; the first run makes them.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
import shapely.geometry
import xarray as xr
from rasterio.features import shapes
from rasterio.fill import fillnodata
from scipy import ndimage

from workbench.assessment import compare_crowns, match_trees
from workbench.params import TreesParameters
from workbench.rasters import Grid, new_raster, read_raster, write_raster
from workbench.site import load_site
from workbench.trees import (
    GrowingWindow,
    TreeInputs,
    TreeModel,
    find_tops,
    search_spacing,
    search_window,
    smoothed,
)
from workbench.trees.tops import SADDLE_SHARE, growing_spacing
from workbench.virtual import build_scene, load_scene, scene_truth

SCENES = ("habichtswald", "baruth")
TUNING, JUDGING = (101, 102), (None, 203)
"""Seeds; None is that of the shipped scene."""
FINE = 0.1
WINDOWS = ((0.0, 0.033), (0.3, 0.033), (0.0, 0.05), (0.0, 0.07), (-0.5, 0.11))
"""Radius at height zero (m) and growth with height that are tried."""
SHARES = (0.03, 0.05)
"""Least prominences that are tried, as shares of the height."""
SMOOTHINGS = (0.0, 0.15, 0.3)
"""Standard deviations of the Gaussian that are tried, metres."""
SPACINGS = ("disc", "two discs", "growing", "growing, no saddle")
"""Least distances of two tops: the search disc, twice that, that of broadleaf discs unless a saddle parts
them, the same without exception."""
DISTANCE = {"conifer": 2.0, "broadleaf old": 3.0, "broadleaf middle": 3.0, "broadleaf young": 2.0}
"""Largest distance of a match, metres [thesis 4.5.1, published/tree_match_distance.csv]."""
SHIFTS = ((7.0, 4.0), (-6.0, 5.0), (5.0, -8.0), (-8.0, -5.0))
"""Shifts of tops that leave nothing but chance, metres: wider than any distance of a match."""
THESIS_FILTER = 49
PUBLISHED = Path(__file__).parents[1] / "data" / "published"


def true_scene(name: str, seed: int | None, folder: Path) -> Path:
    """Folder with ``dsm.tif`` (topmost), ``dtm.tif``, ``trees.gpkg``, ``stands.gpkg`` of a scene."""
    target = folder / f"{name}_{0 if seed is None else seed}"
    if not (target / "stands.gpkg").exists():
        target.mkdir(parents=True, exist_ok=True)
        spec = load_scene(name)
        scene = build_scene(spec if seed is None else spec.model_copy(update={"seed": seed}))
        truth = scene_truth(scene, Grid.from_bounds(scene.crs, scene.extent, FINE), parts=2)
        for layer in ("dsm", "dtm"):
            write_raster(truth[layer], target / f"{layer}.tif")
        scene.trees.to_file(target / "trees.gpkg")
        stands_of(name).to_file(target / "stands.gpkg")
    return target


def stands_of(name: str) -> gpd.GeoDataFrame:
    """Stands of a scene with their type and name."""
    spec = load_scene(name)
    shapes = [shapely.Polygon(np.asarray(stand.area) + spec.origin) for stand in spec.stands]
    kinds = [stand.species_group for stand in spec.stands]
    return gpd.GeoDataFrame(
        {"stand_type": kinds, "stand": [f"{s.species_group} {s.age}" for s in spec.stands]},
        geometry=shapes,
        crs=spec.crs,
    )


def true_heights(source: Path, cell: float) -> xr.DataArray:
    """Topmost surface above ground on cells of about a size: the highest of the fine cells."""
    dsm, dtm = read_raster(source / "dsm.tif"), read_raster(source / "dtm.tif")
    grid, factor = Grid.of(dsm), max(round(cell / FINE), 1)
    rows, columns = (size // factor * factor for size in grid.shape)
    blocks = (dsm - dtm).values[:rows, :columns].reshape(rows // factor, factor, columns // factor, factor)
    coarse = Grid(grid.crs, grid.west, grid.north, FINE * factor, columns // factor, rows // factor)
    return new_raster(blocks.max(axis=(1, 3)).astype(np.float32), coarse, name="height", units="m")


def references(source: Path) -> gpd.GeoDataFrame:
    """True trees as points of their tops, the understorey too; column ``crown`` holds the outlines."""
    trees = gpd.read_file(source / "trees.gpkg")
    trees = trees[trees["understorey"] | (trees["height_m"] >= 3.0)].reset_index(drop=True)
    trees["crown"] = trees.geometry
    return trees.set_geometry(gpd.points_from_xy(trees["top_x"], trees["top_y"], crs=trees.crs))


def tops_by_stand(
    height: xr.DataArray, options: TreesParameters, stands: gpd.GeoDataFrame
) -> gpd.GeoDataFrame:
    """Tops with the windows and the least prominence of the tree stage."""
    window = search_window(options, stands, Grid.of(height).resolution)
    return find_tops(
        height,
        window=window,
        spacing=search_spacing(options, stands),
        saddle_share=options.saddle_share,
        smoothing=options.top_smoothing,
        prominence_share=options.prominence_share,
    )


def judge(tops: gpd.GeoDataFrame, trees: gpd.GeoDataFrame, stands: gpd.GeoDataFrame) -> pd.DataFrame:
    """Scores of every stand over the trees of the stand: those seen from above, and all.

    The understorey is no reference, as thin stems are none in the thesis [3.4.1]: a top without a tree that
    stands on a small crown and is no higher than that is neither right nor false. ``strict`` counts it as
    false.
    """
    rows = []
    small = on_understorey(tops, trees)
    for name, shape in zip(stands["stand"], stands.geometry, strict=True):
        reach = DISTANCE[name if name.startswith("broadleaf") else "conifer"]
        row: dict[str, object] = {"stand": name}
        for kind in ("visible", "all"):
            chosen = trees[~trees["understorey"] & (trees["visible"] | (kind == "all"))]
            match = match_trees(tops, chosen.reset_index(drop=True), reach, area=shape)
            right, missed = len(match.pairs), len(match.missed)
            false = len(match.false) - int(small[match.false].sum())
            row |= {
                f"trees_{kind}": right + missed,
                f"completeness_{kind}": 100 * right / max(right + missed, 1),
                f"correctness_{kind}": 100 * right / max(right + false, 1),
                f"f1_{kind}": 200 * right / max(2 * right + missed + false, 1),
                f"strict_{kind}": 100 * match.correctness,
            }
        rows.append(row)
    return pd.DataFrame(rows)


def judge_with_chance(
    tops: gpd.GeoDataFrame, trees: gpd.GeoDataFrame, stands: gpd.GeoDataFrame
) -> pd.DataFrame:
    """As :func:`judge`, with mean scores of the same tops shifted by 8-9 m: what density alone reaches."""
    scores = judge(tops, trees, stands)
    shifted = pd.concat(
        judge(tops.set_geometry(tops.translate(*shift)), trees, stands) for shift in SHIFTS
    ).groupby("stand", sort=False)
    for name in ("completeness", "correctness", "f1"):
        scores[f"{name}_shifted"] = shifted[f"{name}_visible"].mean().to_numpy()
    return scores


def on_understorey(tops: gpd.GeoDataFrame, trees: gpd.GeoDataFrame) -> np.ndarray:
    """Whether each top stands on the crown of a small tree and is not (by more than 0.5 m) higher than it."""
    small = trees[trees["understorey"]]
    crowns, heights = shapely.STRtree(small["crown"].to_numpy()), small["height_m"].to_numpy()
    top, tree = crowns.query(tops.geometry.to_numpy(), predicate="within")
    result = np.zeros(len(tops), bool)
    result[top[tops["height_m"].to_numpy()[top] <= heights[tree] + 0.5]] = True
    return result


def choose(folder: Path, sites: list[str], root: Path) -> None:
    """Every search beside chance, by type of stand and kind of surface.

    Surfaces are the true ones of the tuning seeds on two cells, and those of sites that were flown over
    scenes of such seeds. ``skill`` is the share of what chance leaves open, 100 (F1 - chance) / (100 -
    chance).
    """
    parts = [_trials_on_truth(name, seed, folder) for name, seed in product(SCENES, TUNING)]
    for name in sites:
        height, trees, stands = _site(name, root)
        parts.append(_trials({f"{name}": height}, trees, stands))
    table = pd.concat(parts)
    table["skill"] = 100 * (table["f1_visible"] - table["f1_shifted"]) / (100 - table["f1_shifted"])
    table["type"] = table["stand"].str.split().str[0]
    shown = {name: table[table["type"] == name] for name in ("conifer", "broadleaf")} | {"all": table}
    keys = ["smoothing", "share", "start", "growth", "spacing"]
    for label, part in shown.items():
        by_stand = part.groupby([*keys, "surface", "type", "stand"])[["f1_visible", "skill"]].mean()
        mean = by_stand.groupby([*keys, "surface", "type"]).mean().groupby([*keys, "surface"]).mean()
        for surface, some in mean.groupby("surface"):
            best = some.droplevel("surface").sort_values("skill", ascending=False)
            print(
                f"\n{label}, {surface}: F1 and skill (%), visible trees; the best, the best of each spacing"
            )
            print(best.head(8).round(1).to_string())
            print(best.loc[best.groupby("spacing")["skill"].idxmax()].round(1).to_string())


def _trials_on_truth(name: str, seed: int, folder: Path) -> pd.DataFrame:
    """Scores of all searches on one scene, kept beside it."""
    source = true_scene(name, seed, folder)
    kept = source / "searches.csv"
    if not kept.exists():
        heights = {f"truth {cell} m": true_heights(source, cell) for cell in (0.2, 0.5)}
        _trials(heights, references(source), stands_of(name)).to_csv(kept, index=False)
    return pd.read_csv(kept)


def _trials(
    surfaces: dict[str, xr.DataArray], trees: gpd.GeoDataFrame, stands: gpd.GeoDataFrame
) -> pd.DataFrame:
    """Scores of all searches on surfaces of one place."""
    rows = []
    for (label, height), smoothing in product(surfaces.items(), SMOOTHINGS):
        for (start, growth), share, spacing in product(WINDOWS, SHARES, SPACINGS):
            tops = _searched(height, start, growth, spacing, smoothing, share)
            tried = {"smoothing": smoothing, "share": share, "start": start, "growth": growth}
            scores = judge_with_chance(tops, trees, stands)
            rows.append(scores.assign(surface=label, spacing=spacing, **tried))
    return pd.concat(rows)


def _searched(
    height: xr.DataArray, start: float, growth: float, spacing: str, smoothing: float, share: float
) -> gpd.GeoDataFrame:
    smallest = max(0.5, math.sqrt(2) * Grid.of(height).resolution)
    apart = {
        "disc": None,
        "two discs": GrowingWindow(2 * start, 2 * growth),
        "growing": growing_spacing(),
        "growing, no saddle": growing_spacing(),
    }
    return find_tops(
        height,
        window=GrowingWindow(start, growth, smallest=smallest),
        spacing=apart[spacing],
        saddle_share=SADDLE_SHARE if spacing == "growing" else None,
        smoothing=smoothing,
        prominence_share=share,
    )


def choose_crowns(folder: Path) -> None:
    """Mean IoU of crowns with the true ones from the true tops, by limits of growing."""
    rows = []
    trials = {
        "none": {},
        "slope 60": {"max_slope": 60.0},
        "slope 75": {"max_slope": 75.0},
        "slope 60, min -30": {"max_slope": 60.0, "min_slope": -30.0},
        **{f"aspect {k}": {"aspect": "always", "max_aspect": k} for k in (2, 3, 4, 6)},
        "slope 60, aspect 4": {"max_slope": 60.0, "aspect": "always", "max_aspect": 4},
        **{f"share {s}": {"crown_min_share": s} for s in (0.0, 0.1, 0.3, 0.5)},
        "watershed": {"crown_method": "watershed"},
        "dalponte": {"crown_method": "dalponte"},
    }
    for name, seed in product(SCENES, TUNING):
        source = true_scene(name, seed, folder)
        stands = stands_of(name)
        model = TreeModel(TreeInputs(true_heights(source, 0.2), stands=stands))
        trees = references(source)
        trees = trees[trees["visible"] & ~trees["understorey"]].set_geometry("crown")
        for size, (label, limits) in product((1, 13, 25, 49), trials.items()):
            options = TreesParameters(**{"smoothing_size": size, "aspect": "never", **limits})
            if size != 49 and not model_smooths(options):
                continue
            crowns = model.crowns(options)
            for stand, shape in zip(stands["stand"], stands.geometry, strict=True):
                true = trees[trees.centroid.within(shape)][["crown"]].rename_geometry("geometry")
                near = crowns[crowns.intersects(shape)].reset_index(drop=True)
                result = compare_crowns(near, true.reset_index(drop=True))
                iou = 100 * float(result.pairs["iou"].sum()) / max(result.reference, 1)
                rows.append({"limits": label, "filter": size, "stand": stand, "iou": iou})
    table = pd.DataFrame(rows).groupby(["limits", "filter", "stand"])["iou"].mean().unstack("stand")
    table["conifer"] = table.filter(like="conifer ").mean(axis=1)
    table["broadleaf"] = table.filter(like="broadleaf ").mean(axis=1)
    print("\nIoU (%) with the true crowns, tuning seeds; a tree that no top found counts as 0")
    print(table.round(1).to_string())


def model_smooths(options: TreesParameters) -> bool:
    """Whether the filter matters."""
    return options.crown_method == "growing" and (options.max_slope is not None or options.aspect != "never")


def on_truth(folder: Path, options: TreesParameters) -> None:
    """Tables 4.18 and 4.19 on true surfaces of the judging seeds."""
    print("\nTable 4.18 on true surfaces (cells of 20 cm), judging seeds; windows by stand type")
    print(pd.concat(_judged_truth("habichtswald", folder, options, 0.2)).round(1).to_string(index=False))
    print("\nTable 4.19 on true surfaces, by cell")
    for cell in (0.1, 0.2):
        print(f"cells of {100 * cell:g} cm")
        print(pd.concat(_judged_truth("baruth", folder, options, cell)).round(1).to_string(index=False))
    _print_published()


def _judged_truth(name: str, folder: Path, options: TreesParameters, cell: float) -> Iterator[pd.DataFrame]:
    for seed in JUDGING:
        source, stands = true_scene(name, seed, folder), stands_of(name)
        tops = tops_by_stand(true_heights(source, cell), options, stands)
        yield judge_with_chance(tops, references(source), stands).assign(
            seed="shipped" if seed is None else seed
        )


def findings(folder: Path, options: TreesParameters) -> None:
    """Findings that need no photogrammetry, on the shipped scene of old and young stands."""
    source, stands = true_scene("habichtswald", None, folder), stands_of("habichtswald")
    height, trees = true_heights(source, 0.2), references(source)
    seen = trees[trees["visible"] & ~trees["understorey"]].reset_index(drop=True)
    found = tops_by_stand(height, options, stands)
    print("\nT17, each stand with its own window")
    _print_scores(judge(found, trees, stands))
    print("\nT21, windows swapped")
    swapped = stands.assign(
        stand_type=stands["stand_type"].map({"conifer": "broadleaf", "broadleaf": "conifer"})
    )
    _print_scores(judge(tops_by_stand(height, options, swapped), trees, stands))
    print(f"\nT22, tops of the surface after a bilateral filter of {THESIS_FILTER}")
    smooth = smoothed(height, THESIS_FILTER, options.smoothing_sigma)
    _print_scores(judge(tops_by_stand(smooth, options, stands), trees, stands))
    hit = np.isin(np.arange(len(seen)), match_trees(found, seen, 2.0).pairs["reference"])
    print(
        f"\nT24, completeness within 2 m (%): free {_share(hit, free_standing(seen))}, others "
        f"{_share(hit, ~free_standing(seen))}"
    )
    holes = punched(height, share=0.25, radius=2.5, seed=1)
    filled = tops_by_stand(holes[0], options, stands)
    hit = np.isin(np.arange(len(seen)), match_trees(filled, seen, 2.0).pairs["reference"])
    inside = at(holes[1], Grid.of(height), seen)
    print(
        f"T25, completeness within 2 m (%): top in an interpolated hole {_share(hit, inside)}, "
        f"elsewhere {_share(hit, ~inside)}"
    )


def free_standing(trees: gpd.GeoDataFrame) -> np.ndarray:
    """Whether no other crown is within a metre of the crown of each tree."""
    crowns = trees["crown"].to_numpy()
    first, second = shapely.STRtree(crowns).query(crowns, predicate="dwithin", distance=1.0)
    free = np.ones(len(trees), bool)
    free[first[first != second]] = False
    return free


def punched(
    height: xr.DataArray, *, share: float, radius: float, seed: int
) -> tuple[xr.DataArray, np.ndarray]:
    """The surface with round holes of a radius (m) over a share of it, filled by interpolation; the holes."""
    rng = np.random.default_rng(seed)
    grid = Grid.of(height)
    number = round(share * height.size * grid.resolution**2 / (np.pi * radius**2))
    centres = np.ones(grid.shape, bool)
    centres[rng.integers(0, grid.height, number), rng.integers(0, grid.width, number)] = False
    holes = ndimage.distance_transform_edt(centres) * grid.resolution <= radius
    filled = fillnodata(height.values.copy(), mask=(~holes).astype(np.uint8), max_search_distance=100)
    return height.copy(data=filled.astype(np.float32)), holes


def at(cells: np.ndarray, grid: Grid, trees: gpd.GeoDataFrame) -> np.ndarray:
    """Values of cells at points."""
    rows = np.floor((grid.north - trees.geometry.y.to_numpy()) / grid.resolution).astype(int)
    columns = np.floor((trees.geometry.x.to_numpy() - grid.west) / grid.resolution).astype(int)
    return cells[rows.clip(0, grid.height - 1), columns.clip(0, grid.width - 1)]


def _share(hit: np.ndarray, part: np.ndarray) -> str:
    return f"{100 * hit[part].mean():.1f} of {part.sum()}" if part.any() else "none"


def _print_scores(scores: pd.DataFrame) -> None:
    print(scores[["stand", "completeness_visible", "correctness_visible"]].round(1).to_string(index=False))


def on_chain(site_names: list[str], root: Path, options: TreesParameters) -> None:
    """The same scores on what the chain made of sites; stands are those of the scene of the same name."""
    for name in site_names:
        height, trees, stands = _site(name, root)
        tops = tops_by_stand(height, options, stands)
        print(f"\n{name}: whole chain")
        print(judge_with_chance(tops, trees, stands).round(1).to_string(index=False))
    _print_published()


def _site(name: str, root: Path) -> tuple[xr.DataArray, gpd.GeoDataFrame, gpd.GeoDataFrame]:
    """Heights above ground, true trees, and the stands as far as two photographs of the site see them."""
    site = load_site(name, root)
    if site.truth is None:
        raise SystemExit(f"{name} has no truth to compare with.")
    height = read_raster(site.products / "surface" / "ndsm.tif")
    stands = stands_of(name.split("-")[0])
    possible = read_raster(site.products / "surface" / "possible_count.tif")
    seen = (np.nan_to_num(possible.values) > 0).astype(np.uint8)
    parts = shapes(seen, mask=seen == 1, transform=Grid.of(possible).transform)
    area = shapely.union_all([shapely.geometry.shape(part) for part, _ in parts])
    return height, references(site.truth), stands.assign(geometry=stands.intersection(area))


def _print_published() -> None:
    for table in ("tree_table4_18_habichtswald", "tree_table4_19_baruth"):
        print(f"\npublished: {table}")
        print(pd.read_csv(PUBLISHED / f"{table}.csv").to_string(index=False))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["choose", "crowns", "truth", "findings", "chain"])
    parser.add_argument("sites", nargs="*", help="Sites of `chain`, or to `choose` on besides.")
    parser.add_argument("--root", type=Path, default=Path())
    parser.add_argument("--folder", type=Path, default=Path("/tmp/trees_virtual"))
    args = parser.parse_args()
    options = TreesParameters()
    pd.set_option("display.width", 250, "display.max_columns", 30)
    if args.what == "choose":
        choose(args.folder, args.sites, args.root)
    elif args.what == "crowns":
        choose_crowns(args.folder)
    elif args.what == "truth":
        on_truth(args.folder, options)
    elif args.what == "findings":
        findings(args.folder, options)
    else:
        on_chain(args.sites, args.root, options)


if __name__ == "__main__":
    main()
