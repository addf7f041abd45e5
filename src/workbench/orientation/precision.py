"""How well the adjustment knows the poses: their covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pycolmap
from scipy import sparse

from workbench.orientation.tie_points import project_with_derivative

_FREE = 1e-12  # Eigenvalues below this share of the largest belong to motions that nothing fixes.


def pose_covariances(
    model: pycolmap.Reconstruction,
    priors: Mapping[str, np.ndarray],
    *,
    fixed_points: Sequence[tuple[np.ndarray, Sequence[str], np.ndarray]] = (),
    observation_sd: float = 1.0,
) -> dict[str, np.ndarray]:
    """Covariances of the poses with lenses held fixed.

    From the normal equations at the solution: ``x_ij`` of tie point j in photograph i depends on its
    place X_j, on the centre C_i and on a small turn t_i about the world's axes by
    ``dx = J (dX - dC + t x (X - C))``; tie points are eliminated (Schur complement), recorded
    positions and surveyed points add their weights.

    Parameters
    ----------
    model
        Adjusted.
    priors
        Covariance (3, 3) of the recorded position by photograph, m2.
    fixed_points
        Control points: place (3,) in the model's frame, photographs, covariance (3, 3).
    observation_sd
        Standard deviation of an image position, px.

    Returns
    -------
    dict of ndarray (6, 6)
        By photograph: x, y, z (metres), turns about x, y, z (radians). NaN where nothing fixes the block.
    """
    ids = sorted(model.reg_image_ids())
    place = {model.image(number).name: k for k, number in enumerate(ids)}
    points = {int(number): k for k, number in enumerate(sorted(model.point3D_ids()))}
    total = len(points) + len(fixed_points)
    rows_a, rows_b = [], []
    for k, number in enumerate(ids):
        image = model.image(number)
        seen = [points[p.point3D_id] for p in image.points2D if p.has_point3D()]
        xyz = [model.point3D(p.point3D_id).xyz for p in image.points2D if p.has_point3D()]
        for j, (point, names, _) in enumerate(fixed_points):
            if image.name in names:
                seen.append(len(points) + j)
                xyz.append(point)
        if not seen:
            continue
        a, b = _design(image, np.array(xyz), k, np.array(seen), len(ids), total)
        rows_a.append(a)
        rows_b.append(b)
    a = sparse.vstack(rows_a).tocsr() / observation_sd
    b = sparse.vstack(rows_b).tocsr() / observation_sd
    normal = (a.T @ a).toarray()
    for name, covariance in priors.items():
        if name in place:
            at = slice(6 * place[name], 6 * place[name] + 3)
            normal[at, at] += np.linalg.inv(covariance)
    blocks = _blocks(b, total)
    for j, (_, _, covariance) in enumerate(fixed_points):
        blocks[len(points) + j] += np.linalg.inv(covariance)
    mixed = (a.T @ b).tocsr()
    inverse = sparse.block_diag(list(np.linalg.pinv(blocks)), format="csr")
    reduced = normal - (mixed @ inverse @ mixed.T).toarray()
    return _split(_invert(reduced), place)


def _design(
    image: pycolmap.Image, xyz: np.ndarray, pose: int, columns: np.ndarray, poses: int, points: int
) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Derivatives of one photograph's n image positions by poses (2n, 6 poses) and points (2n, 3 points)."""
    _, jacobian = project_with_derivative(image, xyz)
    arm = xyz - image.projection_center()
    cross = np.zeros((len(arm), 3, 3))  # [v]x with t x v = -[v]x t
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -arm[:, 2], arm[:, 1], -arm[:, 0]
    cross -= cross.transpose(0, 2, 1)
    by_pose = np.concatenate([-jacobian, -jacobian @ cross], axis=2)
    count = len(xyz)
    rows = np.arange(2 * count)
    a = sparse.csr_matrix(
        (by_pose.ravel(), (np.repeat(rows, 6), np.tile(6 * pose + np.arange(6), 2 * count))),
        shape=(2 * count, 6 * poses),
    )
    at = np.repeat(3 * columns[:, None] + np.arange(3), 2, axis=0)
    b = sparse.csr_matrix((jacobian.ravel(), (np.repeat(rows, 3), at.ravel())), shape=(2 * count, 3 * points))
    return a, b


def _blocks(design: sparse.csr_matrix, count: int) -> np.ndarray:
    """Diagonal blocks (count, 3, 3) of the normal matrix of the points."""
    normal = (design.T @ design).tocoo()
    blocks = np.zeros((count, 3, 3))
    np.add.at(blocks, (normal.row // 3, normal.row % 3, normal.col % 3), normal.data)
    return blocks


def _invert(normal: np.ndarray) -> np.ndarray:
    """Inverse of a normal matrix scaled to a unit diagonal first; NaN if it is singular."""
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    if values[0] < _FREE * values[-1]:
        return np.full_like(normal, np.nan)
    return (vectors / values) @ vectors.T / np.outer(scale, scale)


def _split(covariance: np.ndarray, place: Mapping[str, int]) -> dict[str, np.ndarray]:
    return {name: covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for name, k in place.items()}
