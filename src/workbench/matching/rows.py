"""Rows that do not quite correspond: the vertical parallax that orientation leaves in a rectified pair.

A bundle adjustment ends with residuals of half a pixel and more: a rolling shutter, a lens that no model
describes wholly. In a rectified pair they are differences of rows that vary smoothly over the image.
Half a pixel of them costs a window on fine texture its match, or part of its accuracy. Each downscale
measures them with its disparities, and the next finer one takes them out of the right image. Along the
rows nothing is changed: there a residual cannot be told from height.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from workbench.matching.rectify import Rectification, RowOffsets

_BLOCK = 24  # Edge of a block in which one offset is measured, px.
_FILLED = 0.5  # Part of a block that must be matched.
_ALIKE = 0.5  # Least correlation of a block.
_LEAST = 20  # Blocks; fewer do not fix the six coefficients of a surface.
_LARGEST = 2.0  # Larger offsets, px, are no residuals: least squares from so far away is chance.
_NOISE = 4.0  # Variance of the grey value's gradient that is taken for noise, (1/255)².
_ROUNDS = 6
_STEADY = 1e-5  # Tangent; residuals below count fully.


@dataclass(frozen=True, eq=False)
class _Blocks:
    """What was measured, one value for each block."""

    x: np.ndarray
    """Tangent across, in the right image."""
    y: np.ndarray
    """Tangent down."""
    offset: np.ndarray
    """Lower in the right image by so much than expected, tangent."""
    weight: np.ndarray


def measure_row_offsets(
    left: np.ndarray, right: np.ndarray, disparity: np.ndarray, rectification: Rectification
) -> RowOffsets | None:
    """How far below its row a point of the left image lies in the right one.

    Offsets of blocks, from least-squares matching in both directions with gain and offset of the grey
    values, are fitted by a surface of second degree, robustly (residuals beyond two standard
    deviations count by their inverse).

    Parameters
    ----------
    left, right
        Rectified grey images (rows, columns) float32, NaN = nodata.
    disparity
        Of the left image, px, NaN where unknown.
    rectification
        Their geometry, with the offsets that have been taken out already.

    Returns
    -------
    RowOffsets or None
        Those and what is left of them together; what the rectification has if too little was matched.
    """
    blocks = _blocks(left, right, disparity, rectification)
    known = rectification.rows
    if blocks is None:
        return known
    total = blocks.offset if known is None else blocks.offset + known.at(blocks.x, blocks.y)
    design = RowOffsets.terms(blocks.x, blocks.y)
    weight = blocks.weight
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        coefficients = np.linalg.lstsq(design * root[:, None], total * root, rcond=None)[0]
        residual = np.abs(total - design @ coefficients)
        limit = max(2 * 1.4826 * float(np.median(residual)), _STEADY)
        weight = blocks.weight * np.minimum(1, limit / np.maximum(residual, _STEADY))
    fitted = design @ coefficients
    return RowOffsets(tuple(float(c) for c in coefficients), float(fitted.min()), float(fitted.max()))


def _blocks(
    left: np.ndarray, right: np.ndarray, disparity: np.ndarray, rectification: Rectification
) -> _Blocks | None:
    rows, columns = (n // _BLOCK * _BLOCK for n in left.shape)
    if not rows or not columns:
        return None
    own, other, slope_x, slope_y, column, row = _at_matches(left, right, disparity)
    known = np.isfinite(own) & np.isfinite(other) & np.isfinite(slope_x) & np.isfinite(slope_y)

    def total(values: np.ndarray) -> np.ndarray:
        part = np.where(known, values, 0)[:rows, :columns]
        blocks = part.reshape(rows // _BLOCK, _BLOCK, columns // _BLOCK, _BLOCK)
        return blocks.sum(axis=(1, 3), dtype=np.float64)

    count = np.maximum(total(np.ones_like(own)), 1)

    def covariance(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return total(first * second) / count - total(first) * total(second) / count**2

    # Sums of squares lose their digits far from zero.
    own, other = own - np.float32(128), other - np.float32(128)
    spread, spread_other = covariance(own, own), covariance(other, other)
    gain = np.sqrt(np.maximum(spread, 1e-6) / np.maximum(spread_other, 1e-6))
    correlation = covariance(own, other) / np.sqrt(np.maximum(spread * spread_other, 1e-6))
    xx, yy = covariance(slope_x, slope_x) + _NOISE, covariance(slope_y, slope_y) + _NOISE
    xy = covariance(slope_x, slope_y)
    ex = covariance(own, slope_x) / gain - covariance(other, slope_x)
    ey = covariance(own, slope_y) / gain - covariance(other, slope_y)
    determinant = xx * yy - xy**2
    offset = (xx * ey - xy * ex) / determinant
    good = (count >= _FILLED * _BLOCK**2) & (correlation > _ALIKE) & (np.abs(offset) <= _LARGEST)
    if good.sum() < _LEAST:
        return None
    weight = (determinant / xx * correlation)[good]
    r = rectification
    return _Blocks(
        x=((total(column) / count)[good] + 0.5 - r.principal[0] - r.shift) / r.focal,
        y=((total(row) / count)[good] + 0.5 - r.principal[1]) / r.focal,
        offset=offset[good] / r.focal,
        # No single block of strong texture decides alone.
        weight=np.minimum(weight, np.median(weight)),
    )


def _at_matches(left: np.ndarray, right: np.ndarray, disparity: np.ndarray) -> tuple[np.ndarray, ...]:
    """Left image, right image and its slopes at the matches; their columns and rows there."""
    rows, columns = left.shape
    x, y = np.meshgrid(np.arange(columns, dtype=np.float32), np.arange(rows, dtype=np.float32))
    place = np.where(np.isfinite(disparity), x - disparity, np.float32(-10)).astype(np.float32)

    def at(across: float, down: float) -> np.ndarray:
        return cv2.remap(
            right,
            place + np.float32(across),
            y + np.float32(down),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        )

    slope_x, slope_y = (at(1, 0) - at(-1, 0)) / 2, (at(0, 1) - at(0, -1)) / 2
    return left, at(0, 0), slope_x, slope_y, place, y
