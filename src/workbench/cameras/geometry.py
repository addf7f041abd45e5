"""Arithmetic of overlap, intersection angle and ground resolution."""

from __future__ import annotations

import math

from workbench.errors import CameraError


def intersection_angle(overlap: float, pixels_along: float, pixel_size: float, focal_length: float) -> float:
    """Angle under which two neighbouring photographs see the point below their image centre.

    ``tan(angle) = base / height = (1 - overlap) * pixels_along * pixel_size / focal_length``
    [thesis 3.2.2]. It does not depend on the flying height. With the side overlap and the pixels
    across track it gives the angle between strips.

    Parameters
    ----------
    overlap
        Share of a photograph that its neighbour sees as well, 0..1.
    pixels_along
        Pixels along the direction of flight.
    pixel_size, focal_length
        In one unit of length.

    Returns
    -------
    float
        Degrees, 0..90.

    Raises
    ------
    CameraError
        If the overlap is outside 0..1 or a length is not positive.

    Examples
    --------
    >>> round(intersection_angle(0.9, 3232, 7.4e-6, 0.0517), 2)
    2.65
    """
    if not 0 <= overlap <= 1:
        raise CameraError(f"Overlap {overlap} is outside 0..1: give a fraction, not per cent.")
    if not min(pixels_along, pixel_size, focal_length) > 0:
        raise CameraError("Pixels along track, pixel size and focal length must be positive.")
    return math.degrees(math.atan((1 - overlap) * pixels_along * pixel_size / focal_length))


def ground_sampling_distance(height: float, pixel_size: float, focal_length: float) -> float:
    """Edge of a pixel on the ground, metres, from metres: ``height * pixel_size / focal_length``.

    Raises
    ------
    CameraError
        If a length is not positive.
    """
    if not min(height, pixel_size, focal_length) > 0:
        raise CameraError("Height above ground, pixel size and focal length must be positive.")
    return height * pixel_size / focal_length
