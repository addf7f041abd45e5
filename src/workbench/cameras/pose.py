"""The outer orientation of a photograph, and the angles that describe it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Photogrammetric image axes are x right, y up, z backward; ours are x right, y down, z forward.
_IMAGE_AXES = np.diag([1.0, -1.0, -1.0])
# Camera axes in a body (forward, right, down) with the camera looking down, top of the frame forward.
_NADIR_MOUNT = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a camera stood and how it was turned, in a right-handed metric frame (x east, y north)."""

    rotation: np.ndarray
    """(3, 3): turns world vectors into camera axes (x right, y down, z forward)."""
    centre: np.ndarray
    """(3,): projection centre in world coordinates, metres."""

    @classmethod
    def from_omega_phi_kappa(cls, centre: np.ndarray, omega: float, phi: float, kappa: float) -> Pose:
        """Pose from photogrammetric angles, degrees: image to world is Rx(omega) Ry(phi) Rz(kappa)."""
        to_world = _rx(omega) @ _ry(phi) @ _rz(kappa)
        return cls(_IMAGE_AXES @ to_world.T, np.asarray(centre, dtype=float))

    @classmethod
    def from_roll_pitch_heading(
        cls,
        centre: np.ndarray,
        roll: float,
        pitch: float,
        heading: float,
        *,
        tilt_right: float = 0.0,
        tilt_forward: float = 0.0,
    ) -> Pose:
        """Pose from aircraft angles, degrees (ARINC 705: right wing down, nose up, clockwise from north).

        The camera looks down with the top of its frame forward, then is tilted to the right and
        forward; the side cameras of the 3K system have ``tilt_right`` of -35 and 35.
        """
        body_to_world = _ENU_FROM_NED @ _rz(heading) @ _ry(pitch) @ _rx(roll)
        # Right is +y of the body; looking right from straight down turns about the forward axis.
        mount = _rx(-tilt_right) @ _ry(tilt_forward) @ _NADIR_MOUNT
        return cls((body_to_world @ mount).T, np.asarray(centre, dtype=float))

    @property
    def omega_phi_kappa(self) -> tuple[float, float, float]:
        """Photogrammetric angles, degrees, -180..180 (phi -90..90)."""
        m = self.rotation.T @ _IMAGE_AXES
        phi = np.arcsin(np.clip(m[0, 2], -1, 1))
        omega = np.arctan2(-m[1, 2], m[2, 2])
        kappa = np.arctan2(-m[0, 1], m[0, 0])
        return float(np.degrees(omega)), float(np.degrees(phi)), float(np.degrees(kappa))

    @property
    def view_direction(self) -> np.ndarray:
        """Unit vector (3,) of the optical axis in world coordinates."""
        return self.rotation[2]

    @property
    def translation(self) -> np.ndarray:
        """(3,): the t of ``camera = rotation @ world + t``."""
        return -self.rotation @ self.centre

    def to_camera(self, points: np.ndarray) -> np.ndarray:
        """World points (n, 3) in camera axes."""
        return (points - self.centre) @ self.rotation.T

    def to_world(self, directions: np.ndarray) -> np.ndarray:
        """Directions (n, 3) of camera axes as world vectors."""
        return directions @ self.rotation


def _rx(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _ry(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _rz(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
