"""Local maxima in a disc, exact: the cells that nothing within a radius exceeds."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from workbench.compiled import compiled

MISSING = np.float32(-np.inf)
"""Stands for missing cells: it exceeds nothing and nothing is sought there."""


@compiled(nogil=True)
def summits(surface: np.ndarray, lowest: float, rows: tuple, columns: tuple) -> np.ndarray:
    """Flat places of the cells from ``lowest`` up that none of their four neighbours exceeds.

    Parameters
    ----------
    surface
        (rows, columns) float32, :data:`MISSING` where there is nothing.
    lowest
        Least height.
    rows, columns
        (start, stop) of the part that is searched; neighbours may lie outside.

    Returns
    -------
    ndarray
        (n,) int64, rising.
    """
    height, width = surface.shape
    found = np.empty(1024, np.int64)
    n = 0
    for i in range(rows[0], rows[1]):
        up, down = max(i - 1, 0), min(i + 1, height - 1)
        for j in range(columns[0], columns[1]):
            z = surface[i, j]
            if not z >= lowest:
                continue
            left, right = max(j - 1, 0), min(j + 1, width - 1)
            if surface[i, left] > z or surface[i, right] > z:
                continue
            if surface[up, j] > z or surface[down, j] > z:
                continue
            if n == len(found):
                more = np.empty(2 * n, np.int64)
                more[:n] = found
                found = more
            found[n] = i * width + j
            n += 1
    return found[:n]


def disc(radius: float) -> np.ndarray:
    """Offsets (n, 3) of the cells within a radius in cells: row, column, squared distance; nearest first."""
    reach = int(np.floor(radius))
    step = np.arange(-reach, reach + 1)
    rows, columns = np.meshgrid(step, step, indexing="ij")
    squared = rows**2 + columns**2
    inside = (squared <= radius**2) & (squared > 0)
    offsets = np.stack([rows[inside], columns[inside], squared[inside]], axis=1)
    return offsets[np.lexsort((offsets[:, 1], offsets[:, 0], offsets[:, 2]))].astype(np.int32)


@compiled(nogil=True)
def exceeded_by_none(
    surface: np.ndarray, places: np.ndarray, squared_radii: np.ndarray, offsets: np.ndarray
) -> np.ndarray:
    """Which places nothing within their radius exceeds.

    Parameters
    ----------
    surface
        (rows, columns) float32, :data:`MISSING` where there is nothing.
    places
        (n,) flat places, rising.
    squared_radii
        (n,) squared radius of each in cells.
    offsets
        Of :func:`disc` for the largest radius.

    Returns
    -------
    ndarray
        (n,) bool.
    """
    width = surface.shape[1]
    kept = np.zeros(len(places), np.bool_)
    last_i, last_j, last_z = 0, 0, MISSING
    corner_rows, corner_columns, corners_of = _corners(1.0)[0], _corners(1.0)[1], 1.0
    # Squared radius where the row above (this row) has a maximum, else zero.
    above, here, row = np.zeros(width), np.zeros(width), -1
    for n in range(len(places)):
        i, j = places[n] // width, places[n] % width
        if i != row:
            above, here = here, above
            if i != row + 1:
                above[:] = 0.0
            here[:] = 0.0
            row = i
        z, limit = surface[i, j], squared_radii[n]
        # The cell that exceeded the place before often exceeds this one too.
        if last_z > z and (i - last_i) ** 2 + (j - last_j) ** 2 <= limit:
            continue
        flat = j > 0 and here[j - 1] == limit and surface[i, j - 1] == z
        if flat and above[j] == limit and surface[i - 1, j] == z:
            # On a plateau the discs of the cells above and to the left hold all but a few corners.
            if corners_of != limit:
                corner_rows, corner_columns = _corners(limit)
                corners_of = limit
            k = _exceeds_at(surface, i, j, z, corner_rows, corner_columns)
        else:
            k = _exceeds_in_disc(surface, i, j, z, limit, offsets)
        if k < 0:
            kept[n] = True
            here[j] = limit
        else:
            last_i, last_j = k // width, k % width
            last_z = surface[last_i, last_j]
    return kept


@compiled(nogil=True)
def _exceeds_in_disc(surface: np.ndarray, i: int, j: int, z: float, limit: float, offsets: np.ndarray) -> int:
    height, width = surface.shape
    for k in range(len(offsets)):
        if offsets[k, 2] > limit:
            break
        y, x = i + offsets[k, 0], j + offsets[k, 1]
        if y >= 0 and y < height and x >= 0 and x < width and surface[y, x] > z:
            return y * width + x
    return -1


@compiled(nogil=True)
def _corners(squared_radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Offsets of the cells of a disc that neither the same disc one row up nor one column left holds."""
    reach = int(np.sqrt(squared_radius))
    rows, columns, n = np.empty(reach + 1, np.int64), np.empty(reach + 1, np.int64), 0
    for dy in range(reach + 1):
        dx = int(np.sqrt(squared_radius - dy * dy))
        below = -1 if dy == reach else int(np.sqrt(squared_radius - (dy + 1) ** 2))
        if below < dx:
            rows[n], columns[n] = dy, dx
            n += 1
    return rows[:n], columns[:n]


@compiled(nogil=True)
def _exceeds_at(surface: np.ndarray, i: int, j: int, z: float, rows: np.ndarray, columns: np.ndarray) -> int:
    height, width = surface.shape
    for k in range(len(rows)):
        y, x = i + rows[k], j + columns[k]
        if y < height and x < width and surface[y, x] > z:
            return y * width + x
    return -1


@compiled(nogil=True)
def on_edge(places: np.ndarray, width: int, rows: tuple, columns: tuple) -> np.ndarray:
    """Numbers of the places in the first or last of the rows or columns (start, stop)."""
    found = np.zeros(len(places), np.bool_)
    for n in range(len(places)):
        i, j = places[n] // width, places[n] % width
        found[n] = i == rows[0] or i == rows[1] - 1 or j == columns[0] or j == columns[1] - 1
    return np.flatnonzero(found)


@compiled(nogil=True)
def plateaus(surface_values: np.ndarray, places: np.ndarray, width: int) -> np.ndarray:
    """Number (n,) of the first place of the plateau of each: equal neighbours (of eight) belong together.

    Parameters
    ----------
    surface_values
        (n,) heights at the places.
    places
        (n,) flat places, rising.
    width
        Columns of the raster.
    """
    n = len(places)
    parent = np.arange(n)
    above = 0
    for k in range(n):
        column = places[k] % width
        if column > 0 and k > 0 and places[k - 1] == places[k] - 1:
            _join(parent, surface_values, k, k - 1)
        # First place in the row above that is not left of the upper left neighbour.
        while places[above] < places[k] - width - 1:
            above += 1
        m = above
        while m < k and places[m] <= places[k] - width + 1:
            if abs(places[m] % width - column) <= 1:
                _join(parent, surface_values, k, m)
            m += 1
    for k in range(n):
        parent[k] = _root(parent, k)
    return parent


@compiled(nogil=True)
def _join(parent: np.ndarray, values: np.ndarray, a: int, b: int) -> None:
    if values[a] != values[b]:
        return
    a, b = _root(parent, a), _root(parent, b)
    if a < b:
        parent[b] = a
    else:
        parent[a] = b


@compiled(nogil=True)
def _root(parent: np.ndarray, k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@compiled(nogil=True)
def stand_out(
    surface: np.ndarray, rows: np.ndarray, columns: np.ndarray, depths: np.ndarray, reach: int
) -> np.ndarray:
    """Which tops one cannot leave for anything higher without descending at least their depth.

    Ways may wind over the eight neighbours, within a square of ``reach`` cells around the top. Unlike
    :func:`radial_prominence` this is exact, and it stops as soon as the answer is known.

    Parameters
    ----------
    surface
        (rows, columns) float32, :data:`MISSING` where there is nothing.
    rows, columns
        (n,) places of the tops.
    depths
        (n,) least descent, metres; 0 or less: the top stays.
    reach
        Cells.

    Returns
    -------
    ndarray
        (n,) bool.
    """
    height, width = surface.shape
    edge = 2 * reach + 1
    seen = np.zeros(edge * edge, np.int64)
    stack = np.empty(edge * edge, np.int64)
    result = np.ones(len(rows), np.bool_)
    for n in range(len(rows)):
        if not depths[n] > 0:
            continue
        top, left = rows[n] - reach, columns[n] - reach
        z = surface[rows[n], columns[n]]
        least = z - depths[n]
        stack[0] = reach * edge + reach
        seen[stack[0]] = n + 1
        size = 1
        while size > 0 and result[n]:
            size -= 1
            i, j = stack[size] // edge, stack[size] % edge
            for y in range(max(i - 1, 0, -top), min(i + 2, edge, height - top)):
                for x in range(max(j - 1, 0, -left), min(j + 2, edge, width - left)):
                    value = surface[top + y, left + x]
                    # A descent of exactly the depth is enough.
                    if value > least and seen[y * edge + x] != n + 1:
                        seen[y * edge + x] = n + 1
                        stack[size] = y * edge + x
                        size += 1
                        if value > z:
                            result[n] = False
    return result


@compiled(nogil=True)
def radial_prominence(
    surface: np.ndarray, rows: np.ndarray, columns: np.ndarray, reach: np.ndarray
) -> np.ndarray:
    """How far one must descend from each top on straight ways before anything higher, metres.

    Sixteen straight ways of a length ``reach`` (n,) in cells are followed. On each the lowest cell
    before a higher or the end counts; the highest of these saddles over the ways that lead to
    something higher (over all ways where none does) is the saddle of the top.
    Missing cells count as ground of height zero.
    """
    height, width = surface.shape
    result = np.empty(len(rows), np.float32)
    for n in range(len(rows)):
        i, j = rows[n], columns[n]
        z = surface[i, j]
        saddle, end_saddle = -np.inf, -np.inf
        for way in range(16):
            angle = way * np.pi / 8
            dy, dx = np.sin(angle), np.cos(angle)
            low, higher = z, False
            for step in range(1, reach[n] + 1):
                y, x = int(np.round(i + dy * step)), int(np.round(j + dx * step))
                if y < 0 or y >= height or x < 0 or x >= width:
                    break
                value = max(surface[y, x], np.float32(0.0))
                if value > z:
                    higher = True
                    break
                low = min(low, value)
            if higher:
                saddle = max(saddle, low)
            else:
                end_saddle = max(end_saddle, low)
        result[n] = z - (saddle if saddle > -np.inf else end_saddle)
    return result


def merge_plateaus(places: np.ndarray, levels: np.ndarray, firsts: np.ndarray, width: int) -> np.ndarray:
    """First places (m,) that are not the first of their plateau once the tiles are put together.

    Parameters
    ----------
    places, levels
        (n,) flat places and heights of the maxima along the edges of tiles.
    firsts
        (n,) first place of the plateau of each within its tile.
    width
        Columns of the raster.
    """
    order = np.argsort(places, kind="stable")
    places, levels, firsts = places[order], levels[order], firsts[order]
    across = plateaus(levels, places, width)
    names, within = np.unique(firsts, return_inverse=True)
    size = len(places) + len(names)
    links = coo_array((np.ones(len(places)), (across, len(places) + within)), shape=(size, size))
    group = connected_components(links, directed=False)[1][len(places) :]
    # Names rise, so that the first of each group is its least place.
    _, least = np.unique(group, return_index=True)
    return np.delete(names, least)


def thin(
    points: np.ndarray, levels: np.ndarray, reach: np.ndarray, equal_only: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Walk down points (n, 2) by rank; each that stays removes those within their reach (n,).

    Returns
    -------
    tuple of ndarray
        (n,) bool each: has another point within reach; stays.
    """
    near, stays = np.zeros(len(points), bool), np.ones(len(points), bool)
    pairs = cKDTree(points).query_pairs(float(reach.max()), output_type="ndarray")
    first, second = pairs.min(axis=1), pairs.max(axis=1)
    close = np.hypot(*(points[first] - points[second]).T) <= reach[second]
    if equal_only:
        close &= levels[first] == levels[second]
    first, second = first[close], second[close]
    near[first], near[second] = True, True
    # In the order of the higher of each pair, every point is judged before it judges others.
    for k in np.argsort(first, kind="stable"):
        if stays[first[k]]:
            stays[second[k]] = False
    return near, stays
