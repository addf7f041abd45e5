"""A cheap test whether the rows of a pair correspond."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from workbench.matching.pair import Pair

_CELLS = 8  # The best corner of each cell of an 8 x 8 grid is tried.
_REACH_Y, _REACH_X = 5, 10  # A patch of 11 x 21 pixels.
_SEARCH = 8  # Rows above and below that are searched.
_MATCHED = 0.8  # Correlation of a patch that was found again.
_DISTINCT, _FALL = 3, 0.1  # From three rows away on the correlation must have fallen by so much.
_LEAST = 8  # Fewer points prove nothing.
_STRETCH = 512  # Columns of a search area; wider ranges are searched on a reduced number of points.


@dataclass(frozen=True)
class VerticalOffset:
    """How far corresponding points lie in different rows."""

    median: float
    """Row in the right image minus row in the left one, px."""
    typical: float
    """Median of the absolute offsets, px: large as well where offsets of both signs cancel."""
    points: int
    """Points that were found again."""

    @property
    def proven(self) -> bool:
        """Whether enough points were found to say anything."""
        return self.points >= _LEAST


def vertical_offset(pair: Pair, first: int, last: int) -> VerticalOffset:
    """Look for distinct patches of the left image in the right one, some rows up and down as well.

    Parameters
    ----------
    pair
        Images.
    first, last
        Limits of the disparity, px.
    """
    left, right = pair.left.astype(np.uint8), pair.right.astype(np.uint8)
    offsets = []
    for row, column in _corners(left, pair.left_known, limit=_CELLS**2 * _STRETCH // max(last - first, 1)):
        top, bottom = row - _REACH_Y - _SEARCH, row + _REACH_Y + _SEARCH + 1
        west = max(column - last - _REACH_X, 0)
        east = min(column - first + _REACH_X + 1, left.shape[1])
        if east - west < 2 * _REACH_X + 1:
            continue
        area = right[top:bottom, west:east]
        patch = left[row - _REACH_Y : row + _REACH_Y + 1, column - _REACH_X : column + _REACH_X + 1]
        scores = cv2.matchTemplate(area, patch, cv2.TM_CCOEFF_NORMED)
        _, best, _, (_, found) = cv2.minMaxLoc(scores)
        by_row = scores.max(axis=1)
        elsewhere = by_row[np.abs(np.arange(len(by_row)) - found) >= _DISTINCT]
        # Along a vertical stripe every row looks alike: such a patch says nothing about rows.
        if best >= _MATCHED and elsewhere.max() <= best - _FALL:
            offsets.append(_peak(by_row, found) - _SEARCH)
    if not offsets:
        return VerticalOffset(0.0, 0.0, 0)
    return VerticalOffset(float(np.median(offsets)), float(np.median(np.abs(offsets))), len(offsets))


def _corners(image: np.ndarray, known: np.ndarray, limit: int) -> list[tuple[int, int]]:
    """The strongest corner of each cell, away from the border and from nodata."""
    strength = cv2.cornerMinEigenVal(image, 7)
    blind = cv2.dilate((~known).astype(np.uint8), np.ones((2 * _REACH_Y + 1, 2 * _REACH_X + 1), np.uint8))
    strength[blind > 0] = 0
    border_y, border_x = _REACH_Y + _SEARCH, _REACH_X
    rows, columns = image.shape
    corners = []
    for part_y in np.array_split(np.arange(border_y, rows - border_y), _CELLS):
        for part_x in np.array_split(np.arange(border_x, columns - border_x), _CELLS):
            if not len(part_y) or not len(part_x):
                continue
            cell = strength[part_y[0] : part_y[-1] + 1, part_x[0] : part_x[-1] + 1]
            row, column = np.unravel_index(int(cell.argmax()), cell.shape)
            if cell[row, column] > 0:
                corners.append((int(part_y[0] + row), int(part_x[0] + column)))
    return corners[:: max(-(-len(corners) // max(limit, 2 * _LEAST)), 1)]


def _peak(scores: np.ndarray, index: int) -> float:
    """Place of the maximum with the fit of a parabola."""
    if index == 0 or index == len(scores) - 1:
        return float(index)
    low, centre, high = (float(score) for score in scores[index - 1 : index + 2])
    bend = low + high - 2 * centre
    return index if bend >= 0 else index + 0.5 * (low - high) / bend
