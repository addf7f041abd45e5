"""Mutual information as a matching cost, for images whose grey values relate in no simple way."""

from __future__ import annotations

import cv2
import numpy as np

_LEVELS = 256
_CHANCE = 31.0  # Mean cost of grey values that met by chance, as that of a census of 62 bits.
_MOST = 62.0
_BLUR = 7  # Window of the Gaussian over the histograms [Hirschmüller 2008, section 2.1].
_FLOOR = 1e-7
_ALIKE = 0.98  # Share of the matches that cost more than nothing.


def mutual_information_costs(left: np.ndarray, right: np.ndarray, disparity: np.ndarray) -> np.ndarray:
    """Cost of each pair of grey values [Kim et al. 2003; Hirschmüller 2008, section 2.1].

    Entropies come from the joint histogram of what a first disparity lays on each other, smoothed
    before and after the logarithm. Costs are scaled so that those of a census fit beside the same penalties.

    Parameters
    ----------
    left, right
        Grey values (rows, columns) uint8.
    disparity
        First disparity, px, NaN where unknown; it may be wrong in many places.

    Returns
    -------
    ndarray (256, 256) uint8
        Cost 0..62 of a left and a right grey value.
    """
    rows, columns = np.nonzero(np.isfinite(disparity))
    partner = columns - np.rint(disparity[rows, columns]).astype(np.int64)
    inside = (partner >= 0) & (partner < right.shape[1])
    pairs = left[rows[inside], columns[inside]].astype(np.int64) * _LEVELS
    pairs += right[rows[inside], partner[inside]]
    joint = np.bincount(pairs, minlength=_LEVELS**2).reshape(_LEVELS, _LEVELS).astype(np.float64)
    joint = joint / max(joint.sum(), 1.0) + _FLOOR / _LEVELS**2
    own, other = joint.sum(axis=1), joint.sum(axis=0)
    # The logarithms of one and of two grey values: information that a pair of them shares.
    shared = _logarithm(joint) - _logarithm(own[:, None]) - _logarithm(other[:, None]).T
    order = np.argsort(shared, axis=None)
    best = shared.ravel()[order][np.searchsorted(np.cumsum(joint.ravel()[order]), _ALIKE * joint.sum())]
    chance = float((own[:, None] * other[None, :] * np.minimum(shared, best)).sum())
    cost = _CHANCE * (best - shared) / max(best - chance, 1e-6)
    return np.rint(np.clip(cost, 0, _MOST)).astype(np.uint8)


def _logarithm(probability: np.ndarray) -> np.ndarray:
    size = (1 if probability.shape[1] == 1 else _BLUR, _BLUR)
    smooth = cv2.GaussianBlur(probability, size, 0, borderType=cv2.BORDER_REPLICATE)
    return cv2.GaussianBlur(np.log(np.maximum(smooth, _FLOOR**2)), size, 0, borderType=cv2.BORDER_REPLICATE)
