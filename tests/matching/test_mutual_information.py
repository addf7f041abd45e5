"""Mutual information: grey values that relate in no simple way."""

import cv2
import numpy as np
import pytest

from workbench.matching import match_pair
from workbench.matching.mutual import mutual_information_costs
from workbench.params.match import SgmParameters

RANDOM = np.random.default_rng(8)


def pair(shape=(240, 360), amplitude=4.0):
    """A textured pair with waves of disparity around 12 px, and the true disparity."""
    rows, columns = shape
    texture = cv2.GaussianBlur(RANDOM.normal(0, 1, (rows, columns + 60)).astype(np.float32), (0, 0), 1.2)
    texture = 128 + 40 * texture / texture.std()
    x, y = np.meshgrid(np.arange(columns, dtype=np.float32), np.arange(rows, dtype=np.float32))
    disparity = 12 + amplitude * np.sin(x / 60) * np.cos(y / 50)
    right = np.ascontiguousarray(texture[:, 30 : 30 + columns])
    # The left image takes its pixels from the right one: column left = column right + disparity.
    left = cv2.remap(texture, x - disparity.astype(np.float32) + 30, y, cv2.INTER_CUBIC)
    return np.clip(left, 0, 255), np.clip(right, 0, 255), disparity


def test_costs_of_equal_images_are_least_on_the_diagonal():
    left, right, disparity = pair()
    costs = mutual_information_costs(left.astype(np.uint8), right.astype(np.uint8), disparity)
    assert costs.shape == (256, 256) and costs.max() <= 62
    middle = np.arange(60, 200)
    assert np.median(costs[middle, middle]) <= 12
    assert np.median(costs[middle, 255 - middle][np.abs(2 * middle - 255) > 60]) >= 31


def test_it_matches_as_a_census_does_where_grey_values_agree():
    left, right, disparity = pair()
    found = match_pair(left, right, (0, 30), parameters=SgmParameters(cost="mutual_information"))
    error = (found.disparity.values - disparity)[found.valid.values]
    assert found.valid.values[:, 30:].mean() > 0.9
    assert 1.4826 * np.median(np.abs(error)) < 0.15
    assert (np.abs(error) > 1).mean() < 0.02


def test_it_matches_where_grey_values_fold_over_and_a_census_finds_less():
    left, right, disparity = pair()
    folded = 255 - 2 * np.abs(right - 128)  # Dark and bright become alike, the middle bright.
    found = {
        cost: match_pair(left, folded, (0, 30), parameters=SgmParameters(cost=cost, subpixel=False))
        for cost in ("census9x7", "mutual_information")
    }
    right_share = {
        cost: float((np.abs(one.disparity.values - disparity)[:, 30:] <= 1).mean())
        for cost, one in found.items()
    }
    assert right_share["mutual_information"] > right_share["census9x7"] + 0.1


@pytest.mark.parametrize("seed", [0, 1])
def test_disparities_without_sense_give_costs_within_bounds(seed):
    random = np.random.default_rng(seed)
    image = random.integers(0, 256, (50, 80)).astype(np.uint8)
    for disparity in (random.uniform(0, 20, image.shape), np.full(image.shape, np.nan)):
        costs = mutual_information_costs(image, image, disparity)
        assert costs.max() <= 62
