"""Reed belts: stems per square metre, height and green share as functions of water depth.

Reed is tall and dense in shallow water and low and sparse in deep water [reed paper 3.1]; a front that
is straight or frayed, islets and holes tell a vital from a declining belt.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import rasterio.features
import shapely
from rasterio.transform import Affine
from shapely.geometry import LineString, MultiPolygon, Polygon, shape

from workbench.errors import SceneError
from workbench.virtual.composition import ReedSpec
from workbench.virtual.lake import Shore
from workbench.virtual.noise import fractal_field, gaussian_field
from workbench.virtual.particles import REED_CELL, ReedFields

EXTENT_DENSITY = 3.0
"""Fewer stems per square metre than this are single stems, not the belt."""
_SINGLE_REACH = 5.0
_END = 4.0
_STAIR = 0.2


@dataclass(frozen=True, eq=False)
class Reed:
    """All reed of a scene."""

    fields: ReedFields
    """Density, height and green share on the raster that stems are drawn from, local frame."""
    aoi: np.ndarray
    """(rows, columns) int16 index of the belt a cell belongs to, -1 without reed."""
    extent: gpd.GeoDataFrame
    """One row per belt: ``aoi``, polygons of more than ``EXTENT_DENSITY`` stems per square metre."""
    front: gpd.GeoDataFrame
    """One row per belt: ``aoi``, line between belt and open water, without islets and holes."""
    islets: gpd.GeoDataFrame
    """Polygons of reed in open water: ``aoi``."""
    holes: gpd.GeoDataFrame
    """Polygons of water within the reed: ``aoi``."""


def empty_reed_fields() -> ReedFields:
    """No reed at all."""
    nothing = np.zeros((0, 0), dtype=np.float32)
    zero = np.float32(0)
    return ReedFields(nothing, nothing, nothing, nothing, zero, zero, np.float32(REED_CELL), np.uint64(0))


def reed_fields(
    belts: Sequence[ReedSpec],
    shore: Shore,
    depth: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    *,
    local_level: float,
    seed: int,
) -> tuple[ReedFields, np.ndarray]:
    """Fields of all belts on a raster with cell centres ``x`` and ``y`` (rising), local metres.

    Parameters
    ----------
    belts
        Their stretches along the shore must not overlap.
    shore, depth
        Distances from the shoreline and water depths (negative ashore) at the cell centres.
    local_level
        Water level in the local frame, m.

    Returns
    -------
    ReedFields, ndarray
        The fields, and the index of the belt per cell (-1 none).

    Raises
    ------
    SceneError
        If two belts overlap or one lies outside the scene.
    """
    _check(belts)
    size = depth.shape
    density, height, green = (np.zeros(size) for _ in range(3))
    aoi = np.full(size, -1, dtype=np.int16)
    for index, belt in enumerate(belts):
        inside = (shore.along >= belt.along[0]) & (shore.along < belt.along[1])
        generator = np.random.default_rng([seed, 31, index])
        if not inside.any():
            raise SceneError(
                f"Reed belt {belt.aoi} from {belt.along[0]} to {belt.along[1]} m is not in the scene."
            )
        # Only the part of the raster that the belt can touch.
        rows, columns = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
        part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        near = Shore(shore.distance[part], shore.along[part])
        found = _one_belt(belt, near, depth[part], x[part[1]], y[part[0]], inside[part], generator)
        for target, values in zip((density, height, green), found, strict=True):
            target[part][inside[part]] = values[inside[part]]
        aoi[part][inside[part] & (found[0] > 0)] = index
    foot = np.where(depth > 0, local_level, local_level - depth)
    fields = ReedFields(
        density.astype(np.float32),
        height.astype(np.float32),
        green.astype(np.float32),
        foot.astype(np.float32),
        np.float32(x[0] - REED_CELL / 2),
        np.float32(y[0] - REED_CELL / 2),
        np.float32(REED_CELL),
        np.uint64(seed),
    )
    return fields, aoi


def density_at(belt: ReedSpec, depth: np.ndarray) -> np.ndarray:
    """Stems per square metre at a water depth (m): full ashore, a quarter where the last ones grow."""
    share = np.clip(depth / belt.deepest, 0, 1)
    return np.where(depth < belt.deepest, belt.density * (1 - 0.75 * share**1.2), 0.0)


def height_above_water(belt: ReedSpec, depth: np.ndarray) -> np.ndarray:
    """Mean height of stem tops above the water, ashore above the ground, m, at a water depth (m).

    Stems lose a quarter of their length towards deep water, and the water hides their feet.
    """
    share = np.clip(depth / belt.deepest, 0, 1)
    return np.maximum(belt.height * (1 - 0.25 * share) - np.clip(depth, 0, None), 0.3)


def describe_reed(
    fields: ReedFields, aoi: np.ndarray, belts: Sequence[ReedSpec], origin: np.ndarray, crs: str
) -> Reed:
    """Outlines of the belts in the CRS of the scene."""
    transform = Affine(
        float(fields.step),
        0,
        float(fields.west) + origin[0],
        0,
        float(fields.step),
        float(fields.south) + origin[1],
    )
    rows: dict[str, list[dict[str, object]]] = {"extent": [], "front": [], "islets": [], "holes": []}
    for index, belt in enumerate(belts):
        here = (aoi == index) & (fields.density >= EXTENT_DENSITY)
        parts = [
            shape(geometry)
            for geometry, _ in rasterio.features.shapes(here.astype(np.uint8), mask=here, transform=transform)
        ]
        # The outline runs along cells; without their stairs its length is that of the belt.
        parts = [part.simplify(_STAIR) for part in parts if part.area >= 0.5]
        if not parts:
            continue
        main = max(parts, key=lambda part: part.area)
        rows["extent"].append({"aoi": belt.aoi, "geometry": MultiPolygon(parts)})
        wet = _water_side(main, fields, origin)
        rows["front"].append({"aoi": belt.aoi, "geometry": wet})
        rows["islets"] += [{"aoi": belt.aoi, "geometry": part} for part in parts if part is not main]
        holes = [Polygon(ring) for ring in main.interiors]
        rows["holes"] += [{"aoi": belt.aoi, "geometry": hole} for hole in holes if hole.area >= 0.5]
    frames = {
        name: gpd.GeoDataFrame(found or {"aoi": [], "geometry": []}, geometry="geometry", crs=crs)
        for name, found in rows.items()
    }
    return Reed(fields, aoi, frames["extent"], frames["front"], frames["islets"], frames["holes"])


def _one_belt(
    belt: ReedSpec,
    shore: Shore,
    depth: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    inside: np.ndarray,
    generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    out = -shore.distance
    long = gaussian_field(x[None, :], y[:, None], 9.0, generator, modes=48)
    short = fractal_field(x[None, :], y[:, None], 3.0, 0.7, generator, gain=0.7)
    ripple = fractal_field(x[None, :], y[:, None], 1.2, 0.5, generator, gain=0.6)
    # Belts thin out over a few metres at both ends instead of being cut.
    ends = np.minimum(shore.along - belt.along[0], belt.along[1] - shore.along) + 0.8 * short
    taper = np.sqrt(np.clip(ends / _END, 0, 1))
    front = (belt.width * (1 + belt.fray * (0.22 * long + 0.20 * short)) + 0.12 * ripple) * taper
    stands = inside & (out >= -belt.ashore * taper) & (out <= front) & (depth < belt.deepest)
    single = inside & ~stands & (out > 0) & (out < front + _SINGLE_REACH) & (depth < belt.deepest * 1.25)
    reach = np.clip(1 - (out - front) / _SINGLE_REACH, 0, 1)
    patchy = np.exp(0.22 * short + 0.25 * belt.fray * long)
    full = density_at(belt, depth)
    density = np.where(stands, full * patchy, np.where(single, belt.single_stems * reach, 0.0))
    last = density_at(belt, np.full_like(depth, 0.8 * belt.deepest))
    for cx, cy, radius, is_hole in _patches(belt, front, out, inside, x, y, generator):
        away = np.hypot(x[None, :] - cx, y[:, None] - cy)
        patch = inside & (away < radius * (1 + 0.22 * short))
        if is_hole:
            density[patch & (depth > 0)] = 0.0
        else:
            density = np.where(patch & (depth > 0), np.maximum(density, last * patchy), density)
    share = np.clip(depth / belt.deepest, 0, 1)
    height = height_above_water(belt, depth) * np.exp(0.04 * long + 0.05 * short)
    green = np.clip(belt.green * (1 - 0.25 * share) + 0.14 * long + 0.08 * short, 0, 1)
    return density, np.where(density > 0, height, 0), np.where(density > 0, green, 0)


def _patches(
    belt: ReedSpec,
    front: np.ndarray,
    out: np.ndarray,
    inside: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    generator: np.random.Generator,
) -> list[tuple[float, float, float, bool]]:
    """Centres and radii of islets (in front) and holes (within)."""
    patches = []
    outside = np.argwhere(inside & (out > front + 2.2) & (out < front + 7))
    within = np.argwhere(inside & (out > 0.35 * front) & (out < front - 2.0))
    for number, room, is_hole in ((belt.islets, outside, False), (belt.holes, within, True)):
        for _ in range(number if len(room) else 0):
            row, column = room[generator.integers(len(room))]
            radius = float(generator.uniform(0.7, 1.3 if is_hole else 1.6))
            patches.append((float(x[column]), float(y[row]), radius, is_hole))
    return patches


def _water_side(main: Polygon, fields: ReedFields, origin: np.ndarray) -> shapely.Geometry:
    """The part of a belt's outline with open water on its other side, without its two ends."""
    ring = np.asarray(main.exterior.coords)
    middle = (ring[1:] + ring[:-1]) / 2
    step = float(fields.step)
    normal = np.stack([ring[1:, 1] - ring[:-1, 1], ring[:-1, 0] - ring[1:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    sign = 1.0 if main.exterior.is_ccw else -1.0
    beyond = middle + sign * normal * step - origin[:2]
    columns = ((beyond[:, 0] - fields.west) // step).astype(int)
    rows = ((beyond[:, 1] - fields.south) // step).astype(int)
    height, width = fields.foot.shape
    valid = (rows >= 0) & (columns >= 0) & (rows < height) & (columns < width)
    rows, columns = np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)
    level = fields.foot.min()
    wet = (
        valid
        & (fields.foot[rows, columns] <= level + 1e-3)
        & (fields.density[rows, columns] < EXTENT_DENSITY)
    )
    lines = [LineString(ring[i : i + 2]) for i in np.flatnonzero(wet)]
    return shapely.line_merge(shapely.union_all(lines)) if lines else LineString()


def _check(belts: Sequence[ReedSpec]) -> None:
    stretches = sorted((belt.along, belt.aoi) for belt in belts)
    for (first, name), (second, other) in itertools.pairwise(stretches):
        if second[0] < first[1]:
            raise SceneError(f"Reed belts {name} and {other} overlap along the shore: separate them.")
