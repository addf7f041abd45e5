"""The final bundle adjustment: tie points, recorded positions and control, each by its precision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pyceres
import pycolmap

from workbench.errors import OrientationError
from workbench.orientation.control import triangulate
from workbench.orientation.mapping import prior_of
from workbench.params import OrientParameters
from workbench.site import ControlPoint, Site

_OBLIQUE = 15.0
_RELIEF = 0.2
_LEAST_PRIORS = 3
_MOST_ITERATIONS = 50


def adjust(
    model: pycolmap.Reconstruction,
    site: Site,
    offset: np.ndarray,
    parameters: OrientParameters,
    *,
    control: Sequence[ControlPoint] = (),
    measured: Mapping[str, list[tuple[str, float, float]]] | None = None,
    free_focal_length: bool = False,
) -> None:
    """Adjust poses, tie points and lenses in place.

    Residuals: image positions of tie points (robust) and of control points, recorded positions by
    their standard deviation (robust), surveyed coordinates of control points by theirs. Checkpoints
    must not be among ``control``.

    Raises
    ------
    OrientationError
        If neither positions nor control fix the block.
    """
    added = _add_control(model, control, measured or {}, offset)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = free_focal_length
    options.ceres.min_num_residuals_for_cpu_multi_threading = 10**9
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    options.ceres.solver_options.max_num_iterations = _MOST_ITERATIONS
    options.print_summary = False
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in sorted(model.reg_image_ids()):
        config.add_image(image_id)
    priors = _priors(model, site, offset, parameters) if parameters.georeference != "control" else []
    before = {number: model.point3D(number).xyz.copy() for number in added}
    if len(priors) >= _LEAST_PRIORS:
        options_of_priors = pycolmap.PosePriorBundleAdjustmentOptions()
        options_of_priors.ceres.prior_position_loss_function_type = pycolmap.LossFunctionType.CAUCHY
        adjuster = pycolmap.create_pose_prior_ceres_bundle_adjuster(
            options, options_of_priors, config, priors, model
        )
    elif len(added) >= _LEAST_PRIORS:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.UNSPECIFIED)
        adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, model)
    else:
        raise OrientationError(
            f"Site {site.name}: fewer than three recorded positions and control points fix the block."
        )
    unit = parameters.observation_sd
    for number, point in added.items():
        # The adjuster may work in coordinates shifted towards zero: the survey moves along.
        shift = model.point3D(number).xyz - before[number]
        target = np.array([point.x, point.y, point.z]) - offset + shift
        # Image residuals count in pixels; whatever else is measured gets the same unit of weight.
        covariance = np.diag(np.square([point.sd_xy, point.sd_xy, point.sd_z])) / unit**2
        prior = pyceres.factors.NormalPrior(target, covariance)
        adjuster.problem.add_residual_block(prior, None, [model.point3D(number).xyz])
    adjuster.solve()
    for number in added:
        model.delete_point3D(number)
    model.update_point_3d_errors()


def drop_bad_points(model: pycolmap.Reconstruction, limit: float) -> int:
    """Delete tie points whose mean reprojection error exceeds a limit (px); how many there were."""
    bad = [number for number, point in model.points3D.items() if point.error > limit]
    for number in bad:
        model.delete_point3D(number)
    return len(bad)


def focal_length_is_visible(
    model: pycolmap.Reconstruction, control: Sequence[ControlPoint]
) -> tuple[bool, str]:
    """Whether a block can tell its focal length, and why (not).

    Focal length and flying height compensate each other in a nadir block of constant height over
    flat ground. Oblique views (15 degrees between axes), or tie points or stations spread in height
    by a fifth of the flying height, or control points that differ in height as much, tell them apart.
    """
    axes = np.array([model.image(number).viewing_direction() for number in model.reg_image_ids()])
    mean = axes.mean(axis=0) / np.linalg.norm(axes.mean(axis=0))
    angle = float(np.degrees(np.arccos(np.clip(axes @ mean, -1, 1))).max())
    if angle >= _OBLIQUE:
        return True, f"views differ by {angle:.0f} degrees from their mean"
    points = np.array([point.xyz for point in model.points3D.values()])
    stations = np.array([model.image(number).projection_center() for number in model.reg_image_ids()])
    height = float(np.median(stations[:, 2]) - np.median(points[:, 2]))
    relief = float(np.subtract(*np.percentile(points[:, 2], [95, 5])))
    climb = float(np.ptp(stations[:, 2]))
    surveyed = [point.z for point in control]
    levels = float(np.ptp(surveyed)) if len(surveyed) >= 4 else 0.0
    if max(climb, levels) >= _RELIEF * height or relief >= 2 * _RELIEF * height:
        return True, f"stations, control or ground differ in height by {max(climb, levels, relief):.1f} m"
    return False, (
        f"all views are within {angle:.0f} degrees of the vertical and {climb:.1f} m of one height, "
        f"{height:.0f} m above ground"
    )


def _priors(
    model: pycolmap.Reconstruction, site: Site, offset: np.ndarray, parameters: OrientParameters
) -> list[pycolmap.PosePrior]:
    by_name = {photograph.name: photograph for photograph in site.photographs}
    priors = []
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        found = prior_of(by_name[image.name], offset, parameters)
        if found is not None:
            prior = pycolmap.PosePrior()
            prior.corr_data_id = image.data_id
            prior.position = found[0]
            prior.position_covariance = found[1] / parameters.observation_sd**2
            prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
            priors.append(prior)
    return priors


def _add_control(
    model: pycolmap.Reconstruction,
    control: Sequence[ControlPoint],
    measured: Mapping[str, list[tuple[str, float, float]]],
    offset: np.ndarray,
) -> dict[int, ControlPoint]:
    """Control points as points of the model, with their measurements as tracks."""
    added = {}
    for point in control:
        observations = measured.get(point.name, [])
        start = triangulate(model, observations)
        if start is None:
            continue
        track = pycolmap.Track()
        for photo, column, row in observations:
            image = model.find_image_with_name(photo)
            if image is None or not image.has_pose:
                continue
            image.points2D.append(pycolmap.Point2D(np.array([column, row])))
            track.add_element(image.image_id, len(image.points2D) - 1)
        added[model.add_point3D(start, track, np.zeros(3, np.uint8))] = point
    return added
