"""Weighted adjustment, control and checkpoints against the truth of virtual blocks."""

import re
from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from flown_block import GSD, OFFSET  # type: ignore[import-not-found]

from workbench.errors import OrientationError
from workbench.orientation.control import rms
from workbench.orientation.georeference import georeference
from workbench.orientation.precision import pose_covariances
from workbench.orientation.quality import shape_warnings
from workbench.params import OrientParameters

OPTIONS = OrientParameters(threads=1)


def centre_errors(block):
    return {
        name: block.model.find_image_with_name(name).projection_center() + OFFSET - pose.centre
        for name, pose in block.poses.items()
    }


def free_frame(block):
    """Move a model into a frame that knows nothing of the site."""
    turn = pycolmap.Rotation3d(np.array([0.2, -0.4, 0.3, 0.8]) / np.linalg.norm([0.2, -0.4, 0.3, 0.8]))
    block.model.transform(pycolmap.Sim3d(0.13, turn, np.array([5.0, -3.0, 2.0])))


def without_positions(site):
    return replace(site, photographs=tuple(replace(p, position=None) for p in site.photographs))


@pytest.mark.parametrize("georeference_by", ["positions", "control", "both"])
def test_each_way_to_fix_a_block_finds_the_truth(virtual_block, georeference_by):
    block = virtual_block(disturb=0.05)
    options = OPTIONS.model_copy(update={"georeference": georeference_by})
    fixed = georeference(block.model, block.site, OFFSET, options)
    horizontal, vertical = rms(fixed.residuals(block.model), "check")
    assert horizontal <= 2 * GSD
    assert vertical <= (6 if georeference_by == "positions" else 3) * GSD
    assert bool(fixed.control) == (georeference_by != "positions")


def test_control_alone_places_a_free_model(virtual_block):
    block = virtual_block()
    free_frame(block)
    fixed = georeference(block.model, without_positions(block.site), OFFSET, OPTIONS)
    rows = fixed.residuals(block.model)
    assert rms(rows, "check")[0] <= 2 * GSD
    assert max(np.linalg.norm(e) for e in centre_errors(block).values()) < 0.15


def test_precise_control_wins_over_shifted_positions(virtual_block):
    """Positions 1 m off but said to be good to 2 m: control of 5 mm must hold to its own precision."""
    block = virtual_block()
    shifted = tuple(
        replace(p, position=tuple(np.add(p.position, (1, 1, 1))), position_sd=(2.0, 2.0, 2.0))
        for p in block.site.photographs
    )
    fixed = georeference(block.model, replace(block.site, photographs=shifted), OFFSET, OPTIONS)
    horizontal, vertical = rms(fixed.residuals(block.model), "control")
    assert horizontal < 0.02
    assert vertical < 0.03


def test_control_of_low_weight_does_not_bend_the_block(virtual_block):
    block = virtual_block()
    weak = tuple(replace(p, x=p.x + 1.0, sd_xy=20.0, sd_z=20.0) for p in block.site.control)
    georeference(block.model, replace(block.site, control=weak), OFFSET, OPTIONS)
    errors = np.array(list(centre_errors(block).values()))
    assert np.abs(errors.mean(axis=0)[0]) < 0.1


def test_checkpoints_never_enter(virtual_block):
    """Moving every check and verify point by kilometres changes no pose."""
    poses = []
    for shift in (0.0, 5000.0):
        block = virtual_block(verify=2)
        moved = tuple(p if p.role == "control" else replace(p, z=p.z + shift) for p in block.site.control)
        georeference(block.model, replace(block.site, control=moved), OFFSET, OPTIONS)
        poses.append(np.array(list(centre_errors(block).values())))
    np.testing.assert_array_equal(*poses)


def test_same_input_same_bytes(virtual_block, tmp_path):
    written = []
    for run in ("a", "b"):
        block = virtual_block(disturb=0.05)
        georeference(block.model, block.site, OFFSET, OPTIONS)
        (tmp_path / run).mkdir()
        block.model.write_binary(tmp_path / run)
        written.append((tmp_path / run / "images.bin").read_bytes())
    assert written[0] == written[1]


def test_adjustment_leaves_no_trace_of_control(virtual_block):
    block = virtual_block()
    before = [block.model.image(k).num_points2D() for k in sorted(block.model.reg_image_ids())]
    points = block.model.num_points3D()
    georeference(block.model, block.site, OFFSET, OPTIONS)
    assert [block.model.image(k).num_points2D() for k in sorted(block.model.reg_image_ids())] == before
    assert block.model.num_points3D() == points


def test_gross_control_point_is_named_and_left_out(virtual_block):
    block = virtual_block(control=7, surveyed=12)
    wrong = tuple(replace(p, y=p.y + 4.0) if p.name == "P2" else p for p in block.site.control)
    fixed = georeference(block.model, replace(block.site, control=wrong), OFFSET, OPTIONS)
    assert fixed.gross == ("P2",)
    assert any("P2" in warning for warning in fixed.warnings())
    rows = fixed.residuals(block.model)
    assert next(row for row in rows if row.name == "P2").dy == pytest.approx(-4.0, abs=0.05)
    assert rms(rows, "check")[0] <= 2 * GSD


def test_gross_control_point_of_decimetres_is_found_once_the_block_is_adjusted(virtual_block):
    """One rough point among the control hides it from the first comparison, of free block and survey."""
    block = virtual_block(control=6, surveyed=12)
    rough = [replace(p, sd_xy=0.1, sd_z=0.1) if p.name == "P0" else p for p in block.site.control]
    wrong = tuple(replace(p, x=p.x + 0.3) if p.name == "P1" else p for p in rough)
    fixed = georeference(block.model, replace(without_positions(block.site), control=wrong), OFFSET, OPTIONS)
    assert fixed.gross == ("P1",)
    assert rms(fixed.residuals(block.model), "check")[0] <= 2 * GSD


def test_where_the_others_cannot_tell_a_doubtful_point_is_named_and_used(virtual_block):
    """Three others fit whatever they are: none of four can be called wrong."""
    block = virtual_block(control=4, surveyed=12)
    wrong = tuple(replace(p, z=p.z + 0.8) if p.name == "P1" else p for p in block.site.control)
    fixed = georeference(block.model, replace(without_positions(block.site), control=wrong), OFFSET, OPTIONS)
    assert fixed.gross == ()
    assert len(fixed.control) == 4
    assert any("fits badly" in warning for warning in fixed.warnings())


def test_good_points_are_neither_left_out_nor_doubted(virtual_block):
    for seed in range(4):
        block = virtual_block(control=6, surveyed=12, seed=seed)
        fixed = georeference(block.model, without_positions(block.site), OFFSET, OPTIONS)
        assert (fixed.gross, fixed.doubtful) == ((), "")


@pytest.mark.parametrize("placed", [False, True])
def test_one_point_with_swapped_axes_is_named_and_no_line_is_seen(virtual_block, placed):
    """Thousands of kilometres away, it makes all others look like one place."""
    block = virtual_block(control=6, surveyed=12)
    swapped = tuple(replace(p, x=p.y, y=p.x) if p.name == "P3" else p for p in block.site.control)
    if not placed:
        free_frame(block)
    site = replace(block.site if placed else without_positions(block.site), control=swapped)
    fixed = georeference(block.model, site, OFFSET, OPTIONS)
    assert fixed.gross == ("P3",)
    assert rms(fixed.residuals(block.model), "check")[0] <= 2 * GSD


@pytest.mark.parametrize("point", ["P1", "P8"])
def test_a_mistyped_measurement_is_named_and_its_point_stays(virtual_block, point):
    """One control point and one check point; the others of the point are good."""
    block = virtual_block()
    seen = list(block.site.observations)
    at = next(k for k, o in enumerate(seen) if o.name == point)
    seen[at] = replace(seen[at], column=seen[at].column + 60)
    fixed = georeference(block.model, replace(block.site, observations=tuple(seen)), OFFSET, OPTIONS)
    ((name, photo, miss),) = [(one.name, one.photo, one.miss_px) for one in fixed.misread]
    assert (name, photo, miss) == (point, seen[at].photo, pytest.approx(60, abs=8))
    assert f"{point} in {photo} lies" in fixed.warnings()[0]
    rows = fixed.residuals(block.model)
    assert fixed.gross == () and next(r for r in rows if r.name == point).role != "unused"
    assert rms(rows, "check")[0] <= 2 * GSD


def test_rough_measurements_are_none_that_contradict(virtual_block):
    block = virtual_block(disturb=0.05)
    rng = np.random.default_rng(5)
    rough = tuple(
        replace(o, column=o.column + rng.normal(0, 2), row=o.row + rng.normal(0, 2))
        for o in block.site.observations
    )
    fixed = georeference(block.model, replace(block.site, observations=rough), OFFSET, OPTIONS)
    assert fixed.misread == ()


def test_of_two_measurements_neither_is_blamed(virtual_block):
    block = virtual_block()
    mine = [o for o in block.site.observations if o.name == "P8"][:2]
    others = [o for o in block.site.observations if o.name != "P8"]
    wrong = replace(mine[1], column=mine[1].column + 60, row=mine[1].row + 60)
    site = replace(block.site, observations=(*others, mine[0], wrong))
    fixed = georeference(block.model, site, OFFSET, OPTIONS)
    (one,) = fixed.misread
    assert (one.name, one.photo) == ("P8", "") and "contradict each other" in fixed.warnings()[0]


def test_points_on_a_line_are_refused(virtual_block):
    block = virtual_block()
    control = tuple(p for p in block.site.control)
    a, b = control[0], control[1]
    line = []
    for k, p in enumerate(control[:4]):
        t = k / 3
        line.append(replace(p, x=a.x + t * (b.x - a.x), y=a.y + t * (b.y - a.y), z=a.z + t * (b.z - a.z)))
    free_frame(block)
    site = replace(without_positions(block.site), control=tuple(line))
    with pytest.raises(OrientationError, match="on a line"):
        georeference(block.model, site, OFFSET, OPTIONS)


def test_points_on_a_line_are_used_where_positions_hold_the_block(virtual_block):
    block = virtual_block()
    on_line = {p.name for p in block.site.control if abs(p.y - OFFSET[1] - 2) < 1}  # The southernmost row.
    assert len(on_line) > 2
    control = tuple(replace(p, role="control" if p.name in on_line else "check") for p in block.site.control)
    fixed = georeference(block.model, replace(block.site, control=control), OFFSET, OPTIONS)
    rows = fixed.residuals(block.model)
    assert any("on a line" in warning for warning in fixed.warnings())
    assert (rms(rows, "control")[0] < 0.02, rms(rows, "check")[0] <= 2 * GSD) == (True, True)


@pytest.mark.parametrize("control", [1, 2, 4])
@pytest.mark.parametrize("shift", [(0.0, 0.0, 45.0), (120.0, -80.0, 0.0)])
def test_positions_in_another_datum_do_not_move_the_block(virtual_block, control, shift):
    block = virtual_block(control=control)
    moved = tuple(replace(p, position=tuple(np.add(p.position, shift))) for p in block.site.photographs)
    block.model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), np.array(shift)))
    fixed = georeference(block.model, replace(block.site, photographs=moved), OFFSET, OPTIONS)
    horizontal, vertical = rms(fixed.residuals(block.model), "check")
    assert (horizontal <= 2 * GSD, vertical <= 3 * GSD) == (True, True)
    assert fixed.placing.shift == pytest.approx(shift, abs=0.1)
    expected = "m too high .*ellipsoid" if shift[2] else "m east and .* m north .*two datums"
    assert any(re.search(expected, warning) for warning in fixed.warnings())


@pytest.mark.parametrize("drift", [(0.0, 0.0, 0.0), (7.0, 0.0, 6.0)])
def test_positions_in_the_same_datum_are_not_shifted(virtual_block, drift):
    """Nor those of a poor receiver, off by three of its standard deviations."""
    block = virtual_block(gnss_sd=(1.5, 3.0))
    poor = tuple(replace(p, position=tuple(np.add(p.position, drift))) for p in block.site.photographs)
    block.model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), np.array(drift)))
    fixed = georeference(block.model, replace(block.site, photographs=poor), OFFSET, OPTIONS)
    assert not fixed.placing.shift.any() and not fixed.warnings()[1:]


def test_a_few_check_points_show_another_vertical_datum(virtual_block):
    block = virtual_block(control=0, surveyed=4)
    lower = tuple(replace(p, z=p.z - 45) for p in block.site.control)
    fixed = georeference(block.model, replace(block.site, control=lower), OFFSET, OPTIONS)
    (warning,) = shape_warnings(fixed.residuals(block.model), lower)
    assert "+44.9" in warning and "vertical datum" in warning


def test_control_with_exchanged_axes_is_refused_and_names_no_point(virtual_block):
    """A flat block fits its mirror image, seen from below."""
    block = virtual_block(control=6)
    swapped = tuple(replace(p, x=p.y, y=p.x) for p in block.site.control)
    free_frame(block)
    offset = OFFSET[[1, 0, 2]]
    with pytest.raises(OrientationError, match=r"look up from below .* x and y"):
        georeference(block.model, replace(without_positions(block.site), control=swapped), offset, OPTIONS)


def test_two_control_points_fix_nothing(virtual_block):
    block = virtual_block(control=2)
    with pytest.raises(OrientationError, match="at least 3"):
        georeference(block.model, without_positions(block.site), OFFSET, OPTIONS)


def test_all_points_control_is_said(virtual_block):
    block = virtual_block(control=12)
    fixed = georeference(block.model, block.site, OFFSET, OPTIONS)
    assert any("All surveyed points are control" in warning for warning in fixed.warnings())
    assert rms(fixed.residuals(block.model), "check") == (None, None)


def test_focal_length_is_freed_only_where_the_block_sees_it(virtual_block):
    nadir, oblique = virtual_block(), virtual_block(obliques=True)
    assert not georeference(nadir.model, nadir.site, OFFSET, OPTIONS).free_focal_length
    fixed = georeference(oblique.model, oblique.site, OFFSET, OPTIONS)
    assert fixed.free_focal_length
    assert oblique.model.camera(1).params[0] == pytest.approx(3000, abs=15)


def test_heights_without_control_are_warned_of(virtual_block):
    block = virtual_block(control=0)
    fixed = georeference(block.model, block.site, OFFSET, OPTIONS)
    assert any("focal length of the camera table" in warning for warning in fixed.warnings())


def test_pose_covariance_predicts_the_scatter_over_noise(virtual_block):
    """Errors of 12 seeds, divided by their predicted standard deviations, have unit variance."""
    ratios = []
    for seed in range(12):
        block = virtual_block(seed=seed, control=0, tie_points=150, noise=1.0)
        fixed_lens = OPTIONS.model_copy(update={"focal_length": "fixed"})
        georeference(block.model, block.site, OFFSET, fixed_lens)
        priors = {p.name: np.diag(np.square(p.position_sd)) for p in block.site.photographs}
        found = pose_covariances(block.model, priors)
        errors = centre_errors(block)
        ratios += [errors[name] / np.sqrt(np.diag(found[name])[:3]) for name in errors]
    spread = np.sqrt(np.mean(np.square(ratios), axis=0))
    # Lens distortion is adjusted as well, which the covariance holds fixed; hence the room upwards.
    assert (spread > 0.7).all()
    assert (spread < 1.5).all()


def test_covariance_without_anything_that_fixes_the_block_is_nan(virtual_block):
    block = virtual_block()
    found = pose_covariances(block.model, {})
    assert all(np.isnan(c).all() for c in found.values())


def test_leaves_that_move_do_not_pull_a_photograph_along(virtual_block):
    """A tenth of the points of one photograph, all on one side of it, moved 3 px the same way."""

    def errors(sds):
        block = virtual_block(noise=0.2, seed=4)
        image = block.model.find_image_with_name("1_3.jpg")
        seen = [k for k, p in enumerate(image.points2D) if p.has_point3D()]
        seen.sort(key=lambda k: image.points2D[k].xy[1])
        for k in seen[: len(seen) // 10]:
            image.points2D[k].xy = image.points2D[k].xy + (0.0, 3.0)
        options = OPTIONS.model_copy(update={"outlier_sds": sds})
        georeference(block.model, block.site, OFFSET, options)
        return centre_errors(block)["1_3.jpg"], block.model.compute_num_observations()

    off, everything = errors(1000.0)
    held, kept = errors(5.0)
    assert np.linalg.norm(held) < 0.6 * np.linalg.norm(off)
    # Hardly any observation beside the moved ones is lost.
    assert 0.97 * everything < kept < everything


def test_precision_of_tie_points_is_read_from_their_residuals(virtual_block):
    for noise in (0.2, 0.8):
        block = virtual_block(noise=noise)
        fixed = georeference(block.model, block.site, OFFSET, OPTIONS)
        assert fixed.tie_point_sd == pytest.approx(noise, rel=0.1)
        assert fixed.pointing_sd == pytest.approx(0.3, rel=0.25)  # Of the targets of the block.


def test_a_block_does_not_bend_after_drifting_positions(virtual_block):
    """Positions of a drone drift by a metre from strip to strip; tie points and four targets know better."""
    block = virtual_block(noise=0.2, gnss_sd=(1.5, 3.0), tie_points=1500)
    drift = {0: (1.0, -1.0, 3.0), 1: (-1.0, 1.0, -3.0), 2: (1.0, 1.0, 3.0)}
    site = replace(
        block.site,
        photographs=tuple(
            replace(p, position=tuple(np.add(p.position, drift[p.strip]))) for p in block.site.photographs
        ),
    )
    fixed = georeference(block.model, site, OFFSET, OPTIONS)
    horizontal, vertical = rms(fixed.residuals(block.model), "check")
    assert horizontal <= GSD
    assert vertical <= 2 * GSD


def test_covariance_of_a_block_that_rough_positions_fix(virtual_block):
    """As a whole a block of 18 photographs is known to no better than 20 m over the root of 18."""
    block = virtual_block()
    found = pose_covariances(
        block.model, {name: np.eye(3) * 20.0**2 for name in block.poses}, observation_sd=0.3
    )
    sd = np.sqrt([np.diag(c)[:3] for c in found.values()])
    assert (sd > 20 / np.sqrt(18) * 0.99).all()
    assert (sd < 20).all()
