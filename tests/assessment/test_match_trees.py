"""One-to-one matching of tops and trees: hand-made cases, brute force, intervals, bad input."""

from __future__ import annotations

from itertools import permutations

import geopandas as gpd
import numpy as np
import pytest
from shapely.geometry import box

from workbench.assessment import match_trees
from workbench.errors import AssessmentError


def frame(points, heights=None, crs="EPSG:32633"):
    x, y = np.asarray(points, float).reshape(-1, 2).T
    data = {} if heights is None else {"height_m": heights}
    return gpd.GeoDataFrame(data, geometry=gpd.points_from_xy(x, y), crs=crs)


def pairs(result):
    return set(zip(result.pairs["top"], result.pairs["reference"], strict=True))


def test_of_two_tops_near_one_tree_the_nearer_is_right_and_the_other_false():
    result = match_trees(frame([(0.9, 0), (0.2, 0)]), frame([(0, 0)]), 1.5)
    assert pairs(result) == {(1, 0)}
    assert list(result.false) == [0]
    assert (result.completeness, result.correctness) == (1.0, 0.5)
    assert result.f1 == pytest.approx(2 / 3)


def test_nearest_takes_the_closest_pair_first_where_optimal_finds_one_more():
    tops, trees = [(0, 0), (1.9, 0)], [(1, 0), (-1.5, 0)]
    # Top 1 is 0.9 m from tree 0, top 0 1.0 m; tree 1 is in reach of top 0 only.
    assert pairs(match_trees(np.array(tops), np.array(trees), 2.0)) == {(1, 0), (0, 1)}
    tops = [(0, 0), (2.2, 0)]
    nearest = match_trees(np.array(tops), np.array(trees), 1.6)
    assert pairs(nearest) == {(0, 0)}
    assert pairs(match_trees(np.array(tops), np.array(trees), 1.6, method="optimal")) == {(1, 0), (0, 1)}


def test_distance_limit_itself_is_a_match():
    assert len(match_trees(np.array([[1.5, 0]]), np.array([[0, 0]]), 1.5).pairs) == 1
    assert len(match_trees(np.array([[1.5001, 0]]), np.array([[0, 0]]), 1.5).pairs) == 0


def test_optimal_equals_brute_force():
    rng = np.random.default_rng(3)
    for _ in range(40):
        tops, trees = rng.uniform(0, 4, (5, 2)), rng.uniform(0, 4, (4, 2))
        distance = np.hypot(*(tops[:, None] - trees[None]).transpose(2, 0, 1))
        best = (0, 0.0)
        for choice in permutations(range(5), 4):
            near = [distance[top, tree] for tree, top in enumerate(choice) if distance[top, tree] <= 1.2]
            best = max(best, (len(near), -sum(near)))
        result = match_trees(tops, trees, 1.2, method="optimal")
        assert len(result.pairs) == best[0]
        assert result.pairs.distance_m.sum() == pytest.approx(-best[1])


@pytest.mark.parametrize("method", ["nearest", "optimal"])
def test_order_of_rows_does_not_matter(method):
    rng = np.random.default_rng(4)
    tops, trees = rng.uniform(0, 30, (200, 2)), rng.uniform(0, 30, (180, 2))
    first = match_trees(tops, trees, 1.5, method=method)
    p, q = rng.permutation(200), rng.permutation(180)
    second = match_trees(tops[p], trees[q], 1.5, method=method)
    assert pairs(first) == {(p[top], q[tree]) for top, tree in pairs(second)}


def test_optimal_never_finds_fewer_than_nearest_on_large_tables():
    rng = np.random.default_rng(5)
    tops, trees = rng.uniform(0, 400, (20_000, 2)), rng.uniform(0, 400, (20_000, 2))
    nearest, optimal = (match_trees(tops, trees, 1.0, method=m) for m in ("nearest", "optimal"))
    assert len(optimal.pairs) > len(nearest.pairs)
    for result in (nearest, optimal):
        assert result.pairs["top"].is_unique
        assert result.pairs["reference"].is_unique
        assert len(result.pairs) + len(result.missed) == 20_000


def test_height_difference_separates_a_shrub_from_the_crown_above():
    tops, trees = frame([(0, 0)], [20.0]), frame([(0.2, 0), (1, 0)], [4.0, 19.0])
    assert pairs(match_trees(tops, trees, 2.0)) == {(0, 0)}
    assert pairs(match_trees(tops, trees, 2.0, height_difference=3.0)) == {(0, 1)}
    with pytest.raises(AssessmentError, match="height_m"):
        match_trees(frame([(0, 0)]), trees, 2.0, height_difference=3.0)


def test_only_the_surveyed_area_counts_and_trees_at_its_border_are_found():
    area = gpd.GeoDataFrame(geometry=[box(0, 0, 10, 10)], crs="EPSG:32633")
    tops = frame([(5, 5), (10.4, 5), (20, 20), (2, 8)])
    trees = frame([(5, 5.2), (9.9, 5), (15, 15)])
    result = match_trees(tops, trees, 1.0, area=area)
    assert pairs(result) == {(0, 0), (1, 1)}
    assert list(result.false) == [3]
    assert list(result.outside) == [2]


def test_duplicate_reference_trees_are_set_aside_and_listed():
    result = match_trees(frame([(0, 0)]), frame([(0, 0), (0, 0), (5, 5)]), 1.0)
    assert list(result.duplicates) == [1]
    assert list(result.missed) == [2]


def test_reference_in_another_crs_is_brought_to_that_of_the_tops():
    tops = frame([(400_000, 5_300_000)])
    assert len(match_trees(tops, tops.to_crs("EPSG:4326"), 0.01).pairs) == 1


def test_no_tops_or_no_trees():
    none = frame([])
    result = match_trees(none, frame([(0, 0)]), 1.0)
    assert result.completeness == 0
    assert np.isnan(result.correctness)
    result = match_trees(frame([(0, 0)]), none, 1.0, method="optimal")
    assert result.correctness == 0
    assert np.isnan(result.completeness)
    assert match_trees(none, none, 1.0).intervals().value.isna().all()


def test_intervals_are_reproducible_and_as_wide_as_the_binomial():
    rng = np.random.default_rng(6)
    trees = np.column_stack([np.arange(400) * 10.0, np.zeros(400)])
    tops = trees[rng.random(400) < 0.8] + 0.1
    result = match_trees(tops, trees, 1.0)
    table = result.intervals(seed=7).set_index("score")
    assert table.equals(result.intervals(seed=7).set_index("score"))
    width = 2 * 1.96 * np.sqrt(result.completeness * (1 - result.completeness) / 400)
    assert table.high["completeness"] - table.low["completeness"] == pytest.approx(width, rel=0.1)
    assert table.low["correctness"] == table.high["correctness"] == 1.0


def test_bad_tables_are_refused():
    good = frame([(0, 0)])
    with pytest.raises(AssessmentError, match="no CRS"):
        match_trees(good, frame([(0, 0)], crs=None), 1.0)
    with pytest.raises(AssessmentError, match="metres"):
        match_trees(good.to_crs("EPSG:4326"), good, 1.0)
    with pytest.raises(AssessmentError, match="positive"):
        match_trees(good, good, 0)
    with pytest.raises(AssessmentError, match="not finite"):
        match_trees(np.array([[np.nan, 0]]), np.zeros((1, 2)), 1.0)
    with pytest.raises(AssessmentError, match="have no point"):
        match_trees(gpd.GeoDataFrame(geometry=[None], crs=good.crs), good, 1.0)
