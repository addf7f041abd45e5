"""Seamlines: where one photograph of the mosaic gives way to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import geopandas as gpd
import numpy as np
import rasterio.features
from shapely.geometry import shape

from workbench.errors import MosaicError
from workbench.mosaic.rectify import rectify
from workbench.orientation import OrientedPhotograph
from workbench.params import MosaicParameters
from workbench.rasters import Grid

_DEFAULTS = MosaicParameters()


@dataclass(frozen=True, eq=False)
class Preview:
    """One photograph rectified on coarse cells, for seams and colour balance."""

    index: int
    """Number of the photograph in the block, from 0."""
    rows: slice
    """Rows of the coarse grid that it covers."""
    columns: slice
    """Columns of the coarse grid that it covers."""
    colours: np.ndarray
    """(rows, columns, bands) float32, NaN outside the photograph."""
    tangent: np.ndarray
    """(rows, columns) float32: tangent of the angle from the vertical, inf outside."""


def preview(
    index: int, image: np.ndarray, view: np.ndarray, heights: np.ndarray, grid: Grid
) -> Preview | None:
    """Rectify a (reduced) photograph on a coarse grid; None where it shows no cell of it."""
    rows, columns = _reach(view, heights, grid)
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return None
    window = heights[rows, columns]
    colours = rectify(
        image,
        view,
        window,
        resolution=grid.resolution,
        first_row=rows.start,
        first_column=columns.start,
    )
    x = (np.arange(columns.start, columns.stop) + 0.5) * grid.resolution - view[0]
    y = -(np.arange(rows.start, rows.stop) + 0.5) * grid.resolution - view[1]
    tangent = np.hypot(x[None, :], y[:, None]) / np.maximum(view[2] - window, 1e-6)
    tangent[np.isnan(colours[..., 0])] = np.inf
    return Preview(index, rows, columns, colours, tangent.astype(np.float32))


def find_seams(
    previews: Sequence[Preview],
    shape: tuple[int, int],
    *,
    method: str = _DEFAULTS.seams,
    band: float = _DEFAULTS.seam_band,
) -> np.ndarray:
    """Preferred photograph of every coarse cell.

    ``best-view`` takes the smallest angle from the vertical. ``shortest-path`` lets a seam wander
    where neighbours look alike, within the band in which their views are about equally good
    (OpenCV's dynamic-programming seam finder on colour and gradient).

    Returns
    -------
    ndarray of uint16 (rows, columns)
        Index of the photograph plus one; 0 where there is none.
    """
    best = np.full(shape, np.inf, np.float32)
    labels = np.zeros(shape, np.uint16)
    for view in previews:
        window = (view.rows, view.columns)
        better = view.tangent < best[window]
        best[window][better] = view.tangent[better]
        labels[window][better] = view.index + 1
    if method == "shortest-path" and len(previews) > 1:
        _cut(previews, best, labels, band)
    return labels


def seamline_polygons(
    labels: np.ndarray, grid: Grid, photographs: Sequence[OrientedPhotograph]
) -> gpd.GeoDataFrame:
    """One (multi)polygon a photograph of the cells that it gives, with its name and index.

    Raises
    ------
    MosaicError
        If no photograph gives any cell.
    """
    parts: dict[int, list] = {}
    for polygon, value in rasterio.features.shapes(labels, mask=labels > 0, transform=grid.transform):
        parts.setdefault(int(value), []).append(shape(polygon))
    if not parts:
        raise MosaicError("No photograph shows any cell of the surface: check the orientation and CRS.")
    numbers = sorted(parts)
    return gpd.GeoDataFrame(
        {
            "source": numbers,
            "photograph": [photographs[number - 1].name for number in numbers],
            "geometry": [gpd.GeoSeries(parts[number]).union_all() for number in numbers],
        },
        crs=grid.crs,
    )


def _cut(previews: Sequence[Preview], best: np.ndarray, labels: np.ndarray, band: float) -> None:
    images, corners, masks, chosen = [], [], [], []
    for view in previews:
        usable = np.isfinite(view.tangent) & (view.tangent <= best[view.rows, view.columns] + band)
        rows, columns = np.flatnonzero(usable.any(1)), np.flatnonzero(usable.any(0))
        if not len(rows):
            continue
        part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        top, left = view.rows.start + int(rows[0]), view.columns.start + int(columns[0])
        colours = np.nan_to_num(view.colours[part][..., :3])
        if colours.shape[-1] < 3:
            colours = np.repeat(colours[..., :1], 3, axis=-1)
        images.append(np.ascontiguousarray(colours, dtype=np.float32))
        masks.append(np.ascontiguousarray(usable[part], dtype=np.uint8) * 255)
        corners.append((left, top))
        chosen.append(view.index)
    finder: Any = cv2.detail.DpSeamFinder("COLOR_GRAD")  # the stubs know only wrapped arrays
    for index, (left, top), mask in zip(chosen, corners, finder.find(images, corners, masks), strict=True):
        keep = np.asarray(mask.get() if isinstance(mask, cv2.UMat) else mask) > 0
        labels[top : top + keep.shape[0], left : left + keep.shape[1]][keep] = index + 1


def _reach(view: np.ndarray, heights: np.ndarray, grid: Grid) -> tuple[slice, slice]:
    """Rows and columns that rays through the frame's outline can reach between lowest and highest cell."""
    width, height = view[24], view[25]
    edge = np.linspace(0, 1, 9)
    outline = np.concatenate(
        [
            np.stack([edge * width, 0 * edge], 1),
            np.stack([edge * width, 0 * edge + height], 1),
            np.stack([0 * edge, edge * height], 1),
            np.stack([0 * edge + width, edge * height], 1),
        ]
    )
    # Distortion moves the outline by far less than this share of the frame.
    plane = (outline - view[14:16]) / view[12:14] * 1.15
    rays = np.c_[plane, np.ones(len(plane))] @ view[3:12].reshape(3, 3)
    whole = slice(0, grid.height), slice(0, grid.width)
    if np.any(rays[:, 2] > -0.05):
        return whole
    reached = np.concatenate(
        [
            view[:2] + rays[:, :2] * ((level - view[2]) / rays[:, 2])[:, None]
            for level in (float(heights.min()), float(heights.max()))
        ]
    )
    columns, rows = reached[:, 0] / grid.resolution, -reached[:, 1] / grid.resolution
    return (
        slice(int(max(np.floor(rows.min()), 0)), int(min(np.ceil(rows.max()), grid.height))),
        slice(int(max(np.floor(columns.min()), 0)), int(min(np.ceil(columns.max()), grid.width))),
    )
