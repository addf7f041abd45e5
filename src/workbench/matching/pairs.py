"""Which photographs are matched with each other: inflight and across."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from workbench.errors import MatchingError
from workbench.orientation import Block, OrientedPhotograph

_LEAST_OVERLAP = 0.2
_LARGEST_ANGLE = 45.0
_SAME_VIEW = 25.0
_LEAST_SIDE_OVERLAP = 0.5
_DENSE = 0.7
_SAMPLES = 32  # Along each edge of a photograph: its overlap is known to 2 %.


@dataclass(frozen=True, eq=False)
class StereoPair:
    """Two photographs to match; the left one stands to the left along the base."""

    left: OrientedPhotograph
    """Base image: its pixels get disparities."""
    right: OrientedPhotograph
    """The other one."""
    kind: str
    """inflight or across."""

    @property
    def name(self) -> str:
        """Unique name of the pair."""
        return f"{self.left.name}__{self.right.name}".replace("/", "_")

    @property
    def base(self) -> float:
        """Distance of the projection centres, metres."""
        return float(np.linalg.norm(self.right.pose.centre - self.left.pose.centre))


def intersection_angle_at(pair: StereoPair, ground: float) -> float:
    """Angle, degrees, between the rays to the point below the middle of the base at a height."""
    middle = (pair.left.pose.centre + pair.right.pose.centre) / 2
    axis = pair.left.pose.view_direction + pair.right.pose.view_direction
    reach = (ground - middle[2]) / min(axis[2], -1e-3)
    point = middle + axis * reach
    rays = [p.pose.centre - point for p in (pair.left, pair.right)]
    cosine = rays[0] @ rays[1] / (np.linalg.norm(rays[0]) * np.linalg.norm(rays[1]))
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def overlap_at(first: OrientedPhotograph, second: OrientedPhotograph, ground: float) -> float:
    """Share of the first photograph that the second one sees at a ground height, 0..1."""
    camera = first.camera
    columns, rows = np.meshgrid(
        (np.arange(_SAMPLES) + 0.5) / _SAMPLES * camera.width,
        (np.arange(_SAMPLES) + 0.5) / _SAMPLES * camera.height,
    )
    rays = first.pose.to_world(camera.rays(np.stack([columns.ravel(), rows.ravel()], axis=1)))
    down = rays[:, 2] < -0.05
    points = (
        first.pose.centre + rays * ((ground - first.pose.centre[2]) / np.where(down, rays[:, 2], -1))[:, None]
    )
    return float((second.sees(points) & down).mean())


def select_pairs(block: Block, *, inflight: int, across: bool | None, ground: float) -> list[StereoPair]:
    """Pairs within strips, and on request between neighbouring strips [thesis 4.2].

    ``inflight`` n pairs each photograph with the n before and after it in its strip. ``across``
    pairs it with the nearest photograph of each other strip; None does so where that overlaps by half
    or more. Where the photographs of the other strip overlap by less than 70 %, a point is in three of
    them at most, and the next nearest is taken as well. A pair needs 20 % overlap, an intersection angle
    up to 45 degrees, and axes within 25 degrees of each other (cameras of a rig that look apart see
    nothing in common). A photograph without partner in its strip (kites, single shots) is paired with
    its nearest overlapping neighbours instead.

    Raises
    ------
    MatchingError
        If no two photographs overlap.
    """
    chosen: dict[tuple[str, str], str] = {}
    strips: dict[int, list[OrientedPhotograph]] = defaultdict(list)
    for photograph in block:
        strips[photograph.strip].append(photograph)
    for photographs in strips.values():
        photographs.sort(key=lambda p: (p.order, p.name))
        for place, first in enumerate(photographs):
            for second in photographs[place + 1 : place + 1 + inflight]:
                _choose(chosen, first, second, "inflight", ground)
    paired = {name for names in chosen for name in names}
    for photograph in block:
        alone = photograph.name not in paired
        if across is False and not alone:
            continue
        least = _LEAST_SIDE_OVERLAP if across is None and not alone else _LEAST_OVERLAP
        for number, photographs in sorted(strips.items()):
            if number == photograph.strip:
                continue
            near = sorted(
                photographs, key=lambda p: (np.linalg.norm(p.pose.centre - photograph.pose.centre), p.name)
            )[:2]
            if overlap_at(photograph, near[0], ground) < least:
                continue
            _choose(chosen, photograph, near[0], "across", ground)
            if len(near) == 2 and overlap_at(near[0], near[1], ground) < _DENSE:
                _choose(chosen, photograph, near[1], "across", ground)
    if not chosen:
        raise MatchingError(
            "No two photographs overlap by a fifth with a usable angle: nothing can be matched. "
            "Look at the overlap in the report of the orientation."
        )
    by_name = {photograph.name: photograph for photograph in block}
    return [
        StereoPair(by_name[first], by_name[second], kind) for (first, second), kind in sorted(chosen.items())
    ]


def _choose(
    chosen: dict[tuple[str, str], str],
    first: OrientedPhotograph,
    second: OrientedPhotograph,
    kind: str,
    ground: float,
) -> None:
    names = (min(first.name, second.name), max(first.name, second.name))
    if names in chosen or overlap_at(first, second, ground) < _LEAST_OVERLAP:
        return
    cosine = float(first.pose.view_direction @ second.pose.view_direction)
    if np.degrees(np.arccos(np.clip(cosine, -1, 1))) > _SAME_VIEW:
        return
    if intersection_angle_at(StereoPair(first, second, kind), ground) <= _LARGEST_ANGLE:
        chosen[names] = kind
