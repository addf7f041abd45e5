"""Coarse to fine: the coarser surface, seen from the left image, limits the search."""

from __future__ import annotations

import math

import cv2
import numpy as np

from workbench.compiled import compiled
from workbench.matching.levels import common_extent
from workbench.matching.rectify import Rectification
from workbench.rasters import Grid
from workbench.surface.filling import FilledHeights

_STEP = 8  # A guide needs no more detail than the coarser level had.


def guide_disparity(
    rectification: Rectification, surface: FilledHeights, top: float, bottom: float
) -> np.ndarray:
    """Expected disparity of every left pixel, from the first hit of its ray with a surface.

    Parameters
    ----------
    rectification
        The pair.
    surface
        Coarser surface; only the part that the pair can see is read.
    top, bottom
        Heights between which rays are followed, metres.

    Returns
    -------
    ndarray (rows, columns) float32
        Disparity of the rectified pair, px; NaN where the ray leaves the surface.
    """
    rows, columns = rectification.shape
    u = np.arange(0, columns + _STEP, _STEP) + 0.5
    v = np.arange(0, rows + _STEP, _STEP) + 0.5
    window = _seen_window(rectification, surface.grid, (bottom, top))
    if window is None:
        return np.full((rows, columns), np.nan, np.float32)
    heights, _ = surface.window(*window)
    grid = surface.grid.window(*window)
    origin = rectification.centre - (grid.west, grid.north, 0.0)
    coarse = _first_hits(
        np.ascontiguousarray(heights, dtype=np.float32),
        grid.resolution,
        origin,
        np.ascontiguousarray(rectification.rotation),
        (u - rectification.principal[0]) / rectification.focal,
        (v - rectification.principal[1]) / rectification.focal,
        top,
        bottom,
    )
    disparity = (rectification.focal * rectification.base / coarse - rectification.shift).astype(np.float32)
    # Nearest, not bilinear: at the edge of a tree a mean of crown and ground is neither.
    whole = cv2.resize(
        disparity, (disparity.shape[1] * _STEP, disparity.shape[0] * _STEP), interpolation=cv2.INTER_NEAREST
    )
    half = _STEP // 2
    shifted = np.pad(whole, ((half, 0), (half, 0)), mode="edge")[:rows, :columns]
    return np.ascontiguousarray(shifted)


def _seen_window(
    rectification: Rectification, grid: Grid, heights: tuple[float, float]
) -> tuple[slice, slice] | None:
    """Rows and columns of a grid that a pair can see between two heights."""
    bounds = np.array([common_extent([rectification], height) for height in heights])
    west, south = bounds[:, :2].min(axis=0)
    east, north = bounds[:, 2:].max(axis=0)
    first, last = (int((x - grid.west) / grid.resolution) for x in (west, east))
    top, bottom = (int((grid.north - y) / grid.resolution) for y in (north, south))
    rows = slice(max(top - 1, 0), min(bottom + 2, grid.height))
    columns = slice(max(first - 1, 0), min(last + 2, grid.width))
    return (rows, columns) if rows.start < rows.stop and columns.start < columns.stop else None


@compiled(nogil=True)
def _first_hits(
    heights: np.ndarray,
    resolution: float,
    origin: np.ndarray,
    rotation: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    top: float,
    bottom: float,
) -> np.ndarray:
    """Depth along the common axis at which each ray meets the surface; NaN where it does not."""
    rows, columns = heights.shape
    depths = np.full((len(v), len(u)), np.nan)
    for i in range(len(v)):
        for j in range(len(u)):
            x = rotation[0, 0] * u[j] + rotation[1, 0] * v[i] + rotation[2, 0]
            y = rotation[0, 1] * u[j] + rotation[1, 1] * v[i] + rotation[2, 1]
            z = rotation[0, 2] * u[j] + rotation[1, 2] * v[i] + rotation[2, 2]
            if z > -0.05:
                continue
            depth = max((top - origin[2]) / z, 0.0)
            last = (bottom - origin[2]) / z
            # One cell per step, sideways or in height, whichever is longer.
            step = resolution / max(math.hypot(x, y), -z)
            while depth <= last + step:
                column = int(math.floor((origin[0] + depth * x) / resolution))
                row = int(math.floor(-(origin[1] + depth * y) / resolution))
                if 0 <= row < rows and 0 <= column < columns:
                    height = heights[row, column]
                    if height == height and origin[2] + depth * z <= height:
                        depths[i, j] = depth
                        break
                depth += step
    return depths
