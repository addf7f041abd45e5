"""The default of ``find_tops`` beside what common tools do, on canopy height models of virtual forests.

Tops are sought without any knowledge of the stand, on cells as laser scanning has them (0.5 and 1 m, the
highest leaf of each), and matched with the true trees that are seen from above. Peers are written out here
from their documentation: a disc whose width is constant or grows with height (lidR ``lmf``, ForestTools
``vwf``), the deciduous and the conifer formula of Popescu & Wynne (2004), a median filter and a square of
five cells (pycrown), and scikit-image's ``peak_local_max`` after a Gaussian.

    python benchmarks/trees_peers.py --folder DIR
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import xarray as xr
from scipy import ndimage
from skimage.feature import peak_local_max
from trees_virtual import SCENES, judge, references, stands_of, true_heights, true_scene

from workbench.rasters import Grid
from workbench.trees import find_tops

SEEDS = (None, 203)
LEAST = 3.0


def disc(width: Callable) -> Callable:
    """Local maxima in a disc of a width (m) by height, at least the eight neighbours."""

    def tops(height: xr.DataArray) -> gpd.GeoDataFrame:
        least = 1.42 * Grid.of(height).resolution
        return find_tops(height, radius=lambda h: np.maximum(width(h) / 2, least), working_resolution=None)

    return tops


def peaks(distance: int, sigma: float) -> Callable:
    """scikit-image, distance and standard deviation in cells."""

    def tops(height: xr.DataArray) -> gpd.GeoDataFrame:
        values = ndimage.gaussian_filter(height.values, sigma) if sigma else height.values
        found = peak_local_max(values, min_distance=distance, threshold_abs=LEAST, exclude_border=False)
        return _table(height, *found.T)

    return tops


def median_square(height: xr.DataArray) -> gpd.GeoDataFrame:
    """Median over five cells, then the highest in a square of five cells, one a plateau."""
    values = ndimage.median_filter(height.values, 5)
    high = (values == ndimage.maximum_filter(values, 5)) & (values >= LEAST)
    labels, count = ndimage.label(high, np.ones((3, 3)))
    centres = np.array(ndimage.center_of_mass(high, labels, range(1, count + 1))).reshape(-1, 2)
    return _table(height, *np.round(centres).astype(int).T)


METHODS: dict[str, Callable] = {
    "find_tops, default": find_tops,
    "disc 3 m": disc(lambda h: np.full_like(h, 3.0)),
    "disc 5 m": disc(lambda h: np.full_like(h, 5.0)),
    "disc 3 m + 0.1 h": disc(lambda h: 3 + 0.1 * h),
    "disc 3 m + 0.07 h": disc(lambda h: 3 + 0.07 * h),
    "disc 1.2 m + 0.1 h": disc(lambda h: 1.2 + 0.1 * h),
    "Popescu, conifer": disc(lambda h: 3.75105 - 0.17919 * h + 0.01241 * h**2),
    "Popescu, deciduous": disc(lambda h: 3.09632 + 0.00895 * h**2),
    "median 5, square 5": median_square,
    "peak_local_max 2, Gaussian 1": peaks(2, 1.0),
    "peak_local_max 3, Gaussian 1": peaks(3, 1.0),
    "peak_local_max 3": peaks(3, 0.0),
}


def _table(height: xr.DataArray, rows: np.ndarray, columns: np.ndarray) -> gpd.GeoDataFrame:
    grid = Grid.of(height)
    x = grid.west + (columns + 0.5) * grid.resolution
    y = grid.north - (rows + 0.5) * grid.resolution
    heights = height.values[rows, columns].astype(float)
    return gpd.GeoDataFrame({"height_m": heights}, geometry=gpd.points_from_xy(x, y), crs=grid.crs)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, default=Path("/tmp/trees_virtual"))
    folder = parser.parse_args().folder
    pd.set_option("display.width", 250, "display.max_columns", 30)
    for cell in (0.5, 1.0):
        parts = []
        for scene in SCENES:
            for seed in SEEDS:
                source = true_scene(scene, seed, folder)
                height = true_heights(source, cell).fillna(0.0)
                trees, stands = references(source), stands_of(scene)
                for name, method in METHODS.items():
                    parts.append(judge(method(height), trees, stands).assign(method=name, scene=scene[:1]))
        table = pd.concat(parts)
        table["place"] = table["scene"] + " " + table["stand"]
        scores = table.groupby(["method", "place"])["f1_visible"].mean().unstack("place")
        scores["mean"] = scores.mean(axis=1)
        print(f"\nF1 (%) over visible trees, cells of {cell:g} m, without stand types")
        print(scores.loc[list(METHODS)].round(1).to_string())


if __name__ == "__main__":
    main()
