"""The matcher on pairs with exact truth, and on input that cannot be matched."""

import numpy as np
import pytest
from scipy import ndimage

from workbench.errors import MatchingError
from workbench.matching import match_pair
from workbench.virtual.stereo_pairs import Layer, Radiometry, curved_pair, layered_pair, noise_texture

SIZE = 240
RANGE = (-4, 60)


def waves(x, y):
    return 25 + 8 * np.sin(x / 40) + 6 * np.cos(y / 55)


@pytest.fixture(scope="module")
def curved():
    texture = noise_texture((SIZE, SIZE + 120), seed=3)
    return curved_pair(texture, waves, SIZE, Radiometry(noise=3, gain=0.8, offset=20), seed=4)


def errors(found, pair):
    known = np.isfinite(found.disparity.values) & pair.visible
    difference = found.disparity.values[known] - pair.disparity[known]
    return 1.4826 * np.median(np.abs(difference - np.median(difference))), difference, known


def test_subpixel_accuracy_beats_opencv_with_other_brightness(curved):
    ours, difference, known = errors(match_pair(curved.left, curved.right, RANGE), curved)
    theirs, _, _ = errors(match_pair(curved.left, curved.right, RANGE, engine="opencv"), curved)
    assert ours <= 0.10
    assert ours < theirs
    assert abs(np.median(difference)) < 0.05
    assert known.sum() > 0.8 * curved.visible.sum()


def test_disparities_do_not_lock_to_whole_pixels(curved):
    found = match_pair(curved.left, curved.right, RANGE).disparity.values
    fraction = found[np.isfinite(found)] % 1
    counts = np.histogram(fraction, 10, (0, 1))[0]
    assert counts.max() < 1.6 * counts.mean()


def test_hidden_parts_are_left_empty_and_edges_stay_sharp():
    texture = noise_texture((SIZE, SIZE + 120), seed=8)
    layers = [Layer((10.0, 0.0, 0.0)), Layer((30.0, 0.0, 0.0), (120, 120), (45, 60))]
    pair = layered_pair(texture, layers, SIZE)
    found = match_pair(pair.left, pair.right, RANGE)
    _, difference, _ = errors(found, pair)
    assert (np.abs(difference) > 1).mean() < 0.03
    hidden = ~pair.visible
    assert np.isfinite(found.disparity.values[hidden]).mean() < 0.5


def test_threads_and_strips_do_not_matter(curved):
    one = match_pair(curved.left, curved.right, RANGE, threads=1).disparity
    two = match_pair(curved.left, curved.right, RANGE, threads=2).disparity
    np.testing.assert_array_equal(one, two)


def test_a_guide_narrows_the_search_without_changing_good_matches(curved):
    free = match_pair(curved.left, curved.right, RANGE).disparity.values
    guide = (waves(*np.meshgrid(np.arange(SIZE), np.arange(SIZE))) + 3).astype(np.float32)
    guided = match_pair(curved.left, curved.right, RANGE, guide=guide, guide_radius=(10, 10)).disparity.values
    both = np.isfinite(free) & np.isfinite(guided)
    assert both.sum() > 0.9 * np.isfinite(free).sum()
    assert np.median(np.abs(free[both] - guided[both])) < 0.02


def test_missing_parts_do_not_take_partners_from_the_rest(curved):
    y, x = np.mgrid[:SIZE, :SIZE]
    wedge = x < 60 + y / 3  # as the corner of a turned photograph
    left = np.where(wedge, np.nan, curved.left)
    whole = match_pair(curved.left, curved.right, (-90, 150)).valid.values
    part = match_pair(left, curved.right, (-90, 150)).valid.values
    assert not part[wedge].any()
    rest = ~ndimage.binary_dilation(wedge, iterations=6) & whole
    assert part[rest].mean() > 0.98


def test_without_texture_nothing_is_measured():
    texture = noise_texture((SIZE, SIZE + 120), seed=5)
    texture[:, 130:230] = 128
    pair = curved_pair(texture, waves, SIZE, Radiometry(noise=0))
    found = match_pair(pair.left, pair.right, RANGE)
    _, difference, _ = errors(found, pair)
    assert (np.abs(difference) > 1).mean() < 0.02


def test_stripes_that_say_nothing_about_rows_are_no_proof_against_a_pair():
    columns = np.arange(SIZE + 120)
    texture = (
        128 + 60 * np.sin(2 * np.pi * columns / 11) + 0.15 * (noise_texture((SIZE, SIZE + 120), 6) - 128)
    )
    pair = curved_pair(texture.astype(np.float32), waves, SIZE, Radiometry(noise=2))
    found = match_pair(pair.left, pair.right, RANGE)
    _, difference, known = errors(found, pair)
    assert known.sum() > 0.8 * pair.visible.sum()
    assert (np.abs(difference) > 1).mean() < 0.02


@pytest.mark.parametrize(
    ("kind", "scale", "offset"),
    [(np.uint16, 257, 0), (np.int16, 1, -500), (np.float64, 1 / 255, 0), (np.float32, 1e6, -3e7)],
)
def test_number_types_and_scales_of_images_do_not_matter(curved, kind, scale, offset):
    expected = match_pair(curved.left, curved.right, RANGE)
    images = [
        (image.astype(np.float64) * scale + offset).astype(kind) for image in (curved.left, curved.right)
    ]
    found = match_pair(*images, RANGE)
    assert (found.valid == expected.valid).mean() > 0.99
    both = (found.valid & expected.valid).values
    assert np.median(np.abs(found.disparity - expected.disparity).values[both]) < 0.01


def test_negative_disparities_and_a_range_as_wide_as_the_image(curved):
    mirrored = match_pair(curved.left[:, ::-1], curved.right[:, ::-1], (-60, 4))
    plain = match_pair(curved.left, curved.right, RANGE)
    back = -mirrored.disparity.values[:, ::-1]
    both = np.isfinite(back) & plain.valid.values
    assert both.sum() > 0.95 * plain.valid.values.sum()
    assert np.median(np.abs(back - plain.disparity.values)[both]) < 0.02
    wide = match_pair(curved.left, curved.right, (-SIZE + 1, SIZE - 1))
    assert wide.valid.values.sum() > 0.95 * plain.valid.values.sum()


def test_confidence_is_higher_where_the_match_is_right(curved):
    found = match_pair(curved.left, curved.right, RANGE)
    confidence = found.confidence.values
    assert confidence.min() >= 0
    assert confidence.max() <= 1
    assert np.all(confidence[~found.valid.values] == 0)


@pytest.mark.parametrize(
    ("left", "right", "limits", "message"),
    [
        (
            np.random.default_rng(0).random((60, 80)),
            np.random.default_rng(0).random((60, 70)),
            (0, 16),
            "size|shape",
        ),
        (np.full((60, 80), 7.0), np.random.default_rng(0).random((60, 80)), (0, 16), "constant"),
        (np.full((60, 80), np.nan), np.random.default_rng(0).random((60, 80)), (0, 16), "nodata"),
        (
            np.random.default_rng(0).random((60, 80)),
            np.random.default_rng(1).random((60, 80)),
            (9, 3),
            "range",
        ),
    ],
)
def test_what_cannot_be_matched_is_refused(left, right, limits, message):
    with pytest.raises(MatchingError, match=message):
        match_pair(left, right, limits)


def test_a_pair_with_shifted_rows_is_refused(curved):
    with pytest.raises(MatchingError, match="not rectified"):
        match_pair(curved.left[:-6], curved.right[6:], RANGE)
