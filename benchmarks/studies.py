"""What the studies cost: seconds that were spent, and an estimate of the full set from them.

python benchmarks/studies.py [--root DIR]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd

from workbench.studies.design import load_study, shipped_studies
from workbench.studies.runner import estimate_study


def main() -> None:
    """Print a row per study: seconds of the quick preset that were spent, and what the full design needs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--root", type=Path, default=Path())
    root = parser.parse_args().root
    rows = []
    for name in shipped_studies():
        costs = root / "data" / "studies" / f"{name}-quick" / "costs.csv"
        spent = pd.read_csv(costs)["seconds"].sum() if costs.exists() else float("nan")
        full = estimate_study(load_study(name), root)
        whole = [
            float((full[kind] * full["steps"]).sum()) / 3600 for kind in ("seconds_each", "cpu_seconds_each")
        ]
        quick = estimate_study(load_study(name, quick=True), root)
        processor = float((quick["cpu_seconds_each"] * quick["steps"]).sum()) / 60
        rows.append((name, spent / 60, processor, int(full["steps"].sum()), *whole))
    columns = ["study", "quick_min", "quick_cpu_min", "full_steps", "full_h", "full_cpu_h"]
    table = pd.DataFrame(rows, columns=columns).round(2)
    print(table.to_string(index=False))
    print(table.drop(columns="study").sum().round(1).to_string())


if __name__ == "__main__":
    main()
