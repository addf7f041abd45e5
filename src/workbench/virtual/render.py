"""Photographs of a scene: true central projection with occlusion, light and wind of one exposure.

The radiance is linear and without the optics behind the lens (vignetting, point spread, noise, JPEG);
the projection includes the distortion of the lens. A photograph is computed in tiles; each thread owns
whole tiles, so that the result is the same for any number of threads and any size of tile.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
import xarray as xr

from workbench.cameras import Camera, Pose
from workbench.errors import SceneError
from workbench.virtual import foliage, surfaces, views
from workbench.virtual.above import Direction, map_from_above
from workbench.virtual.air import air_of
from workbench.virtual.grove import Grove
from workbench.virtual.light import BANDS, Light, light_at
from workbench.virtual.particles import TH, TZ
from workbench.virtual.scene import Scene
from workbench.virtual.shade import LightMap, coarsen
from workbench.virtual.texture import textures
from workbench.virtual.water import Ripples, ripples
from workbench.virtual.wind import Wind, WindField, wind_field
from workbench.virtual.world import World

_LATTICE = 4
_TILE = 192
_SHADOW_PER_PIXEL = 1.0
_MOST_SHADOW_CELLS = 60_000_000
_FARTHEST_RADIUS = 1.25


def render(
    scene: Scene,
    camera: Camera,
    pose: Pose,
    *,
    time: datetime,
    exposure: int = 0,
    wind: Wind | None = None,
    supersampling: int = 3,
    bands: Sequence[str] = BANDS,
    cloudiness: float = 0.0,
    tile: int = _TILE,
    threads: int | None = None,
) -> xr.Dataset:
    """Photograph a scene.

    Parameters
    ----------
    scene
        A built scene.
    camera
        Inner orientation, with distortion.
    pose
        In the CRS of the scene; the projection centre must be above everything that it sees.
    time
        Date and time of the exposure (UTC if it has no time zone): decides the sun.
    exposure
        Number of the exposure: every one has ripples and a flutter of leaves of its own, while gusts and
        the sway of trees go on with ``time``.
    wind
        Strength of the wind; a breeze of 4 m/s by default.
    supersampling
        Subpixels along the edge of a pixel, at least 1; 3 or more avoid false failures of matching.
    bands
        Any of red, green, blue, nir.
    cloudiness
        0 clear .. 1 overcast.
    tile
        Edge of a tile, pixels; changes the memory, not the result.
    threads
        Number of threads; all processors by default; changes the time, not the result.

    Returns
    -------
    Dataset
        ``radiance`` (band, row, column) float32, about 0..1: 1 is white paper lying flat in full light;
        at the centres of the pixels ``depth`` (row, column) float32, m along the optical axis; ``cover``
        uint8, codes of :class:`workbench.virtual.world.Cover`; ``tree_id`` int32, 0 where there is none.

    Raises
    ------
    SceneError
        If the camera is below the terrain, the tree tops or the roofs beneath it, looks at the horizon,
        or if the sun is too low, a band is unknown, or the supersampling is less than 1.
    """
    _check(scene, bands, supersampling, tile)
    wind = Wind() if wind is None else wind
    light = light_at(time, *scene.longitude_latitude, cloudiness=cloudiness)
    frame = _Frame.of(scene, camera, pose, supersampling)
    world = scene.world
    west, south, east, north = frame.footprint
    around = (west - 60, south - 60, east + 60, north + 60)
    field = wind_field(wind, exposure, around, seconds=_seconds(time))
    light_map = shadow_map(world, scene.grove, field, light, frame.footprint, frame.pixel, threads=threads)
    tools = _Tools(
        world,
        scene.grove,
        field,
        light_map,
        ripples(wind, exposure),
        air_of(light, frame.view.rotation[2], float(frame.view.centre[2] - scene.lowest)),
        frame,
        views.reach_of_trees(world, frame.view, frame.scale),
        _body_boxes(world, frame),
    )
    results = _empty(camera)
    windows = [
        (r, min(r + tile, camera.height), c, min(c + tile, camera.width))
        for r in range(0, camera.height, tile)
        for c in range(0, camera.width, tile)
    ]
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        list(pool.map(lambda window: _render_tile(tools, window, results), windows))
    return _dataset(results, bands, exposure, time)


def shadow_map(
    world: World,
    grove: Grove,
    field: WindField,
    light: Light,
    footprint: tuple[float, float, float, float],
    pixel: float,
    *,
    threads: int | None = None,
) -> LightMap:
    """Shadows over a footprint (west, south, east, north, local m), cells of one pixel."""
    shear_x, shear_y = light.sun[0] / light.sun[2], light.sun[1] / light.sun[2]
    low = min(float(world.terrain.height.min()), 0.0)
    high = float(world.terrain.height.max()) + 5.0
    if len(grove.table):
        high = max(high, float((grove.table[:, TZ] + grove.table[:, TH]).max()))
    reach_x = sorted((low * shear_x, high * shear_x))
    reach_y = sorted((low * shear_y, high * shear_y))
    west, south, east, north = footprint
    west, east = west - reach_x[1] - 2, east - reach_x[0] + 2
    south, north = south - reach_y[1] - 2, north - reach_y[0] + 2
    cell = max(
        pixel * _SHADOW_PER_PIXEL,
        float(np.sqrt(max((east - west) * (north - south), 1.0) / _MOST_SHADOW_CELLS)),
    )
    # Cells are snapped so that neighbouring photographs of one flight share them.
    west, north = np.floor(west / cell) * cell, np.ceil(north / cell) * cell
    shape = int(np.ceil((north - south) / cell)), int(np.ceil((east - west) / cell))
    direction = Direction(float(west), float(north), float(cell), float(shear_x), float(shear_y))
    if max(light.direct) > 0:
        top, _ = map_from_above(world, grove, field, direction, shape, owners=False, threads=threads)
    else:
        top = np.full((1, 1), -1e9, dtype=np.float32)
    return LightMap(
        np.array(light.sun, dtype=np.float32),
        np.array(light.direct, dtype=np.float32),
        np.array(light.diffuse, dtype=np.float32),
        top,
        coarsen(top),
        np.float32(west),
        np.float32(north),
        np.float32(cell),
        np.float32(shear_x),
        np.float32(shear_y),
    )


@dataclass(frozen=True, eq=False)
class _Frame:
    """Geometry of one photograph in the local frame of the scene."""

    camera: Camera
    view: views.View
    supersampling: int
    scale: float
    """Edge of a subpixel at a depth of 1 m, m."""
    pixel: float
    """Smallest edge of a pixel on the ground, m."""
    footprint: tuple[float, float, float, float]
    """West, south, east, north of what the photograph can see, local m."""

    @classmethod
    def of(cls, scene: Scene, camera: Camera, pose: Pose, s: int) -> _Frame:
        centre = np.asarray(pose.centre, dtype=float) - scene.origin
        edge = _border(camera)
        rays = camera.rays(edge)
        directions = rays @ pose.rotation
        if np.any(directions[:, 2] >= -0.05 * np.linalg.norm(directions, axis=1)):
            raise SceneError("The camera sees the horizon: tilt it down or use a longer focal length.")
        floor = scene.lowest
        reach = (floor - centre[2]) / directions[:, 2]
        _check_height(scene, centre)
        x, y = centre[0] + reach * directions[:, 0], centre[1] + reach * directions[:, 1]
        footprint = (
            float(min(x.min(), centre[0])),
            float(min(y.min(), centre[1])),
            float(max(x.max(), centre[0])),
            float(max(y.max(), centre[1])),
        )
        focal = 0.5 * (camera.focal_x + camera.focal_y)
        focals = np.array([camera.focal_x, camera.focal_y], dtype=float) * s
        principal = np.array([camera.principal_x, camera.principal_y], dtype=float) * s
        rational = any(camera.distortion[5:])
        rotation = np.ascontiguousarray(pose.rotation, dtype=float)
        distortion = np.array(camera.distortion, dtype=float)
        lens = views.Lens(
            rotation.astype(np.float32),
            distortion.astype(np.float32),
            np.concatenate([focals, principal]).astype(np.float32),
            rational,
        )
        limit = float(np.square(rays[:, :2]).sum(axis=1).max() * _FARTHEST_RADIUS + 0.02)
        view = views.View(rotation, centre, focals, principal, distortion, rational, limit, lens)
        return cls(camera, view, s, 1 / (focal * s), float(reach.min() / focal), footprint)


@dataclass(frozen=True, eq=False)
class _Tools:
    """What every tile of a photograph shares."""

    world: World
    grove: Grove
    field: WindField
    light: LightMap
    waves: Ripples
    air: np.ndarray
    """As :func:`workbench.virtual.air.air_of`."""
    frame: _Frame
    tree_boxes: np.ndarray
    """First and last row and column (n, 4), subpixels, that each tree can touch."""
    body_boxes: np.ndarray
    """Body, first and last row and column (n, 5), subpixels, of every body in the photograph."""


def _render_tile(tools: _Tools, window: tuple[int, int, int, int], results: dict[str, np.ndarray]) -> None:
    r0, r1, c0, c1 = window
    frame, world = tools.frame, tools.world
    s, view, scale = frame.supersampling, frame.view, frame.scale
    shape = ((r1 - r0) * s, (c1 - c0) * s)
    tile = views.Tile(
        r0 * s,
        c0 * s,
        np.empty(shape, dtype=np.float32),
        np.full(shape, -1, dtype=np.int32),
        np.zeros((*shape, 4), dtype=np.float32),
        np.empty((*shape, 3)),
    )
    views.meet_ground(world, view, _lattice(frame.camera, window), _LATTICE * s, tile)
    top, bottom, left, right = r0 * s, r1 * s, c0 * s, c1 * s
    bodies = tools.body_boxes
    near = (bodies[:, 1] < bottom) & (bodies[:, 2] > top) & (bodies[:, 3] < right) & (bodies[:, 4] > left)
    surface = textures()
    surfaces.paint_solids(world, surface, tools.light, view, scale, bodies[near], tile)
    boxes = tools.tree_boxes
    near = (boxes[:, 0] < bottom) & (boxes[:, 1] > top) & (boxes[:, 2] < right) & (boxes[:, 3] > left)
    chosen = np.flatnonzero(near)
    planted = world._replace(plants=tools.grove.plants(chosen))
    foliage.paint_trees(planted, tools.field, tools.light, view, scale, chosen, tile)
    foliage.paint_reed(world, tools.field, tools.light, view, scale, _reed_window(world, tile, view), tile)
    cover = np.zeros(shape, dtype=np.uint8)
    surfaces.paint_ground(world, surface, tools.light, tools.waves, view, scale, s, cover, tile)
    views.resolve(
        tile,
        cover,
        world.tree_cover,
        world.solids.cover,
        tools.air,
        s,
        results["radiance"],
        results["depth"],
        results["cover"],
        results["tree_id"],
        r0,
        c0,
    )


def _lattice(camera: Camera, window: tuple[int, int, int, int]) -> np.ndarray:
    """Rays (i, j, 3) in camera axes at pixel corners every few pixels from the corner of a window."""
    r0, r1, c0, c1 = window
    rows = r0 + _LATTICE * np.arange(-(-(r1 - r0) // _LATTICE) + 1)
    columns = c0 + _LATTICE * np.arange(-(-(c1 - c0) // _LATTICE) + 1)
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).astype(float)
    return camera.rays(grid)


def _reed_window(world: World, tile: views.Tile, view: views.View) -> tuple[int, int, int, int]:
    """Rows and columns of the reed raster whose stems may touch a tile."""
    reed = world.reed
    if reed.density.size == 0:
        return 0, 0, 0, 0
    corners = tile.place[[0, 0, -1, -1], [0, -1, 0, -1]]
    high = float(reed.foot.max() + reed.height.max() * 1.3)
    share = (view.centre[2] - high) / np.maximum(view.centre[2] - corners[:, 2], 1e-6)
    raised = view.centre + share[:, None] * (corners - view.centre)
    points = np.concatenate([corners, raised])
    low, top = points.min(axis=0) - 1.5, points.max(axis=0) + 1.5
    rows, columns = reed.density.shape
    i0, i1 = np.clip([(low[1] - reed.south) / reed.step, (top[1] - reed.south) / reed.step + 1], 0, rows)
    j0, j1 = np.clip([(low[0] - reed.west) / reed.step, (top[0] - reed.west) / reed.step + 1], 0, columns)
    return int(i0), int(i1), int(j0), int(j1)


def _body_boxes(world: World, frame: _Frame) -> np.ndarray:
    """Body, first and last row and column (n, 5) int64, subpixels, of every body in the photograph."""
    boxes = []
    for body, (x0, y0, z0, x1, y1, z1) in enumerate(world.solids.bounds):
        corners = np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)])
        image = np.array([views.to_image(frame.view, *corner) for corner in corners])
        if np.any(image[:, 2] < 0):
            continue
        low, high = np.floor(image.min(axis=0)) - 2, np.ceil(image.max(axis=0)) + 3
        boxes.append((body, low[1], high[1], low[0], high[0]))
    return np.array(boxes, dtype=np.int64).reshape(-1, 5)


def _border(camera: Camera, steps: int = 24) -> np.ndarray:
    """Image positions (n, 2) along the border of a photograph."""
    t = np.linspace(0, 1, steps)
    w, h = camera.width, camera.height
    sides = [(t * w, 0 * t), (t * w, 0 * t + h), (0 * t, t * h), (0 * t + w, t * h)]
    return np.concatenate([np.stack(side, axis=-1) for side in sides])


def _empty(camera: Camera) -> dict[str, np.ndarray]:
    shape = (camera.height, camera.width)
    return {
        "radiance": np.zeros((len(BANDS), *shape), dtype=np.float32),
        "depth": np.zeros(shape, dtype=np.float32),
        "cover": np.zeros(shape, dtype=np.uint8),
        "tree_id": np.zeros(shape, dtype=np.int32),
    }


def _dataset(
    results: dict[str, np.ndarray], bands: Sequence[str], exposure: int, time: datetime
) -> xr.Dataset:
    radiance = results["radiance"]
    if tuple(bands) != BANDS:
        radiance = radiance[[BANDS.index(band) for band in bands]]
    # Trees are numbered from 1 outside of compiled code.
    tree_id = results["tree_id"]
    tree_id += 1
    plane = ("row", "column")
    dataset = xr.Dataset(
        {
            "radiance": (("band", *plane), radiance, {"units": "1", "long_name": "radiance"}),
            "depth": (
                plane,
                results["depth"],
                {"units": "m", "long_name": "distance along the optical axis"},
            ),
            "cover": (plane, results["cover"], {"units": "1", "long_name": "land cover code"}),
            "tree_id": (plane, tree_id, {"units": "1", "long_name": "tree, 0 for none"}),
        },
        coords={"band": list(bands)},
        attrs={"exposure": exposure, "time": time.isoformat()},
    )
    rows, columns = results["depth"].shape
    return dataset.assign_coords(row=np.arange(rows) + 0.5, column=np.arange(columns) + 0.5)


def _seconds(time: datetime) -> float:
    """Since 1970; a time without zone is UTC."""
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()


def _check(scene: Scene, bands: Sequence[str], supersampling: int, tile: int) -> None:
    unknown = [band for band in bands if band not in BANDS]
    if unknown or not bands:
        raise SceneError(f"Bands {list(bands)} cannot be rendered: choose from {BANDS}.")
    if supersampling < 1:
        raise SceneError(f"Supersampling {supersampling} is impossible: use 1 or more, better 3.")
    if tile < _LATTICE or tile % _LATTICE:
        raise SceneError(f"A tile of {tile} pixels is impossible: use a multiple of {_LATTICE}.")


def _check_height(scene: Scene, centre: np.ndarray) -> None:
    top = scene.highest_near(centre[0], centre[1], 30.0)
    if centre[2] <= top + 2.0:
        raise SceneError(
            f"The camera at {centre[2] + scene.origin[2]:.1f} m is not above what stands near it "
            f"({top + scene.origin[2]:.1f} m): fly at least 2 m higher."
        )
