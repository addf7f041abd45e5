"""Georeferencing of a virtual block with known truth: outliers, thresholds, five seeds, ways to fix a block.

    python benchmarks/georeferencing.py --root DIR [--seeds 5] [--outliers 0.05]

Simulates `benchmarks/scenes/control.yaml` (a drone, 42 photographs; 20 signals: 6 control, 9 check,
5 verify; recorded positions with 1.5 m and 3 m), maps it with each seed, moves a share of the measurements of
tie points by 2 to 50 pixels, and optimises the threshold of the reprojection error. Beside the error of each
threshold as the survey tells it stands the true one. Tables are printed and written to
DIR/data/studies/georeferencing/.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pycolmap

from workbench.orientation.control import PointResidual
from workbench.orientation.features import match_features
from workbench.orientation.georeference import Georeference, georeference
from workbench.orientation.mapping import map_block
from workbench.orientation.optimise import errors_by_role, optimise_tie_points, summarise_repetitions
from workbench.orientation.thresholds import disturb_observations
from workbench.orientation.tie_points import feature_scales
from workbench.params import OrientParameters, Parameters
from workbench.site import Site, load_site
from workbench.site.tables import read_table
from workbench.stages import write_json
from workbench.virtual import simulate_scene

SCENE = Path(__file__).parent / "scenes" / "control.yaml"
CONTROL = ("P01", "P05", "P08", "P13", "P16", "P20")
THRESHOLDS = (60.0, 30.0, 15.0, 8.0, 4.0, 2.0, 1.5, 1.2, 1.0, 0.8, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
OFFSET_DIGITS = -2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--root", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--outliers", type=float, default=0.05)
    options = parser.parse_args()
    site = drone_block(options.root)
    folder = options.root / "data" / "studies" / "georeferencing"
    folder.mkdir(parents=True, exist_ok=True)
    thresholds, runs = [], []
    for seed in range(1, options.seeds + 1):
        table, run = optimised(site, seed, options.outliers, folder / "work")
        thresholds.append(table.assign(seed=seed))
        runs.append(run)
        print(pd.DataFrame(runs).to_string(index=False, float_format=lambda v: f"{v:.4f}"), flush=True)
    tables = {
        "thresholds": pd.concat(thresholds),
        "thresholds_mean": mean_over_seeds(pd.concat(thresholds)),
        "repetitions": pd.DataFrame(runs),
        "table2": summarise_repetitions(pd.DataFrame(runs)),
        "ways": ways(site, folder / "work"),
    }
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n", float_format="%.6g")
        print(f"\n{name}\n{table.to_string(index=False, float_format=lambda v: f'{v:.4f}')}")
    write_json({"gsd_m": 0.08, "outliers": options.outliers, "seeds": options.seeds}, folder / "design.json")


def mean_over_seeds(table: pd.DataFrame) -> pd.DataFrame:
    """Spatial errors by threshold, means over the seeds that reached it."""
    table = table.assign(seeds=1)
    for kind in ("check", "verify", "true_check", "true_verify"):
        table[f"{kind}_m"] = np.hypot(table[f"{kind}_xy_m"], table[f"{kind}_z_m"])
    wanted = ["tie_points", "check_m", "verify_m", "true_check_m", "true_verify_m"]
    groups = table.groupby("threshold_px", sort=False)
    return groups[wanted].mean().assign(seeds=groups.seeds.sum()).sort_index(ascending=False).reset_index()


def drone_block(root: Path) -> Site:
    """The site, simulated once, with the roles of this experiment."""
    if not (root / "data" / "sites" / "control" / "site.yaml").exists():
        simulate_scene(SCENE, root, Parameters())
    site = load_site("control", root)
    roles = dict.fromkeys(CONTROL, "control")
    others = [point.name for point in site.control if point.name not in CONTROL]
    roles |= {name: "verify" if place % 3 == 1 else "check" for place, name in enumerate(others)}
    return replace(site, control=tuple(replace(p, role=roles[p.name]) for p in site.control))  # type: ignore[arg-type]


def mapped(site: Site, seed: int, work: Path) -> tuple[pycolmap.Reconstruction, dict, np.ndarray]:
    options = OrientParameters(seed=seed)
    positions = np.array([p.position for p in site.photographs])
    offset = np.round(np.median(positions, axis=0), OFFSET_DIGITS)
    offset[2] = 0
    work = work / f"seed-{seed}"
    database = match_features(site, options, work)
    model, _ = map_block(site, database, offset, options, work)
    handle = pycolmap.Database.open(database)
    scales = feature_scales(handle)
    handle.close()
    return model, scales, offset


def optimised(site: Site, seed: int, share: float, work: Path) -> tuple[pd.DataFrame, dict]:
    """Errors by threshold, and those of the chosen one beside the truth."""
    model, scales, offset = mapped(site, seed, work)
    moved = disturb_observations(model, share, seed)
    # The limit of the mapping would drop outliers before the optimisation sees them.
    options = OrientParameters(seed=seed, optimise=True, max_reprojection_error=100)
    fixed = georeference(model, site, offset, options)
    before = errors_by_role(fixed.residuals(model))
    best = optimise_tie_points(model, fixed.adjust, fixed.residuals, scales=scales, thresholds=THRESHOLDS)
    table = best.table()
    truth = [true_errors(site, trial.residuals, "check") for trial in best.trials]
    for role in ("check", "verify"):
        errors = [true_errors(site, trial.residuals, role) for trial in best.trials]
        table[[f"true_{role}_xy_m", f"true_{role}_z_m"]] = errors
    rows = best.trials[best.best].residuals
    horizontal, vertical = true_errors(site, rows, "check")
    run = {
        "seed": seed,
        "registered": best.model.num_reg_images(),
        "moved": moved,
        "threshold_px": best.threshold,
        "interior": best.is_interior,
        "stopped": best.stopped,
        "best_by_truth_px": best.trials[int(np.argmin([np.hypot(*error) for error in truth]))].threshold,
        "before_check_xy_m": before["check_xy_m"],
        "before_check_z_m": before["check_z_m"],
        **errors_by_role(rows),
        "true_check_xy_m": horizontal,
        "true_check_z_m": vertical,
        "optimised_m": best.optimised_error,
        "cross_validated_m": best.cross_validated_error,
        "verify_m": best.verify_error,
    }
    return table, run


def true_errors(site: Site, rows: tuple[PointResidual, ...], role: str) -> tuple[float, float]:
    """Root mean squares of estimated minus true coordinates of the points of a role, metres."""
    path = site.folder / "truth" / "targets.csv"
    truth = {
        row["name"]: np.array([float(row[axis]) for axis in "xyz"])
        for _, row in read_table(path, ["name", "x", "y", "z"])
    }
    surveyed = {p.name: np.array([p.x, p.y, p.z]) for p in site.control}
    off = np.array([surveyed[r.name] + (r.dx, r.dy, r.dz) - truth[r.name] for r in rows if r.role == role])
    return float(np.sqrt((off[:, :2] ** 2).sum(axis=1).mean())), float(np.sqrt((off[:, 2] ** 2).mean()))


def ways(site: Site, work: Path) -> pd.DataFrame:
    """What fixes the block: recorded positions, control points, both; without outliers."""
    rows = []
    for way in ("positions", "control", "both"):
        model, _, offset = mapped(site, 1, work)
        fixed: Georeference = georeference(model, site, offset, OrientParameters(georeference=way))
        rows.append({"georeference": way} | errors_by_role(fixed.residuals(model)))
    return pd.DataFrame(rows)


if __name__ == "__main__":
    main()
