"""Crowns, sampled masks and height errors on cases whose answer is known."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import pytest
from shapely.geometry import Polygon, box

from workbench.assessment import (
    compare_crowns,
    height_errors,
    mask_accuracy,
    sample_points,
    topological_case,
)
from workbench.errors import AssessmentError
from workbench.rasters import Grid, new_raster

CRS = "EPSG:32633"


def frame(*shapes):
    return gpd.GeoDataFrame(geometry=list(shapes), crs=CRS)


def raster(values):
    values = np.asarray(values)
    grid = Grid.from_bounds(CRS, (0, 0, values.shape[1], values.shape[0]), 1.0)
    return new_raster(values, grid, name="values", units="1")


@pytest.mark.parametrize(
    ("crown", "case", "factor"),
    [
        (box(0, 0, 4, 4), "equal", 1.0),
        (box(1, 1, 3, 3), "inside", 1.0),
        (box(-1, -1, 5, 5), "contains", 1.0),
        (box(3, 0, 7, 4), "overlaps", 0.25),
        (box(1, 0, 5, 4), "overlaps", 0.75),
        (box(4, 0, 8, 4), "touches", 0.0),
    ],
)
def test_six_topological_cases_and_overlap_factor(crown, case, factor):
    reference = box(0, 0, 4, 4)
    assert topological_case(crown, reference) == case
    result = compare_crowns(frame(crown), frame(reference))
    assert result.pairs.overlap_factor[0] == pytest.approx(factor)
    assert result.pairs["case"][0] == case
    assert result.completeness == (factor > 0.5)


def test_disjoint_crowns_make_no_pair():
    assert topological_case(box(9, 9, 10, 10), box(0, 0, 4, 4)) == "disjoint"
    result = compare_crowns(frame(box(9, 9, 10, 10)), frame(box(0, 0, 4, 4)))
    assert len(result.pairs) == 0
    assert result.correctness == 0


def test_a_crown_stands_for_one_reference_only():
    merged = box(0, 0, 8, 4)
    result = compare_crowns(frame(merged), frame(box(0, 0, 4, 4), box(4, 0, 8, 4)))
    assert len(result.pairs) == 1
    assert result.completeness == 0.5
    assert result.correctness == 1.0
    assert result.pairs.iou[0] == pytest.approx(0.5)


def test_pairs_have_the_largest_sum_of_iou():
    crowns = frame(box(0, 0, 4, 4), box(3, 0, 6, 4))
    reference = frame(box(2.5, 0, 6.5, 4), box(0, 0, 3, 4))
    result = compare_crowns(crowns, reference)
    assert dict(zip(result.pairs.reference, result.pairs.crown, strict=True)) == {0: 1, 1: 0}


def test_crowns_in_another_crs_or_invalid_are_refused():
    with pytest.raises(AssessmentError, match="one CRS"):
        compare_crowns(frame(box(0, 0, 1, 1)), frame(box(0, 0, 1, 1)).to_crs("EPSG:4326"))
    bow = Polygon([(0, 0), (1, 1), (1, 0), (0, 1)])
    with pytest.raises(AssessmentError, match="no valid polygons"):
        compare_crowns(frame(bow), frame(box(0, 0, 1, 1)))


def test_simple_sample_follows_area_and_stratified_sample_does_not():
    values = np.zeros((100, 100))
    values[:10] = 1
    values[50:60] = np.nan
    simple = sample_points(raster(values), 2000, seed=1)
    assert not simple.duplicated(["row", "column"]).any()
    assert simple["class"].notna().all()
    # 1/9 of the known cells; 2000 draws: four standard deviations are 2.8 points.
    assert abs(simple["class"].mean() - 1 / 9) < 0.028
    even = sample_points(raster(values), 300, design="stratified", seed=1)
    assert even["class"].value_counts().to_dict() == {0.0: 300, 1.0: 300}
    assert even.loc[even["class"] == 1, "weight"].sum() == pytest.approx(1000)
    assert values[even["row"], even["column"]].tolist() == even["class"].tolist()


def test_mask_accuracy_counts_at_points():
    reference = np.zeros((80, 80), bool)
    reference[:, :40] = True
    mask = reference.copy()
    mask[:, 36:40] = False
    matrix = mask_accuracy(raster(mask), raster(reference), 10_000)
    assert matrix.total == 6400
    assert matrix.producer_accuracy["tree"] == pytest.approx(0.9)
    assert matrix.user_accuracy["tree"] == 1.0


def test_height_errors_by_cover():
    rng = np.random.default_rng(2)
    truth = rng.uniform(500, 510, (200, 200))
    cover = np.repeat([[1], [2]], 100, axis=0) * np.ones((1, 200), int)
    noise = rng.normal(0, 0.1, truth.shape) + np.where(cover == 2, 0.3, 0.0)
    measured = truth + noise
    measured[:10] = np.nan
    table = height_errors(
        raster(measured), raster(truth), raster(cover), {1: "meadow", 2: "reed", 3: "roof"}
    ).set_index("cover")
    assert list(table.index) == ["all", "meadow", "reed"]
    assert table.coverage["meadow"] == pytest.approx(0.9)
    assert table.bias_m["reed"] == pytest.approx(0.3, abs=0.01)
    assert table.nmad_m["meadow"] == pytest.approx(0.1, rel=0.05)
    assert table.p95_m["meadow"] == pytest.approx(0.196, rel=0.05)
    assert table.gross_share["reed"] == pytest.approx(0.0228, abs=0.006)


def test_surfaces_on_other_grids_are_refused():
    with pytest.raises(AssessmentError, match="different grids"):
        height_errors(raster(np.zeros((3, 3))), raster(np.zeros((3, 4))))
    with pytest.raises(AssessmentError, match="no known cell"):
        sample_points(raster(np.full((3, 3), np.nan)), 5)
