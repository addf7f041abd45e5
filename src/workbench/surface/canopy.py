"""Whether the photographs could measure crowns: overlap and angle at the height of the canopy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workbench.matching.pairs import StereoPair, intersection_angle_at, overlap_at

LARGEST_ANGLE = 10.0
"""Degrees: beyond it the unmatched share in trees jumps [thesis 4.2, 5.1; findings T06, T15]."""

TREE_HEIGHT = 3.0
"""Metres above the terrain from which vegetation is a tree [thesis 3.3]."""

_LEAST_SHARE = 0.001  # Trees on less of the measured area are no canopy; most of one is never measured.
_STEPS = 1000  # Heights above terrain are counted in steps of a decimetre.


class CanopyHeights:
    """Heights above the terrain that were measured, counted tile by tile."""

    def __init__(self) -> None:
        self._counts = np.zeros(_STEPS, np.int64)
        self._cells = 0

    def add(self, height_above_terrain: np.ndarray) -> None:
        """Count the cells of a window, metres, NaN where nothing was measured."""
        known = height_above_terrain[np.isfinite(height_above_terrain)]
        self._cells += known.size
        steps = (known[known >= TREE_HEIGHT] * 10).clip(0, _STEPS - 1).astype(np.int64)
        self._counts += np.bincount(steps, minlength=_STEPS)

    @property
    def share(self) -> float:
        """Share of the measured cells that are tree."""
        return float(self._counts.sum() / max(self._cells, 1))

    @property
    def crown_height(self) -> float | None:
        """Height that 98 % of the tree cells stay below, metres; None without trees."""
        total = int(self._counts.sum())
        if not total:
            return None
        return float(np.searchsorted(self._counts.cumsum(), 0.98 * total) + 0.5) / 10


@dataclass(frozen=True)
class CrownView:
    """How neighbouring photographs of a strip see the crowns; medians over the pairs."""

    crown_height: float
    """Of the crowns above the ground, metres."""
    overlap: float
    """Forward overlap at the height of the crowns, 0..1."""
    overlap_ground: float
    """The same on the ground."""
    angle: float
    """Intersection angle at the crowns, degrees."""
    overlap_needed: float
    """Forward overlap at the crowns for an angle of 10 degrees."""
    overlap_ground_needed: float
    """The overlap on the ground that leads to it."""


def view_of_crowns(pairs: Sequence[StereoPair], ground: float, crown_height: float) -> CrownView | None:
    """Overlap and angle of the pairs within strips at the crowns; None without such pairs.

    The angle at a height is ``tan(angle) = base / (flying height - crown height)``; the overlap there
    ``1 - base / ((flying height - crown height) * frame)`` with the frame's length per unit of height
    [thesis 3.2.2], which is found from the overlap on the ground.
    """
    within = [pair for pair in pairs if pair.kind == "inflight"]
    if not within:
        return None
    top = ground + crown_height
    rows = []
    for pair in within:
        room = (pair.left.pose.centre[2] + pair.right.pose.centre[2]) / 2 - ground
        overlaps = [overlap_at(pair.left, pair.right, height) for height in (ground, top)]
        if room <= crown_height or overlaps[0] >= 1:
            continue
        frame = pair.base / (room * (1 - overlaps[0]))
        base = np.tan(np.radians(LARGEST_ANGLE))
        rows.append(
            (
                overlaps[1],
                overlaps[0],
                intersection_angle_at(pair, top),
                1 - base / frame,
                1 - base * (room - crown_height) / (room * frame),
            )
        )
    if not rows:
        return None
    overlap, overlap_ground, angle, needed, needed_ground = (float(v) for v in np.median(rows, axis=0))
    return CrownView(crown_height, overlap, overlap_ground, angle, needed, needed_ground)


def crown_warnings(view: CrownView | None, share: float, no_data: float) -> list[str]:
    """What to tell of crowns that the flight could not measure.

    Parameters
    ----------
    view
        How the crowns are seen.
    share
        Share of the measured cells that are tree.
    no_data
        Share of the area seen by at least one pair that has no height.
    """
    if view is None or share < _LEAST_SHARE or view.angle <= LARGEST_ANGLE:
        return []
    return [
        f"Trees (or buildings) reach {view.crown_height:.0f} m above the ground. At that height "
        f"neighbouring photographs overlap by {view.overlap:.0%} only ({view.overlap_ground:.0%} on the "
        f"ground) and meet at {view.angle:.0f} degrees. Beyond {LARGEST_ANGLE:.0f} degrees most of a canopy "
        f"cannot be matched: heights of trees are incomplete and coarse, and {no_data:.0%} of the area that "
        f"pairs see has no height. A forward overlap of {view.overlap_needed:.0%} at the crowns "
        f"({view.overlap_ground_needed:.0%} on the ground) would have measured them."
    ]
