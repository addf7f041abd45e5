"""The two images of a rectified pair as the matchers want them: checked, grey, with a mask of nodata."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workbench.errors import MatchingError

_LUMINANCE = np.array([0.299, 0.587, 0.114], np.float32)  # ITU-R BT.601


@dataclass(frozen=True, eq=False)
class Pair:
    """A rectified pair, ready to be matched."""

    left: np.ndarray
    """Grey values (rows, columns), float32, 0..255 between the darkest and brightest of both images."""
    right: np.ndarray
    """The same of the right image."""
    left_known: np.ndarray
    """Where the left image has data, bool."""
    right_known: np.ndarray
    """Where the right image has data, bool."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.left.shape
        return rows, columns


def prepare_pair(left: np.ndarray, right: np.ndarray) -> Pair:
    """Check two images and bring them to grey values on one scale.

    Parameters
    ----------
    left, right
        (rows, columns), or (rows, columns, 3) in red, green, blue; any number type; NaN = nodata.

    Raises
    ------
    MatchingError
        If the sizes differ, an image has another number of bands, is empty, constant or all nodata.
    """
    grey_left, known_left = _grey(left, "left")
    grey_right, known_right = _grey(right, "right")
    if grey_left.shape != grey_right.shape:
        raise MatchingError(
            f"The left image has {grey_left.shape} rows and columns, the right one {grey_right.shape}: "
            "rectify both to one size."
        )
    low = min(grey_left[known_left].min(), grey_right[known_right].min())
    high = max(grey_left[known_left].max(), grey_right[known_right].max())
    scale = np.float32(255.0 / (high - low))
    return Pair(
        np.where(known_left, (grey_left - low) * scale, np.float32(0)),
        np.where(known_right, (grey_right - low) * scale, np.float32(0)),
        known_left,
        known_right,
    )


def check_range(disparity_range: tuple[float, float], columns: int) -> tuple[int, int]:
    """Whole-pixel disparity limits, both included.

    Raises
    ------
    MatchingError
        If the range is empty, not finite, or moves every pixel out of the other image.
    """
    low, high = (float(limit) for limit in disparity_range)
    if not (np.isfinite(low) and np.isfinite(high)) or high < low:
        raise MatchingError(f"The disparity range {low}..{high} is empty: give (low, high) with low <= high.")
    first, last = int(np.floor(low)), int(np.ceil(high))
    if first >= columns or last <= -columns:
        raise MatchingError(
            f"Disparities of {first}..{last} px lie outside images of {columns} columns: "
            "a disparity is the column in the left image minus the column in the right one."
        )
    return first, last


def _grey(image: np.ndarray, side: str) -> tuple[np.ndarray, np.ndarray]:
    image = np.asarray(image)
    if image.ndim == 3 and image.shape[2] in (1, 3, 4):
        image = image[..., 0] if image.shape[2] == 1 else image[..., :3].astype(np.float32) @ _LUMINANCE
    if image.ndim != 2 or not image.size or not np.issubdtype(image.dtype, np.number):
        raise MatchingError(
            f"The {side} image has shape {image.shape} and type {image.dtype}: "
            "give numbers of shape (rows, columns) or (rows, columns, 3)."
        )
    if np.iscomplexobj(image):
        raise MatchingError(f"The {side} image has complex numbers: give its amplitude.")
    grey = np.ascontiguousarray(image, dtype=np.float32)
    known = np.isfinite(grey)
    if not known.any():
        raise MatchingError(f"The {side} image is all nodata: nothing can be matched.")
    values = grey[known]
    if values.min() == values.max():
        raise MatchingError(f"The {side} image is constant ({values[0]:g}): nothing can be matched.")
    return grey, known
