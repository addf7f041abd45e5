"""Effects of the canopy on what lies below: closure, shade, forest floor, and which trees are hidden."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from scipy import ndimage
from shapely.geometry import Polygon

from workbench.virtual.above import Direction, map_from_above
from workbench.virtual.composition import SceneSpec
from workbench.virtual.forest import Stem
from workbench.virtual.grove import Grove
from workbench.virtual.solids import empty_solids
from workbench.virtual.wind import Wind, wind_field
from workbench.virtual.world import Terrain, World

_VISIBLE_SHARE = 0.25
_MAP_CELL = 0.25
_MAP_ROWS = 2048


def sink_feet(terrain: Terrain, places: Sequence[tuple[float, float]] | np.ndarray) -> np.ndarray:
    """Height (n,) of the terrain at local places (n, 2), m: the same bilinear values as the renderer's."""
    places = np.asarray(places, dtype=float).reshape(-1, 2)
    column = (places[:, 0] - float(terrain.west)) / float(terrain.step)
    row = (places[:, 1] - float(terrain.south)) / float(terrain.step)
    return ndimage.map_coordinates(terrain.height.astype(float), [row, column], order=1, mode="nearest")


def ground_rasters(
    terrain: Terrain, stems: list[Stem], spec: SceneSpec
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weight of forest floor, smoothed canopy height (m) and smoothed closure on the terrain's raster."""
    rows, columns = terrain.height.shape
    canopy = np.zeros((rows, columns), dtype=np.float32)
    step = float(terrain.step)
    for stem in stems:
        if stem.dead:
            continue
        radius = 0.5 * stem.crown
        column, row = (stem.x - float(terrain.west)) / step, (stem.y - float(terrain.south)) / step
        reach = int(np.ceil(radius / step))
        i0, j0 = max(int(row) - reach, 0), max(int(column) - reach, 0)
        i1, j1 = min(int(row) + reach + 2, rows), min(int(column) + reach + 2, columns)
        if i0 >= i1 or j0 >= j1:
            continue
        i, j = np.ogrid[i0:i1, j0:j1]
        share = np.hypot(i - row, j - column) * step / radius
        dome = np.where(share < 1, stem.height * (1 - 0.4 * share**2), 0)
        canopy[i0:i1, j0:j1] = np.maximum(canopy[i0:i1, j0:j1], dome)
    covered = ndimage.gaussian_filter((canopy > 1.0).astype(np.float32), 2.0 / step)
    height = ndimage.gaussian_filter(canopy, 1.5 / step)
    floor = np.zeros((rows, columns), dtype=np.float32)
    y, x = np.mgrid[0:rows, 0:columns]
    x, y = x * step + float(terrain.west), y * step + float(terrain.south)
    for stand in spec.stands:
        floor[shapely.contains_xy(Polygon(stand.area), x, y)] = 1.0
    # Where light falls in, grass and herbs grow; litter lies bare below a closed canopy.
    floor = np.maximum(ndimage.gaussian_filter(floor, 1.2 / step) * (0.25 + 0.75 * covered), 0.42 * covered)
    return floor, height, covered


def mark_visible(world: World, grove: Grove, alone_area: np.ndarray) -> np.ndarray:
    """Whether each tree (n,) shows at least a quarter of its crown from straight above.

    ``alone_area`` (n,) is what its crown would show if it stood alone, m².
    """
    number = len(alone_area)
    if number == 0:
        return np.zeros(0, dtype=bool)
    terrain = world.terrain
    rows, columns = terrain.height.shape
    width, height = (columns - 1) * float(terrain.step), (rows - 1) * float(terrain.step)
    west, north = float(terrain.west), float(terrain.south) + height
    shape = int(height / _MAP_CELL), int(width / _MAP_CELL)
    still = wind_field(Wind.calm(), 0, (0, 0, 1, 1))
    alone = world._replace(solids=empty_solids())
    cells = np.zeros(number, dtype=np.int64)
    for top in range(0, shape[0], _MAP_ROWS):
        rows = min(_MAP_ROWS, shape[0] - top)
        direction = Direction(west, north - top * _MAP_CELL, _MAP_CELL, 0.0, 0.0)
        _, owner = map_from_above(alone, grove, still, direction, (rows, shape[1]))
        cells += np.bincount(owner[owner >= 0], minlength=number)[:number]
    return cells * _MAP_CELL**2 >= _VISIBLE_SHARE * alone_area
