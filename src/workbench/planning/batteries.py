"""Parts of a mission, each flown with one battery, with a safe way there and back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from workbench.errors import PlanningError
from workbench.planning.heights import Relief

_TURN = 5.0  # Seconds that braking and turning at the end of a line cost.
_PHASES = 60.0  # Seconds for take-off and landing.


@dataclass(frozen=True, eq=False)
class Leg:
    """A line, or a piece of one, that is flown with the camera releasing."""

    line: int
    """Number of the line, from 0."""
    way: np.ndarray
    """Corners (n, 3): east, north, altitude, m."""
    releases: np.ndarray
    """Places of release (n, 3)."""

    @property
    def length(self) -> float:
        """Metres."""
        return float(np.linalg.norm(np.diff(self.way, axis=0), axis=1).sum())


@dataclass(frozen=True, eq=False)
class Part:
    """What one battery flies."""

    legs: tuple[Leg, ...]
    transit: float
    """Altitude of approach and return, m: above everything on the way and at both ends."""
    seconds: float
    """From take-off to landing."""

    @property
    def photographs(self) -> int:
        """Releases."""
        return sum(len(leg.releases) for leg in self.legs)

    @property
    def corners(self) -> int:
        """Waypoints, those of approach and return included."""
        return sum(len(leg.way) for leg in self.legs) + 2


@dataclass(frozen=True)
class Budget:
    """What a part may cost."""

    home: np.ndarray
    """(2,) where the aircraft takes off and lands."""
    relief: Relief
    clearance: float
    """Above the relief on the way there and back, m."""
    speed: float
    """Along lines and ways, m/s."""
    climb: float
    """Up and down, m/s."""
    seconds: float
    """Time of a battery less its reserve."""
    most_corners: int
    """Waypoints that a part may have."""


def split(legs: list[Leg], budget: Budget) -> tuple[Part, ...]:
    """Cut a mission into parts, in the order of its lines; a line is cut at a release.

    Raises
    ------
    PlanningError
        If one base is more than a battery can do.
    """
    parts: list[Part] = []
    current: list[Leg] = []
    waiting = list(reversed(legs))
    while waiting:
        leg = waiting.pop()
        if _fits([*current, leg], budget):
            current.append(leg)
            continue
        head, tail = _cut(current, leg, budget)
        if head is not None:
            current.append(head)
        if not current:
            raise PlanningError(
                f"A battery of {budget.seconds / 60:.1f} min (its reserve taken off) does not reach line "
                f"{leg.line + 1} and back: take off nearer to the area, or fly faster."
            )
        parts.append(_part(current, budget))
        current = []
        waiting.append(tail)
    return (*parts, _part(current, budget))


def _cut(before: list[Leg], leg: Leg, budget: Budget) -> tuple[Leg | None, Leg]:
    """The longest beginning of a leg that still fits, and the rest."""
    fitting = [n for n in range(2, len(leg.releases) - 1) if _fits([*before, _piece(leg, 0, n)], budget)]
    if not fitting:
        return None, leg
    return _piece(leg, 0, fitting[-1]), _piece(leg, fitting[-1] - 1, len(leg.releases))


def _piece(leg: Leg, first: int, last: int) -> Leg:
    """Releases ``first`` to ``last`` (excluded) with the way between them."""
    releases = leg.releases[first:last]
    start, end = (np.hypot(*(place[:2] - leg.way[0, :2])) for place in (releases[0], releases[-1]))
    along = np.hypot(*(leg.way[:, :2] - leg.way[0, :2]).T)
    between = leg.way[(along > start + 0.01) & (along < end - 0.01)]
    return Leg(leg.line, np.concatenate([releases[:1], between, releases[-1:]]), releases)


def _fits(legs: list[Leg], budget: Budget) -> bool:
    part = _part(legs, budget)
    return part.seconds <= budget.seconds and part.corners <= budget.most_corners


def _part(legs: list[Leg], budget: Budget) -> Part:
    first, last = legs[0].way[0], legs[-1].way[-1]
    ways = [np.stack([budget.home, end[:2]]) for end in (first, last)]
    tops = [budget.relief.highest_along(way) for way in ways]
    known = [top + budget.clearance for top in tops if math.isfinite(top)]
    transit = max([float(first[2]), float(last[2]), *known])
    ground = float(budget.relief.at(budget.home[None])[0])
    level = sum(leg.length for leg in legs) + sum(float(np.hypot(*np.diff(way, axis=0)[0])) for way in ways)
    between = [np.hypot(*(b.way[0, :2] - a.way[-1, :2])) for a, b in pairwise(legs)]
    up = (transit - ground) + (transit - first[2]) + (transit - last[2]) + (transit - ground)
    seconds = (level + sum(between)) / budget.speed + up / budget.climb + _TURN * 2 * len(legs) + _PHASES
    return Part(tuple(legs), transit, float(seconds))
