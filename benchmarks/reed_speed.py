"""Time and memory of the reed metrics: one area, a lakeshore of 25 megapixels, and density cells alone.

Run it on an idle machine: ``python benchmarks/reed_speed.py``; where others work on it, too, the seconds of
the processor tell more than those of the clock. Every case runs in a process of its own on a surface read
from a file; memory is the peak of that process, libraries included. ``--exactextract`` compares all density
cells with exactextract (seconds); the result for several bands of rows is compared bit by bit.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import geopandas as gpd
import numpy as np
import shapely
from rasterio.crs import CRS
from scipy.ndimage import gaussian_filter

from workbench.rasters import Grid, new_raster, read_raster, write_raster
from workbench.reed import ReedModel, cell_statistics, object_height
from workbench.vectors import read_vector, write_layers

LEVEL, PIXEL = 517.93, 0.136
CASES = {"area": (1000, 1000, 1.0), "lakeshore": (2500, 10_000, 15.0)}
"""Rows, columns, seconds that are aimed at."""
CELLS = (2000, 2000, 0.15)


def lakeshore(rows: int, columns: int, seed: int = 1) -> tuple:
    """A rough belt of reed with islets, gaps without heights, and a wavy front; and the lake."""
    rng = np.random.default_rng(seed)
    grid = Grid(CRS.from_epsg(32633), 316000.07, 5303000.02, PIXEL, columns, rows)
    shore = 0.3 * rows * PIXEL
    out = (np.arange(rows, dtype=np.float32) * PIXEL - np.float32(shore))[:, None]
    front = (
        14
        + gaussian_filter(rng.normal(size=columns), 20) * 20
        + gaussian_filter(rng.normal(size=columns), 5) * 3
    )
    texture = gaussian_filter(rng.standard_normal((rows, columns), dtype=np.float32), 1.5) * 2
    reed = (out > -2) & (out < front.astype(np.float32))
    for x in np.arange(15, columns * PIXEL, 25):
        reed |= np.hypot(np.arange(columns, dtype=np.float32) * PIXEL - x, out - 21) < 1.5
    heights = np.where(reed, 2.5 - 0.06 * out + texture, 0.1 * texture).astype(np.float32) + np.float32(LEVEL)
    heights[texture > 0.95] = np.nan
    dsm = new_raster(heights, grid, name="dsm", units="m", vertical_datum="DHHN2016")
    west, south, east, north = grid.bounds
    lake = gpd.GeoDataFrame(geometry=[shapely.box(west, south, east, north - shore)], crs=grid.crs)
    return dsm, lake


def measure(folder: Path) -> None:
    """All metrics of one surface, in this process."""
    dsm, lake = read_raster(folder / "dsm.tif"), read_vector(folder / "lake.gpkg")
    started, cpu = time.perf_counter(), time.process_time()
    metrics = ReedModel(dsm, LEVEL, lake).measure()
    seconds, cpu = time.perf_counter() - started, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    totals = metrics.totals()
    found = ", ".join(
        f"{key} {totals[key]:.0f}" for key in ("extent_m2", "front_m", "islets", "holes", "sections")
    )
    print(f"{seconds:.2f} s ({cpu:.2f} s of processor), peak {peak:.2f} GB ({found})")


def cells(compare: bool) -> None:
    """Density cells alone, in bands of several sizes, and against exactextract."""
    rows, columns, aim = CELLS
    ohm = object_height(lakeshore(rows, columns)[0], LEVEL)
    cell_statistics(ohm)
    times, cpu = [], time.process_time()
    for _ in range(5):
        started = time.perf_counter()
        found = cell_statistics(ohm)
        times.append(time.perf_counter() - started)
    cpu = (time.process_time() - cpu) / 5
    print(
        f"density cells: {found.mean.size} in {min(times):.3f} s (best of 5; {cpu:.3f} s of processor; "
        f"aim {aim} s)"
    )
    for band in (1, 7, 50, 1000):
        other = cell_statistics(ohm, band=band)
        same = all(
            np.array_equal(getattr(found, name), getattr(other, name), equal_nan=True)
            for name in ("mean", "variance", "known")
        )
        print(f"  bands of {band} rows of cells: {'identical' if same else 'DIFFERENT'}")
    if compare:
        against_exactextract(ohm, found)


def against_exactextract(ohm, found) -> None:
    """Largest difference over all cells, and its time."""
    from exactextract import exact_extract
    from exactextract.raster import NumPyRasterSource

    grid, pixels = found.grid, Grid.of(ohm)
    row, column = (index.ravel() for index in np.indices(grid.shape))
    west, north = grid.west + column * grid.resolution, grid.north - row * grid.resolution
    squares = shapely.box(west, north - grid.resolution, west + grid.resolution, north)
    frame = gpd.GeoDataFrame(geometry=squares, crs=grid.crs)
    source = NumPyRasterSource(
        ohm.values.astype(float), *pixels.bounds, nodata=np.nan, srs_wkt=pixels.crs.to_wkt()
    )
    started = time.perf_counter()
    exact = exact_extract(source, frame, ["mean", "variance"], output="pandas")
    seconds = time.perf_counter() - started
    some = found.known.ravel() > 1e-6
    worst = max(
        float(np.abs(getattr(found, ours).ravel()[some] - exact[theirs].to_numpy()[some]).max())
        for ours, theirs in (("mean", "mean"), ("variance", "variance"))
    )
    print(f"  exactextract: {seconds:.1f} s, largest difference {worst:.1e}")


def main() -> None:
    """Make the surfaces, run the cases."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--exactextract", action="store_true")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure is not None:
        measure(options.measure)
        return
    for name, (rows, columns, aim) in CASES.items():
        with tempfile.TemporaryDirectory() as folder:
            dsm, lake = lakeshore(rows, columns)
            write_raster(dsm, Path(folder) / "dsm.tif")
            write_layers({"lake": lake}, Path(folder) / "lake.gpkg")
            del dsm
            print(f"{name}, {rows} x {columns} (aim {aim:g} s): ", end="", flush=True)
            subprocess.run([sys.executable, __file__, "--measure", folder], check=True)
    cells(options.exactextract)


if __name__ == "__main__":
    main()
