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
        whole = float((full["seconds_each"] * full["steps"]).sum())
        rows.append((name, round(spent, 1), int(full["steps"].sum()), round(whole / 3600, 2)))
    table = pd.DataFrame(rows, columns=["study", "quick_s", "full_steps", "full_h"])
    print(table.to_string(index=False))
    print(f"quick {table['quick_s'].sum() / 60:.1f} min, full {table['full_h'].sum():.1f} h of single steps")


if __name__ == "__main__":
    main()
