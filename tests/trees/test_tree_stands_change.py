"""Stand types, stand tables and the change between two dates, on stands that are counted by hand."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import pytest
from shapely.geometry import box
from tree_shapes import CRS, tops_at

from workbench.errors import TreesError
from workbench.trees import compare_trees, stand_table, stand_types

TREES = [(10.0, 10.0, 12.0), (20.0, 10.0, 8.0), (30.0, 30.0, 22.0), (120.0, 50.0, 30.0)]


def crowns_of(tops, radius=2.0):
    return gpd.GeoDataFrame(
        {"tree_id": tops["tree_id"], "diameter_m": 2 * radius},
        geometry=[box(p.x - radius, p.y - radius, p.x + radius, p.y + radius) for p in tops.geometry],
        crs=tops.crs,
    )


def areas():
    return gpd.GeoDataFrame(
        {"stand": ["a", "b", "empty"]},
        geometry=[box(0, 0, 100, 100), box(100, 0, 200, 100), box(300, 0, 400, 50)],
        crs=CRS,
    )


def test_stand_table_counts_by_hectare():
    tops = tops_at(TREES).assign(interpolated=[False, True, False, False])
    table = stand_table(tops, crowns_of(tops), areas(), height_class=10.0).set_index("stand")
    assert table.loc["a", ["area_ha", "stems", "stems_per_ha"]].tolist() == [1.0, 3, 3.0]
    assert table.loc["a", "height_mean_m"] == pytest.approx(14.0)
    assert table.loc["a", "height_sd_m"] == pytest.approx(np.std([12, 8, 22], ddof=1))
    # Fewer than 100 stems per hectare: the tallest fifth, here one.
    assert table.loc["a", "height_top_m"] == pytest.approx(22.0)
    assert table.loc["a", "crown_cover"] == pytest.approx(3 * 16 / 1e4)
    assert table.loc["a", "interpolated"] == pytest.approx(1 / 3)
    classes = [column for column in table if column.startswith("stems_per_ha_")]
    assert table.loc["a", classes].tolist() == [1, 1, 1]
    assert table.loc["b", classes].tolist() == [0, 0, 1]
    assert table.loc["empty", "stems"] == 0
    assert np.isnan(table.loc["empty", "height_mean_m"])
    assert table.loc["empty", "crown_cover"] == 0


@pytest.mark.parametrize(("number", "tallest"), [(50, 10), (99, 20), (101, 100), (400, 100)])
def test_top_height_is_that_of_100_stems_per_hectare_or_of_a_fifth_of_fewer(number, tallest):
    rng = np.random.default_rng(0)
    heights = rng.uniform(5, 30, number)
    tops = tops_at(np.c_[rng.uniform(1, 99, (number, 2)), heights])
    top = stand_table(tops, crowns_of(tops), areas()).set_index("stand").loc["a", "height_top_m"]
    assert top == pytest.approx(np.sort(heights)[-tallest:].mean())


def test_a_crown_across_the_border_covers_both_areas_and_its_stem_stands_in_one():
    tops = tops_at([(99.0, 50.0, 10.0)])
    table = stand_table(tops, crowns_of(tops), areas()).set_index("stand")
    assert table["stems"].tolist() == [1, 0, 0]
    assert table.loc["a", "crown_cover"] * 1e4 == pytest.approx(12)
    assert table.loc["b", "crown_cover"] * 1e4 == pytest.approx(4)


def test_no_trees_make_a_table_of_zeros():
    tops = tops_at(TREES).iloc[:0]
    table = stand_table(tops, crowns_of(tops), areas())
    assert table["stems"].tolist() == [0, 0, 0]


def test_types_come_from_polygons_in_any_crs_or_from_a_function():
    tops = tops_at(TREES)
    stands = gpd.GeoDataFrame(
        {"stand_type": ["conifer", "broadleaf"]}, geometry=[box(0, 0, 25, 25), box(0, 0, 100, 100)], crs=CRS
    )
    assert stand_types(tops, stands).tolist() == ["conifer", "conifer", "broadleaf", ""]
    assert stand_types(tops, stands.to_crs(4326)).tolist() == ["conifer", "conifer", "broadleaf", ""]
    by_height = stand_types(tops, lambda t: np.where(t["height_m"] > 15, "conifer", "broadleaf"))
    assert by_height.tolist() == ["broadleaf", "broadleaf", "conifer", "conifer"]
    assert stand_types(tops, None).tolist() == [""] * 4


def test_bad_stands_are_refused():
    tops = tops_at(TREES)
    with pytest.raises(TreesError, match="stand_type"):
        stand_types(tops, areas())
    with pytest.raises(TreesError, match="one for each"):
        stand_types(tops, lambda t: ["conifer"])
    with pytest.raises(TreesError, match="column name"):
        stand_table(tops, crowns_of(tops), areas(), name="name")
    with pytest.raises(TreesError, match="positive width"):
        stand_table(tops, crowns_of(tops), areas(), height_class=0)
    with pytest.raises(TreesError, match="one CRS"):
        stand_table(tops, crowns_of(tops).to_crs("EPSG:32632"), areas())


def two_dates(shift=(3.2, -1.7), count=300, seed=0):
    rng = np.random.default_rng(seed)
    before = np.c_[rng.uniform(0, 150, (count, 2)), rng.uniform(8, 20, count)]
    grown = rng.uniform(0.1, 0.6, count)
    after = before + np.c_[np.tile(shift, (count, 1)) + rng.normal(0, 0.05, (count, 2)), grown]
    after = np.r_[after[20:], np.c_[rng.uniform(0, 150, (15, 2)) + shift, np.full(15, 4.0)]]
    return tops_at(before), tops_at(after), grown


def test_change_with_the_shift_taken_out():
    before, after, grown = two_dates()
    change = compare_trees(before, after, 1.0)
    assert change.shift == pytest.approx((3.2, -1.7), abs=0.02)
    assert change.counts["kept"] == pytest.approx(280, abs=3)
    assert change.counts["gone"] == 300 - change.counts["kept"]
    assert change.counts["appeared"] == 295 - change.counts["kept"]
    kept = change.trees[change.trees["change"] == "kept"].set_index("before_id")
    right = kept["after_id"] == kept.index - 20
    assert right.mean() > 0.98
    assert np.abs(kept["growth_m"][right] - grown[kept.index[right] - 1]).max() < 1e-9
    blind = compare_trees(before, after, 1.0, max_shift=0.0)
    assert blind.shift == (0.0, 0.0)
    assert blind.counts["kept"] < 60


def test_a_known_difference_of_the_datums_is_no_growth():
    before, after, _ = two_dates()
    plain = compare_trees(before, after, 1.0).trees["growth_m"].median()
    moved = compare_trees(before, after, 1.0, height_shift=0.25).trees["growth_m"].median()
    assert moved == pytest.approx(plain - 0.25)


def test_dates_without_trees():
    before, after, _ = two_dates()
    assert compare_trees(before.iloc[:0], after, 1.0).counts == {"kept": 0, "appeared": 295, "gone": 0}
    assert compare_trees(before, after.iloc[:0], 1.0).counts == {"kept": 0, "appeared": 0, "gone": 300}
    one = compare_trees(before.iloc[:1], before.iloc[:1], 1.0)
    assert one.counts == {"kept": 1, "appeared": 0, "gone": 0}


def test_dates_in_two_crs_or_impossible_distances_are_refused():
    before, after, _ = two_dates()
    with pytest.raises(TreesError, match="one CRS"):
        compare_trees(before, after.to_crs("EPSG:32632"), 1.0)
    with pytest.raises(TreesError):
        compare_trees(before, after, 0.0)
    with pytest.raises(TreesError):
        compare_trees(before, after, 1.0, max_shift=-1.0)
