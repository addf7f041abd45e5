"""The 2.5D mesh of the sparse tie points, smoothed: a surface for canopies that move."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.interpolate import LinearNDInterpolator
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.spatial import Delaunay

from workbench.errors import MosaicError
from workbench.params import MosaicParameters
from workbench.rasters import Grid, new_raster

_DEFAULTS = MosaicParameters()


def mesh_surface(
    tie_points: np.ndarray,
    grid: Grid,
    *,
    vertical_datum: str,
    smoothing: int = _DEFAULTS.mesh_smoothing,
) -> xr.DataArray:
    """Rasterise the smoothed Delaunay mesh of tie points [orthomosaic paper 2.6].

    Each round of smoothing moves the height of a vertex half way to the mean of its neighbours.
    The authors set the smoothing of their software to 35, whose unit it does not document;
    here it is the number of rounds, so that heights are averaged over about sqrt(35) edges.

    Parameters
    ----------
    tie_points
        World coordinates (n, 3).
    grid
        Cells of the result.
    vertical_datum
        Datum of the heights.
    smoothing
        Rounds, 0 leaves the mesh as it is.

    Returns
    -------
    DataArray
        Heights (rows, columns), metres; NaN outside the mesh.

    Raises
    ------
    MosaicError
        If fewer than four points are given, or all lie on one line.
    """
    if len(tie_points) < 4 or np.linalg.matrix_rank(tie_points[:, :2] - tie_points[0, :2]) < 2:
        raise MosaicError(
            f"{len(tie_points)} tie points make no mesh: use the dense surface (mosaic.surface: dsm)."
        )
    places = tie_points[:, :2] - (grid.west, grid.north)
    mesh = Delaunay(places)
    heights = _smooth(mesh, tie_points[:, 2], smoothing)
    interpolate = LinearNDInterpolator(mesh, heights)
    values = np.empty(grid.shape, np.float32)
    x = grid.x - grid.west
    for tile in grid.tiles(1024):
        rows, columns = tile.core
        values[tile.core] = interpolate(*np.meshgrid(x[columns], grid.y[rows] - grid.north))
    return new_raster(values, grid, name="mesh", units="m", vertical_datum=vertical_datum)


def _smooth(mesh: Delaunay, heights: np.ndarray, rounds: int) -> np.ndarray:
    first, second = np.vstack([mesh.simplices[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]).T
    ones = np.ones(len(first) * 2)
    edges = coo_matrix((ones, (np.r_[first, second], np.r_[second, first])), (len(heights),) * 2)
    neighbours = csr_matrix(edges).sign()
    degree = np.asarray(neighbours.sum(axis=1)).ravel()
    mean_of_neighbours = diags(1 / np.maximum(degree, 1)) @ neighbours
    for _ in range(rounds):
        heights = np.where(degree > 0, 0.5 * heights + 0.5 * (mean_of_neighbours @ heights), heights)
    return heights
