"""What lens, shutter and sensor make of the light: from radiance to the numbers of a photograph."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from workbench.cameras import Camera, Pose
from workbench.errors import SceneError

_REACH = 3.5  # Standard deviations after which the point spread is cut off.
_STEPS = 9  # Samples of the path of a point within a pixel of motion.


@dataclass(frozen=True)
class Optics:
    """Lens, shutter and sensor."""

    point_spread: float = 0.0
    """Standard deviation of the lens point spread, px."""
    vignetting: float = 0.0
    """Share of light lost in the corners of the whole frame, 0 to below 1."""
    exposure_time: float = 0.0
    """Seconds; with the speed it gives the motion blur."""
    readout_time: float = 0.0
    """Seconds between the first and the last row of a rolling shutter; 0 exposes all rows at once."""
    brightness: float = 1.0
    """Radiance times this reaches full scale at 1."""
    full_well: float = np.inf
    """Electrons at full scale; photon noise falls as it grows."""
    read_noise: float = 0.0
    """Standard deviation, electrons."""

    def __post_init__(self) -> None:
        if min(self.point_spread, self.exposure_time, self.readout_time, self.read_noise) < 0:
            raise SceneError("Point spread, exposure, readout time and read noise must not be negative.")
        if not 0 <= self.vignetting < 1 or not min(self.full_well, self.brightness) > 0:
            raise SceneError(
                "Vignetting is a share from 0 to below 1; full well and brightness are positive."
            )


def image_motion(camera: Camera, pose: Pose, velocity: np.ndarray, ground: float) -> np.ndarray:
    """Speed (columns, rows) of the ground in the middle of the photograph, px/s."""
    ray = pose.to_world(camera.rays(np.array([[camera.width / 2, camera.height / 2]])))[0]
    place = pose.centre + (ground - pose.centre[2]) / ray[2] * ray
    step = 1e-3
    later = Pose(pose.rotation, pose.centre + step * np.asarray(velocity))
    before, after = (camera.project(p.to_camera(place[None]))[0] for p in (pose, later))
    return (after - before) / step


def expose(
    radiance: np.ndarray,
    optics: Optics,
    *,
    motion: np.ndarray | tuple[float, float] = (0.0, 0.0),
    whole_frame: tuple[int, int] | None = None,
    rng: np.random.Generator,
) -> np.ndarray:
    """Numbers of a photograph, linear in the light: shutter, lens, vignetting, noise, saturation.

    Parameters
    ----------
    radiance
        (band, row, column) float32.
    optics
        Lens, shutter and sensor.
    motion
        Speed of the ground in the photograph (columns, rows), px/s.
    whole_frame
        Columns and rows of the uncropped frame, whose corners the vignetting refers to.
    rng
        Source of the noise.

    Returns
    -------
    ndarray (band, row, column) float32, 0..1
    """
    u, v = float(motion[0]), float(motion[1])
    rolled = roll_shutter(radiance, (u * optics.readout_time, v * optics.readout_time))
    kernel = blur_kernel(optics.point_spread, (u * optics.exposure_time, v * optics.exposure_time))
    shape = radiance.shape[1:]
    shade = vignette(shape, optics.vignetting, whole_frame) * np.float32(optics.brightness)
    bands = []
    for band in rolled:
        light = band if kernel.size == 1 else cv2.filter2D(band, -1, kernel, borderType=cv2.BORDER_REPLICATE)
        bands.append(_count(np.maximum(light, 0) * shade, optics, rng))
    return np.stack(bands)


def blur_kernel(point_spread: float, path: tuple[float, float]) -> np.ndarray:
    """Lens point spread drawn out along the path of the ground during the exposure.

    Parameters
    ----------
    point_spread
        Standard deviation, px.
    path
        Columns and rows that the ground moves during the exposure, px.

    Returns
    -------
    ndarray (2 n + 1, 2 n + 1) float32 with the sum 1, symmetric about its middle.
    """
    length = float(np.hypot(*path))
    if point_spread == 0 and length == 0:
        return np.ones((1, 1), dtype=np.float32)
    # A pixel cannot hold a spread below this width; a narrower one is a point.
    sigma = max(point_spread, 0.2)
    reach = int(np.ceil(_REACH * sigma + length / 2))
    axis = np.arange(-reach, reach + 1)
    steps = 1 if length == 0 else max(_STEPS, int(np.ceil(length * _STEPS)))
    places = (np.arange(steps) + 0.5) / steps - 0.5
    kernel = np.zeros((axis.size, axis.size))
    for place in places:
        column = np.exp(-0.5 * ((axis - place * path[0]) / sigma) ** 2)
        row = np.exp(-0.5 * ((axis - place * path[1]) / sigma) ** 2)
        kernel += np.outer(row / row.sum(), column / column.sum())
    return (kernel / kernel.sum()).astype(np.float32)


def vignette(shape: tuple[int, int], loss: float, whole_frame: tuple[int, int] | None = None) -> np.ndarray:
    """Share of light (row, column) that reaches the sensor: 1 in the middle, ``1 - loss`` in the corners."""
    rows, columns = shape
    whole_columns, whole_rows = whole_frame or (columns, rows)
    y = (np.arange(rows) + 0.5 - rows / 2) / (whole_rows / 2)
    x = (np.arange(columns) + 0.5 - columns / 2) / (whole_columns / 2)
    aspect = whole_rows / whole_columns
    radius2 = (x[None, :] ** 2 + (y[:, None] * aspect) ** 2) / (1 + aspect**2)
    return (1 - loss * radius2).astype(np.float32)


def roll_shutter(radiance: np.ndarray, path: tuple[float, float]) -> np.ndarray:
    """Rows exposed one after the other while the ground moves by ``path`` (columns, rows), px.

    The middle row is exposed at the nominal moment. The motion is taken as uniform over the photograph,
    which holds where the relief is small against the height of flight.
    """
    if not any(path):
        return radiance
    rows, columns = radiance.shape[1:]
    moment = ((np.arange(rows) + 0.5) / rows - 0.5)[:, None]
    column = np.broadcast_to(np.arange(columns)[None, :] - path[0] * moment, (rows, columns))
    row = np.broadcast_to(np.arange(rows)[:, None] - path[1] * moment, (rows, columns))
    maps = np.ascontiguousarray(column, dtype=np.float32), np.ascontiguousarray(row, dtype=np.float32)
    return np.stack(
        [cv2.remap(band, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE) for band in radiance]
    )


def tone(linear: np.ndarray) -> np.ndarray:
    """8-bit numbers of linear light 0..1, by the curve of sRGB (IEC 61966-2-1)."""
    light = np.clip(linear, 0, 1)
    curve = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.power(light, 1 / 2.4) - 0.055)
    return np.round(curve * 255).astype(np.uint8)


def _count(light: np.ndarray, optics: Optics, rng: np.random.Generator) -> np.ndarray:
    """Light with photon and read noise, cut off at full scale."""
    if np.isinf(optics.full_well):
        return np.minimum(light, 1).astype(np.float32)
    # At more than a few electrons the Poisson distribution is a normal one of the same variance.
    variance = light / optics.full_well + (optics.read_noise / optics.full_well) ** 2
    noise = rng.standard_normal(light.shape, dtype=np.float32)
    return np.clip(light + np.sqrt(variance, dtype=np.float32) * noise, 0, 1).astype(np.float32)
