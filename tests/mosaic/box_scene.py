"""A box on a plane, photographed by exact ray casting: the orthophoto is known in closed form."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rasterio.crs import CRS

from workbench.cameras import Camera, Pose
from workbench.orientation import Block
from workbench.rasters import Grid, new_raster

UTM = CRS.from_epsg(32633)
ORIGIN = np.array([500_000.0, 5_300_000.0])
ROOF = (30.0, 42.0, 28.0, 40.0, 9.0)  # west, east, south, north, height, relative to ORIGIN


def texture(x: np.ndarray, y: np.ndarray, roof: np.ndarray) -> np.ndarray:
    """Smooth colours (..., 3) of 0..255 that tell places apart; the roof is red, the ground green."""
    wave = 40 * np.sin(x * 1.3) * np.cos(y * 0.9) + 20 * np.sin(0.31 * x + 0.57 * y)
    red = np.where(roof, 190, 90) + wave
    green = np.where(roof, 80, 150) + wave
    blue = 110 + 0.5 * wave
    return np.stack([red, green, blue], axis=-1)


def render(camera: Camera, pose: Pose, gain: float = 1.0) -> np.ndarray:
    """Photograph (rows, columns, 3) of the box; its walls are blue."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = pose.to_world(camera.rays(np.stack([columns, rows], -1).reshape(-1, 2)))
    start = pose.centre - (*ORIGIN, 0)
    west, east, south, north, top = ROOF
    reach = (0 - start[2]) / rays[:, 2]
    ground = start + rays * reach[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        t1 = (np.array([west, south, 0]) - start) / rays
        t2 = (np.array([east, north, top]) - start) / rays
    enter = np.fmin(t1, t2).max(axis=1)
    leave = np.fmax(t1, t2).min(axis=1)
    hit = enter < leave
    point = np.where(hit[:, None], start + rays * enter[:, None], ground)
    roof = hit & (point[:, 2] > top - 1e-6)
    colours = texture(point[:, 0], point[:, 1], roof)
    colours[hit & ~roof] = (20, 20, 250)
    colours = np.clip(colours * gain, 1, 255)
    return np.rint(colours).astype(np.uint8).reshape(camera.height, camera.width, 3)


@dataclass(frozen=True, eq=False)
class BoxSite:
    block: Block
    surface: object
    folder: Path


def box_surface(resolution: float = 0.25):
    grid = Grid.from_bounds(UTM, (*(ORIGIN + 5), *(ORIGIN + 65)), resolution)
    x, y = np.meshgrid(grid.x - ORIGIN[0], grid.y - ORIGIN[1])
    west, east, south, north, top = ROOF
    heights = np.where((x > west) & (x < east) & (y > south) & (y < north), top, 0).astype(np.float32)
    return new_raster(heights, grid, name="dsm", units="m", vertical_datum="test")
