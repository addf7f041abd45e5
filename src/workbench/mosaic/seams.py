"""Seamlines: where one photograph of the mosaic gives way to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import geopandas as gpd
import numpy as np
import rasterio.features
from shapely.geometry import shape
from skimage.segmentation import watershed

from workbench.errors import MosaicError
from workbench.mosaic.rectify import rectify
from workbench.orientation import OrientedPhotograph
from workbench.params import MosaicParameters
from workbench.rasters import Grid

_DEFAULTS = MosaicParameters()
_BLUR = 1.0  # Coarse cells.


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
    base_ratio: float,
    method: str = _DEFAULTS.seams,
    band: float = _DEFAULTS.seam_band,
) -> np.ndarray:
    """Preferred photograph of every coarse cell.

    ``best-view`` takes the smallest angle from the vertical. ``low-difference`` starts from the same
    borders and lets a seam leave them where the two best views look different, to go around a crown or a
    roof: labels flood from the cells whose best view is better by more than the band (a watershed, as
    Soille (2006) composes images), and meet on the ridge of ``-(d / c)^2 - (g / b)^2``. d is the
    difference of the two best views in colour, c the contrast of the mosaic, g the difference of their
    tangents, b the band. Where nothing stands in the way the second term alone decides, so that a seam
    over grass stays on the border of the best view, and with it wherever that is in the next computation.

    Parameters
    ----------
    base_ratio
        Distance to the nearest other station over the flying height, the median of the block.
    band
        How much more slanted than the best view another may be, in parts of ``base_ratio``.

    Returns
    -------
    ndarray of uint16 (rows, columns)
        Index of the photograph plus one; 0 where there is none.
    """
    labels = np.zeros(shape, np.uint16)
    best, second = (np.full(shape, np.inf, np.float32) for _ in range(2))
    bands = previews[0].colours.shape[-1] if previews else 1
    colours, others = (np.full((*shape, bands), np.nan, np.float32) for _ in range(2))
    for view in previews:
        window = (view.rows, view.columns)
        better = view.tangent < best[window]
        next_best = ~better & (view.tangent < second[window])
        second[window][better], others[window][better] = best[window][better], colours[window][better]
        second[window][next_best], others[window][next_best] = (
            view.tangent[next_best],
            view.colours[next_best],
        )
        best[window][better], colours[window][better] = view.tangent[better], view.colours[better]
        labels[window][better] = view.index + 1
    if method == "best-view" or len(previews) < 2:
        return labels
    with np.errstate(invalid="ignore"):  # inf - inf where nobody looks
        slant = np.nan_to_num((second - best) / (band * base_ratio), nan=np.inf, posinf=np.inf)
    return _flood(labels, slant, _difference(colours, others))


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


def _difference(colours: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Difference (rows, columns) of two views, 1 for the contrast of the mosaic; 0 where one is missing."""
    known = np.isfinite(colours).all(axis=-1) & np.isfinite(others).all(axis=-1)
    if not known.any():
        return np.zeros(known.shape, np.float32)
    contrast = max(float(np.std(colours[known], axis=0).mean()), 1e-6)
    length = np.sqrt(np.mean(np.square(np.where(known[..., None], colours - others, 0)), axis=-1)) / contrast
    # A cell or two around what differs keep a seam off its rim, and smooth the noise of single cells.
    return cv2.GaussianBlur(length.astype(np.float32), (0, 0), _BLUR)


def _flood(labels: np.ndarray, slant: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """Labels grown from where the best view is beyond doubt, over the ridges between them."""
    ridge = -np.square(difference) - np.square(np.minimum(slant, 1.0))
    seeds = np.where(slant >= 1, labels, 0).astype(np.int32)
    if not seeds.any():
        return labels
    grown = watershed(ridge, seeds, mask=labels > 0).astype(np.uint16)
    return np.where(grown > 0, grown, labels)


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
