"""Speed of tree tops and crowns on 25 Mpx, beside peers, in one run on one machine.

Wall and CPU seconds after a first run that compiles. Peers: scipy's maximum filter with a disc, and the
watershed of scikit-image from the same tops. ``--peers`` runs them too (minutes). ``--large`` times 25 and
100 Mpx by tiles, with the peak of memory, to see how cost and memory grow.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import dask.array
import numpy as np
import xarray as xr
from scipy import ndimage
from skimage.segmentation import watershed

from workbench.rasters import Grid, new_raster
from workbench.trees import GrowingWindow, crown_labels, find_tops

CELL = 0.2
SIZE = 5000
SPACING = 15.8  # Cells between trees: 100 000 on 25 Mpx, of which 90 000 have a top of their own.


def canopy(size: int, seed: int = 0) -> xr.DataArray:
    """Domes on a jittered grid with rough crowns: a closed stand of one tree in ``SPACING`` squared cells."""
    rng = np.random.default_rng(seed)
    number = round(size / SPACING)
    step = size / number
    rows, columns = np.divmod(np.arange(number * number), number)
    y = (rows + 0.5 + rng.uniform(-0.25, 0.25, len(rows))) * step
    x = (columns + 0.5 + rng.uniform(-0.25, 0.25, len(rows))) * step
    height, radius = rng.uniform(15, 30, len(rows)), rng.uniform(0.55, 0.75, len(rows)) * step
    values = np.zeros((size, size), np.float32)
    for i, j, z, r in zip(y, x, height, radius, strict=True):
        top, left = max(int(i - r), 0), max(int(j - r), 0)
        part = values[top : int(i + r) + 2, left : int(j + r) + 2]
        a, b = np.ogrid[top : top + part.shape[0], left : left + part.shape[1]]
        far = ((a - i) ** 2 + (b - j) ** 2) / r**2
        np.maximum(part, np.where(far < 1, z * (1 - 0.6 * far), 0), out=part)
    values += ndimage.gaussian_filter(rng.normal(size=values.shape).astype(np.float32), 1.0, truncate=2)
    grid = Grid.from_bounds("EPSG:32633", (0, 0, size * CELL, size * CELL), CELL)
    return new_raster(np.maximum(values, 0), grid, name="height", units="m")


def timed(name: str, run: Callable[[], Any], repeat: int = 3) -> Any:
    """Run and print the best wall time, with its CPU time."""
    best, result = (np.inf, np.inf), None
    for _ in range(repeat):
        wall, cpu = time.perf_counter(), time.process_time()
        result = run()
        best = min(best, (time.perf_counter() - wall, time.process_time() - cpu))
    print(f"{name:55s} {best[0]:8.2f} s wall {best[1]:8.2f} s CPU", flush=True)
    return result


def footprint(radius: float) -> np.ndarray:
    """Cells of a disc."""
    reach = int(radius)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return x**2 + y**2 <= radius**2


def compare(peers: bool) -> None:
    """The table of 25 Mpx."""
    small, height = canopy(500), canopy(SIZE)
    crown_labels(find_tops(small), small)  # Compiles.
    for radius in (5.0, 24.5):
        tops = timed(f"tops, radius {radius} px", lambda r=radius: find_tops(height, radius=r * CELL))
        if peers:
            shape = footprint(radius)
            peak = timed(
                f"  scipy maximum_filter, radius {radius} px",
                lambda s=shape: ndimage.maximum_filter(height.values, footprint=s),
                repeat=1,
            )
            same = np.zeros(height.shape, bool)
            same[tops["row"], tops["column"]] = True
            print(f"    every top is a maximum of scipy's: {bool((peak == height.values)[same].all())}")
    flat = height.copy(data=np.full(height.shape, 12.0, np.float32))
    timed("tops on a constant raster, radius 24.5 px", lambda: find_tops(flat, radius=24.5 * CELL), 2)
    tops = timed("tops, defaults", lambda: find_tops(height))
    print(f"    {len(tops)} tops")
    timed("tops, smoothed by 0.15 m as in the tree stage", lambda: find_tops(height, smoothing=0.15))
    # Without the spacing there are some more: 90 000, as the peers were timed with.
    tops = find_tops(height, window=GrowingWindow(), prominence_share=0.03)
    labels = timed(f"crowns of {len(tops)} tops, default criteria", lambda: crown_labels(tops, height))
    print(f"    {len(np.unique(labels.values)) - 1} crowns")
    if peers:
        markers = np.zeros(height.shape, np.int32)
        markers[tops["row"], tops["column"]] = tops["tree_id"]
        timed(
            "  scikit-image watershed",
            lambda: watershed(-height.values, markers, mask=height.values >= 3),
            repeat=1,
        )


def large() -> None:
    """Tops and crowns of 25 and 100 Mpx, each in a process of its own."""
    for repeats in (2, 4):
        subprocess.run([sys.executable, __file__, "--one", str(repeats)], check=True)


def one(repeats: int) -> None:
    """Time and peak memory on a canopy repeated in both directions, which is never in memory as a whole."""
    block = canopy(SIZE // 2)
    crown_labels(find_tops(block), block)
    cells = SIZE // 2 * repeats
    grid = Grid.from_bounds("EPSG:32633", (0, 0, cells * CELL, cells * CELL), CELL)
    values = dask.array.tile(dask.array.from_array(block.values, chunks=-1), (repeats, repeats))
    surface = xr.DataArray(values, dims=("y", "x"), coords={"y": grid.y, "x": grid.x}).rio.write_crs(grid.crs)
    started, cpu = time.perf_counter(), time.process_time()
    tops = find_tops(surface)
    found, found_cpu = time.perf_counter(), time.process_time()
    crown_labels(tops, surface)
    grown, grown_cpu = time.perf_counter(), time.process_time()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    print(
        f"{surface.size / 1e6:.0f} Mpx, {len(tops)} tops: {found - started:.2f} s wall "
        f"{found_cpu - cpu:.2f} s CPU, crowns {grown - found:.2f} s wall {grown_cpu - found_cpu:.2f} s CPU, "
        f"peak {memory:.2f} GB",
        flush=True,
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--peers", action="store_true", help="Run the peers too.")
    parser.add_argument("--large", action="store_true", help="25 and 100 Mpx, with the peak of memory.")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        one(args.one)
    elif args.large:
        large()
    else:
        compare(args.peers)


if __name__ == "__main__":
    main()
