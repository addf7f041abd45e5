"""What each tie point is worth: the four attributes by which they are filtered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap


@dataclass(frozen=True, eq=False)
class TiePoints:
    """Attributes of n tie points [orthomosaic paper 2.4]."""

    numbers: np.ndarray
    """(n,) identifiers in the model."""
    xyz: np.ndarray
    """(n, 3) in the model's frame, metres."""
    reprojection_error: np.ndarray
    """(n,) largest distance between measured and projected position over its photographs, px."""
    reconstruction_uncertainty: np.ndarray
    """(n,) ratio of the largest to the smallest axis of the error ellipsoid."""
    projection_accuracy: np.ndarray
    """(n,) mean size of the features that it was measured with, relative to the finest, from 1."""
    image_count: np.ndarray
    """(n,) photographs that it was measured in."""


def tie_points(model: pycolmap.Reconstruction, scales: dict[str, np.ndarray] | None = None) -> TiePoints:
    """Attributes of all tie points of a model.

    Reprojection error: ``max_i |x_i - proj_i(X)|`` over the photographs i. Reconstruction
    uncertainty: ``sqrt(lmax / lmin)`` with the eigenvalues of the point's covariance
    ``(sum_i J_i^T J_i)^-1``, J_i the derivative of the projection, poses held fixed. Projection
    accuracy: mean over i of ``s_i / s_min`` with the feature sizes s, s_min the first percentile of
    the block (the finest key points).

    Parameters
    ----------
    model
        With poses.
    scales
        Feature size of every key point by photograph name; without it the accuracy is 1.
    """
    numbers = np.array(sorted(model.point3D_ids()), dtype=np.uint64)
    xyz = np.array([model.point3D(int(n)).xyz for n in numbers]).reshape(-1, 3)
    index = {int(n): k for k, n in enumerate(numbers)}
    error = np.zeros(len(numbers))
    normal = np.zeros((len(numbers), 3, 3))
    size, count = np.zeros(len(numbers)), np.zeros(len(numbers), dtype=np.uint16)
    finest = _finest(scales)
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        seen = [(k, p) for k, p in enumerate(image.points2D) if p.has_point3D()]
        if not seen:
            continue
        rows = np.array([index[p.point3D_id] for _, p in seen])
        measured = np.array([p.xy for _, p in seen])
        projected, jacobian = project_with_derivative(image, xyz[rows])
        np.maximum.at(error, rows, np.linalg.norm(projected - measured, axis=1))
        np.add.at(normal, rows, np.einsum("nij,nik->njk", jacobian, jacobian))
        np.add.at(count, rows, 1)
        if scales is not None:
            np.add.at(size, rows, scales[image.name][[k for k, _ in seen]] / finest)
    values = np.linalg.eigvalsh(normal) if len(numbers) else np.ones((0, 3))
    uncertainty = np.sqrt(values[:, 2] / np.maximum(values[:, 0], 1e-12))
    accuracy = size / np.maximum(count, 1) if scales is not None else np.ones(len(numbers))
    return TiePoints(numbers, xyz, error, uncertainty, accuracy, count)


def feature_scales(database: pycolmap.Database) -> dict[str, np.ndarray]:
    """Size of every key point, px, by the name of its photograph."""
    scales = {}
    for image in database.read_all_images():
        keypoints = np.asarray(database.read_keypoints(image.image_id))
        if keypoints.shape[1] >= 6:  # affine shape: the scale is the root of its determinant
            a11, a12, a21, a22 = keypoints[:, 2:6].T
            scales[image.name] = np.sqrt(np.abs(a11 * a22 - a12 * a21))
        else:
            scales[image.name] = keypoints[:, 2]
    return scales


def _finest(scales: dict[str, np.ndarray] | None) -> float:
    if not scales:
        return 1.0
    return float(np.percentile(np.concatenate(list(scales.values())), 1))


def project_with_derivative(image: pycolmap.Image, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 2) and derivatives (n, 2, 3) by the point, px and px/m."""
    matrix = image.cam_from_world().matrix()
    rotation = matrix[:, :3]

    def positions(world: np.ndarray) -> np.ndarray:
        return np.asarray(image.camera.img_from_cam(world @ rotation.T + matrix[:, 3]))

    base = positions(points)
    step = 1e-3
    columns = [(positions(points + step * axis) - base) / step for axis in np.eye(3)]
    return base, np.stack(columns, axis=2)
