"""Outlines of labelled cells as polygons."""

from __future__ import annotations

import numpy as np
import rasterio.features
import shapely

from workbench.rasters import Grid


def outlines(labels: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Polygon of each positive label.

    Parameters
    ----------
    labels
        (rows, columns) int32, 0 none.
    grid
        Where the cells lie.

    Returns
    -------
    ids, shapes, cells
        (n,) labels, rising; (n,) polygons, or multipolygons where parts meet in a corner only; (n,)
        number of cells.
    """
    cells = np.bincount(labels.ravel())
    cells[:1] = 0
    ids = np.flatnonzero(cells)
    if len(ids) == 0:
        return ids.astype(np.int32), np.array([], dtype=object), ids
    found, parts = [], []
    for shape, value in rasterio.features.shapes(labels, mask=labels > 0, transform=grid.transform):
        rings = [shapely.linearrings(ring) for ring in shape["coordinates"]]
        parts.append(shapely.polygons(rings[0], holes=rings[1:] or None))
        found.append(int(value))
    order = np.argsort(found, kind="stable")
    places = np.searchsorted(ids, np.asarray(found)[order])
    pieces = np.asarray(parts, dtype=object)[order]
    shapes = np.empty(len(ids), dtype=object)
    starts = np.searchsorted(places, np.arange(len(ids) + 1))
    single = np.diff(starts) == 1
    shapes[single] = pieces[starts[:-1][single]]
    for k in np.flatnonzero(~single):
        shapes[k] = shapely.multipolygons(pieces[starts[k] : starts[k + 1]])
    return ids.astype(np.int32), shapes, cells[ids]
