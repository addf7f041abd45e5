"""Recorded attitudes hold what positions leave open, and move nothing that tie points know better."""

from dataclasses import replace

import numpy as np
import pytest
from flown_block import OFFSET  # type: ignore[import-not-found]
from scipy.spatial.transform import Rotation

from workbench.cameras import Pose
from workbench.orientation.adjust import adjust
from workbench.orientation.attitudes import recorded_turns
from workbench.params import OrientParameters

OPTIONS = OrientParameters(threads=1, georeference="positions")
SD = 0.02


def with_attitudes(block, mounting=(0.0, 0.0, 0.0), noise=0.0, sd=SD):
    """The site with attitudes as an instrument turned against the camera records them."""
    rng = np.random.default_rng(3)
    turn = Rotation.from_rotvec(mounting, degrees=True)
    photographs = []
    for p in block.site.photographs:
        jitter = Rotation.from_rotvec(rng.normal(0, noise, 3), degrees=True)
        rotation = (turn * jitter * Rotation.from_matrix(block.poses[p.name].rotation)).as_matrix()
        attitude = Pose(rotation, np.zeros(3)).omega_phi_kappa
        photographs.append(replace(p, attitude=attitude, attitude_sd=(sd, sd, sd)))
    return replace(block.site, photographs=tuple(photographs))


def single_strip(block, half_width=6.0):
    """Keep the first strip and the tie points close to its axis."""
    model = block.model
    for number in sorted(model.point3D_ids()):
        if abs(model.point3D(number).xyz[1]) > half_width:
            model.delete_point3D(number)
    for image in list(model.images.values()):
        if not image.name.startswith("0_"):
            model.deregister_frame(image.frame_id)
    return block


def turn_errors(block):
    """Degrees about the camera's axes, adjusted against true."""
    errors = []
    for number in sorted(block.model.reg_image_ids()):
        image = block.model.image(number)
        true = Rotation.from_matrix(block.poses[image.name].rotation)
        found = Rotation.from_matrix(image.cam_from_world().rotation.matrix())
        errors.append((found * true.inv()).as_rotvec(degrees=True))
    return np.array(errors)


def test_a_turned_instrument_is_seen_through(virtual_block):
    block = virtual_block()
    site = with_attitudes(block, mounting=(1.0, -2.0, 4.0))
    turns = recorded_turns(block.model, site, OPTIONS)
    assert sum(turn.reference is None for turn in turns) == 3
    assert len(turns) == len(site.photographs)
    for turn in turns:
        if turn.reference is not None:
            one, other = (block.poses[block.model.image(number).name].rotation for number in turn[:2])
            assert np.abs(turn.rotation - one @ other.T).max() < 1e-6
            assert np.allclose(np.sqrt(np.diag(turn.covariance)), np.radians(SD) * np.sqrt(2), rtol=1e-6)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_attitudes_hold_a_single_strip_over_narrow_ground(virtual_block, seed):
    """Positions on a line leave its roll open, by degrees; a calibrated instrument knows it."""
    loose = single_strip(virtual_block(tie_points=2000, seed=seed))
    held = single_strip(virtual_block(tie_points=2000, seed=seed))
    calibrated = OPTIONS.model_copy(update={"mounting_sd": SD})
    adjust(loose.model, loose.site, OFFSET, OPTIONS)
    adjust(held.model, with_attitudes(held, noise=SD), OFFSET, calibrated)
    worst = [np.abs(turn_errors(block)).max() for block in (loose, held)]
    assert worst[1] < 5 * SD  # Two recorded attitudes, each with its noise.
    assert worst[1] < worst[0] / 3


def test_coarse_attitudes_do_not_move_a_good_block(virtual_block):
    plain, informed = virtual_block(), virtual_block()
    adjust(plain.model, plain.site, OFFSET, OPTIONS)
    adjust(informed.model, with_attitudes(informed, (3, 1, 2), noise=1.0, sd=1.0), OFFSET, OPTIONS)
    for number in plain.model.reg_image_ids():
        moved = (
            plain.model.image(number).projection_center() - informed.model.image(number).projection_center()
        )
        assert np.abs(moved).max() < 0.01


def test_attitudes_about_other_axes_are_not_used(virtual_block):
    block = virtual_block()
    rng = np.random.default_rng(0)
    site = replace(
        block.site,
        photographs=tuple(
            replace(p, attitude=tuple(rng.uniform(-180, 180, 3))) for p in block.site.photographs
        ),
    )
    assert recorded_turns(block.model, site, OPTIONS) == []
