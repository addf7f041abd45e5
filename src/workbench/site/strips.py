"""Flight strips from positions and times: the terms inflight and across need them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_SAME_DIRECTION = np.cos(np.radians(35))
_ONE_AXIS = 0.4  # Mean of the doubled ways over their length, above which a flight has one main axis.
_GAP = 2.5
_HOVER = 0.1


def find_strips(positions: Sequence[tuple[float, float]]) -> tuple[list[int], list[int]]:
    """Strip and place within it of photographs in the order of their exposure.

    The next photograph belongs to the strip if the way to it keeps the direction of the last way
    (within 35 degrees) and is no longer than 2.5 times the usual way. Turns, crossing flights and
    pauses therefore begin a new strip. The direction of a strip that has but one photograph is that
    of the way to the second one, if the way after it agrees or the whole flight runs along that axis.
    Photographs taken while hovering (a tenth of the usual way) stay in the strip.

    Parameters
    ----------
    positions
        (x, y), metres, ordered by time.

    Returns
    -------
    strip, order
        A number from 0 for each photograph.
    """
    count = len(positions)
    if count == 0:
        return [], []
    ways = np.diff(np.asarray(positions, dtype=float).reshape(count, 2), axis=0)
    lengths = np.hypot(ways[:, 0], ways[:, 1])
    usual = _usual_way(lengths)
    units = ways / np.maximum(lengths, 1e-9)[:, None]
    moving = lengths > _HOVER * usual
    axis = _main_axis(ways[moving])
    strip, order = [0], [0]
    direction: np.ndarray | None = None
    for i in range(count - 1):
        if not moving[i]:
            goes_on = True
        elif lengths[i] > _GAP * usual:
            goes_on, direction = False, None
        elif direction is None:
            goes_on = count == 2 or _begins_strip(units, moving, i, axis)
            direction = units[i] if goes_on else None
        else:
            goes_on = bool(direction @ units[i] > _SAME_DIRECTION)
            direction = units[i] if goes_on else None
        strip.append(strip[-1] if goes_on else strip[-1] + 1)
        order.append(order[-1] + 1 if goes_on else 0)
    return strip, order


def _usual_way(lengths: np.ndarray) -> float:
    """Median way between two photographs, hovering apart."""
    if not lengths.size:
        return 0.0
    flown = lengths[lengths > _HOVER * np.quantile(lengths, 0.9)]
    return float(np.median(flown)) if flown.size else 0.0


def _begins_strip(units: np.ndarray, moving: np.ndarray, i: int, axis: np.ndarray | None) -> bool:
    later = [j for j in range(i + 1, len(units)) if moving[j]]
    if later and units[i] @ units[later[0]] > _SAME_DIRECTION:
        return True
    # Strips of two photographs have no second way; the axis of the whole flight tells them from turns.
    return axis is not None and bool(abs(units[i] @ axis) > _SAME_DIRECTION)


def _main_axis(ways: np.ndarray) -> np.ndarray | None:
    """Direction (2,), without sign, that most of the way follows; None for crossing flights."""
    if not len(ways):
        return None
    doubled, lengths = 2 * np.arctan2(ways[:, 1], ways[:, 0]), np.hypot(ways[:, 0], ways[:, 1])
    mean = np.average(np.stack([np.cos(doubled), np.sin(doubled)]), axis=1, weights=lengths)
    if np.hypot(*mean) < _ONE_AXIS:
        return None
    angle = np.arctan2(mean[1], mean[0]) / 2
    return np.array([np.cos(angle), np.sin(angle)])
