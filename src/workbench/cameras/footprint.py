"""The footprint of a photograph: its border rays intersected with a terrain raster."""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np
import shapely
import xarray as xr
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from workbench.cameras.lens import Camera
from workbench.cameras.pose import Pose
from workbench.compiled import compiled
from workbench.errors import CameraError
from workbench.rasters import Grid

_BISECTIONS = 50
_LOWEST_RAY = 1e-3  # Sine of the angle below the horizon.


class Oriented(Protocol):
    """Anything with a name, a camera and a pose; an oriented photograph, for one."""

    @property
    def name(self) -> str: ...
    @property
    def camera(self) -> Camera: ...
    @property
    def pose(self) -> Pose: ...


def footprint(
    photograph: Oriented, terrain: xr.DataArray, *, points_per_edge: int = 64, extend: bool = False
) -> BaseGeometry:
    """Outline on the terrain of what a photograph shows [thesis 3.2.1].

    Border rays of any roll, pitch and heading are followed to the first intersection with the
    surface that is bilinear between the cell centres; lens distortion is honoured. What hills hide
    within the outline is not cut out.

    Parameters
    ----------
    photograph
        With its pose in the CRS of the terrain.
    terrain
        Heights (y, x), metres; NaN takes the height of the nearest known cell.
    points_per_edge
        Border rays per edge of the frame.
    extend
        Go on at the height of the nearest cell beyond the terrain's edge, instead of refusing.

    Returns
    -------
    Polygon, or MultiPolygon where relief folds the outline
        In the CRS of the terrain, metres.

    Raises
    ------
    CameraError
        If a border ray does not look down, the camera is below the terrain, or the terrain does not
        reach as far as the photograph.
    """
    grid = Grid.of(terrain)
    heights = _filled(np.asarray(terrain, dtype=np.float64), photograph.name)
    camera, pose = photograph.camera, photograph.pose
    rays = pose.to_world(camera.rays(_border(camera, points_per_edge)))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    if (rays[:, 2] > -_LOWEST_RAY).any():
        raise CameraError(
            f"{photograph.name}: part of the frame looks at or above the horizon, its footprint has no end."
        )
    start = (pose.centre - (grid.west, grid.north, 0)) * (1 / grid.resolution, -1 / grid.resolution, 1)
    steps = rays * (1 / grid.resolution, -1 / grid.resolution, 1)
    if start[2] <= _height(heights, start[0], start[1]):
        raise CameraError(f"{photograph.name}: the camera stands below the terrain: check heights and datum.")
    hits = _intersect(heights, start, steps)
    inside = (hits >= 0).all(axis=1) & (hits <= (grid.width, grid.height)).all(axis=1)
    if not (inside.all() or extend):
        raise CameraError(
            f"{photograph.name}: the terrain ends before the footprint does "
            f"({(~inside).mean():.0%} of the border): give a larger terrain, or extend=True."
        )
    outline = Polygon(hits * (grid.resolution, -grid.resolution) + (grid.west, grid.north))
    if outline.is_valid:
        return outline
    parts = [part for part in shapely.get_parts(shapely.make_valid(outline)) if part.area > 0]
    return shapely.union_all(parts)


def _border(camera: Camera, count: int) -> np.ndarray:
    """Image positions (n, 2) along the frame, clockwise from the upper left corner."""
    t = np.arange(count) / count
    width, height = camera.width, camera.height
    return np.concatenate(
        [
            np.stack([t * width, 0 * t], axis=1),
            np.stack([0 * t + width, t * height], axis=1),
            np.stack([(1 - t) * width, 0 * t + height], axis=1),
            np.stack([0 * t, (1 - t) * height], axis=1),
        ]
    )


def _filled(heights: np.ndarray, name: str) -> np.ndarray:
    known = np.isfinite(heights)
    if not known.any():
        raise CameraError(f"{name}: the terrain is all nodata, no footprint can be found.")
    if known.all():
        return heights
    _, nearest = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    return heights[known][nearest - 1]


@compiled()
def _height(heights: np.ndarray, x: float, y: float) -> float:
    """Bilinear height at a place in cells from the upper left corner; constant beyond the border."""
    rows, columns = heights.shape
    column, row = min(max(x - 0.5, 0.0), columns - 1.0), min(max(y - 0.5, 0.0), rows - 1.0)
    j, i = min(int(column), max(columns - 2, 0)), min(int(row), max(rows - 2, 0))
    right, below = min(j + 1, columns - 1), min(i + 1, rows - 1)
    s, t = column - j, row - i
    upper = heights[i, j] * (1 - s) + heights[i, right] * s
    lower = heights[below, j] * (1 - s) + heights[below, right] * s
    return upper * (1 - t) + lower * t


@compiled()
def _intersect(heights: np.ndarray, start: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """First place (n, 2), in cells, where each ray meets the surface."""
    highest, lowest = heights.max(), heights.min()
    hits = np.empty((len(steps), 2))
    for k in range(len(steps)):
        dx, dy, dz = steps[k]
        above = max((highest - start[2]) / dz, 0.0)
        end = (lowest - start[2]) / dz
        # Half a cell at a time cannot jump over a hill that the cells can hold.
        stride = 0.5 / max(np.hypot(dx, dy), 1e-12)
        before, t = above, above
        while t < end and start[2] + t * dz > _height(heights, start[0] + t * dx, start[1] + t * dy):
            before = t
            t = min(t + stride, end)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (before + t)
            if start[2] + middle * dz > _height(heights, start[0] + middle * dx, start[1] + middle * dy):
                before = middle
            else:
                t = middle
        hits[k, 0], hits[k, 1] = start[0] + t * dx, start[1] + t * dy
    return hits
