"""The final bundle adjustment: tie points, recorded positions and control, each by its precision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pyceres
import pycolmap
import pycolmap.cost_functions

from workbench.errors import OrientationError
from workbench.orientation.attitudes import Turn, recorded_turns
from workbench.orientation.control import intersection_cofactors, triangulate
from workbench.orientation.mapping import prior_of
from workbench.params import OrientParameters
from workbench.site import ControlPoint, Site

_OBLIQUE = 15.0
_RELIEF = 0.2
_LEAST_FIXED = 3
_PRIOR_LOSS = 2.8  # Standard deviations; 95 % of good positions (chi-square, 3 degrees of freedom).
_MOST_ITERATIONS = 50
_ANYWHERE = 1e6  # Metres: COLMAP's prior of a pose, left free where only its rotation is known.
_RAYLEIGH_MEDIAN = 1.1774
# Places in COLMAP's FULL_OPENCV: fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6.
_FOCAL, _PRINCIPAL, _RATIONAL = [0, 1], [2, 3], [9, 10, 11]


def adjust(
    model: pycolmap.Reconstruction,
    site: Site,
    offset: np.ndarray,
    parameters: OrientParameters,
    *,
    control: Sequence[ControlPoint] = (),
    measured: Mapping[str, list[tuple[str, float, float]]] | None = None,
    free_focal_length: bool = False,
    tie_point_sd: float | None = None,
    pointing_sd: float | None = None,
) -> None:
    """Adjust poses, tie points and lenses in place.

    Lenses get the terms k1, k2, k3, p1, p2 of Brown; the principal point and, unless it is freed, the
    focal length are held.

    Residuals: image positions of tie points and of control points, recorded positions and turns between
    photographs by their standard deviations (robust), surveyed coordinates of control points by theirs.
    Checkpoints must not be among ``control``.

    Parameters
    ----------
    tie_point_sd
        Standard deviation of the image position of a tie point, px; ``orient.observation_sd`` by default.
        See :func:`tie_point_precision`.
    pointing_sd
        The same of the measurement of a control point.

    Raises
    ------
    OrientationError
        If neither positions nor control fix the block.
    """
    _use_brown_lens(model)
    added = _add_control(model, control, measured or {}, offset)
    options = pycolmap.BundleAdjustmentOptions()
    # Everything of the lens is a variable of the problem; what is not to move is held by a manifold.
    options.refine_focal_length = options.refine_principal_point = options.refine_extra_params = True
    options.ceres.min_num_residuals_for_cpu_multi_threading = 10**9
    # Outliers are dropped by their error, as in the mapping; a robust loss would shift the lens terms.
    options.ceres.loss_function_type = pycolmap.LossFunctionType.TRIVIAL
    options.ceres.solver_options.max_num_iterations = _MOST_ITERATIONS
    options.print_summary = False
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in sorted(model.reg_image_ids()):
        config.add_image(image_id)
    navigated = parameters.georeference != "control"
    priors = recorded_positions(model, site, offset, parameters) if navigated else {}
    turns = recorded_turns(model, site, parameters) if navigated else []
    if max(len(priors), len(added)) < _LEAST_FIXED:
        raise OrientationError(
            f"Site {site.name}: fewer than three recorded positions and fewer than three control points in "
            "registered photographs: nothing fixes the block. Add control points, or measure them in more."
        )
    # COLMAP's own adjuster for positions first fits the block to them by a similarity of its own, which moves
    # it against the survey; here positions and survey are residuals of one problem and nothing else.
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.UNSPECIFIED)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, model)
    # Image residuals count in pixels; whatever else is measured gets the same unit of weight.
    unit = tie_point_sd or parameters.observation_sd
    # Pointed measurements share it: by how much they are worse is added to the survey of their point.
    excess = max((pointing_sd or parameters.observation_sd) ** 2 - unit**2, 0.0)
    # The problem holds bare pointers to what Python owns.
    kept_alive = [
        _hold_lenses(adjuster.problem, model, free_focal_length),
        _add_positions(adjuster.problem, model, priors, unit),
        _add_turns(adjuster.problem, model, turns, unit),
        _add_survey(adjuster.problem, model, added, measured or {}, offset, unit, excess),
    ]
    adjuster.solve()
    del kept_alive
    _remove_control(model, added)
    model.update_point_3d_errors()


def _hold_lenses(problem: pyceres.Problem, model: pycolmap.Reconstruction, free_focal_length: bool) -> list:
    held = _PRINCIPAL + _RATIONAL + ([] if free_focal_length else _FOCAL)
    kept = []
    for camera in model.cameras.values():
        lens = camera.params
        manifold = pyceres.SubsetManifold(len(lens), sorted(held))
        kept.append((lens, manifold))
        problem.set_manifold(lens, manifold)
    return kept


def _add_positions(
    problem: pyceres.Problem,
    model: pycolmap.Reconstruction,
    priors: Mapping[int, tuple[np.ndarray, np.ndarray]],
    unit: float,
) -> list:
    kept = []
    for image_id, (position, covariance) in priors.items():
        pose = model.image(image_id).frame.rig_from_world.params
        cost = pycolmap.cost_functions.AbsolutePosePositionPriorCost(covariance / unit**2, position)
        loss = pyceres.CauchyLoss(_PRIOR_LOSS * unit)
        kept.append((pose, cost, loss))
        problem.add_residual_block(cost, loss, [pose])
    return kept


def _add_turns(
    problem: pyceres.Problem, model: pycolmap.Reconstruction, turns: Sequence[Turn], unit: float
) -> list:
    kept = []
    for turn in turns:
        numbers = [turn.image] if turn.reference is None else [turn.image, turn.reference]
        poses = [model.image(number).frame.rig_from_world.params for number in numbers]
        cost, loss = _turn_cost(turn, unit)
        kept.append((poses, cost, loss))
        problem.add_residual_block(cost, loss, poses)
    return kept


def _turn_cost(turn: Turn, unit: float) -> tuple[pyceres.CostFunction, pyceres.LossFunction]:
    """Residual of a recorded rotation: a pose prior of COLMAP that leaves the position free."""
    covariance = np.diag(np.full(6, _ANYWHERE**2))
    covariance[:3, :3] = turn.covariance / unit**2
    prior = pycolmap.Rigid3d(pycolmap.Rotation3d(turn.rotation), np.zeros(3))
    costs, width = pycolmap.cost_functions, _PRIOR_LOSS * unit
    if turn.reference is None:  # Another convention of angles would be degrees off: it must lose.
        return costs.AbsolutePosePriorCost(covariance, prior), pyceres.CauchyLoss(width)
    return costs.RelativePosePriorCost(covariance, prior), pyceres.HuberLoss(width)


def _add_survey(
    problem: pyceres.Problem,
    model: pycolmap.Reconstruction,
    added: Mapping[int, ControlPoint],
    measured: Mapping[str, list[tuple[str, float, float]]],
    offset: np.ndarray,
    unit: float,
    excess: float,
) -> list:
    """Surveyed coordinates; ``excess`` (px2) is by how much pointed measurements are worse than the unit."""
    kept = []
    for number, point in added.items():
        place = model.point3D(number).xyz
        target = np.array([point.x, point.y, point.z]) - offset
        covariance = np.diag(np.square([point.sd_xy, point.sd_xy, point.sd_z]))
        if excess:
            covariance += excess * intersection_cofactors(model, place, measured[point.name])
        cost = pyceres.factors.NormalPrior(target, covariance / unit**2)
        kept.append((place, cost))
        problem.add_residual_block(cost, None, [place])
    return kept


def _use_brown_lens(model: pycolmap.Reconstruction) -> None:
    """Give the mapping's lenses (k1, k2, p1, p2) room for k3."""
    for camera in model.cameras.values():
        if camera.model_name == "OPENCV":
            terms = [*camera.params, 0.0, 0.0, 0.0, 0.0]
            camera.model = pycolmap.CameraModelId.FULL_OPENCV
            camera.params = np.array(terms)


def recorded_positions(
    model: pycolmap.Reconstruction, site: Site, offset: np.ndarray, parameters: OrientParameters
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Position (3,) minus offset and covariance (3, 3) of every registered image that has one."""
    by_name = {photograph.name: photograph for photograph in site.photographs}
    found = {}
    for image_id in sorted(model.reg_image_ids()):
        prior = prior_of(by_name[model.image(image_id).name], offset, parameters)
        if prior is not None:
            found[image_id] = prior
    return found


def drop_outliers(model: pycolmap.Reconstruction, limit: float, sds: float | None = None) -> int:
    """Delete observations of tie points that do not fit; points with fewer than two left go with them.

    Leaves, reed and ripples move between exposures: such points match well and pull their photographs
    along, by ten times the precision of a recorded position in a trial. Half a pixel off, they pass any
    limit made for wrong matches, but stand out of the rest.

    Parameters
    ----------
    limit
        Largest length of a residual, px.
    sds
        Largest length in robust standard deviations of the residuals of the block, if given. Lengths of
        normal residuals follow Rayleigh's distribution, whose median is 1.1774 standard deviations.

    Returns
    -------
    int
        Deleted observations.
    """
    residuals = _residuals(model)
    if not residuals:
        return 0
    if sds is not None:
        limit = min(limit, sds * float(np.median([length for length, _, _ in residuals])) / _RAYLEIGH_MEDIAN)
    dropped = 0
    for length, image_id, place in residuals:
        # A point that lost its last pair of observations is gone from all its photographs.
        if length > limit and model.image(image_id).points2D[place].has_point3D():
            model.delete_observation(image_id, place)
            dropped += 1
    return dropped


def tie_point_precision(model: pycolmap.Reconstruction) -> float | None:
    """Standard deviation of the image position of a tie point, px, as the block itself tells.

    Robust, from the median residual. Residuals are shorter than errors, as every place of a point and every
    pose gives way to them: by the share of the measurements that is left over.

    Returns
    -------
    float or None
        None if nothing is left over.
    """
    lengths = [length for length, _, _ in _residuals(model)]
    measured = 2 * len(lengths)
    spare = measured - 3 * model.num_points3D() - 6 * model.num_reg_images()
    if spare <= 0:
        return None
    return float(np.median(lengths)) / _RAYLEIGH_MEDIAN * float(np.sqrt(measured / spare))


def _residuals(model: pycolmap.Reconstruction) -> list[tuple[float, int, int]]:
    """Length (px), image and place in the image of every observation of a tie point."""
    found = []
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        for place, point in enumerate(image.points2D):
            if point.has_point3D():
                shown = image.project_point(model.point3D(point.point3D_id).xyz)
                length = np.inf if shown is None else float(np.hypot(*(shown - point.xy)))
                found.append((length, image_id, place))
    return found


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


def _remove_control(model: pycolmap.Reconstruction, added: Mapping[int, ControlPoint]) -> None:
    """Take control points and their measurements out again; the tracks of tie points stay as they were."""
    images = [element.image_id for number in added for element in model.point3D(number).track.elements]
    for number in added:
        model.delete_point3D(number)
    for image_id in images:  # Measurements were appended last, so they are the last ones.
        model.image(image_id).points2D.pop()
