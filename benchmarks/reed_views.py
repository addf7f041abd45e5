"""Wind and view angles on three areas of reed: what findings R07 and R09 rest on.

``python benchmarks/reed_views.py ROOT`` photographs the first three areas of the scene ``chiemsee14`` with
the nadir camera in calm air and in wind of 2, 4 and 6 m/s, and with the rig of three cameras in wind of
2 m/s, and makes the surfaces. Poses are the true ones, so that no bend of a block hides what wind and views
do. What is there already is kept: an interrupted run continues. It prints the agreement of heights by area
and flight, the rank correlation of wind with the RMSE within the areas (R07), and both rigs side by side
(R09), with the standard deviation of the errors beside their root mean square.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from reed_lake import RIG, SCENE, cut_out, part_of_scene, show
from scipy.stats import spearmanr

from workbench.matching import match_site
from workbench.params import Parameters
from workbench.reed import agreement_by_area, agreements, compare_heights, load_model, load_references
from workbench.reed.findings import coverage_finding
from workbench.site import load_site
from workbench.studies.known_poses import orient_by_truth
from workbench.surface import surface_site
from workbench.virtual import simulate_scene

AREAS = 3
WINDS = (0.0, 2.0, 4.0, 6.0)
FLIGHTS = {f"nadir {wind:g} m/s": {"wind": wind} for wind in WINDS} | {"rig 2 m/s": RIG | {"wind": 2.0}}


def fly(root: Path) -> None:
    """Photographs and surface of every flight."""
    parameters = Parameters()
    stages = {"orientation": orient_by_truth, "matching": match_site, "surface": surface_site}
    for flight, overrides in FLIGHTS.items():
        name = site_name(flight)
        if not (root / "data" / "sites" / name / "site.yaml").exists():
            scene = part_of_scene(root, AREAS)
            simulate_scene(scene, root, parameters, flight_overrides=overrides, site_name=name)
        site = load_site(name, root)
        for folder, stage in stages.items():
            if not (site.products / folder / "metrics.json").exists():
                stage(site, parameters)


def site_name(flight: str) -> str:
    """Folder of a flight."""
    return f"{SCENE}_{flight.removesuffix(' m/s').replace(' ', '_')}"


def measured(root: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Agreement of heights by flight and area, and the scores of every flight."""
    heights, scores = [], []
    for flight in FLIGHTS:
        site = load_site(site_name(flight), root)
        model, references = cut_out(load_model(site)), load_references(site)
        metrics = model.measure()
        compared = compare_heights(metrics.ohm, references.points)
        heights.append(agreement_by_area(compared).assign(flight=flight))
        found = coverage_finding(metrics, compared)
        found["sd_m"] = float(np.sqrt(found["rmse_m"] ** 2 - found["bias_m"] ** 2))
        matrices = agreements(metrics, references)
        found |= {f"{key}_pct": 100 * entry.matrix.overall_accuracy for key, entry in matrices.items()}
        scores.append({"flight": flight} | found)
    return pd.concat(heights), pd.DataFrame(scores).set_index("flight")


def main() -> None:
    """Fly what is missing, then print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("root", type=Path)
    root = parser.parse_args().root
    fly(root)
    heights, scores = measured(root)
    show("RMSE of heights by area, m", heights.pivot(index="flight", columns="aoi", values="rmse").round(2))
    areas = heights[(heights.aoi != "total") & heights.flight.str.startswith("nadir")]
    winds = areas.flight.str.split().str[1].astype(float)
    ranks = areas.groupby("aoi").rmse.rank()
    print(f"\nR07: rank correlation of wind with RMSE within areas {spearmanr(winds, ranks).statistic:.2f}")
    show("R09 and the winds: all areas together", scores.round(3))


if __name__ == "__main__":
    main()
