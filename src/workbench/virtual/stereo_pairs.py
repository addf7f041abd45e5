"""Rectified pairs with exactly known disparities, for tests and comparisons of matchers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

_INVERSIONS = 200  # Fixed-point steps from right to left columns; they shrink by the slope of the surface.
_SAMPLES = 3  # Sub-samples of a pixel along each axis where surfaces have edges.


@dataclass(frozen=True, eq=False)
class StereoPairTruth:
    """A rectified pair and what a perfect matcher would find."""

    left: np.ndarray
    """uint8 (rows, columns)."""
    right: np.ndarray
    """uint8 (rows, columns)."""
    disparity: np.ndarray
    """float32 (rows, columns), px: left column minus right column, true also where hidden."""
    visible: np.ndarray
    """bool: the point of the left pixel is in the right image and not hidden there."""


@dataclass(frozen=True)
class Radiometry:
    """How the two photographs differ from each other and from the scene."""

    noise: float = 2.0
    """Standard deviation of the grey values, of 255."""
    gain: float = 1.0
    """Factor on the right image."""
    offset: float = 0.0
    """Added to the right image."""
    blur: float = 0.0
    """Sigma of a blur of both, px."""


@dataclass(frozen=True)
class Layer:
    """A flat surface with an elliptic or rectangular outline: ``disparity = a + b column + c row``."""

    plane: tuple[float, float, float]
    """a, b, c in pixels of the left image."""
    centre: tuple[float, float] = (0.0, 0.0)
    """Column and row of the outline's centre in the left image."""
    half_size: tuple[float, float] = (np.inf, np.inf)
    """Half width and height; infinite covers the image."""
    round: bool = False
    """Ellipse instead of rectangle."""


def noise_texture(shape: tuple[int, int], seed: int = 0, grains: tuple[float, ...] = (1, 3, 9)) -> np.ndarray:
    """Grey values 0..255 (rows, columns), float32, of structures of several sizes (sigma, px)."""
    random = np.random.default_rng(seed)
    total = sum(sigma * cv2.GaussianBlur(random.normal(size=shape), (0, 0), sigma) for sigma in grains)
    total = (total - np.mean(total)) / np.std(total)
    return np.clip(128 + 45 * total, 0, 255).astype(np.float32)


def curved_pair(
    texture: np.ndarray,
    disparity: Callable[[np.ndarray, np.ndarray], np.ndarray],
    columns: int,
    radiometry: Radiometry = Radiometry(),
    seed: int = 0,
) -> StereoPairTruth:
    """A continuous surface without hidden parts.

    Parameters
    ----------
    texture
        Grey values painted on the surface (rows, more than columns); the surplus lies on both sides.
    disparity
        Of left column and row; may change by less than a pixel per column.
    columns
        Width of the images.
    radiometry, seed
        Noise and the like.
    """
    rows = texture.shape[0]
    start = (texture.shape[1] - columns) / 2
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    truth = disparity(x, y)
    partner = x + truth
    for _ in range(_INVERSIONS):
        partner = x + disparity(partner, y)
    left, right = (ndimage.map_coordinates(texture, [y, at + start], mode="reflect") for at in (x, partner))
    inside = (x - truth >= 0) & (x - truth <= columns - 1)
    return StereoPairTruth(*_expose(left, right, radiometry, seed), truth.astype(np.float32), inside)


def layered_pair(
    texture: np.ndarray,
    layers: list[Layer],
    columns: int,
    radiometry: Radiometry = Radiometry(),
    seed: int = 0,
) -> StereoPairTruth:
    """Flat surfaces in front of each other, with hidden parts, by exact ray casting.

    Of the layers at a place, the one with the largest disparity is seen. Each has its own part of
    the texture (rows, columns). Edges are averaged over sub-samples of a pixel.
    """
    rows = texture.shape[0]
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    images = []
    for right in (False, True):
        total = np.zeros((rows, columns))
        for dy in steps:
            for dx in steps:
                total += _cast(texture, layers, x + dx, y + dy, right)[0]
        images.append(total / _SAMPLES**2)
    _, truth, layer = _cast(texture, layers, x, y, right=False)
    _, _, there = _cast(texture, layers, x - truth, y, right=True)
    inside = (x - truth >= 0) & (x - truth <= columns - 1)
    left, right_image = _expose(images[0], images[1], radiometry, seed)
    return StereoPairTruth(left, right_image, truth.astype(np.float32), inside & (layer == there))


def _cast(
    texture: np.ndarray, layers: list[Layer], x: np.ndarray, y: np.ndarray, right: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Grey value, disparity and layer that rays through an image see."""
    nearest = np.full(x.shape, -np.inf)
    seen = np.zeros(x.shape, np.int64)
    place = np.zeros(x.shape)
    for number, layer in enumerate(layers):
        a, b, c = layer.plane
        column = (x + a + c * y) / (1 - b) if right else x
        u, v = ((column - layer.centre[0]) / layer.half_size[0], (y - layer.centre[1]) / layer.half_size[1])
        covered = u * u + v * v <= 1 if layer.round else np.maximum(np.abs(u), np.abs(v)) <= 1
        disparity = a + b * column + c * y
        front = covered & (disparity > nearest)
        nearest[front], seen[front], place[front] = disparity[front], number, column[front]
    height, width = texture.shape
    grey = ndimage.map_coordinates(
        texture, [(y + 97 * seen) % (height - 1), (place + 131 * seen) % (width - 1)], order=3, mode="reflect"
    )
    return grey, nearest, seen


def _expose(
    left: np.ndarray, right: np.ndarray, radiometry: Radiometry, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    exposed = []
    for image, gain, offset in ((left, 1.0, 0.0), (right, radiometry.gain, radiometry.offset)):
        if radiometry.blur > 0:
            image = cv2.GaussianBlur(image, (0, 0), radiometry.blur)
        image = image * gain + offset + random.normal(size=image.shape) * radiometry.noise
        exposed.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    return exposed[0], exposed[1]
