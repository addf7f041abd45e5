"""Time and error of the bilateral filter, 1000 x 1000 cells, windows of 49 and 249 cells.

    python benchmarks/bilateral.py              # own filter; OpenCV at 49 cells
    python benchmarks/bilateral.py --slow       # OpenCV at 249 cells as well (minutes)

The error is against the sum written down in the documentation of the filter, in float64, at random cells
and at every spike; the thesis needed 120 s and 2400 s on 8 threads (published/tree_bilateral_runtime.csv).
"""

from __future__ import annotations

import argparse
import time

import cv2
import numpy as np
import pandas as pd

from workbench.surface import bilateral

SIZE = 1000
SAMPLES = 1500


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--slow", action="store_true")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    bilateral(landscape(5.0)[:64, :64], 5, 10.0)  # Compilation.
    rows = []
    for relief in (5.0, 150.0):
        surface = landscape(relief)
        for size in (49, 249):
            spent = []
            for _ in range(options.repeats):
                start, cpu = time.perf_counter(), time.process_time()
                found = np.asarray(bilateral(surface, size, 10.0))
                spent.append((time.perf_counter() - start, time.process_time() - cpu))
            wall, cpu = (min(column) for column in zip(*spent, strict=True))
            rows.append(row("workbench", relief, size, wall, cpu, surface, found))
            if size == 49 or options.slow:
                start, cpu = time.perf_counter(), time.process_time()
                filled = np.nan_to_num(surface, nan=float(np.nanmedian(surface)))
                theirs = cv2.bilateralFilter(filled, size, 10.0, size / 6)
                wall, cpu = time.perf_counter() - start, time.process_time() - cpu
                rows.append(row("OpenCV", relief, size, wall, cpu, surface, theirs))
    print(pd.DataFrame(rows).to_string(index=False))


def landscape(relief: float) -> np.ndarray:
    """Hills, trees of 0 to 25 m, noise, holes, single spikes up and down."""
    random = np.random.default_rng(1)
    hills = cv2.GaussianBlur(random.normal(size=(SIZE, SIZE)), (0, 0), 80)
    trees = np.abs(cv2.GaussianBlur(random.normal(size=(SIZE, SIZE)), (0, 0), 8))
    z = 400 + hills / np.ptp(hills) * relief + trees / trees.max() * 25
    z += random.normal(size=z.shape) * 0.2
    z[300:360, 500:700] = np.nan
    z[random.random(z.shape) < 0.01] = np.nan
    for at, step in (((100, 100), 60), ((800, 300), -40), ((500, 900), 90)):
        z[at] += step
    return z.astype(np.float32)


def row(
    name: str, relief: float, size: int, wall: float, cpu: float, surface: np.ndarray, found: np.ndarray
) -> dict[str, object]:
    """One line of the table."""
    random = np.random.default_rng(2)
    cells = [(100, 100), (800, 300), (500, 900), *map(tuple, random.integers(0, SIZE, (SAMPLES, 2)))]
    error = [
        abs(found[cell] - exact(surface, cell, size, 10.0)) for cell in cells if np.isfinite(surface[cell])
    ]
    return {
        "filter": name,
        "relief_m": relief,
        "size": size,
        "seconds": round(wall, 3),
        "cpu_s": round(cpu, 3),
        "largest_error_mm": round(1000 * max(error), 3),
        "median_error_mm": round(1000 * float(np.median(error)), 4),
    }


def exact(z: np.ndarray, cell: tuple[int, int], size: int, sigma: float) -> float:
    """The definition of the filter at one cell, in float64."""
    reach, space = size // 2, size / 6
    row, column = int(cell[0]), int(cell[1])
    rows = slice(max(row - reach, 0), row + reach + 1)
    columns = slice(max(column - reach, 0), column + reach + 1)
    part = z[rows, columns].astype(np.float64)
    y, x = np.mgrid[rows.start : rows.start + part.shape[0], columns.start : columns.start + part.shape[1]]
    own = float(z[row, column])
    weight = np.exp(
        -((y - row) ** 2 + (x - column) ** 2) / (2 * space**2) - (part - own) ** 2 / (2 * sigma**2)
    )
    weight[np.isnan(part)] = 0
    return float(own + (weight * np.nan_to_num(part - own)).sum() / weight.sum())


if __name__ == "__main__":
    main()
