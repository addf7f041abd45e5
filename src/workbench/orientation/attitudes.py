"""Recorded attitudes, after the turn of each camera against the instrument that recorded them."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from workbench.cameras import Pose
from workbench.params import OrientParameters
from workbench.site import Photograph, Site

_LEAST = 4  # Photographs of a camera: fewer do not tell its mounting from the noise.
_MOST_SPREAD = 15.0  # Degrees; beyond, the records count from other axes than ours.


def recorded_turns(
    model: pycolmap.Reconstruction, site: Site, parameters: OrientParameters
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Rotation and its covariance of every registered image whose attitude was recorded.

    An instrument is never quite aligned with the camera, and headings have an error of their own: the
    median turn between adjusted and recorded attitudes of each camera is taken off. What is left says
    how photographs are turned against each other. A block of several strips knows that far better from
    its tie points; in a single strip over a narrow ground a progressive roll is hidden by a yaw.

    Parameters
    ----------
    model
        Roughly placed in the site's CRS.

    Returns
    -------
    dict
        By image number: ``camera_from_world`` (3, 3), and covariance (3, 3) of small turns about the
        camera's axes, radians squared.
    """
    by_name = {photograph.name: photograph for photograph in site.photographs}
    cameras: dict[str, list[int]] = defaultdict(list)
    for image_id in sorted(model.reg_image_ids()):
        photograph = by_name[model.image(image_id).name]
        if photograph.attitude is not None:
            cameras[photograph.camera].append(image_id)
    found = {}
    for numbers in cameras.values():
        if len(numbers) < _LEAST:
            continue
        photographs = [by_name[model.image(number).name] for number in numbers]
        recorded = Rotation.from_matrix([_rotation(photograph) for photograph in photographs])
        adjusted = Rotation.from_matrix(
            [model.image(number).cam_from_world().rotation.matrix() for number in numbers]
        )
        turns = (adjusted * recorded.inv()).as_rotvec(degrees=True)
        mounting = np.median(turns, axis=0)
        if np.median(np.linalg.norm(turns - mounting, axis=1)) > _MOST_SPREAD:
            continue
        expected = (Rotation.from_rotvec(mounting, degrees=True) * recorded).as_matrix()
        for number, photograph, rotation in zip(numbers, photographs, expected, strict=True):
            sd = photograph.attitude_sd or (parameters.attitude_sd,) * 3
            found[number] = rotation, rotation @ np.diag(np.radians(sd) ** 2) @ rotation.T
    return found


def _rotation(photograph: Photograph) -> np.ndarray:
    return Pose.from_omega_phi_kappa(np.zeros(3), *photograph.attitude).rotation  # type: ignore[misc]
