"""Recorded attitudes: how the photographs of a strip are turned against each other."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from workbench.cameras import Pose
from workbench.params import OrientParameters
from workbench.site import Site

_LEAST = 4  # Photographs of a strip: fewer do not tell the mounting from the noise.
_MOST_TURNED = 15.0  # Degrees; beyond, the records count from other axes than ours.


class _Record(NamedTuple):
    """Attitude of a photograph as it was recorded."""

    image: int
    rotation: Rotation
    variance: np.ndarray
    """(3,): of small turns about x, y, z of the site's CRS, radians squared."""


class Turn(NamedTuple):
    """Recorded rotation of a photograph, by itself or against another one."""

    image: int
    """Number of the image."""
    reference: int | None
    """Number of the image it is turned against; None for the axes of the site's CRS."""
    rotation: np.ndarray
    """(3, 3): camera axes of the image from those of the reference."""
    covariance: np.ndarray
    """(3, 3): of small turns about the camera's axes, radians squared."""


def recorded_turns(model: pycolmap.Reconstruction, site: Site, parameters: OrientParameters) -> list[Turn]:
    """Rotations of the photographs of every strip and camera against the one in its middle, and of that one.

    An instrument is never quite aligned with the camera, and headings have an error of their own. In
    rotations between photographs of one heading they cancel; the attitude of the middle one is only as
    good as the alignment. A block of several strips knows all this far better from its tie points and
    positions. In a single strip the roll of the whole is free but for them, and over narrow ground a
    progressive roll hides behind a yaw.

    Parameters
    ----------
    model
        Roughly placed in the site's CRS.
    """
    by_name = {photograph.name: photograph for photograph in site.photographs}
    strips: dict[tuple[str, int], list[_Record]] = defaultdict(list)
    for image_id in sorted(model.reg_image_ids(), key=lambda number: by_name[model.image(number).name].order):
        photograph = by_name[model.image(image_id).name]
        stated = photograph.attitude_sd or (parameters.attitude_sd and (parameters.attitude_sd,) * 3)
        if photograph.attitude is not None and stated:
            pose = Pose.from_omega_phi_kappa(np.zeros(3), *photograph.attitude)
            record = _Record(image_id, Rotation.from_matrix(pose.rotation), np.square(np.radians(stated)))
            strips[photograph.camera, photograph.strip].append(record)
    found = []
    for records in strips.values():
        mounting = _mounting(model, records) if len(records) >= _LEAST else None
        if mounting is None:
            continue
        middle = records[len(records) // 2]
        reference = (mounting * middle.rotation).as_matrix()
        for record in records:
            if record is middle:
                variance = record.variance + np.radians(parameters.mounting_sd) ** 2
                found.append(_turn(record.image, None, record.rotation.as_matrix(), np.eye(3), variance))
            else:
                rotation = (mounting * record.rotation).as_matrix()
                variance = record.variance + middle.variance
                found.append(_turn(record.image, middle.image, rotation, reference, variance))
    return found


def _turn(
    image: int, reference: int | None, rotation: np.ndarray, other: np.ndarray, variance: np.ndarray
) -> Turn:
    """Turn against other axes; ``variance`` (3,) is about the axes of the site's CRS."""
    return Turn(image, reference, rotation @ other.T, rotation @ np.diag(variance) @ rotation.T)


def _mounting(model: pycolmap.Reconstruction, records: Sequence[_Record]) -> Rotation | None:
    """Median turn from recorded to adjusted attitudes; None if no mounting can explain it."""
    adjusted = Rotation.from_matrix(
        [model.image(record.image).cam_from_world().rotation.matrix() for record in records]
    )
    recorded = Rotation.concatenate([record.rotation for record in records])
    turns = (adjusted * recorded.inv()).as_rotvec(degrees=True)
    if np.median(np.linalg.norm(turns, axis=1)) > _MOST_TURNED:
        return None
    return Rotation.from_rotvec(np.median(turns, axis=0), degrees=True)
