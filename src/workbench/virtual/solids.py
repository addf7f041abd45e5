"""Hard bodies (buildings, cars, boulders) as convex polyhedra, hit exactly by rays.

A body is the set of points with ``nx x + ny y + nz z <= d`` for each of its planes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from workbench.virtual.compiled import inner

WALL, ROOF_TILES, ROOF_FLAT, STONE, PAINT, GLASS = range(6)


class Solids(NamedTuple):
    """All hard bodies of a scene."""

    planes: np.ndarray
    """(p, 4) float64: outward unit normal and distance, local frame."""
    first: np.ndarray
    """(n + 1,) int64: row of the first plane of each body."""
    bounds: np.ndarray
    """(n, 6) float64: smallest and largest x, y, z."""
    colour: np.ndarray
    """(n, 2, 4) float32: red, green, blue, nir of upward faces and of the others."""
    cover: np.ndarray
    """(n,) uint8 land cover code."""
    surface: np.ndarray
    """(n,) int64: kind of surface of the upward faces (``WALL`` ... ``GLASS``)."""


def empty_solids() -> Solids:
    """No body at all."""
    return Solids(
        np.zeros((0, 4)),
        np.zeros(1, dtype=np.int64),
        np.zeros((0, 6)),
        np.zeros((0, 2, 4), dtype=np.float32),
        np.zeros(0, dtype=np.uint8),
        np.zeros(0, dtype=np.int64),
    )


@inner
def hit_solid(solids, body, ox, oy, oz, dx, dy, dz):
    """Where the line ``o + t d`` enters and leaves a body: t of both and the row of the plane entered.

    Entry is larger than exit where the line misses.
    """
    enter, leave, plane = -1e30, 1e30, -1
    for k in range(solids.first[body], solids.first[body + 1]):
        nx, ny, nz, d = solids.planes[k, 0], solids.planes[k, 1], solids.planes[k, 2], solids.planes[k, 3]
        speed = nx * dx + ny * dy + nz * dz
        room = d - (nx * ox + ny * oy + nz * oz)
        if speed < -1e-12:
            t = room / speed
            if t > enter:
                enter, plane = t, k
        elif speed > 1e-12:
            t = room / speed
            if t < leave:
                leave = t
        elif room < 0:
            return 1e30, -1e30, -1
    return enter, leave, plane
