"""Trees of a scene: stands of one age and single trees, grown, coloured, and told visible or hidden."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.geometry import Polygon

from workbench.errors import SceneError
from workbench.virtual.composition import SingleTreesSpec, StandSpec
from workbench.virtual.grove import Grove, fits
from workbench.virtual.noise import gaussian_field
from workbench.virtual.particles import CENTRE, TRED, TREE_COLUMNS
from workbench.virtual.trees3d import (
    COUNT,
    LEAF_DIAMETER,
    RA,
    RB,
    RC,
    SPECIES_GROUPS,
    TreeForm,
    X,
    Y,
    Z,
    grow_tree,
)

# Height and crown diameter (mean, standard deviation) and spacing, m. Sizes stay within thesis table
# 2.2 (conifers 15-40 m, crowns 3-8 m, once grown) and the largest crowns of thesis 4.3: 14 m for
# broadleaf trees and 6 m for conifers; young broadleaf stands crown to crown, nearly equally high.
_STANDS = {
    ("conifer", "young"): ((9.0, 0.9), (2.6, 0.3), 2.0),
    ("conifer", "middle"): ((18.0, 1.5), (3.8, 0.45), 3.0),
    ("conifer", "old"): ((27.0, 2.0), (5.2, 0.5), 4.2),
    ("broadleaf", "young"): ((10.0, 0.6), (3.0, 0.35), 2.3),
    ("broadleaf", "middle"): ((17.0, 1.3), (6.2, 0.8), 4.7),
    ("broadleaf", "old"): ((25.0, 2.2), (10.8, 1.5), 8.2),
}
_LARGEST_CROWN = {"broadleaf": 14.0, "conifer": 6.0}
_JITTER = 0.22
_GAP_FIELD = 16.0
# Share of the way to the middle of its free ground that the top of a tree goes, and the longest way in
# spacings. In old broadleaf stands tops then stand 1 to 2 m off their stems, as measured in beech forests;
# conifers stay within a few decimetres.
_PLASTICITY = {"broadleaf": 0.75, "conifer": 0.25}
_LARGEST_SHIFT = 0.4
# Reflectance of leaves, red green blue nir, of a few kinds a group: beech, oak, birch; spruce, pine.
_LEAVES = {
    "broadleaf": np.array(
        [[0.060, 0.112, 0.028, 0.48], [0.050, 0.088, 0.026, 0.44], [0.085, 0.135, 0.036, 0.50]]
    ),
    "conifer": np.array([[0.034, 0.060, 0.026, 0.31], [0.050, 0.074, 0.030, 0.34]]),
}
_UNDERSTOREY_HEIGHT = (1.0, 5.0)


@dataclass(frozen=True, eq=False)
class Stem:
    """One tree before it is grown."""

    x: float
    y: float
    species_group: str
    height: float
    crown: float
    lean: tuple[float, float] = (0.0, 0.0)
    dead: bool = False
    understorey: bool = False
    crown_share: float | None = None


def plant_stand(spec: StandSpec, seed: int) -> list[Stem]:
    """Stems of a stand: a jittered triangular grid with gaps, and an understorey.

    The mean number per area is ``2 / (sqrt(3) spacing^2)`` times the share that gaps leave
    (1 - 0.3 clumping).

    Raises
    ------
    SceneError
        If the species group is unknown or the area crosses itself.
    """
    if spec.species_group not in SPECIES_GROUPS:
        raise SceneError(f"Species group {spec.species_group!r} is unknown: choose one of {SPECIES_GROUPS}.")
    polygon = Polygon(spec.area)
    if not polygon.is_valid:
        raise SceneError(f"The area of a {spec.age} {spec.species_group} stand crosses itself.")
    rng = np.random.default_rng([seed, 7])
    spacing = spec.spacing or _STANDS[spec.species_group, spec.age][2]
    points = _grid(polygon, spacing, rng)
    vigour = gaussian_field(points[:, 0], points[:, 1], _GAP_FIELD, rng, modes=48)
    # The gaps lie where the field is low; their share is that of the normal distribution.
    keep = vigour > np.quantile(vigour, 0.3 * spec.clumping) if len(points) else np.zeros(0, dtype=bool)
    points, vigour = points[keep], vigour[keep]
    if len(points) > 1:
        vigour = (vigour - vigour.mean()) / max(float(vigour.std()), 1e-9)
    stems = [_stem(spec, x, y, v, rng) for (x, y), v in zip(points, vigour, strict=True)]
    return _into_free_space(stems, polygon, spacing) + _understorey(spec, polygon, rng)


def plant_singles(spec: SingleTreesSpec, area: Polygon, seed: int, blocked: list[Stem]) -> list[Stem]:
    """Single trees with a least distance to each other and to the stems that stand already.

    Raises
    ------
    SceneError
        If the species group is unknown.
    """
    if spec.species_group not in SPECIES_GROUPS:
        raise SceneError(f"Species group {spec.species_group!r} is unknown: choose one of {SPECIES_GROUPS}.")
    rng = np.random.default_rng([seed, 8])
    polygon = Polygon(spec.area) if spec.area else area
    west, south, east, north = polygon.bounds
    stems: list[Stem] = []
    taken = [(stem.x, stem.y) for stem in blocked if not stem.understorey]
    for _ in range(60 * spec.number):
        if len(stems) == spec.number:
            break
        x, y = rng.uniform(west, east), rng.uniform(south, north)
        near = np.asarray(taken).reshape(-1, 2) - (x, y)
        if not shapely.contains_xy(polygon, x, y) or np.any(np.hypot(*near.T) < spec.apart):
            continue
        height = rng.uniform(*spec.height)
        crown = min(height * rng.uniform(*spec.crown_share), _LARGEST_CROWN[spec.species_group])
        taken.append((x, y))
        stems.append(Stem(x, y, spec.species_group, height, crown, crown_share=rng.uniform(0.75, 0.88)))
    return stems


@dataclass(frozen=True, eq=False)
class Crown:
    """What is known of a grown tree without its foliage."""

    outline: np.ndarray
    """(36, 2) crown seen from above, m from the foot."""
    top: tuple[float, float]
    """Where the highest clump stands, m from the foot."""
    alone_area: float
    """Area that it would show from above if it stood alone, m²."""


def grow_trees(stems: list[Stem], feet: np.ndarray, seed: int) -> tuple[Grove, list[Crown]]:
    """Grow all stems on their feet (local heights, m); foliage is kept while it fits into memory."""
    table = np.zeros((len(stems), TREE_COLUMNS), dtype=np.float32)
    crowns: list[Crown] = []
    grown: list[np.ndarray] | None = []
    total = 0
    for index, stem in enumerate(stems):
        form, rng = _grow(stem, seed, index)
        clumps = form.clumps
        leaf = LEAF_DIAMETER[stem.species_group]
        crowns.append(Crown(form.outline, form.top, lone_area(clumps, leaf)))
        table[index, :TRED] = stem.x, stem.y, feet[index], stem.height, len(clumps), leaf
        table[index, TRED:CENTRE] = _leaf_colour(stem, rng)
        table[index, CENTRE:] = _sphere(clumps)
        total += len(clumps)
        if grown is not None and fits(total):
            grown.append(clumps)
        else:
            grown = None
    return Grove(table, lambda index: _grow(stems[index], seed, index)[0].clumps, grown), crowns


def _grow(stem: Stem, seed: int, index: int) -> tuple[TreeForm, np.random.Generator]:
    """One tree, and the generator that grew it."""
    rng = np.random.default_rng([seed, 9, index])
    form = grow_tree(
        stem.species_group,
        stem.height,
        stem.crown,
        rng,
        dead=stem.dead,
        lean=stem.lean,
        crown_share=stem.crown_share,
    )
    return form, rng


def lone_area(clumps: np.ndarray, leaf: float) -> float:
    """Area, m², of a crown's particles seen from above without neighbours, from the spread of its clumps."""
    leafy = clumps[clumps[:, COUNT] > 0] if np.any(clumps[:, COUNT] > 0) else clumps
    spread = max(float(np.std(leafy[:, X])) * float(np.std(leafy[:, Y])), 0.05)
    # A uniform disc of radius r has a standard deviation of r / 2 along each axis.
    disc = np.pi * 4 * spread
    leaf_area = float(np.sum(leafy[:, COUNT])) * 0.55 * np.pi / 4 * leaf**2
    return disc * (1 - np.exp(-leaf_area / disc)) if leaf_area > 0 else 0.2 * disc


def breast_height_diameter(stem: Stem) -> float:
    """Diameter at breast height, m, from height and crown: thick stems carry wide crowns."""
    factor = 0.022 if stem.species_group == "broadleaf" else 0.030
    return round(0.006 * stem.height + factor * stem.crown, 3)


def _grid(polygon: Polygon, spacing: float, rng: np.random.Generator) -> np.ndarray:
    west, south, east, north = polygon.bounds
    rows = np.arange(south, north + spacing, spacing * np.sqrt(3) / 2)
    columns = np.arange(west, east + spacing, spacing)
    x, y = np.meshgrid(columns, rows)
    x = x + 0.5 * spacing * (np.arange(len(rows)) % 2)[:, None]
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    points += rng.normal(0, _JITTER * spacing, points.shape)
    return points[shapely.contains_xy(polygon, points[:, 0], points[:, 1])]


def _stem(spec: StandSpec, x: float, y: float, vigour: float, rng: np.random.Generator) -> Stem:
    group = spec.species_group
    (mean, spread), (crown, crown_spread), _ = _STANDS[group, spec.age]
    mean, spread = spec.height or (mean, spread)
    crown, crown_spread = spec.crown or (crown, crown_spread)
    z = 0.4 * vigour + np.sqrt(1 - 0.4**2) * rng.normal()
    other = rng.uniform() < spec.admixture
    if other:
        group = SPECIES_GROUPS[1 - SPECIES_GROUPS.index(group)]
    height = max(mean + spread * z, 0.4 * mean)
    diameter = crown + crown_spread * (0.5 * z + np.sqrt(0.75) * rng.normal())
    diameter = float(np.clip(diameter, 0.5 * crown, _LARGEST_CROWN[group]))
    lean = rng.normal(0, spec.lean * height, 2)
    return Stem(
        float(x),
        float(y),
        group,
        float(height),
        diameter,
        (float(lean[0]), float(lean[1])),
        rng.uniform() < spec.dead,
    )


def _into_free_space(stems: list[Stem], polygon: Polygon, spacing: float) -> list[Stem]:
    """Let trees lean towards the middle of the ground that is nearer to them than to their neighbours.

    Crowns grow away from their neighbours, so that they stand more evenly than their stems. Broadleaf
    trees do so far more than conifers, which grow upright.
    """
    if len(stems) < 3:
        return stems
    places = np.array([(stem.x, stem.y) for stem in stems])
    ground = polygon.buffer(0.5 * spacing)
    cells = shapely.voronoi_polygons(shapely.MultiPoint(places), extend_to=ground, ordered=True)
    free = shapely.intersection(shapely.get_parts(cells), ground)
    shift = shapely.get_coordinates(shapely.centroid(free)) - places
    shift *= np.minimum(1, _LARGEST_SHIFT * spacing / np.maximum(np.hypot(*shift.T), 1e-9))[:, None]
    shift *= np.array([_PLASTICITY[stem.species_group] for stem in stems])[:, None]
    return [
        replace(stem, lean=(stem.lean[0] + float(x), stem.lean[1] + float(y)))
        for stem, (x, y) in zip(stems, shift, strict=True)
    ]


def _understorey(spec: StandSpec, polygon: Polygon, rng: np.random.Generator) -> list[Stem]:
    mean = (spec.height or _STANDS[spec.species_group, spec.age][0])[0]
    number = rng.poisson(spec.understorey * polygon.area / 10_000)
    west, south, east, north = polygon.bounds
    points = np.stack([rng.uniform(west, east, number), rng.uniform(south, north, number)], axis=1)
    top = min(_UNDERSTOREY_HEIGHT[1], 0.35 * mean)
    stems = []
    for x, y in points[shapely.contains_xy(polygon, points[:, 0], points[:, 1])]:
        height = float(rng.uniform(_UNDERSTOREY_HEIGHT[0], max(top, 1.5)))
        stems.append(
            Stem(float(x), float(y), "broadleaf", height, 0.8 * height, understorey=True, crown_share=0.85)
        )
    return stems


def _leaf_colour(stem: Stem, rng: np.random.Generator) -> np.ndarray:
    kinds = _LEAVES[stem.species_group]
    base = kinds[rng.choice(len(kinds), p=[0.5, 0.3, 0.2] if len(kinds) == 3 else [0.75, 0.25])]
    if stem.understorey:
        base = _LEAVES["broadleaf"][2] * 0.95
    brightness = np.exp(rng.normal(0, 0.13))
    # Yellower trees are brighter in red, bluer ones darker; the infrared varies for itself.
    hue = rng.normal(0, 0.10)
    return base * brightness * np.array([np.exp(hue), 1.0, np.exp(-0.4 * hue), np.exp(rng.normal(0, 0.06))])


def _sphere(clumps: np.ndarray) -> tuple[float, float]:
    """Height of the centre and radius of a sphere around the stem that holds all clumps."""
    size = np.max(clumps[:, [RA, RB, RC]], axis=1)
    low, high = np.min(clumps[:, Z] - size), np.max(clumps[:, Z] + size)
    centre = (low + high) / 2
    away = np.sqrt(clumps[:, X] ** 2 + clumps[:, Y] ** 2 + (clumps[:, Z] - centre) ** 2)
    return float(centre), float(np.max(away + size))
