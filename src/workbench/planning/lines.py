"""Parallel flight lines over an area of any outline."""

from __future__ import annotations

import math

import numpy as np
import shapely
from shapely import Polygon

from workbench.errors import PlanningError


def longest_direction(area: Polygon) -> float:
    """Direction of the longer side of the smallest rectangle around an area, degrees from north, 0..180.

    Lines along it are fewest, and so are turns.
    """
    corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(area))
    sides = np.diff(corners, axis=0)[:2]
    along = sides[int(np.hypot(*sides.T).argmax())]
    return math.degrees(math.atan2(along[0], along[1])) % 180


def flight_lines(area: Polygon, direction: float, spacing: float, base: float) -> list[np.ndarray]:
    """Places of release along parallel lines that are flown to and fro.

    The outermost lines lie on the border of the area or beyond it, and each line begins and ends at least
    one base outside, so that the border is seen as often as the middle. A line is as long as the part of
    the area within one spacing to either side needs.

    Parameters
    ----------
    area
        In metres.
    direction
        Of the first line, degrees clockwise from north.
    spacing
        Of lines, m.
    base
        Distance of releases, m.

    Returns
    -------
    list of ndarray (n, 2)
        East and north of every release of a line, in order of flight.

    Raises
    ------
    PlanningError
        If the area is empty.
    """
    if area.is_empty or not area.area > 0:
        raise PlanningError("The area to fly is empty: give a polygon with an area.")
    angle = math.radians(direction)
    along = np.array([math.sin(angle), math.cos(angle)])
    across = np.array([math.cos(angle), -math.sin(angle)])
    middle = np.array(area.centroid.coords[0])
    turned = shapely.transform(area, lambda points: (points - middle) @ np.stack([along, across], axis=1))
    first, low, last, high = turned.bounds
    number = math.ceil((high - low) / spacing) + 1
    centre = (low + high) / 2
    lines: list[np.ndarray] = []
    for index in range(number):
        offset = centre + (index - (number - 1) / 2) * spacing
        band = shapely.box(first - 1, offset - spacing, last + 1, offset + spacing)
        seen = turned.intersection(band)
        if seen.is_empty:
            continue
        start, _, end, _ = seen.bounds
        releases = math.ceil((end - start) / base) + 3
        steps = (start + end) / 2 + (np.arange(releases) - (releases - 1) / 2) * base
        if len(lines) % 2:
            steps = steps[::-1]
        lines.append(middle + steps[:, None] * along + offset * across)
    return lines
