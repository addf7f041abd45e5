"""A photograph as numbers for compiled loops: project points without Python."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from workbench.compiled import compiled
from workbench.rasters import Grid

if TYPE_CHECKING:
    from workbench.orientation import OrientedPhotograph

_GUARD = 1.05  # Beyond the frame's corner by this factor, a polynomial lens model may fold back.


def view_table(photographs: Sequence[OrientedPhotograph], grid: Grid) -> np.ndarray:
    """Numbers of each photograph for compiled loops, (n, 28) float64.

    Columns: centre relative to the grid's upper left corner (3), rotation (9), focal lengths (2),
    principal point (2), distortion (8), width, height, largest squared radius of the frame in the
    plane z = 1, spare.
    """
    table = np.zeros((len(photographs), 28))
    for row, photograph in zip(table, photographs, strict=True):
        camera, pose = photograph.camera, photograph.pose
        corners = np.array(
            [[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]], float
        )
        plane = camera.rays(corners)[:, :2]
        row[0:3] = pose.centre - (grid.west, grid.north, 0.0)
        row[3:12] = pose.rotation.ravel()
        row[12:16] = camera.focal_x, camera.focal_y, camera.principal_x, camera.principal_y
        row[16:24] = camera.distortion
        row[24:26] = camera.width, camera.height
        row[26] = (plane**2).sum(axis=1).max() * _GUARD**2
    return table


@compiled(inline="always")
def project(view: np.ndarray, x: float, y: float, z: float) -> tuple[float, float]:
    """Column and row of a point given relative to the grid's corner; NaN where it is not in the frame."""
    dx, dy, dz = x - view[0], y - view[1], z - view[2]
    depth = view[9] * dx + view[10] * dy + view[11] * dz
    if not depth > 0:
        return math.nan, math.nan
    u = (view[3] * dx + view[4] * dy + view[5] * dz) / depth
    v = (view[6] * dx + view[7] * dy + view[8] * dz) / depth
    r2 = u * u + v * v
    if r2 > view[26]:
        return math.nan, math.nan
    radial = (1 + r2 * (view[16] + r2 * (view[17] + r2 * view[20]))) / (
        1 + r2 * (view[21] + r2 * (view[22] + r2 * view[23]))
    )
    p1, p2 = view[18], view[19]
    column = view[12] * (u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)) + view[14]
    row = view[13] * (v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v) + view[15]
    if 0 <= column < view[24] and 0 <= row < view[25]:
        return column, row
    return math.nan, math.nan
