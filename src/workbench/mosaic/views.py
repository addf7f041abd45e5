"""Which photograph sees a cell, and which sees it best: projection, line of sight, best view."""

from __future__ import annotations

import math

import numpy as np

from workbench.cameras.view import project
from workbench.compiled import compiled

NO_PHOTOGRAPH = 0
"""Value of ``source`` where no photograph shows the cell; photograph k of the list has value k + 1."""

_SKIP = 16  # Cells of a block of the coarse maximum that lets a line of sight jump over low ground.
_NEAR = 8.0  # Cells over which the tolerance fades out: only neighbours on one slope need it.


def steepest_tangent(table: np.ndarray) -> float:
    """Largest tangent of the angle from the vertical at which any photograph looks."""
    tangent = 0.0
    for row in table:
        tilt = math.acos(min(max(-row[11], -1.0), 1.0))
        angle = min(tilt + math.atan(math.sqrt(row[26])), math.radians(80))
        tangent = max(tangent, math.tan(angle))
    return tangent


def best_views(
    heights: np.ndarray,
    table: np.ndarray,
    *,
    resolution: float,
    first_row: int = 0,
    first_column: int = 0,
    preferred: np.ndarray | None = None,
    wanted: np.ndarray | None = None,
    tolerance: float | None = 2.0,
) -> np.ndarray:
    """Photograph that shows each cell best.

    The preferred photograph is taken where it sees the cell; otherwise the one with the smallest
    angle from the vertical that does [thesis 2.3.1.2].

    Parameters
    ----------
    heights
        Surface (rows, columns), metres; NaN is seen by nobody.
    table
        Of :func:`workbench.cameras.view.view_table`, relative to the upper left corner of the whole grid.
    resolution
        Cell, metres.
    first_row, first_column
        Place of this window in the whole grid.
    preferred
        Values of ``source`` (rows, columns) to try first.
    wanted
        Cells to decide on (rows, columns) bool; the others only stand in the way. All by default.
    tolerance
        How far, in cells, a neighbour must rise above the line of sight to hide a cell; it fades to
        nothing within eight cells. None skips the test.

    Returns
    -------
    ndarray of uint16 (rows, columns)
        Number of the photograph in the table plus one, or :data:`NO_PHOTOGRAPH`.
    """
    heights = np.ascontiguousarray(heights, dtype=np.float32)
    if preferred is None:
        preferred = np.zeros(heights.shape, np.uint16)
    if wanted is None:
        wanted = np.ones(heights.shape, bool)
    return _best_views(
        heights,
        _block_maxima(heights),
        table,
        resolution,
        first_row,
        first_column,
        np.ascontiguousarray(preferred, dtype=np.uint16),
        np.ascontiguousarray(wanted),
        -1.0 if tolerance is None else tolerance * resolution,
    )


@compiled()
def _block_maxima(heights: np.ndarray) -> np.ndarray:
    rows, columns = heights.shape
    maxima = np.full(((rows + _SKIP - 1) // _SKIP, (columns + _SKIP - 1) // _SKIP), -np.inf)
    for row in range(rows):
        for column in range(columns):
            height = heights[row, column]
            if height > maxima[row // _SKIP, column // _SKIP]:
                maxima[row // _SKIP, column // _SKIP] = height
    return maxima


@compiled()
def _hidden(
    heights: np.ndarray,
    maxima: np.ndarray,
    row: int,
    column: int,
    step_x: float,
    step_y: float,
    step_z: float,
    tolerance: float,
) -> bool:
    """Whether the surface rises into the line of sight from a cell towards the camera.

    ``step_x`` and ``step_y`` are cells east and south per step, ``step_z`` metres up per step.
    """
    rows, columns = heights.shape
    x, y = column + 0.5, row + 0.5
    start = heights[row, column]
    count = 1.5  # The neighbour that a slanted cell leans on does not hide it.
    while True:
        px, py = x + count * step_x, y + count * step_y
        if not (0 <= px < columns and 0 <= py < rows):
            return False
        i, j = int(py), int(px)
        # An edge is uncertain by a cell, and so is the place of the pixel that shows it: the line runs two
        # steps lower than it should (fewer where it begins, or a neighbour as high would hide the cell).
        steps = max(count - 2.0, 0.5 * (count - 1.0))
        line = start + steps * step_z + tolerance * max(1.0 - count / _NEAR, 0.0)
        if count >= _NEAR and maxima[i // _SKIP, j // _SKIP] <= line:
            to_x = to_y = 1e9
            if step_x > 0:
                to_x = ((j // _SKIP + 1) * _SKIP - px) / step_x
            elif step_x < 0:
                to_x = (px - (j // _SKIP) * _SKIP) / -step_x
            if step_y > 0:
                to_y = ((i // _SKIP + 1) * _SKIP - py) / step_y
            elif step_y < 0:
                to_y = (py - (i // _SKIP) * _SKIP) / -step_y
            # Whole steps keep the sampled places the same, wherever a tile begins.
            count += max(math.ceil(min(to_x, to_y)), 1.0)
            continue
        if heights[i, j] > line:
            return True
        count += 1.0


@compiled(nogil=True)
def _best_views(
    heights: np.ndarray,
    maxima: np.ndarray,
    table: np.ndarray,
    resolution: float,
    first_row: int,
    first_column: int,
    preferred: np.ndarray,
    wanted: np.ndarray,
    tolerance: float,
) -> np.ndarray:
    rows, columns = heights.shape
    source = np.zeros((rows, columns), np.uint16)
    order = np.empty(len(table), np.int64)
    tangents = np.empty(len(table))
    for row in range(rows):
        y = -(first_row + row + 0.5) * resolution
        for column in range(columns):
            z = heights[row, column]
            if z != z or not wanted[row, column]:
                continue
            x = (first_column + column + 0.5) * resolution
            wish = int(preferred[row, column]) - 1
            found = 0
            for k in range(len(table)):
                view = table[k]
                u, _ = project(view, x, y, z)
                if u != u:
                    continue
                tangent = math.hypot(view[0] - x, view[1] - y) / max(view[2] - z, 1e-6)
                if k == wish:
                    tangent = -1.0
                place = found
                while place > 0 and tangents[place - 1] > tangent:
                    tangents[place], order[place] = tangents[place - 1], order[place - 1]
                    place -= 1
                tangents[place], order[place] = tangent, k
                found += 1
            for place in range(found):
                k = order[place]
                if tolerance >= 0:
                    dx, dy = table[k, 0] - x, -(table[k, 1] - y)
                    longest = max(abs(dx), abs(dy))
                    if longest > 0.5 * resolution:
                        rise = (table[k, 2] - z) * resolution / longest
                        if _hidden(heights, maxima, row, column, dx / longest, dy / longest, rise, tolerance):
                            continue
                source[row, column] = k + 1
                break
    return source
