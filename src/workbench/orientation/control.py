"""Surveyed points: into the model's frame, into the adjustment, and what they say of its error."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap

from workbench.errors import OrientationError
from workbench.orientation.tie_points import project_with_derivative
from workbench.site import ControlPoint, Observation, on_a_line

_LEAST_CONTROL = 3
_GROSS = 5.0
_BEND = 0.01  # Of the distance from camera to point: so much may a block be bent before its adjustment.
_LEAST_SPARE = 10  # Measurements more than the places of the points need: a fifth of the precision is known.
_STEP = 1e-4  # Metres, of the numerical derivative.
_UNKNOWN = (float("nan"), float("nan"), float("nan"), float("nan"))


@dataclass(frozen=True)
class PointResidual:
    """How a surveyed point fits."""

    name: str
    """Name of the point."""
    role: str
    """control, check or verify; unused if it is seen in fewer than two photographs."""
    photographs: int
    """Registered photographs that it was measured in."""
    dx: float
    """Estimated minus surveyed x, metres."""
    dy: float
    """Estimated minus surveyed y, metres."""
    dz: float
    """Estimated minus surveyed z, metres."""
    reprojection_px: float
    """Root mean square of its image residuals, px."""


def triangulate(
    model: pycolmap.Reconstruction, observations: Sequence[tuple[str, float, float]]
) -> np.ndarray | None:
    """Point (3,) that fits image measurements (photo, column, row) best; None with fewer than two.

    Least squares of the image residuals, from the point nearest to all rays. None also if the rays do not
    meet in front of the cameras, or the lens has no ray: a measurement or a pose is then wrong.
    """
    views = []
    for photo, column, row in observations:
        image = model.find_image_with_name(photo)
        if image is not None and image.has_pose:
            views.append((image, np.array([column, row])))
    if len(views) < 2:
        return None
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for image, position in views:
        inside = image.camera.cam_from_img(position)
        if inside is None:  # The lens shows nothing there.
            return None
        direction = image.cam_from_world().rotation.inverse() * np.append(inside, 1.0)
        direction /= np.linalg.norm(direction)
        across = np.eye(3) - np.outer(direction, direction)
        normal += across
        right += across @ image.projection_center()
    point = np.linalg.solve(normal, right)
    for _ in range(10):
        residual, design = [], []
        for image, position in views:
            shown = image.project_point(point)
            moved = [image.project_point(point + _STEP * axis) for axis in np.eye(3)]
            if shown is None or any(place is None for place in moved):
                return None
            residual.append(position - shown)
            design.append(np.stack([(place - shown) / _STEP for place in moved], axis=1))
        change = np.linalg.lstsq(np.vstack(design), np.concatenate(residual), rcond=None)[0]
        point = point + change
        if np.linalg.norm(change) < 1e-7:
            break
    return point


def by_point(observations: Sequence[Observation]) -> dict[str, list[tuple[str, float, float]]]:
    """Measurements (photo, column, row) of each point by its name."""
    grouped: dict[str, list[tuple[str, float, float]]] = defaultdict(list)
    for o in observations:
        grouped[o.name].append((o.photo, o.column, o.row))
    return grouped


def align_to_control(
    model: pycolmap.Reconstruction,
    control: Sequence[ControlPoint],
    measured: Mapping[str, list[tuple[str, float, float]]],
    offset: np.ndarray,
) -> tuple[str, ...]:
    """Move, turn and scale a model onto its control points; robust against gross errors.

    Returns
    -------
    tuple of str
        Names of control points that do not fit the others: gross errors, to be left out.

    Raises
    ------
    OrientationError
        If fewer than three points can be used, or they lie on a line.
    """
    source, target, names, tolerance, distance = [], [], [], [], []
    for point in control:
        found = triangulate(model, measured.get(point.name, [])) if point.role == "control" else None
        if found is not None:
            source.append(found)
            target.append(np.array([point.x, point.y, point.z]) - offset)
            names.append(point.name)
            tolerance.append(max(point.sd_xy, point.sd_z))
            centre = _centre(model, measured[point.name])
            distance.append(float(np.linalg.norm(found - centre)))
    if len(source) < _LEAST_CONTROL:
        raise OrientationError(
            f"{len(source)} control point(s) measured in two or more registered photographs; at least "
            f"{_LEAST_CONTROL} are needed to fix a block. Measure more, or use recorded positions."
        )
    src, tgt = np.array(source), np.array(target)
    bend = _BEND * _scale(src, tgt) * float(np.median(distance))
    keep = _consistent(src, tgt, np.maximum(_GROSS * np.array(tolerance), bend))
    # After what is far off, or one point in another zone would make the others look like a line.
    if on_a_line(tgt[keep]):
        raise OrientationError(
            f"Control points {', '.join(names)} lie on a line: the block could turn about it. Add one beside."
        )
    fit = _umeyama(src[keep], tgt[keep])
    model.transform(fit)
    return tuple(name for name, good in zip(names, keep, strict=True) if not good)


def residuals(
    model: pycolmap.Reconstruction,
    points: Sequence[ControlPoint],
    measured: Mapping[str, list[tuple[str, float, float]]],
    offset: np.ndarray,
    unused: Sequence[str] = (),
) -> list[PointResidual]:
    """Residual of every surveyed point, from the poses alone."""
    rows = []
    for point in points:
        observations = [
            o
            for o in measured.get(point.name, [])
            if (image := model.find_image_with_name(o[0])) is not None and image.has_pose
        ]
        estimate = triangulate(model, observations)
        if estimate is None:
            rows.append(PointResidual(point.name, "unused", len(observations), *_UNKNOWN))
            continue
        difference = estimate + offset - (point.x, point.y, point.z)
        image_residuals = [
            model.find_image_with_name(photo).project_point(estimate) - (column, row)
            for photo, column, row in observations
        ]
        error = float(np.sqrt(np.mean(np.square(np.linalg.norm(image_residuals, axis=1)))))
        role = "unused" if point.name in unused else point.role
        dx, dy, dz = map(float, difference)
        rows.append(PointResidual(point.name, role, len(observations), dx, dy, dz, error))
    return rows


def pointing_precision(rows: Sequence[PointResidual]) -> float | None:
    """Standard deviation of the pointed measurements of control points, px, by how well their rays meet.

    Returns
    -------
    float or None
        None with too few measurements to tell.
    """
    chosen = [row for row in rows if row.role == "control" and row.photographs > 1]
    spare = sum(2 * row.photographs - 3 for row in chosen)
    if spare < _LEAST_SPARE:
        return None
    squares = sum(row.photographs * row.reprojection_px**2 for row in chosen)
    return float(np.sqrt(squares / spare))


def worst_fitting(
    model: pycolmap.Reconstruction,
    rows: Sequence[PointResidual],
    points: Sequence[ControlPoint],
    measured: Mapping[str, list[tuple[str, float, float]]],
    *,
    observation_sd: float,
) -> tuple[str, float]:
    """The control point that fits worst after an adjustment, and its residual in standard deviations.

    The standard deviations are those of the survey and of the image measurements, by which the rays to the
    point meet where they do; those of the poses are not counted.

    Parameters
    ----------
    rows
        Of :func:`residuals`.
    points
        Control points in the adjustment, at least one.
    observation_sd
        Of an image position, px.
    """
    by_name = {row.name: row for row in rows}
    found = ("", -1.0)
    for point in points:
        row = by_name[point.name]
        estimate = triangulate(model, measured[point.name])
        if estimate is None or row.role == "unused":
            continue
        covariance = np.diag(np.square([point.sd_xy, point.sd_xy, point.sd_z]))
        covariance += observation_sd**2 * intersection_cofactors(model, estimate, measured[point.name])
        difference = np.array([row.dx, row.dy, row.dz])
        sds = float(np.sqrt(difference @ np.linalg.solve(covariance, difference)))
        if sds > found[1]:
            found = (point.name, sds)
    return found


def intersection_cofactors(
    model: pycolmap.Reconstruction, place: np.ndarray, observations: Sequence[tuple[str, float, float]]
) -> np.ndarray:
    """Covariance (3, 3) of the place where rays of known poses meet, m2 per px2 of the image positions."""
    normal = np.zeros((3, 3))
    for photo, _, _ in observations:
        image = model.find_image_with_name(photo)
        if image is not None and image.has_pose:
            _, design = project_with_derivative(image, place[None])
            normal += design[0].T @ design[0]
    return np.linalg.inv(normal)


def rms(rows: Sequence[PointResidual], role: str) -> tuple[float | None, float | None]:
    """Root mean square horizontal (of the length) and vertical residual, metres; None without points."""
    chosen = [row for row in rows if row.role == role]
    if not chosen:
        return None, None
    horizontal = np.sqrt(np.mean([row.dx**2 + row.dy**2 for row in chosen]))
    vertical = np.sqrt(np.mean([row.dz**2 for row in chosen]))
    return float(horizontal), float(vertical)


def _umeyama(source: np.ndarray, target: np.ndarray) -> pycolmap.Sim3d:
    """Similarity of least squares (Umeyama 1991)."""
    mean_s, mean_t = source.mean(axis=0), target.mean(axis=0)
    s, t = source - mean_s, target - mean_t
    u, d, vt = np.linalg.svd(t.T @ s / len(s))
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(sign) @ vt
    scale = float((d * sign).sum() / (s**2).sum() * len(s))
    return pycolmap.Sim3d(scale, pycolmap.Rotation3d(rotation), mean_t - scale * rotation @ mean_s)


def _consistent(source: np.ndarray, target: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    """Which points agree on one similarity: leave out the worst while it stands far out of the rest."""
    keep = np.ones(len(source), bool)
    while keep.sum() > _LEAST_CONTROL + 1:
        worst, best_rest = -1, np.inf
        for k in np.flatnonzero(keep):
            rest = keep.copy()
            rest[k] = False
            if on_a_line(target[rest]):
                continue
            error = _misfit(source, target, rest)[rest].max()
            if error < best_rest:
                worst, best_rest = int(k), error
        everything = _misfit(source, target, keep)[keep].max()
        limit = max(tolerance[keep].max(), best_rest * _GROSS)
        if worst < 0 or everything <= limit:
            break
        keep[worst] = False
    return keep


def _centre(model: pycolmap.Reconstruction, observations: Sequence[tuple[str, float, float]]) -> np.ndarray:
    """Middle of the stations that a point was measured from."""
    images = [model.find_image_with_name(photo) for photo, _, _ in observations]
    return np.mean([image.projection_center() for image in images if image and image.has_pose], axis=0)


def _scale(source: np.ndarray, target: np.ndarray) -> float:
    """Ratio of distances between points, robust against a few that are wrong."""
    pairs = np.triu_indices(len(source), 1)
    lengths = [np.linalg.norm(xyz[pairs[0]] - xyz[pairs[1]], axis=1) for xyz in (source, target)]
    return float(np.median(lengths[1]) / max(float(np.median(lengths[0])), 1e-12))


def _misfit(source: np.ndarray, target: np.ndarray, keep: np.ndarray) -> np.ndarray:
    fit = _umeyama(source[keep], target[keep])
    moved = np.array([fit * point for point in source])
    return np.linalg.norm(moved - target, axis=1)
