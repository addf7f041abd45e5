"""Brighton Beach: how the products of the chain agree with OpenDroneMap's points.

    workbench new-site beach --photos ../shared/data/brighton_beach/images --vertical-datum barometric
    workbench run --site beach
    python benchmarks/brighton_beach.py --site beach --points ../shared/data/brighton_beach/odm_model.laz

OpenDroneMap's points are a peer's result, not truth. Both blocks hang on the same positions, but tilt and
scale differ by what GNSS allows: a similarity of seven parameters is fitted first, robustly.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from workbench.points import read_points
from workbench.rasters import Grid, read_raster
from workbench.site import load_site
from workbench.stages import FOLDERS, read_json


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--site", required=True)
    parser.add_argument("--root", type=Path, default=Path())
    parser.add_argument("--points", type=Path, required=True)
    arguments = parser.parse_args()
    products = load_site(arguments.site, arguments.root).products
    for name, value in compare(products, arguments.points).items():
        print(f"{name:32s} {value}")


def compare(products: Path, points: Path) -> dict[str, float]:
    """Figures of the comparison, lengths in metres, shares 0..1."""
    dsm = read_raster(products / FOLDERS["surface"] / "dsm.tif")
    count = read_raster(products / FOLDERS["surface"] / "count.tif")
    xyz, _, _ = read_points(points)
    similarity, scale = fit_similarity(xyz, dsm)
    moved = similarity(xyz)
    heights = sample(dsm, moved)
    difference = heights - moved[:, 2]
    known = np.isfinite(difference)
    good = difference[known]
    deviation = np.abs(good - np.median(good))
    covered = [coverage(count, moved, least) for least in (1, 2)]
    orientation = read_json(products / FOLDERS["orient"] / "metrics.json")
    runs = {
        verb: read_json(products / folder / "run.json")
        for verb, folder in FOLDERS.items()
        if (products / folder / "run.json").exists()
    }
    return {
        "registered": orientation["registered"],
        "reprojection_error_px": orientation["reprojection_error_px"],
        "height_scale": round(scale, 4),
        "nmad_m": round(float(1.4826 * np.median(deviation)), 4),
        "p95_m": round(float(np.percentile(deviation, 95)), 4),
        "off_by_more_than_half_metre": round(float((deviation > 0.5).mean()), 5),
        "covered_by_one_pair": round(covered[0], 4),
        "covered_by_two_pairs": round(covered[1], 4),
        "seconds": round(sum(run["seconds"] for run in runs.values()), 1),
        "cpu_seconds": round(sum(run["cpu_seconds"] for run in runs.values()), 1),
        "peak_memory_mb": max(run["peak_memory_mb"] for run in runs.values()),
    } | {f"seconds_{verb}": run["seconds"] for verb, run in runs.items()}


def fit_similarity(xyz, dsm, rounds: int = 12):
    """Similarity that lays points onto a surface, by robust point-to-plane iterations.

    Returns the function that moves points, and its scale (ours over theirs).
    """
    thin = xyz[:: max(len(xyz) // 60_000, 1)]
    slope_y, slope_x = np.gradient(dsm.values, Grid.of(dsm).resolution)
    origin = thin.mean(axis=0)
    total = np.eye(4)
    local = thin - origin
    total[:3, 3] = [0, 0, np.nanmedian(sample(dsm, thin) - thin[:, 2])]
    for _ in range(rounds):
        moved = local @ total[:3, :3].T + total[:3, 3]
        places = moved + origin
        residual = sample(dsm, places) - places[:, 2]
        dx, dy = sample_array(slope_x, dsm, places), -sample_array(slope_y, dsm, places)
        usable = np.isfinite(residual) & np.isfinite(dx) & np.isfinite(dy) & (np.hypot(dx, dy) < 1)
        spread = 1.4826 * np.median(np.abs(residual[usable] - np.median(residual[usable])))
        usable &= np.abs(residual - np.median(residual[usable])) < 4 * spread + 1e-3
        x, y, z = moved[usable].T
        gx, gy = dx[usable], dy[usable]
        # A shift t, a small rotation r and a scale s change z - dsm(x, y) linearly.
        design = np.stack(
            [-gx, -gy, np.ones_like(x), y + gy * z, -x - gx * z, gx * y - gy * x, z - gx * x - gy * y], 1
        )
        t1, t2, t3, r1, r2, r3, s = np.linalg.lstsq(design, residual[usable], rcond=None)[0]
        turn = np.array([[0, -r3, r2], [r3, 0, -r1], [-r2, r1, 0]])
        step = np.eye(4)
        step[:3, :3] = np.eye(3) * (1 + s) + turn
        step[:3, 3] = t1, t2, t3
        total = step @ total
    scale = float(np.cbrt(np.linalg.det(total[:3, :3])))
    return lambda points: (points - origin) @ total[:3, :3].T + total[:3, 3] + origin, scale


def sample(raster, places):
    """Bilinear values of a raster at places (n, 3), NaN outside or beside a hole."""
    return sample_array(raster.values, raster, places)


def sample_array(values, raster, places):
    grid = Grid.of(raster)
    column = (places[:, 0] - grid.west) / grid.resolution - 0.5
    row = (grid.north - places[:, 1]) / grid.resolution - 0.5
    j, i = np.floor(column).astype(int), np.floor(row).astype(int)
    inside = (i >= 0) & (j >= 0) & (i < grid.height - 1) & (j < grid.width - 1)
    i, j = np.where(inside, i, 0), np.where(inside, j, 0)
    u, v = column - j, row - i
    upper = values[i, j] * (1 - u) + values[i, j + 1] * u
    lower = values[i + 1, j] * (1 - u) + values[i + 1, j + 1] * u
    return np.where(inside, upper * (1 - v) + lower * v, np.nan)


def coverage(count, places, least: int, cell: float = 0.1) -> float:
    """Share of the 10 cm cells that hold a point in which any cell of ours was measured by enough pairs."""
    grid = Grid.of(count)
    rows, columns = np.nonzero(count.values >= least)
    ours = np.stack([np.floor(grid.x[columns] / cell), np.floor(grid.y[rows] / cell)], 1).astype(np.int64)
    theirs = np.unique(np.floor(places[:, :2] / cell).astype(np.int64), axis=0)
    key = np.int64(1 << 32)
    return float(np.isin(theirs[:, 0] * key + theirs[:, 1], ours[:, 0] * key + ours[:, 1]).mean())


if __name__ == "__main__":
    main()
