"""Compare the estimate of time and memory with what a finished site took.

    python benchmarks/estimate.py --site brighton --root .

Prints one line a stage: estimated and measured CPU seconds, and the largest memory. The coefficients
of ``workbench.site.estimate`` come from such tables.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from workbench.params import Parameters, load_parameters
from workbench.site import estimate_cost, load_site
from workbench.stages import FOLDERS, read_json


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--site", required=True)
    parser.add_argument("--root", type=Path, default=Path())
    options = parser.parse_args()
    path = options.root / "params.yaml"
    parameters = load_parameters(path) if path.exists() else Parameters()
    site = load_site(options.site, options.root)
    expected = estimate_cost(site, parameters)
    print(f"{'stage':10}{'estimated CPU s':>18}{'measured CPU s':>18}{'measured MB':>14}")
    for stage, seconds in expected.seconds.items():
        run = site.products / FOLDERS[stage] / "run.json"
        estimated = f"{seconds * expected.threads:18.0f}"
        if run.exists():
            facts = read_json(run)
            print(f"{stage:10}{estimated}{facts['cpu_seconds']:18.0f}{facts['peak_memory_mb']:14.0f}")
        else:
            print(f"{stage:10}{estimated}{'not run':>18}{'':14}")
    print(f"estimated peak memory {expected.peak_memory_mb:.0f} MB")


if __name__ == "__main__":
    main()
