"""Houses, cars and boulders of a scene as convex bodies on the terrain."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import HalfspaceIntersection

from workbench.errors import SceneError
from workbench.virtual.composition import BuildingSpec, CarSpec
from workbench.virtual.solids import GLASS, PAINT, ROOF_FLAT, ROOF_TILES, STONE, WALL, Solids, empty_solids
from workbench.virtual.world import Cover

Body = tuple[np.ndarray, np.ndarray, Cover, int]
_ROOFS = {
    "red": (0.215, 0.095, 0.064, 0.29),
    "brown": (0.140, 0.095, 0.070, 0.26),
    "grey": (0.190, 0.190, 0.195, 0.21),
    "white": (0.560, 0.560, 0.550, 0.55),
}
_WALL = (0.42, 0.40, 0.35, 0.45)
_CARS = {
    "red": (0.300, 0.016, 0.018, 0.35),
    "white": (0.640, 0.640, 0.640, 0.62),
    "black": (0.020, 0.020, 0.022, 0.03),
    "silver": (0.330, 0.340, 0.350, 0.33),
    "blue": (0.035, 0.070, 0.200, 0.20),
}
_STONE = (0.270, 0.245, 0.225, 0.30)
_OVERHANG = 0.5


def house(spec: BuildingSpec, foot: float) -> list[Body]:
    """Walls and roof of a building whose floor lies at ``foot`` (local m).

    Raises
    ------
    SceneError
        If the ridge is not above the eaves.
    """
    if spec.ridge <= spec.eaves:
        raise SceneError(
            f"The ridge of a building ({spec.ridge} m) must be above its eaves ({spec.eaves} m)."
        )
    roof, walls = _ROOFS[spec.colour], _WALL
    half_l, half_w = spec.length / 2, spec.width / 2
    frame = _placed(spec.x, spec.y, foot, spec.azimuth)
    if spec.roof == "flat":
        parts = [
            (_box(half_l, half_w, -2.0, spec.ridge), roof, walls, ROOF_FLAT),
            # Plant rooms and vents make a flat roof no blank sheet.
            (
                _box(0.12 * half_l, 0.2 * half_w, spec.ridge, spec.ridge + 1.3, 0.4 * half_l),
                walls,
                walls,
                WALL,
            ),
            (
                _box(0.05 * half_l, 0.1 * half_w, spec.ridge, spec.ridge + 0.7, -0.5 * half_l),
                roof,
                walls,
                PAINT,
            ),
        ]
    else:
        rise = spec.ridge - spec.eaves
        slope = rise / half_w
        over = half_w + _OVERHANG
        low = spec.eaves - slope * _OVERHANG
        roof_planes = [
            *_box(half_l + _OVERHANG, over, low - 0.15, spec.ridge + 1)[:5],
            (0.0, rise, half_w, half_w * spec.ridge),
            (0.0, -rise, half_w, half_w * spec.ridge),
        ]
        parts = [
            (_box(half_l, half_w, -2.0, spec.eaves), walls, walls, WALL),
            (np.array(roof_planes), roof, walls, ROOF_TILES),
            (_box(0.35, 0.35, spec.eaves, spec.ridge + 0.8, 0.3 * half_l, 0.25 * half_w), walls, walls, WALL),
        ]
    return [
        (frame(planes), np.array([top, side]), Cover.BUILDING, surface)
        for planes, top, side, surface in parts
    ]


def car(spec: CarSpec, foot: float) -> list[Body]:
    """Body and cabin of a car."""
    paint = _CARS[spec.colour]
    frame = _placed(spec.x, spec.y, foot, spec.azimuth)
    cabin = [
        *_box(1.25, 0.72, 0.8, 1.45, -0.15)[2:],
        (1.0, 0.0, 0.75, 0.75 * 1.45 + 0.75),
        (-1.0, 0.0, 0.6, 0.6 * 1.45 + 1.1),
    ]
    dark = (0.03, 0.03, 0.035, 0.04)
    return [
        (frame(_box(2.15, 0.88, 0.25, 0.85)), np.array([paint, paint]), Cover.CAR, PAINT),
        (frame(np.array(cabin)), np.array([dark, dark]), Cover.CAR, GLASS),
        (frame(_box(0.62, 0.62, 1.3, 1.47, -0.17)), np.array([paint, paint]), Cover.CAR, PAINT),
    ]


def boulder(x: float, y: float, foot: float, generator: np.random.Generator) -> list[Body]:
    """An angular stone of 0.4 to 1.6 m."""
    size = generator.uniform(0.2, 0.8)
    normals = generator.normal(size=(16, 3))
    normals = np.concatenate([normals, [[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    reach = size * generator.uniform(0.75, 1.1, len(normals)) * (1 - 0.35 * np.abs(normals[:, 2]))
    tone = np.array(_STONE) * np.exp(generator.normal(0, 0.2))
    planes = _placed(x, y, foot + 0.3 * size, generator.uniform(0, 360))(np.column_stack([normals, reach]))
    return [(planes, np.array([tone, tone]), Cover.BOULDER, STONE)]


def collect_solids(bodies: list[Body]) -> Solids:
    """Bodies as the tables that compiled loops read."""
    if not bodies:
        return empty_solids()
    planes, colours, covers, surfaces = zip(*bodies, strict=True)
    first = np.concatenate([[0], np.cumsum([len(p) for p in planes])])
    return Solids(
        np.ascontiguousarray(np.concatenate(planes), dtype=float),
        first.astype(np.int64),
        np.array([_bounds(p) for p in planes]),
        np.array(colours, dtype=np.float32),
        np.array(covers, dtype=np.uint8),
        np.array(surfaces, dtype=np.int64),
    )


def _box(
    half_l: float, half_w: float, low: float, high: float, at_l: float = 0.0, at_w: float = 0.0
) -> np.ndarray:
    """Planes of a box: its length runs along +x before it is placed; the upper plane is the last."""
    return np.array(
        [
            (1.0, 0.0, 0.0, half_l + at_l),
            (-1.0, 0.0, 0.0, half_l - at_l),
            (0.0, 1.0, 0.0, half_w + at_w),
            (0.0, -1.0, 0.0, half_w - at_w),
            (0.0, 0.0, -1.0, -low),
            (0.0, 0.0, 1.0, high),
        ]
    )


def _placed(x: float, y: float, z: float, azimuth: float) -> Callable[[np.ndarray], np.ndarray]:
    """Turn planes so that +x points to the azimuth, and move their origin to a place."""
    a = math.radians(azimuth)
    turn = np.array([[math.sin(a), -math.cos(a), 0], [math.cos(a), math.sin(a), 0], [0, 0, 1]])

    def place(planes: np.ndarray) -> np.ndarray:
        planes = np.asarray(planes, dtype=float)
        length = np.linalg.norm(planes[:, :3], axis=1)
        normals = planes[:, :3] / length[:, None] @ turn.T
        return np.column_stack([normals, planes[:, 3] / length + normals @ (x, y, z)])

    return place


def _bounds(planes: np.ndarray) -> np.ndarray:
    """Smallest and largest x, y, z of a body."""
    inside = _inner_point(planes)
    corners = HalfspaceIntersection(np.column_stack([planes[:, :3], -planes[:, 3]]), inside).intersections
    return np.concatenate([corners.min(axis=0), corners.max(axis=0)])


def _inner_point(planes: np.ndarray) -> np.ndarray:
    """Centre of the largest ball within a body."""
    result = linprog(
        [0, 0, 0, -1],
        A_ub=np.column_stack([planes[:, :3], np.ones(len(planes))]),
        b_ub=planes[:, 3],
        bounds=[(None, None)] * 3 + [(0, None)],
    )
    if result.status != 0 or result.x[3] <= 0:
        raise SceneError("A body of the scene has no volume: check its lengths and heights.")
    return result.x[:3]
