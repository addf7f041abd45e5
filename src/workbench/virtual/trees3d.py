"""A single tree: from species group, height and crown diameter to clumps of foliage, trunk and branches.

The outline follows the generalised ellipsoid of Pollock (thesis 2.4.1): with ``t`` the height within
the crown (0 base, 1 top) the radius is ``R (1 - t^n)^(1/n)``; n = 1.2 for conifers (whorls of branches
around a straight stem), n = 2 for broadleaf trees (lobes with secondary tops, lopsided). Within the
outline the foliage is porous: each clump is an ellipsoid that the renderer fills with leaves from
hashes, so that light, wind and sight go through it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from workbench.errors import SceneError

# Columns of a clump. Frame: axis (DX, DY, DZ) is the long axis of the ellipsoid, RA its half length,
# RB across (horizontal), RC upright; COUNT leaves of full size; SHADE a brightness; AO the share of
# the sky that is seen; KIND is one of BALL, SPRAY, LINE.
X, Y, Z, DX, DY, DZ, RA, RB, RC, COUNT, SHADE, AO, KIND = range(13)
CLUMP_COLUMNS = 13
BALL, SPRAY, LINE = 0.0, 1.0, 2.0

SPECIES_GROUPS = ("broadleaf", "conifer")
CROWN_SHAPE = {"broadleaf": 2.0, "conifer": 1.2}
"""n of the crown model, typical values of thesis table 2.2."""
LEAF_DIAMETER = {"broadleaf": 0.06, "conifer": 0.05}
"""Diameter of a disc of foliage, metres: a leaf with its neighbours, a tuft of needles (3-9 cm)."""
LEAF_AREA_INDEX = {"broadleaf": 5.0, "conifer": 4.5}
"""One-sided leaf area over crown area: beech stands have 5 to 6, stands of pine 2.5 to 4, of spruce 5 to 8.

With half of it a line of sight ends 3 m below the outermost leaves of a conifer, and ground shows through
single crowns.
"""
_BRANCHES = 40
"""Main branches of a broadleaf crown: small crowns have shorter ones, not fewer (while clumps last)."""
_CLUMPS_A_BRANCH = 2, 6
_BRANCH_SPREAD = 0.2  # Of the clumps of a branch around it, in radii of the lobe.


@dataclass(frozen=True, eq=False)
class TreeForm:
    """What one tree is made of, relative to the foot of its stem."""

    clumps: np.ndarray
    """(n, 13) float32, metres, columns as named at the top of this module, from the top downwards."""
    outline: np.ndarray
    """(36, 2) crown seen from above, metres, counter-clockwise from east every 10 degrees."""
    top: tuple[float, float]
    """Where the highest clump stands, x and y, metres."""


def grow_tree(
    species_group: str,
    height: float,
    crown_diameter: float,
    generator: np.random.Generator,
    *,
    dead: bool = False,
    lean: tuple[float, float] = (0.0, 0.0),
    crown_share: float | None = None,
) -> TreeForm:
    """Build one tree.

    Parameters
    ----------
    species_group
        ``"broadleaf"`` or ``"conifer"``.
    height, crown_diameter
        Metres.
    generator
        Source of everything that is individual.
    dead
        Without leaves: a stem with bare branches.
    lean
        Horizontal offset of the top against the foot, x and y, metres.
    crown_share
        Length of the crown over height, 0..1; by default 0.65 (broadleaf) or 0.6 (conifer).

    Raises
    ------
    SceneError
        If the species group is unknown or a size is not positive.
    """
    if species_group not in SPECIES_GROUPS:
        raise SceneError(f"Species group {species_group!r} is unknown: choose one of {SPECIES_GROUPS}.")
    if not min(height, crown_diameter) > 0:
        raise SceneError(
            f"A tree of {height} m with a crown of {crown_diameter} m is impossible: both must be positive."
        )
    radius = crown_diameter / 2
    if species_group == "conifer":
        share = 0.6 if crown_share is None else crown_share
        foliage = _whorls(height, radius, share, generator)
    else:
        share = 0.65 if crown_share is None else crown_share
        foliage = _lobes(height, radius, share, generator)
    _fit_width(foliage, radius)
    wood = _wood(height, radius, share, foliage, generator, bare=dead)
    if dead:
        foliage = foliage[:0]
    clumps = np.concatenate([foliage, wood])
    bend = np.clip(clumps[:, Z] / height, 0, 1) ** 1.5
    clumps[:, X] += lean[0] * bend
    clumps[:, Y] += lean[1] * bend
    clumps = clumps[np.argsort(-clumps[:, Z], kind="stable")].astype(np.float32)
    return TreeForm(clumps, crown_outline(clumps), (float(clumps[0, X]), float(clumps[0, Y])))


def crown_outline(clumps: np.ndarray, directions: int = 36) -> np.ndarray:
    """Farthest reach (directions, 2) of clumps around the stem, every 10 degrees, at least 5 cm."""
    angles = np.arange(directions) * 2 * np.pi / directions
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    leafy = clumps[clumps[:, KIND] != LINE] if np.any(clumps[:, KIND] != LINE) else clumps
    centre = leafy[:, :2].mean(axis=0)
    offsets = leafy[:, :2] - centre
    flat = np.hypot(leafy[:, DX], leafy[:, DY]) * leafy[:, RA]
    radii = 0.9 * np.maximum((flat + leafy[:, RB]) / 2, leafy[:, RB])
    along = offsets @ unit.T
    across = offsets[:, :1] * unit[:, 1] - offsets[:, 1:] * unit[:, 0]
    room = radii[:, None] ** 2 - across**2
    reach = np.where(room > 0, along + np.sqrt(np.maximum(room, 0)), 0.05).max(axis=0)
    return centre + np.maximum(reach, 0.05)[:, None] * unit


def crown_radius(t: Any, radius: float, shape: float) -> Any:
    """Radius of the crown model at height ``t`` (0 base .. 1 top) within the crown, metres."""
    return radius * (1 - np.clip(t, 0, 1) ** shape) ** (1 / shape)


def _lobes(height: float, radius: float, share: float, rng: np.random.Generator) -> np.ndarray:
    """Broadleaf crown: a main dome and secondary lobes, each clothed with clumps of leaves."""
    depth = share * height
    lobes = 1 + rng.poisson(2.0 + 0.7 * radius)
    turn = rng.uniform(0, 2 * np.pi)
    out = np.sqrt(rng.uniform(0.15, 0.75, lobes)) * radius * 0.8
    angle = turn + np.arange(lobes) * 2.4 + rng.normal(0, 0.3, lobes)
    lopsided = rng.normal(0, 0.08 * radius, 2)
    centre_x = out * np.cos(angle) + lopsided[0]
    centre_y = out * np.sin(angle) + lopsided[1]
    centre_x[0], centre_y[0] = lopsided
    size = np.maximum(radius - out * 0.85, 0.35 * radius) * rng.uniform(0.8, 1.1, lobes)
    size[0] = 0.72 * radius
    dome = crown_radius(out / radius, 1.0, CROWN_SHAPE["broadleaf"])
    top = height - 0.55 * depth * (1 - dome) - np.abs(rng.normal(0, 0.07, lobes)) * depth
    top[0] = height
    tall = np.minimum(size * rng.uniform(0.9, 1.3, lobes), 0.5 * depth)
    weights = size**2 / np.sum(size**2)
    number = int(np.clip(14 * (2 * radius) ** 1.25, 12, 420))
    clump = np.clip(0.30 * radius**0.45, 0.16, 0.75) * rng.uniform(0.7, 1.3, number)
    # Clumps sit in groups on branches; between branches light falls deep into the crown.
    branches = max(number // int(np.clip(number // _BRANCHES, *_CLUMPS_A_BRANCH)), 3)
    branch = np.arange(number) % branches
    which = rng.choice(lobes, branches, p=weights)[branch]
    up = rng.uniform(-0.35, 1.0, branches)[branch] + rng.normal(0, _BRANCH_SPREAD, number)
    up = np.where(up > 1, 2 - up, up)
    around = rng.uniform(0, 2 * np.pi, branches)[branch]
    around = around + rng.normal(0, _BRANCH_SPREAD, number) / np.sqrt(np.maximum(1 - up**2, 0.1))
    shell = rng.uniform(0.55, 1.0, branches)[branch] ** 0.5 * rng.uniform(0.85, 1.05, number)
    level = np.sqrt(np.maximum(1 - up**2, 0))
    rows = np.zeros((number, CLUMP_COLUMNS))
    reach = np.maximum(size[which] - clump, 0.3 * size[which])
    rows[:, X] = centre_x[which] + shell * reach * level * np.cos(around)
    rows[:, Y] = centre_y[which] + shell * reach * level * np.sin(around)
    rows[:, Z] = top[which] - tall[which] * (1 - shell * up) - 0.6 * clump
    lift = rng.uniform(-0.1, 0.5, number)
    rows[:, DX], rows[:, DY], rows[:, DZ] = _unit(np.cos(around), np.sin(around), lift)
    rows[:, RA] = clump * rng.uniform(0.9, 1.5, number)
    rows[:, RB], rows[:, RC] = clump, clump * rng.uniform(0.45, 0.75, number)
    rows[:, KIND] = BALL
    _share_leaves(rows, radius, "broadleaf")
    sunk = np.clip((height - rows[:, Z]) / depth, 0, 1)
    rows[:, AO] = np.clip(1.05 - 0.65 * sunk - 0.45 * (1 - shell), 0.15, 1)
    rows[:, SHADE] = np.exp(rng.normal(0, 0.10, number))
    return _fit_top(rows, height)


def _whorls(height: float, radius: float, share: float, rng: np.random.Generator) -> np.ndarray:
    """Conifer crown: whorls of flat branches, rising near the top and drooping below."""
    depth = share * height
    spacing = rng.uniform(0.38, 0.55)
    levels = np.arange(0.25, depth, spacing)
    rows = []
    turn = rng.uniform(0, 2 * np.pi)
    skew = rng.uniform(0, 2 * np.pi)
    for below in levels:
        t = 1 - below / depth
        reach = max(crown_radius(t, radius, CROWN_SHAPE["conifer"]), 0.12)
        branches = int(rng.integers(5, 8))
        turn += rng.uniform(0.3, 1.0)
        angle = turn + (np.arange(branches) + rng.normal(0, 0.13, branches)) * 2 * np.pi / branches
        length = reach * rng.uniform(0.72, 1.12, branches) * (1 + 0.12 * np.cos(angle - skew))
        slope = 0.55 * t**2 - 0.35 * (1 - t) + rng.normal(0, 0.07, branches)
        row = np.zeros((branches, CLUMP_COLUMNS))
        row[:, DX], row[:, DY], row[:, DZ] = _unit(np.cos(angle), np.sin(angle), slope)
        row[:, RA] = 0.5 * length
        row[:, X] = 0.52 * length * np.cos(angle)
        row[:, Y] = 0.52 * length * np.sin(angle)
        row[:, Z] = height - below + 0.52 * length * slope - rng.uniform(0, 0.15, branches)
        row[:, RB] = np.clip(0.30 * length, 0.07, 0.45)
        row[:, RC] = np.clip(0.10 * length, 0.04, 0.16)
        row[:, AO] = np.clip(0.95 - 0.8 * (1 - t), 0.15, 1)
        row[:, SHADE] = np.exp(rng.normal(0, 0.10, branches))
        rows.append(row)
    spike = np.zeros((1, CLUMP_COLUMNS))
    spike[0, [Z, DX, DY, DZ, RA, RB, RC, SHADE, AO]] = height - 0.3, 0.02, 0.0, 1.0, 0.3, 0.07, 0.07, 1.1, 1
    clumps = np.concatenate([spike, *rows])
    clumps[:, KIND] = SPRAY
    _share_leaves(clumps, radius, "conifer")
    return _fit_top(clumps, height)


def _wood(
    height: float,
    radius: float,
    share: float,
    foliage: np.ndarray,
    rng: np.random.Generator,
    *,
    bare: bool,
) -> np.ndarray:
    """Trunk and main branches as lines; a bare tree shows more of them, and thinner ones."""
    thick = 0.007 * height + 0.01
    stem_top = height * (0.96 if bare else 1 - 0.35 * share)
    pieces = [(np.zeros(3), np.array([0.0, 0.0, stem_top]), thick)]
    if len(foliage):
        number = min(len(foliage), 34 if bare else 14)
        for tip in foliage[rng.choice(len(foliage), number, replace=False)]:
            end = tip[:3].astype(float)
            rise = np.hypot(end[0], end[1]) * rng.uniform(0.5, 1.1)
            foot = np.array([0.0, 0.0, np.clip(end[2] - rise, 0.25 * height, stem_top)])
            # Branches bend: up first, then outwards.
            elbow = (foot + end) / 2 + [0, 0, 0.12 * rise] + rng.normal(0, 0.08 * rise, 3)
            width = thick * rng.uniform(0.18, 0.4)
            pieces += [(foot, elbow, width), (elbow, end, 0.6 * width)]
    rows = np.zeros((len(pieces), CLUMP_COLUMNS))
    for row, (foot, end, half_width) in zip(rows, pieces, strict=True):
        axis = end - foot
        length = max(float(np.linalg.norm(axis)), 1e-3)
        row[:3] = (foot + end) / 2
        row[[DX, DY, DZ]] = axis / length
        row[[RA, RB, RC, SHADE, KIND]] = length / 2, half_width, half_width, rng.uniform(0.7, 1.2), LINE
        row[AO] = 0.9 if bare else 0.45
    return rows


def _share_leaves(rows: np.ndarray, radius: float, species_group: str) -> None:
    """Spread the leaf area of a crown over its clumps by their size seen from above."""
    leaves = LEAF_AREA_INDEX[species_group] * radius**2 / (LEAF_DIAMETER[species_group] / 2) ** 2
    weights = rows[:, RA] * rows[:, RB]
    rows[:, COUNT] = leaves * weights / weights.sum()


def _fit_top(rows: np.ndarray, height: float) -> np.ndarray:
    """Shift a crown upright so that its highest clump ends at the height asked for."""
    rise = np.abs(rows[:, DZ]) * rows[:, RA] + np.sqrt(1 - rows[:, DZ] ** 2) * rows[:, RC]
    rows[:, Z] += height - np.max(rows[:, Z] + rise)
    return rows


def _fit_width(rows: np.ndarray, radius: float) -> None:
    """Stretch a crown so that its area seen from above is that of the circle asked for."""
    for _ in range(3):
        x, y = crown_outline(rows).T
        area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
        rows[:, [X, Y]] *= np.clip(np.sqrt(np.pi * radius**2 / area), 0.7, 1.6)


def _unit(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    length = np.sqrt(x**2 + y**2 + z**2)
    return x / length, y / length, z / length
