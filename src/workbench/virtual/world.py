"""A scene in the form that compiled loops read: tables and rasters in a local frame of metres.

Rasters of the ground have their samples at cell corners and rows that run north; bilinear values between
the samples are the truth.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from workbench.virtual.particles import Plants, ReedFields
from workbench.virtual.solids import Solids


class Cover(IntEnum):
    """Land cover codes of a rendered pixel and of the truth."""

    NOTHING = 0
    WATER = 1
    REED = 2
    MEADOW = 3
    BROADLEAF = 4
    CONIFER = 5
    FOREST_FLOOR = 6
    PATH = 7
    ROAD = 8
    BUILDING = 9
    SHORE = 10
    BOULDER = 11
    CAR = 12
    TARGET = 13
    DEAD_TREE = 14


class Terrain(NamedTuple):
    """Height of land and lake bed."""

    height: np.ndarray
    """(rows, columns) float32, m, local."""
    west: np.float32
    """x of the first column, m."""
    south: np.float32
    """y of the first row, m."""
    step: np.float32
    """Spacing, m."""


class Ground(NamedTuple):
    """What lies on the terrain, on the raster of the terrain."""

    floor: np.ndarray
    """Weight of forest floor, 0 meadow .. 1 below a closed canopy."""
    road: np.ndarray
    """Distance to the edge of the nearest road, m, negative on it."""
    path: np.ndarray
    """Distance to the edge of the nearest path, m, negative on it."""
    canopy: np.ndarray
    """Smoothed height of the canopy above the terrain, m."""
    closure: np.ndarray
    """Smoothed share of the ground below crowns and reed, 0..1."""


class World(NamedTuple):
    """Everything that a ray of light can meet."""

    terrain: Terrain
    """Land and lake bed."""
    ground: Ground
    """Surfaces."""
    plants: Plants
    """Trees."""
    tree_cover: np.ndarray
    """(n,) uint8 land cover code of each tree."""
    reed: ReedFields
    """Reed."""
    solids: Solids
    """Buildings, cars, boulders."""
    targets: np.ndarray
    """(n, 5) float64: x, y, edge length (m), direction (degrees), 0 for four quadrants or 1 for a letter."""
    water_level: float
    """Height of the lake, m, local; far below the terrain without a lake."""
