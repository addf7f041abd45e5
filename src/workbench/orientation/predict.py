"""Where a surveyed point should be in the photographs, once it is measured in two of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from workbench.errors import OrientationError
from workbench.orientation.block import Block
from workbench.site import Observation

_ROUNDS = 20
_CONVERGED = 1e-8


def predict_observation(block: Block, point_observations: Sequence[Observation]) -> dict[str, np.ndarray]:
    """Image positions of a point in all photographs whose frame it falls into.

    Parameters
    ----------
    block
        Oriented photographs.
    point_observations
        Measurements of one point in at least two of them.

    Returns
    -------
    dict of ndarray (2,)
        Column and row, px, by name of the photograph; occlusion is not tested.

    Raises
    ------
    OrientationError
        If the measurements are of several points, fewer than two are in oriented photographs, their rays
        are parallel, or they contradict each other beyond any point.
    """
    point = intersect(block, point_observations)
    positions = {photograph.name: photograph.project(point[None])[0] for photograph in block}
    return {
        photograph.name: positions[photograph.name]
        for photograph in block
        if photograph.camera.contains(positions[photograph.name][None])[0]
    }


def intersect(block: Block, point_observations: Sequence[Observation]) -> np.ndarray:
    """Point (3,), metres in the block's CRS, with the least squares of its image residuals.

    Raises
    ------
    OrientationError
        As :func:`predict_observation`.
    """
    names = {o.name for o in point_observations}
    if len(names) > 1:
        raise OrientationError(f"Measurements of several points are mixed: {', '.join(sorted(names))}.")
    by_name = {photograph.name: photograph for photograph in block}
    used = [o for o in point_observations if o.photo in by_name]
    name = next(iter(names), "?")
    if len({o.photo for o in used}) < 2:
        raise OrientationError(
            f"Point {name} is measured in {len(used)} oriented photograph(s): measure it in two."
        )
    views = [by_name[o.photo] for o in used]
    measured = np.array([[o.column, o.row] for o in used])
    origin = np.mean([view.pose.centre for view in views], axis=0)
    point = _nearest_to_rays(views, measured, origin, name)
    if not np.isfinite(_residual(views, measured, point)).all():
        raise OrientationError(
            f"Point {name}: its rays meet behind a camera, so one of its measurements is wrong."
        )
    for _ in range(_ROUNDS):
        residual = _residual(views, measured, point)
        change = np.linalg.lstsq(_derivative(views, point), residual, rcond=None)[0]
        # Measurements that contradict each other send a full step astray, even behind a camera.
        while not np.linalg.norm(_residual(views, measured, point + change)) <= np.linalg.norm(residual):
            change = change / 2
            if np.linalg.norm(change) < _CONVERGED:
                return point
        point = point + change
        if np.linalg.norm(change) < _CONVERGED:
            break
    return point


def _nearest_to_rays(views: Sequence, measured: np.ndarray, origin: np.ndarray, name: str) -> np.ndarray:
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for view, position in zip(views, measured, strict=True):
        ray = view.pose.to_world(view.camera.rays(position[None]))[0]
        ray = ray / np.linalg.norm(ray)
        across = np.eye(3) - np.outer(ray, ray)
        normal += across
        right += across @ (view.pose.centre - origin)
    if np.linalg.cond(normal) > 1e8:
        raise OrientationError(
            f"Point {name}: the rays of its photographs are parallel; measure another one."
        )
    return origin + np.linalg.solve(normal, right)


def _residual(views: Sequence, measured: np.ndarray, point: np.ndarray) -> np.ndarray:
    return np.concatenate([m - v.project(point[None])[0] for v, m in zip(views, measured, strict=True)])


def _derivative(views: Sequence, point: np.ndarray, step: float = 1e-3) -> np.ndarray:
    moved = np.concatenate([point + step * np.eye(3), point - step * np.eye(3)])
    rows = []
    for view in views:
        position = view.project(moved)
        rows.append((position[:3] - position[3:]).T / (2 * step))
    return np.vstack(rows)
