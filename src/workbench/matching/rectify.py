"""Epipolar rectification for any direction of the base, with undistortion in one resampling."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from workbench.cameras import Camera, Pose
from workbench.errors import MatchingError
from workbench.matching.pairs import StereoPair
from workbench.orientation import OrientedPhotograph


@dataclass(frozen=True)
class RowOffsets:
    """How far lower points lie in the right image than their row says: a surface of second degree.

    In tangents (pixels over the focal length), so that it holds for every downscale of a pair.
    """

    coefficients: tuple[float, ...]
    """Of 1, x, y, xy, xx, yy."""
    lowest: float
    """Least offset that was seen: beyond what was measured the surface would run away."""
    highest: float
    """Largest offset that was seen."""

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Offsets, tangent, at tangents across and down in the right image."""
        return np.clip(self.terms(x, y) @ np.array(self.coefficients), self.lowest, self.highest)

    @staticmethod
    def terms(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """What the coefficients belong to, (..., 6)."""
        return np.stack([np.ones_like(x), x, y, x * y, x * x, y * y], axis=-1)


@dataclass(frozen=True, eq=False)
class Rectification:
    """A pair in which a point lies in the same row of both images.

    The disparity is column left minus column right, from 0 to ``disparities``; a point at depth Z
    (along the common axis) has ``focal * base / Z - shift``.
    """

    rotation: np.ndarray
    """(3, 3): world to the common frame; x along the base, z the mean viewing direction."""
    centre: np.ndarray
    """(3,): projection centre of the left image, world."""
    focal: float
    """Focal length of both, px."""
    principal: tuple[float, float]
    """Column and row of the left principal point, px, origin at the corner of the first pixel."""
    base: float
    """Distance of the centres, metres."""
    shift: float
    """Disparity of the nearest background, subtracted so that the range begins at 0, px."""
    disparities: int
    """Width of the range, px."""
    shape: tuple[int, int]
    """Rows and columns of the rectified images."""
    rows: RowOffsets | None = None
    """What orientation left of vertical parallax, as far as it is known; taken out of the right image."""

    def points(self, columns: np.ndarray, rows: np.ndarray, disparity: np.ndarray) -> np.ndarray:
        """World points (..., 3) of left pixels (positions, origin at the corner) with a disparity."""
        depth = self.focal * self.base / (disparity + self.shift)
        plane = np.stack(
            [(columns - self.principal[0]) / self.focal, (rows - self.principal[1]) / self.focal], axis=-1
        )
        rays = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
        return self.centre + (rays * depth[..., None]) @ self.rotation

    def height_precision(self, height: np.ndarray, disparity_sd: float = 0.3) -> np.ndarray:
        """Standard deviation of heights, metres, at world heights: ``Z^2 / (focal base) * sd``."""
        depth = np.maximum(self.centre[2] - height, 1e-6)
        return np.asarray(depth**2 / (self.focal * self.base) * disparity_sd, dtype=np.float32)


def rectify_pair(
    pair: StereoPair, heights: tuple[float, float], *, downscale: int
) -> tuple[Rectification, bool]:
    """Common frame of a pair (Fusiello et al. 2000) that holds what both see between two heights.

    Returns
    -------
    rectification : Rectification
    swapped : bool
        Whether ``pair.right`` is the left image of the rectified pair.

    Raises
    ------
    MatchingError
        If the base is zero, or the photographs see nothing in common between the heights.
    """
    first, second = pair.left, pair.right
    if pair.base < 1e-3:
        raise MatchingError(f"{pair.name}: both photographs stand at one place; there is no base to match.")
    axis = first.pose.view_direction + second.pose.view_direction
    # The image should stand as the photographs do: x to their right decides which one is left.
    swapped = bool((second.pose.centre - first.pose.centre) @ first.pose.rotation[0] < 0)
    x = (second.pose.centre - first.pose.centre) / pair.base
    if abs(x @ first.pose.rotation[0]) < abs(x @ first.pose.rotation[1]):
        # A base along the image's columns: any of the two may be left; keep the names' order.
        swapped = False
    left, right = (second, first) if swapped else (first, second)
    x = (right.pose.centre - left.pose.centre) / pair.base
    z = axis - (axis @ x) * x
    z /= np.linalg.norm(z)
    rotation = np.stack([x, np.cross(z, x), z])
    focal = (left.camera.focal_x + right.camera.focal_x) / 2 / downscale
    near, far = _depth_range(pair, rotation, heights)
    shift = np.floor(focal * pair.base / far - 1)
    disparities = int(np.ceil(focal * pair.base / near + 1 - shift))
    low, high = _frame(left, right, rotation, focal, shift, disparities)
    columns, rows = np.ceil(high - low).astype(int)
    if columns < 16 or rows < 16:
        raise MatchingError(f"{pair.name}: the photographs have nothing in common at heights {heights}.")
    rectification = Rectification(
        rotation=rotation,
        centre=left.pose.centre,
        focal=focal,
        principal=(-float(low[0]), -float(low[1])),
        base=pair.base,
        shift=float(shift),
        disparities=max(disparities, 8),
        shape=(int(rows), int(columns)),
    )
    return rectification, swapped


def resample(
    image: np.ndarray, camera: Camera, pose: Pose, rectification: Rectification, *, right: bool
) -> np.ndarray:
    """Rectified grey image (rows, columns) float32, NaN outside the photograph.

    Parameters
    ----------
    image
        Grey photograph (rows, columns), possibly reduced against ``camera`` by a whole factor.
    camera, pose
        Of the full photograph.
    rectification
        The common frame.
    right
        Whether this is the right image, whose principal point is moved by the shift.
    """
    rows, columns = rectification.shape
    cx = rectification.principal[0] + (rectification.shift if right else 0.0)
    # Projecting every 8th position and interpolating is exact to a few thousandths of a pixel.
    step = 8
    u = np.arange(0, columns + step, step) + 0.5
    v = np.arange(0, rows + step, step) + 0.5
    plane = np.stack(
        np.meshgrid((u - cx) / rectification.focal, (v - rectification.principal[1]) / rectification.focal),
        -1,
    )
    if right and rectification.rows is not None:
        plane[..., 1] += rectification.rows.at(plane[..., 0], plane[..., 1])
    rays = np.concatenate([plane, np.ones((*plane.shape[:2], 1))], -1) @ rectification.rotation
    positions = camera.project((rays @ pose.rotation.T).reshape(-1, 3)).reshape(len(v), len(u), 2)
    # A reduced photograph lacks the remainder of its last row and column: its pixels keep their scale.
    reduced = max(round(camera.width / image.shape[1]), 1)
    coarse = (positions / reduced - 0.5).astype(np.float32)
    grid_x, grid_y = np.meshgrid(
        np.arange(columns, dtype=np.float32) / step, np.arange(rows, dtype=np.float32) / step
    )
    maps = [cv2.remap(np.ascontiguousarray(coarse[..., k]), grid_x, grid_y, cv2.INTER_LINEAR) for k in (0, 1)]
    source = image.astype(np.float32)
    sampled = cv2.remap(source, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = (
        (maps[0] >= 0) & (maps[0] <= image.shape[1] - 1) & (maps[1] >= 0) & (maps[1] <= image.shape[0] - 1)
    )
    sampled[~inside] = np.nan
    return sampled


def _depth_range(pair: StereoPair, rotation: np.ndarray, heights: tuple[float, float]) -> tuple[float, float]:
    """Nearest and farthest depth along the common axis of what the left frame sees between two heights."""
    depths = []
    for photograph in (pair.left, pair.right):
        rays = photograph.pose.to_world(photograph.camera.rays(_outline(photograph.camera)))
        for level in heights:
            reach = (level - photograph.pose.centre[2]) / np.minimum(rays[:, 2], -0.05)
            depths.append((rays * reach[:, None]) @ rotation[2])
    depth = np.concatenate(depths)
    depth = depth[depth > 0]
    return float(depth.min()), float(depth.max())


def _frame(
    left: OrientedPhotograph,
    right: OrientedPhotograph,
    rotation: np.ndarray,
    focal: float,
    shift: float,
    disparities: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest column and row, relative to the left principal point, that can have a match."""
    (left_low, left_high), (right_low, right_high) = (
        _rectified_bounds(photograph, rotation, focal) for photograph in (left, right)
    )
    right_low[0] += shift
    right_high[0] += shift
    # A left column u meets right columns u - disparities ... u.
    first = min(max(left_low[0], right_low[0]), max(right_low[0], left_low[0] - disparities))
    last = max(min(left_high[0], right_high[0] + disparities), min(right_high[0], left_high[0]))
    top, bottom = max(left_low[1], right_low[1]), min(left_high[1], right_high[1])
    return np.floor([first, top]), np.ceil([last, bottom])


def _rectified_bounds(
    photograph: OrientedPhotograph, rotation: np.ndarray, focal: float
) -> tuple[np.ndarray, np.ndarray]:
    rays = photograph.pose.to_world(photograph.camera.rays(_outline(photograph.camera))) @ rotation.T
    plane = rays[rays[:, 2] > 0.05]
    plane = plane[:, :2] / plane[:, 2:] * focal
    return plane.min(axis=0), plane.max(axis=0)


def _outline(camera: Camera) -> np.ndarray:
    edge = np.linspace(0, 1, 9)
    zero, one = np.zeros(9), np.ones(9)
    unit = np.concatenate(
        [np.stack(p, axis=1) for p in ((edge, zero), (edge, one), (zero, edge), (one, edge))]
    )
    return unit * (camera.width, camera.height)
