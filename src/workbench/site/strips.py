"""Flight strips from positions and times: the terms inflight and across need them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_SAME_DIRECTION = np.cos(np.radians(35))
_GAP = 2.5


def find_strips(positions: Sequence[tuple[float, float]]) -> tuple[list[int], list[int]]:
    """Strip and place within it of photographs in the order of their exposure.

    A strip goes on while the way to the next photograph keeps the direction of the way before or
    after it (within 35 degrees) and is no longer than 2.5 times the median way. Turns, crossing
    flights and pauses therefore begin a new strip.

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
    ways = np.diff(np.asarray(positions, dtype=float), axis=0)
    lengths = np.hypot(ways[:, 0], ways[:, 1])
    usual = np.median(lengths) if count > 1 else 0.0
    units = ways / np.maximum(lengths, 1e-9)[:, None]
    agrees = np.einsum("ij,ij->i", units[:-1], units[1:]) > _SAME_DIRECTION
    with_before = np.r_[False, agrees] if count > 1 else np.zeros(0, bool)
    with_after = np.r_[agrees, False] if count > 1 else np.zeros(0, bool)
    # Two photographs alone have no second way to compare with: they are one strip.
    straight = with_before | with_after | (count == 2)
    goes_on = straight & (lengths <= _GAP * usual)
    strip, order = [0], [0]
    for way in goes_on:
        strip.append(strip[-1] if way else strip[-1] + 1)
        order.append(order[-1] + 1 if way else 0)
    return strip, order
