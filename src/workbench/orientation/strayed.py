"""Photographs that were matched with a look-alike of their ground, and put back where they were recorded.

Rows of crops, roofs of one kind and planted trees repeat: a photograph may fit a place tens of metres away
by a hundred matches. Where it was recorded it fits by others.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pycolmap

from workbench.site import Site

_FAR = 10.0  # Times the median distance of adjusted and recorded positions.
_LEAST_FAR = 1.0  # Metres; precise recorders would make a handful of decimetres look far.
_TRIALS = 5  # Places that a photograph may fit before its own is found.
_LEAST_POINTS = 15  # As COLMAP asks of any photograph before it connects it.
_MOST_ERROR = 12.0  # Pixels, of a first pose: COLMAP's default for registration.

Matches = Callable[[int, int], np.ndarray]
"""Verified matches (n, 2) of two images by their numbers: places of the key points in either."""


def far_from_recorded(
    model: pycolmap.Reconstruction, site: Site, offset: np.ndarray
) -> tuple[dict[str, float], float]:
    """Photographs much farther from their recorded position than the others, and the limit, metres.

    Returns
    -------
    far : dict
        Horizontal distance by name, metres.
    limit : float
        Beyond which a photograph is far; infinite without positions.
    """
    away = {}
    for photograph in site.photographs:
        image = model.find_image_with_name(photograph.name)
        if image is not None and image.has_pose and photograph.position is not None:
            distance = image.projection_center() + offset - photograph.position
            away[photograph.name] = float(np.linalg.norm(distance[:2]))
    if not away:
        return {}, np.inf
    limit = max(_FAR * float(np.median(list(away.values()))), _LEAST_FAR)
    return {name: distance for name, distance in away.items() if distance > limit}, limit


def replace_strayed(
    model: pycolmap.Reconstruction, site: Site, offset: np.ndarray, matches: Matches, seed: int
) -> list[str]:
    """Give strayed photographs the pose near their record that their matches support, in place.

    A photograph that fits nowhere near its record keeps its pose: the record may be wrong.

    Returns
    -------
    list of str
        Names of the photographs that were put back.
    """
    far, limit = far_from_recorded(model, site, offset)
    positions = {p.name: np.asarray(p.position) - offset for p in site.photographs if p.name in far}
    replaced = []
    for name in far:
        image = model.find_image_with_name(name)
        seen = _seen_elsewhere(model, image, set(far), matches)
        pose = _pose_near(image, model, seen, positions[name], limit, seed)
        if pose is not None:
            _put_back(model, image, *pose)
            replaced.append(name)
    return replaced


def _seen_elsewhere(
    model: pycolmap.Reconstruction, image: pycolmap.Image, far: set[str], matches: Matches
) -> list[tuple[int, int]]:
    """Key points of an image, and points of the model that their matches in good photographs show."""
    found = set()
    for number in sorted(model.reg_image_ids()):
        other = model.image(number)
        if other.name in far:
            continue
        for own, place in matches(image.image_id, number):
            point = other.points2D[int(place)]
            if point.has_point3D():
                found.add((int(own), int(point.point3D_id)))
    return sorted(found)


def _pose_near(
    image: pycolmap.Image,
    model: pycolmap.Reconstruction,
    seen: list[tuple[int, int]],
    position: np.ndarray,
    limit: float,
    seed: int,
) -> tuple[pycolmap.Rigid3d, list[tuple[int, int]]] | None:
    """Pose within ``limit`` of a position and what supports it; what fits elsewhere is taken away."""
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error, options.ransac.random_seed = _MOST_ERROR, seed
    for _ in range(_TRIALS):
        if len(seen) < _LEAST_POINTS:
            return None
        keypoints = np.array([image.points2D[own].xy for own, _ in seen])
        points = np.array([model.point3D(number).xyz for _, number in seen])
        found = pycolmap.estimate_and_refine_absolute_pose(keypoints, points, image.camera, options)
        if found is None or found["num_inliers"] < _LEAST_POINTS:
            return None
        fits = np.asarray(found["inlier_mask"])
        pose = found["cam_from_world"]
        centre = pose.inverse().translation
        if np.linalg.norm((centre - position)[:2]) <= limit:
            return pose, [pair for pair, good in zip(seen, fits, strict=True) if good]
        seen = [pair for pair, good in zip(seen, fits, strict=True) if not good]
    return None


def _put_back(
    model: pycolmap.Reconstruction,
    image: pycolmap.Image,
    pose: pycolmap.Rigid3d,
    support: list[tuple[int, int]],
) -> None:
    frame, number = image.frame, image.image_id
    model.deregister_frame(frame.frame_id)
    frame.set_cam_from_world(image.camera_id, pose)
    model.register_frame(frame.frame_id)
    used: set[int] = set()
    for own, point in support:
        # Two matches may claim one key point, or one point; the first of each counts.
        if own in used or not model.exists_point3D(point):
            continue
        if any(element.image_id == number for element in model.point3D(point).track.elements):
            continue
        model.add_observation(point, pycolmap.TrackElement(number, own))
        used.add(own)
