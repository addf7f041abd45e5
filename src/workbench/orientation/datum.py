"""Recorded positions and control points in two frames: heights above ellipsoid and geoid, older datums."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pycolmap

from workbench.errors import OrientationError
from workbench.orientation.control import triangulate
from workbench.orientation.mapping import prior_of
from workbench.params import OrientParameters
from workbench.site import ControlPoint, Site

# A datum is a matter of tens of metres. Nearer than this, recorded positions may just be poor, and the robust
# weights of the adjustment deal with them: standard deviations of recorded and surveyed places, and parts of
# the flying height, by which a small block tilts (plan) and stretches (height) on its control points.
_BEYOND_XY, _BEYOND_Z = 10.0, 5.0
_ROUGH_XY, _ROUGH_Z = 0.05, 0.02
_UPWARD = 0.5  # Mean vertical part of the viewing directions; no flight looks up by 30 degrees.


def require_upright(model: pycolmap.Reconstruction) -> None:
    """Refuse a block that its control points have turned upside down.

    A plane and its mirror image are one turn apart: with x and y exchanged, control points fit a block whose
    photographs look up from below the ground.

    Raises
    ------
    OrientationError
        If the photographs look up.
    """
    upward = np.mean([model.image(number).viewing_direction()[2] for number in model.reg_image_ids()])
    if upward > _UPWARD:
        raise OrientationError(
            "Placed by the control points, the photographs look up from below the ground: coordinates are "
            "mirrored. x and y (east and north) are exchanged, or heights have the wrong sign. Mend them."
        )


def shift_of_records(
    model: pycolmap.Reconstruction,
    site: Site,
    offset: np.ndarray,
    options: OrientParameters,
    control: Sequence[ControlPoint],
    measured: Mapping[str, list[tuple[str, float, float]]],
    *,
    aligned: bool,
) -> np.ndarray:
    """By how much recorded positions lie beside those that the control points give, metres.

    Zero without control points.

    Parameters
    ----------
    aligned
        Whether the model was placed by three or more control points; it lies where it was recorded otherwise.

    Returns
    -------
    (3,) ndarray
        Recorded minus surveyed, the median; zero horizontally or vertically where it may be an error of the
        receivers (within ten standard deviations in plan, five in height) or of the block (5 and 2 % of its
        height).
    """
    if not control:
        return np.zeros(3)
    names = {photograph.name: photograph for photograph in site.photographs}
    centres, differences, variances = [], [], []
    for number in model.reg_image_ids():
        image = model.image(number)
        prior = prior_of(names[image.name], offset, options)
        if prior is not None:
            centres.append(image.projection_center())
            differences.append(prior[0] - centres[-1])
            variances.append(np.diag(prior[1]))
    if not aligned:
        found = [(point, triangulate(model, measured.get(point.name, []))) for point in control]
        differences = [
            place + offset - (point.x, point.y, point.z) for point, place in found if place is not None
        ]
    if not differences or not variances:
        return np.zeros(3)
    surveyed = np.median([(p.sd_xy**2, p.sd_xy**2, p.sd_z**2) for p in control], axis=0)
    variance = np.median(variances, axis=0) + surveyed
    ground = np.median([point.xyz[2] for point in model.points3D.values()])
    height = abs(float(np.median(centres, axis=0)[2] - ground))
    shift = np.median(differences, axis=0)
    if np.hypot(*shift[:2]) <= max(_BEYOND_XY * np.sqrt(variance[:2].sum()), _ROUGH_XY * height):
        shift[:2] = 0.0
    if abs(shift[2]) <= max(_BEYOND_Z * np.sqrt(variance[2]), _ROUGH_Z * height):
        shift[2] = 0.0
    return shift


def without_shift(site: Site, shift: np.ndarray) -> Site:
    """The site with its recorded positions moved onto the frame of the control points."""
    moved = []
    for photograph in site.photographs:
        if photograph.position is not None:
            x, y, z = (float(value) for value in photograph.position - shift)
            photograph = replace(photograph, position=(x, y, z))
        moved.append(photograph)
    return replace(site, photographs=tuple(moved))


def describe_shift(shift: np.ndarray) -> str:
    """Warning of a shift, in words."""
    east, north, up = shift
    parts = [f"{east:+.2f} m east and {north:+.2f} m north"] if east or north else []
    parts += [f"{abs(up):.2f} m too {'high' if up > 0 else 'low'}"] if up else []
    only_up = bool(up) and not (east or north)
    cause = "heights above the ellipsoid and the geoid, or a wrong focal length" if only_up else "two datums"
    return (
        f"Recorded positions lie {', '.join(parts)} beside those that the control points give ({cause}?). "
        "The control points decide; the positions are used without this shift."
    )
