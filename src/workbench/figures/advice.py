"""Warnings that no single stage raises: what the figures of several stages together mean, and the remedy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_LEAST_COVERAGE = 0.8
_LEAST_TWICE = 0.5
_WIDE_ANGLE = 15.0  # Thesis: 5-10 degrees are usable for trees; beyond, views of a crown differ too much.


def advice(metrics: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Warnings from the metrics of the stages, by their verbs; stages that were not run say nothing."""
    found = []
    surface, match = metrics.get("surface", {}), metrics.get("match", {})
    coverage = surface.get("coverage_ge1")
    if coverage is not None and coverage < _LEAST_COVERAGE:
        found.append(
            f"Only {100 * coverage:.0f} % of the area that two photographs see was measured. Water, canopy "
            "and bare ground hardly match: fly more overlap, or allow coarser match.downscales."
        )
    twice = surface.get("coverage_ge2")
    if twice is not None and twice < _LEAST_TWICE:
        found.append(
            f"Only {100 * twice:.0f} % was measured by two or more pairs: heights of one pair are not "
            "controlled by another. Fly more overlap, or raise match.inflight."
        )
    angle = match.get("angle_median_deg")
    if angle is not None and angle > _WIDE_ANGLE:
        found.append(
            f"The median intersection angle is {angle:.0f} degrees. Tree crowns and reed look too different "
            "from such directions and are often missed; 5-10 degrees suit them: fly more forward overlap."
        )
    trees = metrics.get("trees", {})
    seen = surface.get("ground_seen_share")
    if trees.get("trees") and seen is not None and seen < 0.3:
        found.append(
            f"Ground was seen on {100 * seen:.0f} % of the terrain: heights of trees hang on an interpolated "
            "terrain. Give a lidar terrain as dtm in site.yaml."
        )
    return found
