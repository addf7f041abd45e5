"""Foliage as particles: where every leaf of a clump and of a reed stem is, without storing it.

Compiled code of this module is shared by the photograph, the shadow map and the truth: all three see the
same leaves. Coordinates are metres in the scene's local frame (x east, y north, z up).

Level of detail: a sample (subpixel, cell of a map) of edge ``s`` sees a leaf of diameter ``d`` as a disc
if ``d >= 1.6 s``. Smaller leaves are replaced by fewer particles of one sample each that cover the same
area, so that porosity does not depend on the ground sampling distance.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from workbench.virtual.compiled import inner, kernel
from workbench.virtual.noise import bilinear, hash2, hash3, mix, uniform
from workbench.virtual.trees3d import (
    COUNT,
    DX,
    DY,
    DZ,
    KIND,
    LINE,
    RA,
    RB,
    RC,
    SPRAY,
)

# Columns of the table of trees: foot, height, number of its clumps, leaf diameter, leaf colour, and a
# sphere (height of its centre above the foot, radius) that holds the tree in calm air.
TX, TY, TZ, TH, CLUMPS, LEAF, TRED, TGREEN, TBLUE, TNIR, CENTRE, REACH = range(12)
TREE_COLUMNS = 12
LIBRARY = 4096
_MEAN_FACING = 0.63
"""Mean width of a leaf of the library, seen from above, over its length; 0.9 for reed blades."""
_SMALLEST_DISC = 1.6
_STEM_AREA = 0.085
_STEM_LEAF = 0.025
_LEAVES_PER_STEM = 11
REED_CELL = 0.25
"""Edge of a cell whose reed stems share a hash, m."""


class Leaves(NamedTuple):
    """A library of leaves in a ball of radius 1; a clump takes a run of it, stretched and turned."""

    position: np.ndarray
    """(LIBRARY, 3) float32, denser towards the shell."""
    normal: np.ndarray
    """(LIBRARY, 3) float32 unit vectors, upward and outward with scatter."""
    bright: np.ndarray
    """(LIBRARY,) float32, around 1."""


class Plants(NamedTuple):
    """All trees of a scene, with the clumps of some or all of them."""

    trees: np.ndarray
    """(n, 12) float32, columns as named at the top of this module."""
    clumps: np.ndarray
    """(m, 13) float32, columns of :mod:`workbench.virtual.trees3d`, relative to the foot of the tree."""
    first: np.ndarray
    """(n,) int64, number of a tree's first clump among the clumps of all trees: the key of its hashes."""
    row: np.ndarray
    """(n,) int64, row in ``clumps`` where those of a tree begin; -1 where they are not at hand."""
    leaves: Leaves
    """The library."""


class ReedFields(NamedTuple):
    """Reed as fields on a raster whose rows run north; stems follow from hashes."""

    density: np.ndarray
    """(rows, columns) float32, stems per square metre, 0 without reed."""
    height: np.ndarray
    """(rows, columns) float32, mean height of stem tops above the water level or, ashore, the ground, m."""
    green: np.ndarray
    """(rows, columns) float32, share of green stems, 0..1."""
    foot: np.ndarray
    """(rows, columns) float32, height of the surface that the stems rise from, m, local."""
    west: np.float32
    """x of the left edge of the first column, m."""
    south: np.float32
    """y of the lower edge of the first row, m."""
    step: np.float32
    """Edge of a cell of the raster, m; stems are drawn cell by cell."""
    seed: np.uint64
    """Seed of the stems."""


@functools.cache
def leaf_library() -> Leaves:
    """The library of leaves. Always the same."""
    rng = np.random.default_rng(4096)
    direction = rng.normal(size=(LIBRARY, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position = direction * rng.uniform(0.05, 1, (LIBRARY, 1)) ** 0.42
    normal = 0.55 * direction + 0.6 * rng.normal(size=(LIBRARY, 3)) + [0, 0, 0.75]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    bright = np.exp(rng.normal(0, 0.16, LIBRARY))
    return Leaves(position.astype(np.float32), normal.astype(np.float32), bright.astype(np.float32))


@inner
def leaf_detail(count, diameter, sample_edge, h):
    """Number of particles for leaves of one size, and their diameter (0: one sample each)."""
    if diameter >= np.float32(_SMALLEST_DISC) * sample_edge:
        wanted, size = count, diameter
    else:
        area = np.float32(_MEAN_FACING * math.pi / 4) * diameter * diameter
        wanted, size = count * area / (sample_edge * sample_edge), np.float32(0)
    return int(wanted + uniform(h)), size


@inner
def line_detail(length, width, sample_edge, h):
    """The same for a stem or branch."""
    if width >= np.float32(1.3) * sample_edge:
        # Discs overlap so far that the edge is smooth at the size of a sample.
        apart = np.float32(0.8) if width < np.float32(8) * sample_edge else np.float32(0.25)
        return int(length / (apart * width)) + 1, width
    return int(length * width / (sample_edge * sample_edge) + uniform(h)), np.float32(0)


@inner
def clump_frame(clump):
    """Second and third axis of a clump: horizontal across, and upright."""
    flat = math.sqrt(clump[DX] * clump[DX] + clump[DY] * clump[DY])
    if flat > np.float32(1e-4):
        bx, by = np.float32(-clump[DY] / flat), np.float32(clump[DX] / flat)
    else:
        bx, by = np.float32(1), np.float32(0)
    cx = -clump[DZ] * by
    cy = clump[DZ] * bx
    cz = clump[DX] * by - clump[DY] * bx
    return bx, by, cx, cy, cz


@inner
def clump_particles(clump, index, leaf_diameter, sample_edge, deep):
    """Number and diameter of the particles of a clump at a level of detail.

    Deep within the canopy small leaves are replaced by blocks of 2 x 2 samples (diameter -1).
    """
    h = hash2(np.uint64(index), np.uint64(5))
    if deep and clump[KIND] != np.float32(LINE):
        number, size = leaf_detail(clump[COUNT], leaf_diameter, np.float32(2) * sample_edge, h)
        return number, size if size > 0 else np.float32(-1)
    if clump[KIND] == np.float32(LINE):
        return line_detail(np.float32(2) * clump[RA], np.float32(2) * clump[RB], sample_edge, h)
    return leaf_detail(clump[COUNT], leaf_diameter, sample_edge, h)


@inner
def clump_leaf(clump, frame, leaves, start, i, number):
    """Offset of particle ``i`` from the centre of its clump, and its row in the library."""
    a, b, c, row = leaf_in_clump(clump, leaves, start, i, number)
    x, y, z = clump_offset(clump, frame, a, b, c)
    return x, y, z, row


@inner
def leaf_in_clump(clump, leaves, start, i, number):
    """Place of particle ``i`` on the three axes of its clump, m, and its row in the library."""
    row = (start + i) & (LIBRARY - 1)
    if clump[KIND] == np.float32(LINE):
        a = clump[RA] * (np.float32(2) * (np.float32(i) + np.float32(0.5)) / np.float32(number) - 1)
        return np.float32(a), np.float32(0), np.float32(0), row
    a = leaves.position[row, 0]
    taper = np.float32(1)
    if clump[KIND] == np.float32(SPRAY):
        taper = np.float32(1.05) - np.float32(0.55) * (a + np.float32(1)) * np.float32(0.75)
    b = leaves.position[row, 1] * clump[RB] * taper
    c = leaves.position[row, 2] * clump[RC] * taper
    return np.float32(a * clump[RA]), np.float32(b), np.float32(c), row


@inner
def clump_offset(clump, frame, a, b, c):
    """Offset, m, of a place on the axes of a clump from its centre: east, north, up."""
    bx, by, cx, cy, cz = frame
    x = clump[DX] * a + bx * b + cx * c
    y = clump[DY] * a + by * b + cy * c
    z = clump[DZ] * a + cz * c
    return x, y, z


@inner
def jitter(field, key, i):
    """Displacement of one leaf by the wind, m, and the change of its brightness, a share.

    ``key`` is a hash of the clump or stem and of the exposure.
    """
    h = mix(key + np.uint64(i) * np.uint64(0x9E3779B1))
    tenth = np.float32(1 / 65535)
    u = np.float32(h & np.uint64(0xFFFF)) * tenth - np.float32(0.5)
    v = np.float32(h >> np.uint64(16)) * tenth - np.float32(0.5)
    two = np.float32(2)
    return two * field.leaf * u, two * field.leaf * v, field.flutter * (u + v)


@inner
def stems_in_cell(reed, row, column):
    """Number of stems in a cell of the reed raster: a Poisson number from its hash."""
    expected = reed.density[row, column] * reed.step * reed.step
    if expected <= 0:
        return 0
    h = hash3(reed.seed, np.uint64(row), np.uint64(column))
    limit = math.exp(-expected)
    product = uniform(h)
    number = 0
    while product > limit and number < 200:
        number += 1
        h = hash2(h, np.uint64(number))
        product *= max(uniform(h), np.float32(1e-7))
    return number


@inner
def stem(reed, row, column, i):
    """One stem: x, y, foot, height above the foot (m), green (bool), its hash."""
    h = hash2(hash3(reed.seed, np.uint64(row), np.uint64(column)), np.uint64(1000 + i))
    x = reed.west + (np.float32(column) + uniform(h)) * reed.step
    h2 = hash2(h, np.uint64(1))
    y = reed.south + (np.float32(row) + uniform(h2)) * reed.step
    h3 = hash2(h, np.uint64(2))
    h4 = hash2(h, np.uint64(3))
    # The sum of three uniform numbers has a standard deviation of one half: 9 % of the height.
    spread = uniform(h3) + uniform(h4) + uniform(hash2(h, np.uint64(4))) - np.float32(1.5)
    tall = np.float32(reed.height[row, column] * (1 + np.float32(0.18) * spread))
    green = uniform(hash2(h, np.uint64(5))) < reed.green[row, column]
    return x, y, np.float32(reed.foot[row, column]), tall, green, h


@inner
def stem_detail(tall, sample_edge, h):
    """Number and diameter of the particles of one stem."""
    area = np.float32(_STEM_AREA) * tall / np.float32(2.5)
    count = area / np.float32(_MEAN_FACING * math.pi / 4 * _STEM_LEAF**2)
    return leaf_detail(count, np.float32(_STEM_LEAF), sample_edge, h)


@inner
def stem_leaf(h, tall, i, number):
    """Offset of particle ``i`` of a stem from its foot, its normal, and its height share 0..1.

    Every sixteenth particle belongs to the panicle at the top, another one to the stem itself, the rest
    to blades that rise, bend over and hang, one above the other around the stem.
    """
    turn = np.float32(6.2832) * uniform(h)
    k = hash2(h, np.uint64(50 + i))
    u = uniform(k)
    part = i & 15
    zero = np.float32(0)
    if i == 0:
        return zero, zero, tall, zero, zero, np.float32(1), np.float32(1), 1
    if part == 0:
        down = np.float32(0.25) * u * u
        lean = np.float32(0.10) * u
        x, y = lean * math.cos(turn), lean * math.sin(turn)
        return np.float32(x), np.float32(y), tall - down, zero, zero, np.float32(1), np.float32(1), 1
    if part == 1:
        share = np.float32(1) - np.float32(0.95) * u
        return zero, zero, share * tall, zero, zero, np.float32(1), share, 2
    blade = (i * 7 + int(u * np.float32(2.0))) % _LEAVES_PER_STEM
    t = uniform(hash2(k, np.uint64(1)))
    share = np.float32(0.22) + np.float32(0.74) * np.float32(blade + 1) / np.float32(_LEAVES_PER_STEM)
    angle = turn + np.float32(2.4) * np.float32(blade)
    reach = np.float32(0.32) * t
    rise = np.float32(0.16) * t - np.float32(0.24) * t * t
    c, s = np.float32(math.cos(angle)), np.float32(math.sin(angle))
    slope = np.float32(0.5) - np.float32(1.5) * t
    length = np.float32(1) / np.float32(math.sqrt(1 + slope * slope))
    z = min(share * tall + rise, tall)
    return reach * c, reach * s, z, -slope * c * length, -slope * s * length, length, share, 0


@kernel
def _stem_table(reed, row0, row1, column0, column1):
    number = 0
    for row in range(row0, row1):
        for column in range(column0, column1):
            number += stems_in_cell(reed, row, column)
    table = np.empty((number, 5))
    k = 0
    for row in range(row0, row1):
        for column in range(column0, column1):
            for i in range(stems_in_cell(reed, row, column)):
                x, y, foot, tall, green, _ = stem(reed, row, column, i)
                table[k, 0], table[k, 1], table[k, 2] = x, y, foot
                table[k, 3], table[k, 4] = tall, green
                k += 1
    return table


def stem_table(reed: ReedFields, bounds: tuple[float, float, float, float]) -> np.ndarray:
    """Stems within (west, south, east, north), local metres: (n, 5) x, y, foot, height above it, green."""
    west, south, east, north = bounds
    rows, columns = reed.density.shape
    row0 = int(np.clip((south - reed.south) // reed.step, 0, rows))
    row1 = int(np.clip((north - reed.south) // reed.step + 1, 0, rows))
    column0 = int(np.clip((west - reed.west) // reed.step, 0, columns))
    column1 = int(np.clip((east - reed.west) // reed.step + 1, 0, columns))
    table = _stem_table(reed, row0, max(row1, row0), column0, max(column1, column0))
    inside = (table[:, 0] >= west) & (table[:, 0] < east) & (table[:, 1] >= south) & (table[:, 1] < north)
    return table[inside]


@inner
def ground_height(terrain, x, y):
    """Height of the terrain, m: bilinear between samples at cell corners."""
    column = (x - terrain.west) / terrain.step
    row = (y - terrain.south) / terrain.step
    return bilinear(terrain.height, np.float32(column), np.float32(row))
