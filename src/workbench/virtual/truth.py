"""Truth of a scene on a grid: surfaces, terrain, land cover, trees and reed in calm air."""

from __future__ import annotations

import numpy as np
import xarray as xr

from workbench.errors import RasterError
from workbench.rasters import Grid, new_raster
from workbench.virtual.above import NOTHING, REED, SOLID, Direction, map_from_above
from workbench.virtual.scene import Scene
from workbench.virtual.shade import cover_below
from workbench.virtual.texture import textures
from workbench.virtual.wind import Wind, wind_field
from workbench.virtual.world import Cover

_PARTS = 3
_MOST_SAMPLES = 8e6  # Samples of a strip of rows: 50 bytes each while it is worked on.
_HEIGHTS = {
    "dsm": "topmost surface",
    "dsm_mean": "surface seen from above, cell mean",
    "dtm": "land and lake bed",
}


def scene_truth(scene: Scene, grid: Grid, *, parts: int = _PARTS) -> xr.Dataset:
    """What is true in every cell of a grid.

    Parameters
    ----------
    scene
        A built scene.
    grid
        In the CRS of the scene.
    parts
        Samples along the edge of a cell; the surface is looked at straight from above on each.

    Returns
    -------
    Dataset
        On the grid: ``dsm`` (the topmost particle, roof, ground or water of a cell, m), ``dsm_mean`` (the
        surface seen from above, averaged over the cell: what a camera can measure at best, m), ``dtm``
        (land and lake bed, m), ``cover`` (commonest code of :class:`Cover` seen from above), ``tree_id``
        (of the topmost tree, 0 none), ``stem_density`` (stems per square metre), ``stem_height`` (mean
        height of stem tops above water or ground, m, NaN without reed).

    Raises
    ------
    RasterError
        If the grid has another CRS than the scene.
    """
    if grid.crs != scene.crs:
        raise RasterError(
            f"Grid in {grid.crs} for scene {scene.spec.name} in {scene.crs}: use the scene's CRS."
        )
    size = max(int(_MOST_SAMPLES / (grid.width * parts * parts)), 1)
    pieces = [
        _strip(scene, grid, slice(top, min(top + size, grid.height)), parts)
        for top in range(0, grid.height, size)
    ]
    values = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
    layers = {}
    for name, text in _HEIGHTS.items():
        layers[name] = new_raster(
            values[name],
            grid,
            name=name,
            units="m",
            long_name=text,
            vertical_datum=scene.vertical_datum,
        )
    layers["cover"] = new_raster(values["cover"], grid, name="cover", units="1", nodata=0)
    layers["tree_id"] = new_raster(values["tree_id"], grid, name="tree_id", units="1", nodata=0)
    density, height = _reed_on(scene, grid)
    layers["stem_density"] = new_raster(
        density, grid, name="stem_density", units="1/m2", long_name="reed stems"
    )
    layers["stem_height"] = new_raster(
        height, grid, name="stem_height", units="m", long_name="reed above water"
    )
    return xr.Dataset(layers)


def _strip(scene: Scene, grid: Grid, rows: slice, parts: int) -> dict[str, np.ndarray]:
    """Heights, cover and trees of some rows of the grid: a strip needs the memory, not the scene."""
    count, world = rows.stop - rows.start, scene.world
    shape = (count * parts, grid.width * parts)
    cell = grid.resolution / parts
    north = grid.north - rows.start * grid.resolution - scene.origin[1]
    direction = Direction(grid.west - scene.origin[0], north, cell, 0.0, 0.0)
    still = wind_field(Wind.calm(), 0, (0, 0, 1, 1))
    top, owner = map_from_above(world, scene.grove, still, direction, shape)
    x = direction.west + (np.arange(shape[1]) + 0.5) * cell
    y = direction.north - (np.arange(shape[0]) + 0.5) * cell
    ground = scene.ground_z(*(axis.ravel() for axis in np.meshgrid(x + scene.origin[0], y + scene.origin[1])))
    ground = ground.reshape(shape) - scene.origin[2]
    below = np.maximum(ground, world.water_level)
    bare = (owner == NOTHING) | (top < below)
    surface = np.where(bare, below, top)
    codes = cover_below(world, textures(), x, y, cell)
    codes = np.where(bare, codes, _object_codes(scene, owner)).astype(np.uint8)
    tree = np.where(bare | (owner < 0), 0, owner + 1)
    blocks = surface.reshape(count, parts, grid.width, parts)
    z = scene.origin[2]
    return {
        "dsm": (blocks.max(axis=(1, 3)) + z).astype(np.float32),
        "dsm_mean": (blocks.mean(axis=(1, 3)) + z).astype(np.float32),
        "dtm": (ground.reshape(blocks.shape).mean(axis=(1, 3)) + z).astype(np.float32),
        "cover": _commonest(codes, parts),
        "tree_id": _of_highest(tree, surface, parts),
    }


def _object_codes(scene: Scene, owner: np.ndarray) -> np.ndarray:
    world = scene.world
    codes = np.full(owner.shape, int(Cover.NOTHING), dtype=np.uint8)
    codes[owner == REED] = Cover.REED
    trees = owner >= 0
    if trees.any():
        codes[trees] = world.tree_cover[owner[trees]]
    hard = owner <= SOLID
    if hard.any():
        codes[hard] = world.solids.cover[SOLID - owner[hard]]
    return codes


def _commonest(codes: np.ndarray, parts: int) -> np.ndarray:
    """Commonest code per cell, the smallest of equals."""
    stack = _stacked(codes, parts)
    counts = np.stack([(stack == code).sum(axis=2) for code in range(max(Cover) + 1)])
    return counts.argmax(axis=0).astype(np.uint8)


def _of_highest(names: np.ndarray, surface: np.ndarray, parts: int) -> np.ndarray:
    highest = _stacked(surface, parts).argmax(axis=2)[..., None]
    return np.take_along_axis(_stacked(names, parts), highest, axis=2)[..., 0].astype(np.int32)


def _stacked(values: np.ndarray, parts: int) -> np.ndarray:
    """All samples of a cell along the last axis, (rows, columns, samples)."""
    rows, columns = (edge // parts for edge in values.shape)
    blocks = values.reshape(rows, parts, columns, parts).transpose(0, 2, 1, 3)
    return blocks.reshape(rows, columns, parts * parts)


def _reed_on(scene: Scene, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Expected density and mean height at cell centres."""
    fields = scene.reed.fields
    density = np.zeros(grid.shape, dtype=np.float32)
    height = np.full(grid.shape, np.nan, dtype=np.float32)
    if fields.density.size == 0:
        return density, height
    columns = np.floor((grid.x - scene.origin[0] - float(fields.west)) / float(fields.step)).astype(int)
    rows = np.floor((grid.y - scene.origin[1] - float(fields.south)) / float(fields.step)).astype(int)
    inside = ((rows >= 0) & (rows < fields.density.shape[0]))[:, None] & (
        (columns >= 0) & (columns < fields.density.shape[1])
    )
    rows = rows.clip(0, fields.density.shape[0] - 1)
    columns = columns.clip(0, fields.density.shape[1] - 1)
    found = np.where(inside, fields.density[np.ix_(rows, columns)], 0)
    density[:] = found
    stands = found > 0
    height[stands] = fields.height[np.ix_(rows, columns)][stands]
    return density, height
