"""The inner orientation of a camera: central projection with Brown-Conrady distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from workbench.errors import CameraError

_UNDISTORT_STEPS = 30
_UNDISTORT_TOLERANCE = 1e-12


@dataclass(frozen=True)
class Camera:
    """Inner orientation of a camera.

    Image positions are ``(column, row)`` in pixels with the origin at the upper left corner of the
    upper left pixel (so that its centre is at 0.5, 0.5), as in COLMAP. Camera axes: x right, y down,
    z forward.
    """

    name: str
    """Make, model and lens, or any unique name."""
    width: int
    """Columns."""
    height: int
    """Rows."""
    focal_x: float
    """Focal length over pixel width, px."""
    focal_y: float
    """Focal length over pixel height, px."""
    principal_x: float
    """Column of the principal point, px."""
    principal_y: float
    """Row of the principal point, px."""
    distortion: tuple[float, ...] = (0.0,) * 8
    """k1, k2, p1, p2, k3, k4, k5, k6 of the (rational) Brown-Conrady model, in OpenCV's order."""
    pixel_size: float | None = None
    """Edge of a pixel on the sensor, metres, where known."""

    def __post_init__(self) -> None:
        if min(self.width, self.height) < 1 or not (self.focal_x > 0 and self.focal_y > 0):
            raise CameraError(
                f"Camera {self.name}: {self.width} x {self.height} pixels with focal lengths "
                f"{self.focal_x}, {self.focal_y} px is impossible."
            )
        if len(self.distortion) > 8:
            raise CameraError(f"Camera {self.name}: at most 8 distortion coefficients are known.")
        padded = tuple(float(k) for k in self.distortion) + (0.0,) * (8 - len(self.distortion))
        object.__setattr__(self, "distortion", padded)

    @classmethod
    def from_focal_length(
        cls,
        name: str,
        width: int,
        height: int,
        *,
        focal_length: float,
        pixel_size: float,
        distortion: tuple[float, ...] = (),
        principal_offset: tuple[float, float] = (0.0, 0.0),
    ) -> Camera:
        """Camera from focal length and pixel size (both metres); principal offset in pixels."""
        focal = focal_length / pixel_size
        return cls(
            name,
            width,
            height,
            focal,
            focal,
            width / 2 + principal_offset[0],
            height / 2 + principal_offset[1],
            distortion,
            pixel_size,
        )

    @property
    def matrix(self) -> np.ndarray:
        """Camera matrix (3, 3) for image positions whose origin is the corner of the first pixel."""
        return np.array(
            [
                [self.focal_x, 0, self.principal_x],
                [0, self.focal_y, self.principal_y],
                [0, 0, 1.0],
            ]
        )

    @property
    def opencv_matrix(self) -> np.ndarray:
        """Camera matrix (3, 3) for OpenCV, whose origin is the centre of the first pixel."""
        matrix = self.matrix
        matrix[:2, 2] -= 0.5
        return matrix

    def scaled(self, factor: float) -> Camera:
        """The same camera with its photograph reduced by a factor (2 halves both edges)."""
        return replace(
            self,
            width=max(int(self.width / factor), 1),
            height=max(int(self.height / factor), 1),
            focal_x=self.focal_x / factor,
            focal_y=self.focal_y / factor,
            principal_x=self.principal_x / factor,
            principal_y=self.principal_y / factor,
            pixel_size=None if self.pixel_size is None else self.pixel_size * factor,
        )

    def distort(self, plane: np.ndarray) -> np.ndarray:
        """Distorted positions (n, 2) in the plane z = 1 of undistorted ones (n, 2)."""
        k1, k2, p1, p2, k3, k4, k5, k6 = self.distortion
        x, y = plane[..., 0], plane[..., 1]
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.stack([x * radial + dx, y * radial + dy], axis=-1)

    def undistort(self, plane: np.ndarray) -> np.ndarray:
        """Inverse of :meth:`distort` by fixed-point iteration, (n, 2)."""
        if not any(self.distortion):
            return np.array(plane, dtype=float)
        undistorted = np.array(plane, dtype=float)
        for _ in range(_UNDISTORT_STEPS):
            step = plane - self.distort(undistorted)
            undistorted += step
            if not step.size or np.nanmax(np.abs(step)) < _UNDISTORT_TOLERANCE:
                break
        return undistorted

    def project(self, points: np.ndarray) -> np.ndarray:
        """Image positions (n, 2) of points (n, 3) in camera axes; NaN behind the camera."""
        depth = np.where(points[..., 2] > 0, points[..., 2], np.nan)
        plane = self.distort(points[..., :2] / depth[..., None])
        return plane * (self.focal_x, self.focal_y) + (self.principal_x, self.principal_y)

    def rays(self, positions: np.ndarray) -> np.ndarray:
        """Directions (n, 3) in camera axes, with z = 1, of image positions (n, 2)."""
        plane = (positions - (self.principal_x, self.principal_y)) / (self.focal_x, self.focal_y)
        plane = self.undistort(plane)
        return np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)

    def contains(self, positions: np.ndarray) -> np.ndarray:
        """Whether image positions (n, 2) lie within the frame, (n,) bool; NaN is outside."""
        column, row = positions[..., 0], positions[..., 1]
        return (column >= 0) & (column < self.width) & (row >= 0) & (row < self.height)
