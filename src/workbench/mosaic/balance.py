"""Colour balance between photographs: one gain for each photograph and band."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from workbench.mosaic.seams import Preview

_LEAST_CELLS = 50  # Fewer common cells say nothing of the brightness of two photographs.
_PRIOR = 0.1  # Weight of "no change" against a pair with full overlap; fixes the common brightness.
_LIMIT = 4.0


def balance_gains(previews: Sequence[Preview], photographs: int, *, white: float) -> np.ndarray:
    """Gains that make neighbours equally bright where they overlap.

    For each pair the median of the log ratio of common cells is an observation of the difference of
    two log gains; all are adjusted by least squares, weighted by the square root of the common area.

    Parameters
    ----------
    previews
        Photographs on common coarse cells.
    photographs
        Number of photographs of the block.
    white
        Largest value of the photographs (255 or 65535); cells near it or near black are not used.

    Returns
    -------
    ndarray (photographs, bands)
        Factors, geometric mean 1, between 1/4 and 4; 1 for photographs without neighbours.
    """
    bands = previews[0].colours.shape[-1] if previews else 1
    gains = np.ones((photographs, bands))
    rows: list[tuple[int, int, float, np.ndarray]] = []
    for place, first in enumerate(previews):
        for second in previews[place + 1 :]:
            observation = _log_ratio(first, second, white)
            if observation is not None:
                rows.append((first.index, second.index, *observation))
    if not rows:
        return gains
    design = np.zeros((len(rows) + photographs, photographs))
    observed = np.zeros((len(rows) + photographs, bands))
    for line, (first_index, second_index, weight, ratio) in enumerate(rows):
        design[line, first_index], design[line, second_index] = weight, -weight
        observed[line] = -weight * ratio
    strongest = max(row[2] for row in rows)
    design[len(rows) :] = np.eye(photographs) * _PRIOR * strongest
    logs = np.linalg.lstsq(design, observed, rcond=None)[0]
    used = sorted({index for row in rows for index in row[:2]})
    logs[used] -= logs[used].mean(axis=0)
    return np.clip(np.exp(logs), 1 / _LIMIT, _LIMIT)


def _log_ratio(first: Preview, second: Preview, white: float) -> tuple[float, np.ndarray] | None:
    """Weight and median log ratio (bands,) of two previews where both show a cell; None if too few."""
    top, bottom = max(first.rows.start, second.rows.start), min(first.rows.stop, second.rows.stop)
    left = max(first.columns.start, second.columns.start)
    right = min(first.columns.stop, second.columns.stop)
    if top >= bottom or left >= right:
        return None
    a, b = (
        view.colours[
            top - view.rows.start : bottom - view.rows.start,
            left - view.columns.start : right - view.columns.start,
        ]
        for view in (first, second)
    )
    with np.errstate(invalid="ignore"):
        usable = np.all((a > 0.02 * white) & (a < 0.98 * white), -1)
        usable &= np.all((b > 0.02 * white) & (b < 0.98 * white), -1)
    count = int(usable.sum())
    if count < _LEAST_CELLS:
        return None
    return np.sqrt(count), np.median(np.log(a[usable] / b[usable]), axis=0)
