"""Lens, shutter and sensor, each measured in images that it made."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from workbench.cameras import Camera, Pose
from workbench.errors import SceneError
from workbench.virtual.flight import plan_flight
from workbench.virtual.flight_cameras import flight_camera
from workbench.virtual.optics import Optics, blur_kernel, expose, image_motion, roll_shutter, tone, vignette


def moments(kernel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    axis = np.arange(kernel.shape[0]) - kernel.shape[0] // 2
    y, x = np.meshgrid(axis, axis, indexing="ij")
    mean = np.array([(kernel * x).sum(), (kernel * y).sum()])
    spread = np.array(
        [[(kernel * x * x).sum(), (kernel * x * y).sum()], [(kernel * x * y).sum(), (kernel * y * y).sum()]]
    )
    return mean, spread


@pytest.mark.parametrize("sigma", [0.8, 1.5, 3.0])
@pytest.mark.parametrize("path", [(0.0, 0.0), (4.0, 0.0), (3.0, 3.0)])
def test_point_spread_keeps_the_light_and_has_the_asked_width(sigma, path):
    kernel = blur_kernel(sigma, path)
    mean, spread = moments(kernel)
    assert kernel.sum() == pytest.approx(1, abs=1e-6)
    assert mean == pytest.approx([0, 0], abs=1e-6)
    # A box of length L adds L^2 / 12 to the variance along its direction.
    expected = sigma**2 * np.eye(2) + np.outer(path, path) / 12
    assert spread == pytest.approx(expected, rel=0.03, abs=0.02)


def test_no_blur_is_no_blur():
    assert blur_kernel(0, (0, 0)).shape == (1, 1)
    rng = np.random.default_rng(1)
    light = rng.random((1, 20, 20)).astype(np.float32)
    assert np.array_equal(expose(light, Optics(), rng=rng), light)


def test_motion_blurs_along_the_track():
    point = np.zeros((1, 41, 41), dtype=np.float32)
    point[0, 20, 20] = 1
    optics = Optics(point_spread=0.5, exposure_time=0.01)
    image = expose(point, optics, motion=(0.0, -600.0), rng=np.random.default_rng(1))[0]
    _, spread = moments(image)
    assert spread[1, 1] == pytest.approx(0.25 + 36 / 12, rel=0.05)
    assert spread[0, 0] == pytest.approx(0.25, rel=0.2)


@pytest.mark.parametrize("mount", [0, 1, 2])
def test_image_motion_is_that_of_points_on_the_ground(mount):
    camera = flight_camera("3K")
    flight = plan_flight(
        (0, 0, 4000, 500), camera, ground=0.0, start=datetime(2021, 7, 14, tzinfo=UTC),
        forward_overlap=0.8, side_overlap=0.3, height=1000.0, speed=70.0, direction=30.0,
    )  # fmt: skip
    exposure = flight.exposures[3 + mount]
    motion = image_motion(camera.camera, exposure.pose, exposure.velocity, 0.0)
    # Ground passes from the top of the frame to its bottom; slant range slows it down at the sides.
    slant = np.cos(np.radians(camera.tilts[mount]))
    assert motion[1] == pytest.approx(70 / flight.gsd * slant, rel=1e-3)
    assert motion[0] == pytest.approx(0, abs=1e-3 * motion[1])


def test_vignetting_takes_the_asked_share_of_the_corners():
    shade = vignette((200, 300), 0.4)
    assert shade[0, 0] == pytest.approx(0.6, abs=0.01)
    assert shade[100, 150] == pytest.approx(1, abs=1e-4)
    cropped = vignette((100, 100), 0.4, (300, 200))
    assert np.allclose(cropped, shade[50:150, 100:200], atol=1e-6)
    flat = np.full((3, 200, 300), 0.5, dtype=np.float32)
    seen = expose(flat, Optics(vignetting=0.4), rng=np.random.default_rng(1))
    assert seen[:, 0, 0] == pytest.approx([0.3] * 3, abs=0.005)


@pytest.mark.parametrize("level", [0.02, 0.2, 0.6])
def test_noise_is_photon_noise_and_read_noise(level):
    flat = np.full((1, 400, 400), level, dtype=np.float32)
    optics = Optics(full_well=10_000, read_noise=20)
    seen = expose(flat, optics, rng=np.random.default_rng(2))
    # 160 000 pixels: the standard deviation is known to 0.2 %.
    expected = np.sqrt(level * 10_000 + 20**2) / 10_000
    assert seen.std() == pytest.approx(expected, rel=0.01)
    assert seen.mean() == pytest.approx(level, abs=5 * expected / 400)


def test_light_saturates():
    assert (
        expose(np.full((1, 4, 4), 3.0, dtype=np.float32), Optics(), rng=np.random.default_rng(1)).max() == 1
    )


def test_rolling_shutter_shears_a_vertical_line():
    image = np.zeros((1, 101, 101), dtype=np.float32)
    image[0, :, 50] = 1
    rolled = roll_shutter(image, (10.0, 0.0))[0]
    centre = (rolled * np.arange(101)).sum(axis=1) / rolled.sum(axis=1)
    moment = (np.arange(101) + 0.5) / 101 - 0.5
    assert np.polyfit(moment, centre, 1) == pytest.approx([10.0, 50.0], abs=0.05)
    assert roll_shutter(image, (0.0, 0.0)) is image


def test_tone_is_the_curve_of_srgb():
    values = tone(np.array([-1.0, 0.0, 0.0031308, 0.2158605, 1.0, 2.0]))
    assert values.tolist() == [0, 0, 10, 128, 255, 255]
    assert np.all(np.diff(tone(np.linspace(0, 1, 1000)).astype(int)) >= 0)


@pytest.mark.parametrize(
    "wrong", [{"point_spread": -1.0}, {"vignetting": 1.0}, {"full_well": 0.0}, {"read_noise": -2.0}]
)
def test_impossible_optics_are_refused(wrong):
    with pytest.raises(SceneError):
        Optics(**wrong)


def test_motion_of_a_level_camera_is_speed_over_gsd():
    camera = Camera("c", 100, 80, 1000, 1000, 50, 40)
    pose = Pose.from_roll_pitch_heading(np.array([0, 0, 500.0]), 0, 0, 0)
    assert image_motion(camera, pose, np.array([0, 25.0, 0]), 0.0) == pytest.approx([0, 50], abs=1e-3)
