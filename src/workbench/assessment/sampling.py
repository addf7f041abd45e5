"""Random points for an error matrix: simple or stratified by class."""

from __future__ import annotations

from typing import Literal

import geopandas as gpd
import numpy as np
import pandas as pd
import xarray as xr

from workbench.assessment.error_matrix import ErrorMatrix, error_matrix
from workbench.errors import AssessmentError
from workbench.rasters import Grid

Design = Literal["simple", "stratified"]


def sample_points(
    classes: xr.DataArray, count: int, *, design: Design = "simple", seed: int = 0
) -> gpd.GeoDataFrame:
    """Draw random cells of a class raster, each at most once, as points at their centres.

    Parameters
    ----------
    classes
        (y, x) class of each cell with a CRS: bool, integers, or floats with NaN where unknown. Unknown
        cells are never drawn.
    count
        Number of points, or of points per class when stratified; fewer where a class has fewer cells.
    design
        ``simple``: every known cell is equally likely. ``stratified``: the same number in each class,
        so that rare classes are judged too; scores over all classes then need the areas as weights
        (column ``weight``: cells that a point stands for).
    seed
        Seed of the draw.

    Returns
    -------
    GeoDataFrame
        Points with columns class, row, column, weight.

    Raises
    ------
    AssessmentError
        If no cell is known or the count is not positive.
    """
    if count < 1:
        raise AssessmentError(f"{count} points judge nothing: ask for at least one.")
    grid = Grid.of(classes)
    values = classes.to_numpy()
    known = np.flatnonzero(np.isfinite(values.ravel()) if values.dtype.kind == "f" else np.ones(values.size))
    if len(known) == 0:
        raise AssessmentError("The class raster has no known cell to draw points from.")
    rng = np.random.default_rng(seed)
    strata = [known]
    if design == "stratified":
        of_cell = values.ravel()[known]
        strata = [known[of_cell == name] for name in np.unique(of_cell)]
    drawn, weight = [], []
    for cells in strata:
        chosen = rng.choice(cells, min(count, len(cells)), replace=False)
        drawn.append(chosen)
        weight.append(np.full(len(chosen), len(cells) / len(chosen)))
    places = np.concatenate(drawn)
    row, column = np.divmod(places, grid.width)
    table = pd.DataFrame(
        {
            "class": values.ravel()[places],
            "row": row,
            "column": column,
            "weight": np.concatenate(weight),
        }
    )
    return gpd.GeoDataFrame(table, geometry=gpd.points_from_xy(grid.x[column], grid.y[row]), crs=grid.crs)


def mask_accuracy(
    mask: xr.DataArray,
    reference: xr.DataArray,
    count: int,
    *,
    names: tuple[str, str] = ("tree", "other"),
    design: Design = "simple",
    seed: int = 0,
) -> ErrorMatrix:
    """Error matrix of a mask at random points [thesis 4.4].

    Parameters
    ----------
    mask, reference
        (y, x) bool (or 0, 1, NaN = unknown) on the same grid.
    count, design, seed
        See :func:`sample_points`; strata are those of the reference.
    names
        Of true and of false cells.

    Raises
    ------
    AssessmentError
        If grids differ or nothing is known.
    """
    if Grid.of(mask) != Grid.of(reference):
        raise AssessmentError("Mask and reference lie on different grids: use rasters.match_grid first.")
    known = xr.where(np.isfinite(mask) & np.isfinite(reference), reference.astype(float), np.nan)
    known = known.rio.write_crs(mask.rio.crs)
    points = sample_points(known, count, design=design, seed=seed)
    found = mask.to_numpy()[points["row"], points["column"]].astype(bool)
    true = points["class"].to_numpy().astype(bool)
    label = np.array([names[1], names[0]])
    return error_matrix(list(label[found.astype(int)]), list(label[true.astype(int)]), names)
