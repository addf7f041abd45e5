"""The optimisation of the reprojection-error threshold, confirmed by truth."""

import numpy as np
import pandas as pd
import pycolmap
import pytest
from flown_block import GSD, OFFSET  # type: ignore[import-not-found]

from workbench.errors import OrientationError
from workbench.orientation.georeference import georeference
from workbench.orientation.optimise import (
    filter_tie_points,
    optimise_tie_points,
    summarise_repetitions,
)
from workbench.orientation.tie_points import tie_points
from workbench.params import OrientParameters

THRESHOLDS = (60.0, 30.0, 10.0, 4.0, 2.0, 1.5, 1.0, 0.8, 0.6, 0.4, 0.2)
# All outliers stay until the optimisation removes them.
OPTIONS = OrientParameters(threads=1, max_reprojection_error=100, optimise=True)


@pytest.fixture
def optimised(virtual_block):
    block = virtual_block(outliers=0.05, surveyed=20, control=4, verify=6, disturb=0.05)
    fixed = georeference(block.model, block.site, OFFSET, OPTIONS)
    return (
        block,
        fixed,
        optimise_tie_points(block.model, fixed.adjust, fixed.residuals, thresholds=THRESHOLDS),
    )


def test_optimum_is_interior_and_within_two_and_three_gsd(optimised):
    _, _, result = optimised
    assert result.is_interior
    assert result.optimised_error < result.trials[0].check_error
    best = result.table().query("chosen").iloc[0]
    assert best.check_xy_m <= 2 * GSD
    assert best.check_z_m <= 3 * GSD


def test_truth_confirms_the_checkpoints(optimised):
    block, fixed, result = optimised

    def true_error(model):
        rows = fixed.residuals(model)
        surveyed = {p.name: np.array([p.x, p.y, p.z]) for p in block.site.control}
        errors = [
            surveyed[r.name] + (r.dx, r.dy, r.dz) - block.truth[r.name] for r in rows if r.role == "check"
        ]
        return np.sqrt(np.mean(np.sum(np.square(errors), axis=1)))

    assert true_error(result.model) < true_error(block.model)
    assert true_error(result.model) == pytest.approx(result.optimised_error, abs=GSD / 2)


def test_reported_error_is_not_the_optimised_one(optimised):
    _, _, result = optimised
    assert result.cross_validated_error >= result.optimised_error
    assert result.verify_error is not None
    assert result.verify_error < 4 * GSD


def test_search_ends_where_photographs_are_lost(optimised):
    _, _, result = optimised
    assert "would lose" in result.stopped
    assert result.trials[-1].threshold > THRESHOLDS[-1]
    assert result.model.num_reg_images() == 18


def test_a_list_that_ends_too_early_is_continued(virtual_block):
    """The best of a list that ends above the noise is its strictest: the search goes on until it is not."""
    block = virtual_block(outliers=0.05, surveyed=20, control=4, disturb=0.05)
    fixed = georeference(block.model, block.site, OFFSET, OPTIONS)
    result = optimise_tie_points(block.model, fixed.adjust, fixed.residuals, thresholds=(60.0, 10.0))
    thresholds = [trial.threshold for trial in result.trials]
    assert thresholds[:4] == [60.0, 10.0, 7.0, 4.9]
    assert result.threshold < 10
    assert result.is_interior


def test_input_model_is_not_changed(virtual_block):
    block = virtual_block(tie_points=200)
    fixed = georeference(block.model, block.site, OFFSET, OPTIONS)
    before = block.model.num_points3D(), block.model.image(1).projection_center()
    optimise_tie_points(block.model, fixed.adjust, fixed.residuals, thresholds=(1.0, 0.8))
    assert block.model.num_points3D() == before[0]
    np.testing.assert_array_equal(block.model.image(1).projection_center(), before[1])


def test_without_checkpoints_there_is_nothing_to_optimise(virtual_block):
    block = virtual_block(control=12, surveyed=12)
    fixed = georeference(block.model, block.site, OFFSET, OPTIONS)
    with pytest.raises(OrientationError, match="at least two points of role check"):
        optimise_tie_points(block.model, fixed.adjust, fixed.residuals)


def test_attributes_of_an_undisturbed_block(virtual_block):
    block = virtual_block(noise=0.0)
    points = tie_points(block.model)
    assert points.reprojection_error.max() < 1e-6
    assert points.image_count.min() >= 2
    assert (points.reconstruction_uncertainty >= 1).all()


def test_reconstruction_uncertainty_of_two_views_is_twice_height_over_base():
    """Below the middle of base B at distance h, the ellipsoid's axes are as 2 h / B (analytic)."""
    height, base = 90.0, 30.0
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(camera_id=1, model="RADIAL", width=4000, height=3000, params=[3000, 2000, 1500, 0, 0])
    )
    down = np.diag([1.0, -1.0, -1.0])
    for number, x in ((1, -base / 2), (2, base / 2)):
        column = 2000 - 3000 * x / height
        image = pycolmap.Image(name=f"{number}", keypoints=[[column, 1500.0]], camera_id=1, image_id=number)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(down), -down @ (x, 0.0, height))
        model.add_image_with_trivial_frame(image, pose)
    track = pycolmap.Track([pycolmap.TrackElement(1, 0), pycolmap.TrackElement(2, 0)])
    model.add_point3D(np.zeros(3), track, np.zeros(3, np.uint8))
    scales = {"1": np.array([2.0]), "2": np.array([6.0])}
    points = tie_points(model, scales)
    assert points.reconstruction_uncertainty[0] == pytest.approx(2 * height / base, rel=1e-4)
    assert points.reprojection_error[0] == pytest.approx(0, abs=1e-9)
    assert points.projection_accuracy[0] == pytest.approx(4.0 / np.percentile([2, 6], 1))


def test_filter_drops_exactly_what_exceeds_the_limit(virtual_block):
    block = virtual_block(outliers=0.05)
    before = tie_points(block.model)
    filtered, lost = filter_tie_points(block.model, "reprojection_error", 2.0, None, 15)
    kept = set(before.numbers[before.reprojection_error <= 2.0])
    assert set(tie_points(filtered).numbers) == kept
    assert lost == []


def test_table_of_repetitions_has_the_published_form():
    rows = [
        {"check_xy_m": v, "check_z_m": 2 * v, "control_xy_m": 0.1, "control_z_m": 0.1}
        | {"verify_xy_m": None, "verify_z_m": None}
        for v in (0.01, 0.02, 0.03)
    ]
    table = summarise_repetitions(pd.DataFrame(rows))
    assert table.columns.tolist() == [
        *("control_xy_mean_m", "control_xy_sd_m", "control_z_mean_m", "control_z_sd_m"),
        *("check_xy_mean_m", "check_xy_sd_m", "check_z_mean_m", "check_z_sd_m"),
    ]
    assert table.check_xy_mean_m[0] == pytest.approx(0.02)
    assert table.check_xy_sd_m[0] == pytest.approx(0.01)
    assert table.control_xy_sd_m[0] == pytest.approx(0.0)
    with pytest.raises(OrientationError, match="at least two repetitions"):
        summarise_repetitions(pd.DataFrame(rows[:1]))
