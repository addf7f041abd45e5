"""From matches to a first model: incremental structure from motion, in the frame of the positions."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pycolmap

from workbench.errors import OrientationError
from workbench.params import OrientParameters
from workbench.site import Photograph, Site

_LEAST_PRIORS = 3
# Aerial blocks with 90 % overlap meet at 2-5 degrees; COLMAP's 16 would leave no pair to begin with.
_LEAST_START_ANGLE = 2.0
_LEAST_ANGLE = 0.5


def map_block(
    site: Site, database: Path, offset: np.ndarray, parameters: OrientParameters, work: Path
) -> tuple[pycolmap.Reconstruction, int]:
    """Register as many photographs as possible; the largest of several models counts.

    Returns
    -------
    model : Reconstruction
        In the site's CRS minus ``offset`` where positions were used, otherwise in a free frame.
    models : int
        How many separate models there were.

    Raises
    ------
    OrientationError
        If no two photographs could be connected.
    """
    use_positions = parameters.georeference != "control" and _write_priors(site, database, offset, parameters)
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = parameters.seed
    options.mapper.random_seed = parameters.seed
    options.triangulation.random_seed = parameters.seed
    options.num_threads = options.mapper.num_threads = 1
    # One thread in the solver: the same seed then gives the same bytes.
    options.ba_min_num_residuals_for_cpu_multi_threading = 10**9
    options.use_prior_position = use_positions
    options.use_robust_loss_on_prior_position = use_positions
    options.ba_refine_focal_length = parameters.focal_length == "free"
    options.mapper.abs_pose_refine_focal_length = parameters.focal_length == "free"
    options.mapper.init_min_tri_angle = _LEAST_START_ANGLE
    options.mapper.filter_min_tri_angle = _LEAST_ANGLE
    options.triangulation.min_angle = _LEAST_ANGLE
    options.min_model_size = 2
    options.extract_colors = False
    # The database may remember photographs that the site has set aside since.
    options.image_names = [photograph.name for photograph in site.photographs]
    folder = work / "models"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    pycolmap.set_random_seed(parameters.seed)
    # Without colours the photographs themselves are not looked at.
    models = pycolmap.incremental_mapping(database, work, folder, options)
    if not models:
        raise OrientationError(
            f"Site {site.name}: no two photographs could be connected. They may not overlap, or be blurred, "
            "or show too little texture: look at the overlap map, raise orient.max_image_size."
        )
    largest = max(models.values(), key=lambda model: (model.num_reg_images(), model.num_points3D()))
    return largest, len(models)


def prior_of(
    photograph: Photograph, offset: np.ndarray, parameters: OrientParameters
) -> tuple[np.ndarray, np.ndarray] | None:
    """Position (3,) minus offset and its covariance (3, 3), or None without a position."""
    if photograph.position is None:
        return None
    sd = photograph.position_sd or (parameters.gnss_sd_xy, parameters.gnss_sd_xy, parameters.gnss_sd_z)
    return np.asarray(photograph.position) - offset, np.diag(np.square(sd))


def _write_priors(site: Site, database: Path, offset: np.ndarray, parameters: OrientParameters) -> bool:
    """Replace what EXIF put into the database by local coordinates; False if there are too few."""
    by_name = {photograph.name: photograph for photograph in site.photographs}
    handle = pycolmap.Database.open(database)
    known = {prior.corr_data_id.id: prior for prior in handle.read_all_pose_priors()}
    count = 0
    for image in handle.read_all_images():
        photograph = by_name.get(image.name)
        found = prior_of(photograph, offset, parameters) if photograph else None
        prior = pycolmap.PosePrior()
        prior.corr_data_id = image.data_id
        prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
        if found is not None:
            prior.position, prior.position_covariance = found
            count += 1
        if image.data_id.id in known:
            prior.pose_prior_id = known[image.data_id.id].pose_prior_id
            handle.update_pose_prior(prior)
        elif found is not None:
            handle.write_pose_prior(prior)
    handle.close()
    return count >= _LEAST_PRIORS
