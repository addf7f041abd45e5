"""The optimisation of tie points on a block that is oriented already: to look at, to teach, to test."""

from __future__ import annotations

import numpy as np
import pycolmap

from workbench.errors import OrientationError
from workbench.orientation.georeference import georeference
from workbench.orientation.optimise import Optimisation, optimise_tie_points
from workbench.params import OrientParameters
from workbench.site import Site
from workbench.stages import FOLDERS, read_json

_MOVED = (2.0, 50.0)


def try_thresholds(
    site: Site, options: OrientParameters, *, outliers: float = 0.0, seed: int = 0
) -> Optimisation:
    """Optimise the threshold of the tie points of an oriented site; its products are not changed.

    Parameters
    ----------
    outliers
        Share of the measurements of tie points that are moved by 2 to 50 pixels before, 0..1: what a block
        is like whose matches are worse.
    seed
        Of these.

    Raises
    ------
    OrientationError
        If there are fewer than two checkpoints, or the share is outside 0..1.
    SiteError
        If the site is not oriented.
    """
    folder = site.products / FOLDERS["orient"]
    offset = np.array(read_json(folder / "metrics.json")["offset"])
    model = pycolmap.Reconstruction(folder / "sparse")
    if outliers:
        disturb_observations(model, outliers, seed)
    # The limit of the mapping would take outliers away before the optimisation sees them.
    limit = 100.0 if outliers else options.max_reprojection_error
    loose = options.model_copy(update={"optimise": True, "max_reprojection_error": limit})
    fixed = georeference(model, site, offset, loose)
    thresholds = (60.0, 30.0, 15.0, 8.0, *options.thresholds) if outliers else options.thresholds
    return optimise_tie_points(
        model,
        fixed.adjust,
        fixed.residuals,
        thresholds=thresholds,
        max_reconstruction_uncertainty=options.max_reconstruction_uncertainty,
        max_projection_accuracy=options.max_projection_accuracy,
        least_tie_points=options.least_tie_points,
        folds=options.folds,
    )


def disturb_observations(model: pycolmap.Reconstruction, share: float, seed: int) -> int:
    """Move a share of the measurements of tie points by 2 to 50 px in any direction, in place.

    Returns
    -------
    int
        How many were moved.

    Raises
    ------
    OrientationError
        If the share is outside 0..1.
    """
    if not 0 <= share <= 1:
        raise OrientationError(f"A share of {share} of the measurements is outside 0..1.")
    random = np.random.default_rng(seed)
    moved = 0
    for number in sorted(model.reg_image_ids()):
        for point in model.image(number).points2D:
            if point.has_point3D() and random.random() < share:
                angle, distance = random.uniform(0, 2 * np.pi), random.uniform(*_MOVED)
                point.xy = point.xy + distance * np.array([np.cos(angle), np.sin(angle)])
                moved += 1
    return moved
