"""Spectral indices of vegetation."""

from __future__ import annotations

import numpy as np


def vegetation_index(near_infrared: np.ndarray, red: np.ndarray) -> np.ndarray:
    """NDVI = (NIR - R) / (NIR + R), -1..1; NaN where both are zero.

    Bands of one shape, any number type.
    """
    nir, r = near_infrared.astype(np.float32), red.astype(np.float32)
    return _ratio(nir - r, nir + r)


def green_leaf_index(red: np.ndarray, green: np.ndarray, blue: np.ndarray) -> np.ndarray:
    """GLI = (2 G - R - B) / (2 G + R + B), -1..1; NaN where all are zero.

    Bands of one shape, any number type.
    """
    r, g, b = (band.astype(np.float32) for band in (red, green, blue))
    return _ratio(2 * g - r - b, 2 * g + r + b)


def brightness(*bands: np.ndarray) -> np.ndarray:
    """Mean of the bands (red, green, blue, and near infrared where there is one)."""
    total = bands[0].astype(np.float32)
    for band in bands[1:]:  # One at a time: an orthophoto of centimetres fills a gigabyte as numbers.
        total += band
    return total / np.float32(len(bands))


def _ratio(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    return np.divide(above, below, out=np.full(below.shape, np.nan, np.float32), where=below != 0)
