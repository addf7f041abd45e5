"""The matcher on pairs with exact truth, and on input that cannot be matched."""

import numpy as np
import pytest

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
