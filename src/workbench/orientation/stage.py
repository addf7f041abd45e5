"""The orientation stage: from a site to poses, tie points and residuals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pycolmap

from workbench.errors import OrientationError
from workbench.orientation.adjust import recorded_positions
from workbench.orientation.control import PointResidual, rms, triangulate
from workbench.orientation.features import match_features
from workbench.orientation.files import round_model, write_cameras, write_control, write_model, write_table
from workbench.orientation.georeference import Georeference, georeference
from workbench.orientation.mapping import map_block
from workbench.orientation.optimise import Optimisation, errors_by_role, optimise_tie_points
from workbench.orientation.precision import pose_covariances
from workbench.orientation.quality import deformation, shape_warnings
from workbench.orientation.strayed import Matches, far_from_recorded, replace_strayed
from workbench.orientation.tie_points import TiePoints, feature_scales, tie_points
from workbench.params import OrientParameters, Parameters
from workbench.points import write_points
from workbench.site import Site, check_site
from workbench.stages import FOLDERS, open_stage

_LEAST_PHOTOGRAPHS = 2


def orient_site(site: Site, parameters: Parameters) -> dict:
    """Orient the photographs of a site.

    Writes ``sparse/``, ``cameras.csv``, ``tie_points.laz``, ``control.csv`` and the metrics.
    Features and matches are kept under ``work/``.

    Returns
    -------
    dict
        The metrics.

    Raises
    ------
    OrientationError
        If CRS, datum or cameras are open, the site has errors (see :func:`workbench.site.check_site`),
        photographs cannot be connected, or nothing fixes the block.
    """
    _require_answers(site)
    _require_sound(site)
    options = parameters.orient
    with open_stage(site.products / FOLDERS["orient"], {"orient": options}) as stage:
        offset = _offset(site)
        model, models, replaced, database = _map(site, offset, options, stage.path("work"))
        fixed = georeference(model, site, offset, options)
        scales = feature_scales(database)
        reasons = _reasons(model, site, database)
        database.close()
        optimisation = _optimise(model, fixed, scales, options) if options.optimise else None
        if optimisation is not None:
            model = optimisation.model
            write_table(optimisation.table(), stage.path("optimisation.csv"))
            stage.metrics["optimisation"] = _summary(optimisation)
        stage.metrics |= _precision(model, fixed)
        round_model(model)
        points = tie_points(model, scales)
        rows = fixed.residuals(model)
        warnings = fixed.warnings() + shape_warnings(rows, site.control)
        write_model(model, stage.path("sparse"))
        write_cameras(model, site, offset, reasons, stage.path("cameras.csv"))
        write_control(rows, stage.path("control.csv"))
        _write_tie_points(points, offset, site, stage.path("tie_points.laz"))
        warnings += [
            f"{name} fitted a place that looks like its ground; it was put back where it was recorded."
            for name in replaced
        ]
        warnings += _stray_warnings(model, site, offset)
        if models > 1:
            warnings.append(f"{models} separate models: the largest is used, the others are not connected.")
        if reasons:
            warnings.append(f"{len(reasons)} photograph(s) could not be registered, see cameras.csv.")
        shape = deformation(rows, site.control)
        stage.metrics["deformation"] = None if shape is None else shape.values()
        stage.metrics.update(_metrics(model, site, offset, rows, points, models, warnings))
    return stage.metrics


def repeat_optimisation(site: Site, options: OrientParameters, work: Path) -> pd.DataFrame:
    """Map, georeference and optimise a site with several seeds [orthomosaic paper 2.4, Table 2].

    Returns
    -------
    DataFrame
        One row a seed: seed, registered, threshold_px, cross_validated_m, and errors by role and axis,
        metres; :func:`workbench.orientation.optimise.summarise_repetitions` makes Table 2 of it.

    Raises
    ------
    OrientationError
        As :func:`orient_site`; and without checkpoints.
    """
    _require_answers(site)
    offset = _offset(site)
    rows = []
    for seed in range(options.seed, options.seed + options.repetitions):
        seeded = options.model_copy(update={"seed": seed})
        # Matches depend on the seed too (RANSAC): each seed has its own database.
        model, _, _, database = _map(site, offset, seeded, work / f"seed-{seed}")
        fixed = georeference(model, site, offset, seeded)
        scales = feature_scales(database)
        database.close()
        best = _optimise(model, fixed, scales, seeded)
        row = {"seed": seed, "registered": best.model.num_reg_images(), "threshold_px": best.threshold}
        row["cross_validated_m"] = best.cross_validated_error
        rows.append(row | errors_by_role(best.trials[best.best].residuals))
    return pd.DataFrame(rows)


def _require_answers(site: Site) -> None:
    if site.unanswered:
        raise OrientationError("Open questions:\n" + "\n".join(f"  {q}" for q in site.unanswered))
    if len(site.photographs) < _LEAST_PHOTOGRAPHS:
        raise OrientationError(
            f"Site {site.name} has {len(site.photographs)} usable photograph(s): overlapping ones are needed."
        )


def _require_sound(site: Site) -> None:
    """Refuse a site whose files contradict each other: a control point in another zone bends the block."""
    errors = check_site(site).errors
    if errors:
        raise OrientationError(
            f"Site {site.name} has {len(errors)} error(s):\n" + "\n".join(f"  {error}" for error in errors)
        )


def _offset(site: Site) -> np.ndarray:
    """Whole hundreds of metres near the block: coordinates stay small, and the number readable."""
    places = [p.position for p in site.photographs if p.position] or [(p.x, p.y, p.z) for p in site.control]
    if not places:
        raise OrientationError(
            f"Site {site.name} has neither recorded positions nor control points: nothing fixes the block."
        )
    offset = np.floor(np.median(np.array(places), axis=0) / 100) * 100
    offset[2] = 0.0
    return offset


def _map(
    site: Site, offset: np.ndarray, options: OrientParameters, work: Path
) -> tuple[pycolmap.Reconstruction, int, list[str], pycolmap.Database]:
    """First model, number of models, photographs that were put back at their records, open database."""
    path = match_features(site, options, work)
    model, models = map_block(site, path, offset, options, work)
    database = pycolmap.Database.open(path)
    replaced = []
    if options.georeference != "control":  # Only recorded positions place a first model in the site.
        replaced = replace_strayed(model, site, offset, _matches_of(database), options.seed)
    return model, models, replaced, database


def _optimise(
    model: pycolmap.Reconstruction,
    fixed: Georeference,
    scales: dict[str, np.ndarray],
    options: OrientParameters,
) -> Optimisation:
    return optimise_tie_points(
        model,
        fixed.adjust,
        fixed.residuals,
        scales=scales,
        thresholds=options.thresholds,
        max_reconstruction_uncertainty=options.max_reconstruction_uncertainty,
        max_projection_accuracy=options.max_projection_accuracy,
        least_tie_points=options.least_tie_points,
        folds=options.folds,
    )


def _summary(optimisation: Optimisation) -> dict[str, Any]:
    return {
        "threshold_px": optimisation.threshold,
        "optimised_error_m": round(optimisation.optimised_error, 5),
        "cross_validated_error_m": round(optimisation.cross_validated_error, 5),
        "verify_error_m": optimisation.verify_error and round(optimisation.verify_error, 5),
        "interior": optimisation.is_interior,
        "stopped": optimisation.stopped,
    }


def _precision(model: pycolmap.Reconstruction, fixed: Georeference) -> dict[str, float | None]:
    """Median standard deviations of the poses; a thousandth of a millimetre is noise of the arithmetic."""
    positions = recorded_positions(model, fixed.site, fixed.offset, fixed.options)
    priors = {model.image(number).name: covariance for number, (_, covariance) in positions.items()}
    surveyed = []
    for point in fixed.control:
        place = triangulate(model, fixed.measured.get(point.name, []))
        if place is not None:
            names = [photo for photo, _, _ in fixed.measured[point.name]]
            surveyed.append((place, names, np.diag(np.square([point.sd_xy, point.sd_xy, point.sd_z]))))
    if fixed.options.georeference == "control":
        priors = {}
    unit = fixed.tie_point_sd or fixed.options.observation_sd
    covariances = pose_covariances(model, priors, fixed_points=surveyed, observation_sd=unit)
    sd = np.sqrt(np.median([np.diag(c) for c in covariances.values()], axis=0))
    return {
        "tie_point_sd_px": round(unit, 4),
        "pose_sd_xy_m": round(float(np.hypot(sd[0], sd[1])), 5),
        "pose_sd_z_m": round(float(sd[2]), 5),
        "pose_sd_turn_deg": round(float(np.degrees(sd[3:].max())), 6),
    }


def _reasons(model: pycolmap.Reconstruction, site: Site, database: pycolmap.Database) -> dict[str, str]:
    """Why a photograph has no pose."""
    ids = {image.name: image.image_id for image in database.read_all_images()}
    pairs, inliers = database.read_two_view_geometry_num_inliers()
    partners: dict[int, int] = {}
    for pair, count in zip(pairs, inliers, strict=True):
        for image_id in pair if np.ndim(pair) else pycolmap.pair_id_to_image_pair(pair):
            partners[int(image_id)] = max(partners.get(int(image_id), 0), int(count))
    reasons = {}
    for photograph in site.photographs:
        image = model.find_image_with_name(photograph.name)
        if image is not None and image.has_pose:
            continue
        keypoints = database.num_keypoints_for_image(ids[photograph.name])
        best = partners.get(ids[photograph.name], 0)
        if keypoints < 100:
            reasons[photograph.name] = f"only {keypoints} features: blurred, dark or without texture"
        elif best < 15:
            reasons[photograph.name] = f"at most {best} matches with any other: no overlap, or changed ground"
        else:
            reasons[photograph.name] = f"matched ({best}), but not connected to the largest model"
    return reasons


def _stray_warnings(model: pycolmap.Reconstruction, site: Site, offset: np.ndarray) -> list[str]:
    """Photographs much farther from their recorded position than the others: one of the two is wrong."""
    far, _ = far_from_recorded(model, site, offset)
    return [
        f"{name} lies {distance:.1f} m from its recorded position, much farther than the others: it was "
        "matched wrongly, or the record is wrong. Set it aside, or empty its position, in photographs.csv."
        for name, distance in far.items()
    ]


def _matches_of(database: pycolmap.Database) -> Matches:
    def read(one: int, other: int) -> np.ndarray:
        if not database.exists_two_view_geometry(one, other):
            return np.empty((0, 2), int)
        return np.asarray(database.read_two_view_geometry(one, other).inlier_matches)

    return read


def _write_tie_points(points: TiePoints, offset: np.ndarray, site: Site, path: Any) -> None:
    attributes = {
        "reprojection_error": points.reprojection_error.astype(np.float32),
        "reconstruction_uncertainty": np.minimum(points.reconstruction_uncertainty, 1e6).astype(np.float32),
        "projection_accuracy": points.projection_accuracy.astype(np.float32),
        "image_count": points.image_count,
    }
    crs = site.crs.to_wkt()  # type: ignore[union-attr]  # _require_answers refuses sites without.
    write_points(points.xyz + offset, path, crs=crs, attributes=attributes)


def _metrics(
    model: pycolmap.Reconstruction,
    site: Site,
    offset: np.ndarray,
    rows: Sequence[PointResidual],
    points: TiePoints,
    models: int,
    warnings: list[str],
) -> dict:
    differences = []
    for photograph in site.photographs:
        image = model.find_image_with_name(photograph.name)
        if image is not None and image.has_pose and photograph.position is not None:
            differences.append(image.projection_center() + offset - photograph.position)
    gnss = np.sqrt(np.mean(np.sum(np.square(differences), axis=1))) if differences else None
    values: dict[str, Any] = {
        "registered": model.num_reg_images(),
        "photos": len(site.photographs),
        "models": models,
        "reprojection_error_px": round(model.compute_mean_reprojection_error(), 4),
        "tie_points": len(points.numbers),
        "observations": model.compute_num_observations(),
        "gnss_rms_m": None if gnss is None else round(float(gnss), 4),
        "offset": offset.tolist(),
        "focal_length_px": {str(c.camera_id): round(float(c.params[0]), 3) for c in model.cameras.values()},
    }
    for role in ("control", "check", "verify"):
        horizontal, vertical = rms(rows, role)
        values[f"{role}_rms_xy_m"] = None if horizontal is None else round(horizontal, 5)
        values[f"{role}_rms_z_m"] = None if vertical is None else round(vertical, 5)
    return values | {"warnings": warnings}
