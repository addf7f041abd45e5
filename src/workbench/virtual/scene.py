"""Virtual scenes: from a composition in YAML to a landscape with known truth.

``load_scene`` reads and checks a composition, ``build_scene`` makes the landscape of it. A scene is a
value: the same composition and seed give the same leaves.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

import geopandas as gpd
import numpy as np
import pyproj
import shapely
import yaml
from pydantic import ValidationError
from rasterio.crs import CRS
from scipy import ndimage
from shapely.geometry import LineString, Polygon

from workbench.errors import SceneError
from workbench.virtual import bodies
from workbench.virtual.canopy import ground_rasters, mark_visible, sink_feet
from workbench.virtual.composition import LineSpec, SceneSpec
from workbench.virtual.forest import Stem, grow_trees, plant_singles, plant_stand
from workbench.virtual.grove import Grove
from workbench.virtual.lake import Shore, measure_shore, shape_lake
from workbench.virtual.particles import REED_CELL, ReedFields
from workbench.virtual.reed_belt import Reed, describe_reed, empty_reed_fields, reed_fields
from workbench.virtual.tables import building_table, lake_polygon, target_table, tree_table
from workbench.virtual.terrain import land_heights, level_border
from workbench.virtual.world import Cover, Ground, Terrain, World

_BORDER = 28.0
_NO_LAKE = -1e6
_LARGEST = 40_000_000
_HIGHEST_BANK, _DEEPEST_FLOOD = 5.0, 1.0
"""Most metres of the land along a lake above its level (over a beach of 22 m, 23 % steep) and below it."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A landscape with known truth."""

    spec: SceneSpec
    """What it is composed of."""
    crs: CRS
    """Of all coordinates that leave the scene."""
    vertical_datum: str
    """Of all heights that leave the scene."""
    water_level: float | None
    """Height of the lake, m."""
    origin: np.ndarray
    """(3,): local coordinates plus this are coordinates in the CRS."""
    trees: gpd.GeoDataFrame
    """One row a tree: tree_id (from 1), species_group, x, y, ground_z, top_x, top_y, top_z, height_m,
    dbh_m, visible (from above), dead, understorey; geometry is the crown seen from above."""
    reed: Reed
    """Reed belts, islets, holes and the fields that stems are drawn from."""
    buildings: gpd.GeoDataFrame
    """Footprints of the walls, with the height of ground, eaves and ridge, m."""
    targets: gpd.GeoDataFrame
    """Signals of control points: name, kind, x, y, z, edge_m."""
    shoreline: Polygon | None
    """The lake within the scene."""
    world: World
    """Tables for the renderer, in the local frame; without the foliage of the trees."""
    grove: Grove
    """The foliage of the trees."""

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, south, east, north in the CRS; the renderer goes on a little beyond."""
        x, y = self.spec.origin
        return x, y, x + self.spec.size[0], y + self.spec.size[1]

    @cached_property
    def longitude_latitude(self) -> tuple[float, float]:
        """Middle of the scene, degrees, WGS84."""
        west, south, east, north = self.extent
        transformer = pyproj.Transformer.from_crs(self.crs.to_wkt(), "EPSG:4326", always_xy=True)
        longitude, latitude = transformer.transform((west + east) / 2, (south + north) / 2)
        return float(longitude), float(latitude)

    @cached_property
    def lowest(self) -> float:
        """Lowest surface that can be seen, local m."""
        return float(max(self.world.terrain.height.min(), self.world.water_level))

    def highest_near(self, x: float, y: float, radius: float) -> float:
        """Highest terrain, tree or roof within a radius of a local place, local m."""
        terrain = self.world.terrain
        rows, columns = terrain.height.shape
        i = int(np.clip((y - terrain.south) / terrain.step, 0, rows - 1))
        j = int(np.clip((x - terrain.west) / terrain.step, 0, columns - 1))
        top = max(float(terrain.height[i, j]), self.world.water_level)
        trees = self.world.plants.trees
        near = np.hypot(trees[:, 0] - x, trees[:, 1] - y) < radius
        if near.any():
            top = max(top, float((trees[near, 2] + trees[near, 3]).max()))
        for x0, y0, _, x1, y1, z1 in self.world.solids.bounds:
            if x0 - radius < x < x1 + radius and y0 - radius < y < y1 + radius:
                top = max(top, float(z1))
        return top

    def ground_z(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Height (n,) of land or lake bed at places (n,) in the CRS, m."""
        terrain = self.world.terrain
        column = (np.asarray(x, dtype=float) - self.origin[0] - float(terrain.west)) / float(terrain.step)
        row = (np.asarray(y, dtype=float) - self.origin[1] - float(terrain.south)) / float(terrain.step)
        rows, columns = terrain.height.shape
        column, row = np.clip(column, 0, columns - 1.001), np.clip(row, 0, rows - 1.001)
        i, j = row.astype(int), column.astype(int)
        v, u = row - i, column - j
        h = terrain.height.astype(float)
        low = h[i, j] * (1 - u) + h[i, j + 1] * u
        high = h[i + 1, j] * (1 - u) + h[i + 1, j + 1] * u
        return low * (1 - v) + high * v + self.origin[2]


def scene_names() -> list[str]:
    """Names of the scenes that come with the package."""
    return sorted(entry.name[:-5] for entry in _shipped().iterdir() if entry.name.endswith(".yaml"))


def load_scene(name_or_path: str | Path) -> SceneSpec:
    """Read and check the composition of a scene.

    Parameters
    ----------
    name_or_path
        Name of a scene of the package, or path of a YAML file.

    Raises
    ------
    SceneError
        If there is no such scene, or its composition is wrong; all problems are named at once.
    """
    path = Path(name_or_path)
    source = path if path.suffix in (".yaml", ".yml") else _shipped() / f"{name_or_path}.yaml"
    if not source.is_file():
        raise SceneError(f"Scene {name_or_path} is unknown: give a YAML file or one of {scene_names()}.")
    try:
        return SceneSpec(**yaml.safe_load(source.read_text(encoding="utf-8")))
    except (yaml.YAMLError, TypeError) as error:
        raise SceneError(f"{source}: is not a scene ({error}).") from error
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(str(part) for part in problem['loc'])}: {problem['msg']}"
            for problem in error.errors()
        )
        raise SceneError(f"{source}: {problems}.") from error


def build_scene(spec: SceneSpec) -> Scene:
    """Make the landscape of a composition.

    Raises
    ------
    SceneError
        If the CRS is not metric, the terrain is too large for memory, species are unknown, reed has no
        lake, or objects lie outside.
    """
    crs = _check(spec)
    x, y = _axes(spec)
    origin = np.array([spec.origin[0], spec.origin[1], np.floor(spec.terrain.base) - 10.0])
    level = None if spec.lake is None else spec.lake.level - origin[2]
    heights = land_heights(spec.terrain, x, y, spec.seed)
    heights = level_border(heights, spec.terrain, x, y, spec.size)
    _check_level(spec, x, y, heights)
    shore = None
    if spec.lake is not None:
        shore = measure_shore(spec.lake, x, y, spec.seed)
        heights = shape_lake(spec.lake, heights, shore)
    terrain = Terrain(
        (heights - origin[2]).astype(np.float32),
        np.float32(x[0]),
        np.float32(y[0]),
        np.float32(spec.terrain.step),
    )
    road, path = _line_distance(spec.roads, x, y), _line_distance(spec.paths, x, y)
    fields, aoi = _reed(spec, terrain, shore, level)
    blocked = np.minimum(road, path) < 0.3
    stems = _stems(spec, terrain, level, blocked)
    feet = sink_feet(terrain, [(stem.x, stem.y) for stem in stems])
    grove, crowns = grow_trees(stems, feet, spec.seed)
    solids = bodies.collect_solids(_bodies(spec, terrain, level, blocked, stems))
    targets = np.array(
        [(t.x, t.y, t.edge, t.azimuth, float(t.kind == "letter")) for t in spec.targets], dtype=float
    ).reshape(-1, 5)
    floor, canopy, closure = ground_rasters(terrain, stems, spec)
    ground = Ground(floor, road, path, canopy, closure)
    codes = {"broadleaf": Cover.BROADLEAF, "conifer": Cover.CONIFER}
    tree_cover = np.array(
        [Cover.DEAD_TREE if s.dead else codes[s.species_group] for s in stems], dtype=np.uint8
    )
    level_or_none = _NO_LAKE if level is None else float(level)
    world = World(terrain, ground, grove.empty, tree_cover, fields, solids, targets, level_or_none)
    visible = mark_visible(world, grove, np.array([crown.alone_area for crown in crowns]))
    return Scene(
        spec,
        crs,
        spec.vertical_datum,
        None if spec.lake is None else spec.lake.level,
        origin,
        tree_table(stems, crowns, feet, visible, origin, spec.crs),
        describe_reed(fields, aoi, spec.reed, origin, spec.crs),
        building_table(spec, terrain, origin),
        target_table(spec, terrain, origin),
        lake_polygon(terrain, level, spec, origin),
        world,
        grove,
    )


def _check(spec: SceneSpec) -> CRS:
    crs = CRS.from_user_input(spec.crs)
    if not crs.is_projected:
        raise SceneError(f"Scene {spec.name}: {spec.crs} is not projected; use metres, for example UTM.")
    if min(spec.size) < 10:
        raise SceneError(f"Scene {spec.name} of {spec.size} m is too small: use at least 10 m x 10 m.")
    nodes = spec.size[0] * spec.size[1] / spec.terrain.step**2
    if nodes > _LARGEST:
        raise SceneError(
            f"Scene {spec.name} has {nodes:.0f} terrain nodes, more than {_LARGEST}: "
            "raise terrain.step or cut it into scenes."
        )
    if spec.reed and spec.lake is None:
        raise SceneError(f"Scene {spec.name} has reed but no lake: add one or leave the reed out.")
    for kind, placed in (("Target", spec.targets), ("Building", spec.buildings), ("Car", spec.cars)):
        for item in placed:
            if not (0 <= item.x <= spec.size[0] and 0 <= item.y <= spec.size[1]):
                raise SceneError(f"{kind} at ({item.x}, {item.y}) lies outside scene {spec.name}.")
    names = [target.name for target in spec.targets]
    if len(set(names)) < len(names):
        raise SceneError(f"Scene {spec.name}: every target needs a name of its own.")
    return crs


def _check_level(spec: SceneSpec, x: np.ndarray, y: np.ndarray, heights: np.ndarray) -> None:
    """Refuse a lake that lies metres below the land along its outline, or stands above it.

    The land would be pulled to the water within the width of the beach, as a pit or a dam.
    """
    if spec.lake is None:
        return
    ring = Polygon(spec.lake.outline).exterior
    near = np.array([ring.interpolate(s).coords[0] for s in np.arange(0, ring.length, spec.terrain.step)])
    inside = (near >= 0).all(axis=1) & (near <= spec.size).all(axis=1)
    if not inside.any():
        return
    step = spec.terrain.step
    rows = ((near[inside, 1] - y[0]) / step).astype(int)
    columns = ((near[inside, 0] - x[0]) / step).astype(int)
    land = float(np.median(heights[rows, columns]))
    lowest, highest = land - _HIGHEST_BANK, land + _DEEPEST_FLOOD
    if not lowest <= spec.lake.level <= highest:
        raise SceneError(
            f"Scene {spec.name}: the lake level is {spec.lake.level:g} m, the land along its outline "
            f"{land:.1f} m: choose a level from {lowest:.1f} to {highest:.1f} m or another terrain.base."
        )


def _axes(spec: SceneSpec) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the terrain: the scene and a border that slanting photographs still see."""
    step = spec.terrain.step
    return (
        np.arange(-_BORDER, spec.size[0] + _BORDER + step, step),
        np.arange(-_BORDER, spec.size[1] + _BORDER + step, step),
    )


def _line_distance(lines: tuple[LineSpec, ...], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Distance to the edge of the nearest line, negative on it, m."""
    distance = np.full((len(y), len(x)), 1e3, dtype=np.float32)
    for i, northing in enumerate(y if lines else ()):
        points = shapely.points(x, np.full(len(x), northing))
        for line in lines:
            found = shapely.distance(LineString(line.points), points) - line.width / 2
            np.minimum(distance[i], found, out=distance[i], casting="same_kind")
    return distance


def _reed(
    spec: SceneSpec, terrain: Terrain, shore: Shore | None, level: float | None
) -> tuple[ReedFields, np.ndarray]:
    if not spec.reed or shore is None or level is None:
        return empty_reed_fields(), np.zeros((0, 0), dtype=np.int16)
    x = np.arange(-_BORDER + REED_CELL / 2, spec.size[0] + _BORDER, REED_CELL)
    y = np.arange(-_BORDER + REED_CELL / 2, spec.size[1] + _BORDER, REED_CELL)
    rows, columns = np.meshgrid(
        (y - float(terrain.south)) / float(terrain.step),
        (x - float(terrain.west)) / float(terrain.step),
        indexing="ij",
    )
    distance, along, height = (
        ndimage.map_coordinates(values, [rows, columns], order=1, mode="nearest")
        for values in (shore.distance, shore.along, terrain.height.astype(float))
    )
    return reed_fields(
        spec.reed, Shore(distance, along), level - height, x, y, local_level=level, seed=spec.seed
    )


def _stems(spec: SceneSpec, terrain: Terrain, level: float | None, blocked: np.ndarray) -> list[Stem]:
    """All stems that stand on dry land, off the roads, clear of houses and targets."""
    stems: list[Stem] = []
    for index, stand in enumerate(spec.stands):
        stems += plant_stand(stand, spec.seed * 1009 + index)
    whole = shapely.box(0, 0, *spec.size)
    for index, singles in enumerate(spec.single_trees):
        stems += plant_singles(singles, whole, spec.seed * 1013 + index, stems)
    keep_clear = [(b.x, b.y, 0.5 * np.hypot(b.length, b.width) + 1.0, 0.35) for b in spec.buildings]
    keep_clear += [(t.x, t.y, t.edge + 1.5, 0.75) for t in spec.targets]
    keep_clear += [(c.x, c.y, 2.5, 0.5) for c in spec.cars]
    free = []
    for stem in stems:
        i = int(np.clip((stem.y - terrain.south) / terrain.step, 0, blocked.shape[0] - 1))
        j = int(np.clip((stem.x - terrain.west) / terrain.step, 0, blocked.shape[1] - 1))
        wet = level is not None and terrain.height[i, j] < level + 0.15
        near = any(np.hypot(stem.x - x, stem.y - y) < r + k * stem.crown for x, y, r, k in keep_clear)
        if not (blocked[i, j] or wet or near):
            free.append(stem)
    return free


def _bodies(
    spec: SceneSpec, terrain: Terrain, level: float | None, blocked: np.ndarray, stems: list[Stem]
) -> list[bodies.Body]:
    placed: list[bodies.Body] = []
    for building in spec.buildings:
        placed += bodies.house(building, float(sink_feet(terrain, [(building.x, building.y)])[0]))
    for vehicle in spec.cars:
        placed += bodies.car(vehicle, float(sink_feet(terrain, [(vehicle.x, vehicle.y)])[0]))
    rng = np.random.default_rng([spec.seed, 12])
    taken = [(b.x, b.y, 0.5 * np.hypot(b.length, b.width)) for b in spec.buildings]
    taken += [(t.x, t.y, 1.5 * t.edge) for t in spec.targets] + [(s.x, s.y, 0.8) for s in stems]
    left = spec.boulders
    for _ in range(60 * spec.boulders):
        x, y = rng.uniform(1, spec.size[0] - 1), rng.uniform(1, spec.size[1] - 1)
        foot = float(sink_feet(terrain, [(x, y)])[0])
        i, j = int((y - terrain.south) / terrain.step), int((x - terrain.west) / terrain.step)
        clear = all(np.hypot(x - a, y - b) > r + 1.2 for a, b, r in taken)
        if left and clear and not blocked[i, j] and (level is None or foot > level - 0.1):
            placed += bodies.boulder(x, y, foot, rng)
            left -= 1
    return placed


def _shipped() -> Traversable:
    return files("workbench.virtual") / "scenes"
