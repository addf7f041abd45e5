"""What a mission reaches over the relief, photograph by photograph."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from workbench.planning.mission import Mission

_GRID = 7  # Places along each side of a frame.


def reached(mission: Mission) -> pd.DataFrame:
    """GSD, overlaps and angle of every photograph at the median and at the highest place that it sees.

    Overlap falls and the angle grows towards what stands high: crowns are seen by fewer photographs than the
    ground. Of a nadir camera; the frame lies along the line.

    Returns
    -------
    DataFrame
        A row a release: part and line (from 1), x, y, z, ``height_m`` above the median, ``gsd_m``,
        ``forward_overlap``, ``side_overlap``, ``angle_deg`` at the median, and ``forward_overlap_least``,
        ``side_overlap_least``, ``angle_most_deg`` at the highest place; NaN where the surface is unknown.
    """
    camera = mission.camera
    scale = camera.pixel_size / camera.focal_length
    wide, long = camera.full_frame[0] * scale, camera.full_frame[1] * scale
    rows = []
    for number, part in enumerate(mission.parts, 1):
        for leg in part.legs:
            for x, y, z in leg.releases:
                ground = mission.relief.at(
                    _frame((x, y), mission.height * wide, mission.height * long, mission.direction)
                )
                seen = ground[np.isfinite(ground)]
                median, top = (np.median(seen), seen.max()) if len(seen) else (np.nan, np.nan)
                rows.append((number, leg.line + 1, x, y, z, z - median, z - top))
    table = pd.DataFrame(rows, columns=["part", "line", "x", "y", "z", "height_m", "least"])
    for above, forward, side, angle in (
        ("height_m", "forward_overlap", "side_overlap", "angle_deg"),
        ("least", "forward_overlap_least", "side_overlap_least", "angle_most_deg"),
    ):
        table[forward] = 1 - mission.base / (long * table[above])
        table[side] = 1 - mission.spacing / (wide * table[above])
        table[angle] = np.degrees(np.arctan(mission.base / table[above]))
    table.insert(6, "gsd_m", table["height_m"] * scale)
    return table.drop(columns="least")


def summary(table: pd.DataFrame) -> str:
    """The extremes of what is reached, in words."""
    known = table.dropna()
    if known.empty:
        return "nothing is known of the surface below the photographs"
    return (
        f"reached: GSD {100 * known.gsd_m.min():.1f}-{100 * known.gsd_m.max():.1f} cm, forward overlap "
        f"{100 * known.forward_overlap.median():.0f} % ({100 * known.forward_overlap_least.min():.0f} % "
        f"at the highest place), side {100 * known.side_overlap.median():.0f} % "
        f"({100 * known.side_overlap_least.min():.0f} %), angle {known.angle_deg.median():.1f} degrees "
        f"({known.angle_most_deg.max():.1f})"
    )


def _frame(centre: tuple[float, float], width: float, length: float, direction: float) -> np.ndarray:
    """Places (n, 2) of a grid within a frame that lies along a direction."""
    angle = math.radians(direction)
    across, along = np.meshgrid(np.linspace(-0.5, 0.5, _GRID) * width, np.linspace(-0.5, 0.5, _GRID) * length)
    x = centre[0] + along * math.sin(angle) + across * math.cos(angle)
    y = centre[1] + along * math.cos(angle) - across * math.sin(angle)
    return np.stack([x.ravel(), y.ravel()], axis=1)
