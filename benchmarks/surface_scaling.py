"""Time and memory of match and surface on virtual flights of 10, 40 and 160 photographs.

    python benchmarks/surface_scaling.py            # prints a table; several minutes

The flights have one camera, GSD and overlap; four times the photographs cover four times the area. Each
stage runs in a process of its own, so that its peak memory is its own; poses are the true ones.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd

from workbench.params import Parameters
from workbench.studies.known_poses import orient_by_truth
from workbench.virtual import simulate_scene

GSD, FRAME = 0.1, (800, 533)
FORWARD, SIDE = 0.6, 0.4
LAYOUTS = {10: (2, 22.0), 40: (4, 117.0), 160: (8, 315.0)}
"""Photographs: strips, and length of the scene in metres that makes strips of 5, 10 and 20."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=list(LAYOUTS), choices=list(LAYOUTS))
    parser.add_argument("--root", type=Path, help="keep the sites here; a temporary folder by default")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure(size, options.root or Path(folder)) for size in options.sizes]
    table = pd.DataFrame(rows)
    for column in ("match_s", "surface_s", "match_cpu_s", "surface_cpu_s"):
        table[f"{column}_ratio"] = (table[column] / table[column].shift()).round(2)
    print(table.to_string(index=False))


def measure(size: int, root: Path) -> dict[str, float]:
    """Seconds and memory of one flight."""
    name = f"meadow{size}"
    site_folder = root / "data" / "sites" / name
    if not (site_folder / "site.yaml").exists():
        scene = root / f"{name}.yaml"
        scene.parent.mkdir(parents=True, exist_ok=True)
        scene.write_text(json.dumps(scene_of(size, name)), encoding="utf-8")  # JSON is YAML.
        parameters = Parameters(simulate={"supersampling": 1, "truth_resolution": 0.5})
        site = simulate_scene(scene, root, parameters)
        orient_by_truth(site, parameters)
    row: dict[str, float] = {"photographs": count_photographs(site_folder)}
    products = root / "data" / "products" / name
    for verb, folder in (("match", "matching"), ("surface", "surface")):
        subprocess.run(
            [Path(sys.executable).with_name("workbench"), verb, "--site", name, "--root", root], check=True
        )
        run = json.loads((products / folder / "run.json").read_text(encoding="utf-8"))
        row |= {
            f"{verb}_s": run["seconds"],
            f"{verb}_cpu_s": run["cpu_seconds"],
            f"{verb}_mb": run["peak_memory_mb"],
        }
    made = json.loads((products / "surface" / "metrics.json").read_text(encoding="utf-8"))
    return row | {"coverage": made["coverage_ge1"]}


def scene_of(size: int, name: str) -> dict:
    """A meadow that so many photographs cover."""
    strips, length = LAYOUTS[size]
    across = FRAME[0] * GSD * (1 - SIDE) * (strips - 1)
    return {
        "name": name,
        "title": "Rolling meadow for measurements of cost",
        "seed": 5,
        "crs": "EPSG:25832",
        "vertical_datum": "DHHN2016",
        "origin": [660000.0, 5300000.0],
        "size": [length, round(across, 1)],
        "terrain": {"base": 560.0, "relief": 1.6, "longest": 35.0},
        "boulders": 40 * size // 10,
        "flight": {
            "camera": "3K nadir",
            "frame": None,
            "reduction": 5616 / FRAME[0],
            "gsd": GSD,
            "forward_overlap": FORWARD,
            "side_overlap": SIDE,
            "strips": strips,
            "speed": 15.0,
            "wind": 0.0,
        },
    }


def count_photographs(site_folder: Path) -> int:
    """Photographs of a site."""
    return len((site_folder / "photographs.csv").read_text(encoding="utf-8").splitlines()) - 1


if __name__ == "__main__":
    main()
