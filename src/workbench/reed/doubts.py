"""Whether surface, water level and shoreline fit each other: what no threshold can tell."""

from __future__ import annotations

import cv2
import numpy as np
from affine import Affine
from rasterio.features import rasterize

from workbench.params import ReedParameters
from workbench.reed.measure import ReedMetrics

_STAND = 1.0  # Reed is taller [reed 1], m.
_SAMPLES = 1_000_000  # Heights that are looked at.
_FAR = 6.0  # Farther from reed than matching smears its front, m.
_LEAST = 20.0  # Open water that a level can be judged by, m².
_OFF = 0.25  # Height of open water that is no longer noise, m.
_ALL = 0.95  # Share of the known lake side that no belt of reed covers.
_FEW, _MANY = 0.05, 0.3  # Shares of ground at the level of the water: of land, of a lake.


def doubts(metrics: ReedMetrics, options: ReedParameters, *, shoreline: bool = True) -> list[str]:
    """Sentences about what looks wrong, each with a remedy; none if nothing does.

    Parameters
    ----------
    metrics
        Measured with these options.
    shoreline
        Whether there is one.
    """
    found = []
    if metrics.extent.reed.is_empty:
        found.append(f"No reed on the lake side: check water level and height limits. {_heights(metrics)}")
    if not shoreline:
        found.append("There is no shoreline: everything between the height limits counts as reed.")
    elif _sides_swapped(metrics):
        found.append(
            "Hardly any ground on the lake side of the shoreline lies at the level of the water, much of the "
            "other side does: is it the polygon of the land? Give that of the lake."
        )
    elif metrics.extent.reed.area > _ALL * (metrics.extent.lake.area - metrics.extent.unknown.area):
        found.append(
            "Nearly all of the lake side with heights counts as reed: is the water level too low, or has the "
            f"water no heights? {_heights(metrics)}"
        )
    share = float(metrics.areas.unknown_m2.sum()) / max(metrics.extent.lake.area, 1e-9)
    if share > 0.1:
        found.append(f"{100 * share:.0f} % of the lake side has no height and is unknown.")
    water = open_water(metrics)
    if abs(water) > _OFF:
        found.append(
            f"Open water lies {abs(water):.2f} m {'above' if water > 0 else 'below'} the stated level: is "
            "that of the day, in the vertical datum of the surface? Heights are off by as much."
        )
    return found


def open_water(metrics: ReedMetrics) -> float:
    """Median height of open water above the stated level, m; NaN without enough of it.

    Open water is ground of known height on the lake side, lower than any stand (1 m), and farther than 6 m
    from anything higher: where it is not near zero, surface and level do not fit.
    """
    heights, lake, cell = _sample(metrics)
    with np.errstate(invalid="ignore"):
        low = heights < _STAND
    tall = (np.isfinite(heights) & ~low) | ~lake
    reach = 2 * int(np.ceil(_FAR / cell)) + 1
    near = cv2.dilate(tall.astype(np.uint8), np.ones((reach, reach), dtype=np.uint8)).astype(bool)
    water = heights[low & lake & ~near]
    return float(np.median(water)) if len(water) * cell**2 >= _LEAST else float("nan")


def _heights(metrics: ReedMetrics) -> str:
    heights, lake, _ = _sample(metrics)
    known = heights[lake & np.isfinite(heights)]
    if not len(known):
        return "It has no heights at all."
    low, middle, high = np.percentile(known, [5, 50, 95])
    return f"Heights there are {low:.1f} to {high:.1f} m above the water, {middle:.1f} m in the middle."


def _sides_swapped(metrics: ReedMetrics) -> bool:
    heights, lake, cell = _sample(metrics)
    with np.errstate(invalid="ignore"):
        level = np.abs(heights) < _OFF
    known = np.isfinite(heights)
    inside, outside = (np.count_nonzero(known & side) for side in (lake, ~lake))
    if min(inside, outside) * cell**2 < _LEAST:
        return False
    return bool(
        np.count_nonzero(level & lake) < _FEW * inside and np.count_nonzero(level & ~lake) > _MANY * outside
    )


def _sample(metrics: ReedMetrics) -> tuple[np.ndarray, np.ndarray, float]:
    """Every so many-th height (m), whether it lies on the lake side, and the distance between two, m."""
    grid = metrics.extent.grid
    step = int(np.ceil(np.sqrt(grid.height * grid.width / _SAMPLES)))
    heights = metrics.ohm.values[step // 2 :: step, step // 2 :: step]
    # The middle of a coarse cell is that of the pixel that stands for it.
    shift = step // 2 + 0.5 - step / 2
    transform = grid.transform * Affine.translation(shift, shift) * Affine.scale(step)
    lake = rasterize([metrics.extent.lake], out_shape=heights.shape, transform=transform, dtype="uint8")
    return heights, lake.astype(bool), step * grid.resolution
