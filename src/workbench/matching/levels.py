"""Downscales, heights and extent: what a block needs to be matched from coarse to fine."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from workbench.errors import MatchingError
from workbench.matching.rectify import Rectification
from workbench.orientation import Block
from workbench.params import MatchParameters

_FINE, _TARGET, _COARSEST = 0.05, 0.15, 0.20


def choose_downscales(ground_resolution: float) -> tuple[int, ...]:
    """Factors by which photographs of a ground resolution (metres) are reduced.

    From 5 cm on they are those of the thesis, 1, 2, 3 [4.2.1]. Finer photographs are reduced as far as
    stays within 5 cm, then double up to 15 cm and end at 20 cm, the coarsest that the thesis finds
    best for trees [5.1]: a drone at 1.6 cm gets 3, 6, 12. Single leaves and blades, which move between
    exposures, are no surface, and a pixel of a colour sensor measures one colour of three: the rest is
    interpolated, then compressed. On photographs of a drone the finer list is the worse one, on
    virtual ones, where nothing of this happens, it is better by millimetres (docs/surface.md).

    Raises
    ------
    MatchingError
        If the ground resolution is not positive.
    """
    if not ground_resolution > 0:
        raise MatchingError("The photographs lie below the ground: check the vertical datum of positions.")
    if ground_resolution >= _FINE:
        return 1, 2, 3
    factors = [max(math.floor(_FINE / ground_resolution), 1)]
    while factors[-1] * 2 * ground_resolution <= _TARGET:
        factors.append(factors[-1] * 2)
    last = math.floor(_COARSEST / ground_resolution)
    if last > factors[-1]:
        factors.append(last)
    return tuple(factors)


def ground_height(block: Block) -> float:
    """Median height of the tie points, metres.

    Raises
    ------
    MatchingError
        If the block has no tie points.
    """
    if not len(block.tie_points):
        raise MatchingError("The block has no tie points: orient it again.")
    return float(np.median(block.tie_points[:, 2]))


def search_heights(block: Block, parameters: MatchParameters) -> tuple[float, float]:
    """Lowest and highest height to search, metres: tie points widened, generously upwards.

    Tie points miss trees. Where cameras fly low the widening ends at 70 % of the flying height:
    nearer to the camera no two photographs overlap.
    """
    z = block.tie_points[:, 2]
    low, high = np.percentile(z, [0.5, 99.5])
    stations = np.array([photograph.pose.centre[2] for photograph in block])
    room = 0.7 * (float(np.median(stations)) - ground_height(block))
    top = min(max(high, ground_height(block) + min(parameters.height_margin_up, room)), stations.min() - 1)
    return float(low - parameters.height_margin_down), float(top)


def common_extent(
    rectifications: Sequence[Rectification], ground: float
) -> tuple[float, float, float, float]:
    """West, south, east, north of what any pair sees at a ground height."""
    corners = []
    for r in rectifications:
        rows, columns = r.shape
        plane = np.array([[0, 0, 1], [columns, 0, 1], [0, rows, 1], [columns, rows, 1]], float)
        plane[:, :2] = (plane[:, :2] - r.principal) / r.focal
        rays = plane @ r.rotation
        reach = (ground - r.centre[2]) / np.minimum(rays[:, 2], -0.05)
        corners.append(r.centre[:2] + rays[:, :2] * reach[:, None])
    every = np.concatenate(corners)
    west, south = every.min(axis=0)
    east, north = every.max(axis=0)
    return float(west), float(south), float(east), float(north)
