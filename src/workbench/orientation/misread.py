"""Measurements of surveyed points that contradict the others of their point: mistyped, or another mark."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap

from workbench.orientation.control import triangulate

_LIMIT = 10.0  # Standard deviations of a measurement; poses before their adjustment err by pixels too.
_STANDS_OUT = 5.0  # Times the residuals of the others among themselves.
_LEAST = 3  # Of two measurements neither can be told to be the wrong one.

Measured = Mapping[str, list[tuple[str, float, float]]]
"""Measurements (photo, column, row) of each point by its name."""


@dataclass(frozen=True)
class Misread:
    """A measurement that does not show the point of the others."""

    name: str
    """Surveyed point."""
    photo: str
    """Photograph; empty where two measurements contradict each other and neither can be trusted more."""
    miss_px: float
    """Distance from where the others see the point, px."""

    def __str__(self) -> str:
        if self.photo:
            return (
                f"The measurement of {self.name} in {self.photo} lies {self.miss_px:.0f} px from where the "
                "others see the point and is not used: look at it again."
            )
        return (
            f"The measurements of {self.name} contradict each other by {self.miss_px:.0f} px: measure it "
            "in more photographs, or look at them again."
        )


def misread_measurements(
    model: pycolmap.Reconstruction, measured: Measured, *, observation_sd: float
) -> tuple[Misread, ...]:
    """Find measurements that miss the point where the others of their point meet, one by one.

    Parameters
    ----------
    observation_sd
        Of a measurement, px. Ten of them, and five times what the others miss it by, are no chance.
    """
    found = []
    for name, observations in sorted(measured.items()):
        kept = [o for o in observations if _is_registered(model, o[0])]
        while len(kept) >= 2:
            residuals = _residuals(model, kept, kept)
            worst = float(np.max(residuals)) if residuals is not None else np.inf
            if worst <= _LIMIT * observation_sd:
                break
            culprit = _culprit(model, kept, _LIMIT * observation_sd) if len(kept) >= _LEAST else None
            if culprit is None:
                if np.isfinite(worst):
                    found.append(Misread(name, "", worst))
                break
            place, miss = culprit
            found.append(Misread(name, kept[place][0], miss))
            del kept[place]
    return tuple(found)


def without_misread(
    measured: Measured, misread: tuple[Misread, ...]
) -> dict[str, list[tuple[str, float, float]]]:
    """The measurements that are left."""
    wrong = {(one.name, one.photo) for one in misread}
    return {
        name: [o for o in observations if (name, o[0]) not in wrong]
        for name, observations in measured.items()
    }


def _culprit(
    model: pycolmap.Reconstruction, observations: list[tuple[str, float, float]], limit: float
) -> tuple[int, float] | None:
    """The measurement without which the others agree best, and by how much it misses them."""
    best: tuple[float, int, float] | None = None
    for place, one in enumerate(observations):
        rest = observations[:place] + observations[place + 1 :]
        among, missed = _residuals(model, rest, rest), _residuals(model, rest, [one])
        if among is not None and missed is not None and (best is None or np.max(among) < best[0]):
            best = float(np.max(among)), place, float(missed[0])
    if best is None or best[2] <= max(limit, _STANDS_OUT * best[0]):
        return None
    return best[1], best[2]


def _residuals(
    model: pycolmap.Reconstruction,
    observations: list[tuple[str, float, float]],
    of: list[tuple[str, float, float]],
) -> np.ndarray | None:
    """Image residuals (px) of some measurements against the point that the observations give."""
    point = triangulate(model, observations)
    if point is None:
        return None
    shown = [model.find_image_with_name(photo).project_point(point) for photo, _, _ in of]
    if any(place is None for place in shown):
        return None
    return np.array(
        [np.hypot(*(place - o[1:])) for place, o in zip(shown, of, strict=True)],
    )


def _is_registered(model: pycolmap.Reconstruction, photo: str) -> bool:
    image = model.find_image_with_name(photo)
    return image is not None and image.has_pose
