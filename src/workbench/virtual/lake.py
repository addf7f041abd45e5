"""A lake: distance from its shore, bed and beach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import Polygon

from workbench.errors import SceneError
from workbench.virtual.composition import LakeSpec
from workbench.virtual.noise import fractal_field

_BEACH_WIDTH = 22.0
_WOBBLE = 0.9


@dataclass(frozen=True, eq=False)
class Shore:
    """Place of every node relative to the shoreline."""

    distance: np.ndarray
    """(rows, columns) m inland from the shoreline, negative in the lake."""
    along: np.ndarray
    """(rows, columns) m along the outline from its first point to the place nearest to the node."""


def measure_shore(spec: LakeSpec, x: np.ndarray, y: np.ndarray, seed: int) -> Shore:
    """Distances from the outline, with bays and points of about a metre added.

    Raises
    ------
    SceneError
        If the outline crosses itself.
    """
    polygon = Polygon(spec.outline)
    if not polygon.is_valid:
        raise SceneError("The outline of the lake crosses itself: give its corners in order.")
    points_x, points_y = np.meshgrid(x, y)
    points = shapely.points(points_x, points_y)
    ring = polygon.exterior
    sign = np.where(shapely.contains_xy(polygon, points_x, points_y), -1.0, 1.0)
    generator = np.random.default_rng([seed, 2])
    wobble = _WOBBLE * fractal_field(x[None, :], y[:, None], 14.0, 2.0, generator)
    line = shapely.LineString(ring.coords)
    return Shore(sign * shapely.distance(line, points) + wobble, shapely.line_locate_point(line, points))


def shape_lake(spec: LakeSpec, land: np.ndarray, shore: Shore) -> np.ndarray:
    """Heights of land, beach and bed: the land falls to the water level, the bed on to its deepest."""
    inland = np.clip(shore.distance, 0, None)
    out = np.clip(-shore.distance, 0, None)
    t = np.clip(inland / _BEACH_WIDTH, 0, 1)
    weight = t * t * (3 - 2 * t)
    beach = spec.level + spec.beach_slope * inland
    dry = (1 - weight) * beach + weight * np.maximum(land, beach.clip(max=spec.level + 0.4))
    bed = spec.level - spec.deepest * (1 - np.exp(-spec.bed_slope * out / spec.deepest))
    return np.where(shore.distance >= 0, dry, bed)
