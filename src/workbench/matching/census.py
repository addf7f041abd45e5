"""The census transform: every pixel becomes the pattern of which neighbours are darker than itself."""

from __future__ import annotations

import cv2
import numpy as np

from workbench.compiled import compiled

_REACH = {"census9x7": (3, 4), "census5x5": (2, 2)}
BITS = 62
"""Bits that costs count up to, whatever the window."""


def census(image: np.ndarray, window: str) -> np.ndarray:
    """Census of an image [Zabih and Woodfill 1994].

    Parameters
    ----------
    image
        Grey values (rows, columns), float32, without NaN.
    window
        ``census9x7`` (62 comparisons) or ``census5x5`` (24).

    Returns
    -------
    ndarray of uint64 (rows, columns)
        One bit for each neighbour, row by row; beyond the border the image is repeated.
    """
    reach_y, reach_x = _REACH[window]
    padded = cv2.copyMakeBorder(image, reach_y, reach_y, reach_x, reach_x, cv2.BORDER_REPLICATE)
    return _census(padded, reach_y, reach_x)


def census_scale(window: str) -> int:
    """Factor, in sixteenths, that brings the differing bits of a window to 0..62."""
    reach_y, reach_x = _REACH[window]
    comparisons = (2 * reach_y + 1) * (2 * reach_x + 1) - 1
    return 16 * BITS // comparisons


@compiled(nogil=True)
def _census(padded: np.ndarray, reach_y: int, reach_x: int) -> np.ndarray:
    rows, columns = padded.shape[0] - 2 * reach_y, padded.shape[1] - 2 * reach_x
    words = np.zeros((rows, columns), np.uint64)
    for row in range(rows):
        word = words[row]
        centre = padded[row + reach_y, reach_x : reach_x + columns]
        for i in range(2 * reach_y + 1):
            for j in range(2 * reach_x + 1):
                if i == reach_y and j == reach_x:
                    continue
                other = padded[row + i, j : j + columns]
                for column in range(columns):
                    bit = np.uint64(1) if other[column] < centre[column] else np.uint64(0)
                    word[column] = (word[column] << np.uint64(1)) | bit
    return words
