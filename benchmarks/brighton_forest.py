"""Brighton Beach's forest by downscale: how much of it is measured, how surely, how high.

    python benchmarks/brighton_forest.py --site beach --points .../odm_model.laz --picture forest.png

Forest is here what at least one pair sees and where OpenDroneMap has no point within 1.5 m. Every downscale
is gridded alone, as the surface stage does it; confidence is that of the matcher, averaged over the pairs.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from brighton_beach import fit_similarity
from matplotlib.figure import Figure
from scipy import ndimage

from workbench.matching.levels import search_heights
from workbench.matching.store import PairStore
from workbench.orientation import read_block
from workbench.params import Parameters
from workbench.points import read_points
from workbench.rasters import Grid, new_raster, read_raster
from workbench.site import load_site
from workbench.stages import FOLDERS
from workbench.surface.filling import fill_heights
from workbench.surface.gridding import grid_pair
from workbench.surface.levels import grid_level
from workbench.surface.possible_count import count_possible, possible_pairs

CELL, NEAR = 0.25, 1.5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--site", required=True)
    parser.add_argument("--root", type=Path, default=Path())
    parser.add_argument("--points", type=Path, required=True)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    site = load_site(options.site, options.root)
    parameters = Parameters()
    block = read_block(site.products / FOLDERS["orient"], site)
    dsm = read_raster(site.products / FOLDERS["surface"] / "dsm.tif")
    xyz, _, _ = read_points(options.points)
    points = fit_similarity(xyz, dsm)[0](xyz)
    grid = Grid.from_bounds(Grid.of(dsm).crs, Grid.of(dsm).bounds, CELL)
    terrain = terrain_of(points, grid)
    forest = forest_of(points, grid)
    possible = count_possible(possible_pairs(block, parameters.match), terrain).values
    forest &= possible >= 1
    store = PairStore(site.products / FOLDERS["match"] / "pairs.zip")
    heights = search_heights(block, parameters.match)
    rows, maps = [], []
    with tempfile.TemporaryDirectory() as folder:
        for downscale in store.downscales:
            pairs = store.stored(downscale)
            with grid_level(pairs, downscale, grid, heights, Path(folder), parameters.surface) as level:
                whole = (slice(0, grid.height), slice(0, grid.width))
                height, count = (level.arrays.read(name, whole) for name in ("height", "count"))
            total, times = np.zeros(grid.shape), np.zeros(grid.shape)
            for pair in pairs:
                found = grid_pair(pair.load(), grid, heights)
                if found is not None:
                    agrees = np.abs(found[0] - height) < 1.0
                    total += np.where(agrees, found[1] - 1, 0)
                    times += agrees
            confidence = np.divide(total, times, out=np.full(grid.shape, np.nan), where=times > 0) / 255
            rows.append(describe(downscale, height - terrain.values, count, confidence, forest))
            maps.append((downscale, np.where(forest, height - terrain.values, np.nan), confidence))
    print(f"forest: {forest.sum() * CELL**2:.0f} m2 seen by at least one pair")
    print(pd.DataFrame(rows).round(3).to_string(index=False))
    if options.picture:
        draw(maps, forest).savefig(options.picture, dpi=110)


def terrain_of(points: np.ndarray, grid: Grid):
    """The open ground around, closed smoothly below the forest."""
    heights = np.full(grid.shape, np.nan, np.float32)
    row = ((grid.north - points[:, 1]) / CELL).astype(int).clip(0, grid.height - 1)
    column = ((points[:, 0] - grid.west) / CELL).astype(int).clip(0, grid.width - 1)
    heights[row, column] = points[:, 2]
    # Single points at the rim of the forest lie in trees: only what is surrounded counts.
    heights[ndimage.uniform_filter(np.isfinite(heights).astype(float), 9) < 0.7] = np.nan
    raster = new_raster(heights, grid, name="terrain", units="m", vertical_datum="of the site")
    filled, _ = fill_heights(raster).window(slice(0, grid.height), slice(0, grid.width))
    return raster.copy(data=filled.astype(np.float32))


def forest_of(points: np.ndarray, grid: Grid) -> np.ndarray:
    """Cells further than 1.5 m from any point of OpenDroneMap."""
    has = np.zeros(grid.shape, bool)
    row = ((grid.north - points[:, 1]) / CELL).astype(int).clip(0, grid.height - 1)
    column = ((points[:, 0] - grid.west) / CELL).astype(int).clip(0, grid.width - 1)
    has[row, column] = True
    return ndimage.distance_transform_edt(~has) * CELL > NEAR


def describe(
    downscale: int, above: np.ndarray, count: np.ndarray, confidence: np.ndarray, forest: np.ndarray
) -> dict[str, float]:
    """One line of the table."""
    known = forest & np.isfinite(above)
    crown = known & (above > 3)
    labels, number = ndimage.label(crown)
    sizes = np.bincount(labels.ravel())[1:] * CELL**2
    return {
        "downscale": downscale,
        "measured_%": 100 * known.sum() / forest.sum(),
        "by_two_%": 100 * (known & (count >= 2)).sum() / forest.sum(),
        "crown_%": 100 * crown.sum() / forest.sum(),
        "confidence": float(np.nanmedian(confidence[known])) if known.any() else np.nan,
        "confidence_crown": float(np.nanmedian(confidence[crown])) if crown.any() else np.nan,
        "crown_median_m": float(np.median(above[crown])) if crown.any() else np.nan,
        "crown_p90_m": float(np.percentile(above[crown], 90)) if crown.any() else np.nan,
        "below_ground_%": 100 * (known & (above < -1.5)).sum() / max(known.sum(), 1),
        "patches": number,
        "median_patch_m2": float(np.median(sizes)) if number else np.nan,
    }


def draw(maps: list[tuple[int, np.ndarray, np.ndarray]], forest: np.ndarray) -> Figure:
    """Height above ground and confidence in the forest, a column a downscale."""
    made = Figure(figsize=(3.1 * len(maps), 6.2), layout="constrained")
    axes = made.subplots(2, len(maps), squeeze=False)
    for column, (downscale, above, confidence) in enumerate(maps):
        for row, (values, low, high, label) in enumerate(
            ((above, 0, 18, "above ground (m)"), (np.where(forest, confidence, np.nan), 0.5, 1, "confidence"))
        ):
            place = axes[row, column]
            place.imshow(np.where(forest, 0.93, 1.0), cmap="gray", vmin=0, vmax=1)
            shown = place.imshow(values, cmap="viridis", vmin=low, vmax=high, interpolation="nearest")
            place.set_axis_off()
            place.set_title(f"downscale {downscale}", fontsize=9)
            if column == len(maps) - 1:
                made.colorbar(shown, ax=axes[row, :].tolist(), label=label, shrink=0.8)
    return made


if __name__ == "__main__":
    main()
