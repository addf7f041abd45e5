"""Vertical parallax that orientation left in a pair: measured, taken out, kept with the pair."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from workbench.cameras import Camera, Pose
from workbench.matching.pairs import StereoPair
from workbench.matching.rectify import RowOffsets, rectify_pair, resample
from workbench.matching.rows import measure_row_offsets
from workbench.matching.store import MatchedPair, load_pair, save_pair
from workbench.orientation import OrientedPhotograph

CAMERA = Camera.from_focal_length("test", 640, 480, focal_length=0.02, pixel_size=2e-5)
GROUND, CELL = 0.0, 0.05


def photograph(name, x):
    pose = Pose.from_roll_pitch_heading(np.array([x, 0.0, 100.0]), 0, 0, 0)
    return OrientedPhotograph(name, None, CAMERA, pose, 0, 0)


def picture(station, texture, lowered):
    """What a station sees of a flat ground, each row lowered on the sensor by ``lowered(x, y)`` px."""
    columns, rows = np.meshgrid(np.arange(CAMERA.width) + 0.5, np.arange(CAMERA.height) + 0.5)
    shift = lowered((columns - 320) / 1000, (rows - 240) / 1000)
    seen = np.stack([columns.ravel(), (rows - shift).ravel()], axis=1)
    rays = station.pose.to_world(CAMERA.rays(seen))
    points = station.pose.centre + rays * ((GROUND - station.pose.centre[2]) / rays[:, 2])[:, None]
    place = (points[:, :2] / CELL + texture.shape[0] / 2 - 0.5).astype(np.float32)
    place = place.reshape(CAMERA.height, CAMERA.width, 2)
    return cv2.remap(texture, place[..., 0], place[..., 1], cv2.INTER_LINEAR)


@pytest.fixture(scope="module")
def texture():
    noise = np.random.default_rng(3).normal(128, 120, (2400, 2400)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 3)


def rectified(texture, lowered, rows=None):
    """Both rectified images, their true disparity and geometry."""
    frame, swapped = rectify_pair(
        StereoPair(photograph("a", -5), photograph("b", 5), "inflight"), (-2, 10), downscale=1
    )
    frame = replace(frame, rows=rows)
    stations = [photograph("a", -5), photograph("b", 5)]
    left, right = stations[::-1] if swapped else stations
    images = [
        resample(
            picture(s, texture, lowered if is_right else lambda x, y: 0 * x),
            CAMERA,
            s.pose,
            frame,
            right=is_right,
        )
        for s, is_right in ((left, False), (right, True))
    ]
    disparity = np.full(frame.shape, frame.focal * frame.base / 100 - frame.shift, np.float32)
    return *images, disparity, frame


def bent(x, y):
    return 0.5 + x - 1.5 * y + 4 * x * y + 2 * x**2 - 3 * y**2


def test_offsets_are_found_and_taken_out(texture):
    left, right, disparity, frame = rectified(texture, bent)
    first = measure_row_offsets(left, right, disparity, frame)
    left, right, disparity, frame = rectified(texture, bent, rows=first)
    second = measure_row_offsets(left, right, disparity, frame)
    x, y = np.meshgrid(np.linspace(-0.25, 0.2, 9), np.linspace(-0.2, 0.2, 9))
    true = bent(x, y) if frame.rotation[1] @ photograph("a", 0).pose.rotation[1] > 0 else -bent(-x, -y)
    np.testing.assert_allclose(second.at(x, y) * frame.focal, true, atol=0.08)
    # What is left after the first round is what the second one adds.
    assert np.abs(second.at(x, y) - first.at(x, y)).max() * frame.focal < 0.15


def test_a_true_pair_keeps_its_rows(texture):
    found = measure_row_offsets(*rectified(texture, lambda x, y: 0 * x))
    assert max(abs(found.lowest), abs(found.highest)) * 1000 < 0.05


def test_too_little_says_nothing(texture):
    left, right, disparity, frame = rectified(texture, bent)
    disparity[60:] = disparity[:, 60:] = np.nan
    assert measure_row_offsets(left, right, disparity, frame) is None
    known = RowOffsets((1e-3, 0, 0, 0, 0, 0), 1e-3, 1e-3)
    assert measure_row_offsets(left, right, disparity, replace(frame, rows=known)) is known


def test_offsets_are_stored_with_the_pair(texture, tmp_path):
    left, right, disparity, frame = rectified(texture, bent)
    rows = measure_row_offsets(left, right, disparity, frame)
    pair = MatchedPair("p", 1, replace(frame, rows=rows), disparity, np.zeros(frame.shape, np.uint8))
    save_pair(pair, tmp_path / "p.zip")
    assert load_pair(tmp_path / "p.zip").rectification.rows == rows
