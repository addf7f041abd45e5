"""The index on cases made by hand, and sections of a belt whose front is known."""

import math

import geopandas as gpd
import numpy as np
import pytest
import shapely
from rasterio.crs import CRS

from workbench.assessment import ErrorMatrix
from workbench.errors import ReedError
from workbench.params import ReedParameters
from workbench.rasters import Grid, new_raster
from workbench.reed import (
    ReedModel,
    arsi,
    classify,
    compare_dates,
    measure_reed,
    propagate,
    sensitivity,
    strips,
)

CRS_ = CRS.from_epsg(32633)
WEST, SOUTH = 400000.0, 5300000.0


def test_index_by_hand():
    assert arsi(1.0, 0, 0, 0.0, 100.0) == 3
    assert arsi(1.5, 1, 2, 20.0, 80.0) == 7.75
    assert arsi(2.0, 2, 0, 50.0, 50.0) == 9
    assert arsi(1.2, 0, 0, 5.0, 0.0) == math.inf
    assert math.isnan(arsi(1.2, 0, 0, 0.0, 0.0))
    assert math.isnan(arsi(math.nan, 1, 0, 5.0, 5.0))
    assert arsi([1.0, 2.0], [0, 1], [0, 1], [0.0, 10.0], [10.0, 10.0]).tolist() == [3, 9]


@pytest.mark.parametrize(
    "case", [(0.9, 0, 0, 1, 1), (1, -1, 0, 1, 1), (1, 0, -1, 1, 1), (1, 0, 0, -1, 1), (1, 0, 0, 1, -1)]
)
def test_impossible_numbers_are_refused(case):
    with pytest.raises(ReedError, match="aRSI"):
        arsi(*case)


def test_at_the_cut_a_section_is_stressed():
    status = classify([7.999, 8.0, 8.001, math.inf, math.nan], 8.0)
    assert status.tolist() == ["healthy", "stressed", "stressed", "stressed", "excluded"]


def scene(*, islet=False, hole=False, gap=None, notch=None, front=20.0, nan=None, level=0.0):
    """A belt along y = 5..front (shore at y = 5), x = 0..60, 0.1 m cells, reed of 3 m."""
    grid = Grid(CRS_, WEST, SOUTH + 50, 0.1, 600, 500)
    y, x = np.meshgrid(grid.y - SOUTH, grid.x - WEST, indexing="ij")
    reed = y < front
    if notch is not None:
        reed &= ~((x > notch) & (x < notch + 2) & (y > front - 4))
    if islet:
        reed |= np.hypot(x - 15, y - 26) < 1.5
    if hole:
        reed &= ~(np.hypot(x - 25, y - 14) < 1.5)
    if gap is not None:
        reed &= ~((x > gap) & (x < gap + 10))
    values = np.where(reed, 3.0, 0.0) + level
    if nan is not None:
        values[(x > nan) & (x < nan + 10)] = np.nan
    return new_raster(values.astype(np.float32), grid, name="dsm", units="m", vertical_datum="gauge")


LAKE = gpd.GeoSeries([shapely.box(WEST - 50, SOUTH + 5, WEST + 100, SOUTH + 100)], crs=CRS_)


def transects(places=(5, 15, 25, 35, 45, 55), **columns):
    lines = [shapely.LineString([(WEST + x, SOUTH + 30), (WEST + x, SOUTH + 5)]) for x in places]
    values = {"aoi": "A", "transect": range(1, len(lines) + 1)} | columns
    return gpd.GeoDataFrame(values, geometry=lines, crs=CRS_)


def test_straight_front_is_healthy_everywhere():
    metrics = measure_reed(scene(), 0.0, LAKE, transects=transects())
    sections = metrics.sections
    assert sections.front_m.to_numpy() == pytest.approx(np.full(5, 10.0), abs=1e-3)
    assert sections.sinuosity.to_numpy() == pytest.approx(np.ones(5), abs=1e-3)
    assert sections.arsi.to_numpy() == pytest.approx(np.full(5, 3.0), abs=0.15)
    assert set(sections.status) == {"healthy"}
    assert metrics.totals()["extent_m2"] == pytest.approx(60 * 15, rel=1e-6)


def test_islets_holes_and_notches_count_in_their_section():
    metrics = measure_reed(
        scene(islet=True, hole=True, notch=39.0), 0.0, LAKE, transects=transects((5, 12, 22, 32, 42, 52))
    )
    sections = metrics.sections
    assert sections.islets.tolist() == [0, 1, 0, 0, 0]
    assert sections.holes.tolist() == [0, 0, 1, 0, 0]
    assert sections.sinuosity[3] == pytest.approx(1.8, abs=0.02)  # 10 m and twice 4 m more.


def test_sections_without_front_are_listed_with_the_reason():
    metrics = measure_reed(scene(gap=25.0), 0.0, LAKE, transects=transects())
    sections = metrics.sections.set_index("section")
    assert sections.status[3] == "excluded"
    assert sections.reason[3] == "no reed"
    assert (sections.status.drop(3) != "excluded").all()
    assert metrics.totals()["excluded"] == 1


def test_two_fronts_in_a_section_are_taken_together():
    sections = measure_reed(scene(gap=18.0), 0.0, LAKE, transects=transects((5, 15, 31))).sections
    both = sections.iloc[1]
    assert both.fronts == 2
    # 3 m on either side of the channel, and its banks of 14.5 m (half a metre is shore).
    assert both.front_m == pytest.approx(2 * (3 + 14.5), abs=0.3)
    assert both.sinuosity == pytest.approx(17.5 / math.hypot(3, 14.5), rel=0.01)


def test_unknown_surface_excludes_a_section():
    sections = measure_reed(scene(nan=25.0), 0.0, LAKE, transects=transects()).sections.set_index("section")
    assert sections.reason[3] == "surface unknown"
    assert sections.holes.sum() == 0


def test_transects_may_run_either_way_and_come_in_any_order():
    forward = measure_reed(scene(notch=39.0), 0.0, LAKE, transects=transects()).sections
    backward = transects().iloc[::-1].reset_index(drop=True)
    backward["geometry"] = backward.geometry.reverse()
    other = measure_reed(scene(notch=39.0), 0.0, LAKE, transects=backward).sections
    assert other.arsi.to_numpy() == pytest.approx(forward.arsi.to_numpy())


def test_without_transects_the_shore_is_cut_into_sections():
    sections = measure_reed(scene(), 0.0, LAKE).sections
    assert len(sections) == 6
    assert sections.sinuosity.iloc[1:-1].to_numpy() == pytest.approx(np.ones(4), abs=1e-3)


def test_crossing_or_incomplete_transects_are_refused():
    crossing = transects((5, 15))
    crossing.loc[1, "geometry"] = shapely.LineString([(WEST + 15, SOUTH + 30), (WEST, SOUTH + 5)])
    with pytest.raises(ReedError, match="Transects 1 and 2 of area A cross"):
        strips(crossing, shapely.LineString())
    with pytest.raises(ReedError, match="lack the column aoi"):
        measure_reed(scene(), 0.0, LAKE, transects=transects().drop(columns="aoi"))
    point = transects((5, 15))
    point.loc[0, "geometry"] = shapely.Point(WEST, SOUTH)
    with pytest.raises(ReedError, match="is Point"):
        strips(point, shapely.LineString())
    far = transects()
    far["geometry"] = far.geometry.translate(1e5)
    with pytest.raises(ReedError, match="do not touch"):
        measure_reed(scene(), 0.0, LAKE, transects=far)


def test_only_what_depends_on_a_parameter_is_computed_again():
    model = ReedModel(scene(notch=39.0), 0.0, LAKE, transects=transects())
    first = model.measure()
    model.measure()
    assert model.computed == ()
    model.measure(ReedParameters(arsi_cut=7))
    assert model.computed == ("sections",)
    model.measure(ReedParameters(arsi_cut=7, variance_cut=0.2))
    assert model.computed == ("cells", "sections", "areas")
    model.measure(ReedParameters(arsi_cut=7, variance_cut=0.2, min_height=1.0))
    assert "statistics" not in model.computed
    again = model.measure()
    assert again.sections.drop(columns="geometry").equals(first.sections.drop(columns="geometry"))


def test_the_parameter_goes_before_the_level_of_the_site():
    model = ReedModel(scene(level=500.0), 499.0, LAKE)
    right = model.measure(ReedParameters(water_level=500.0)).totals()["extent_m2"]
    assert right == pytest.approx(60 * 15, rel=1e-6)


def test_retreat_is_the_distance_that_the_front_moved():
    before = measure_reed(scene(front=20.0), 0.0, LAKE, transects=transects())
    after = measure_reed(scene(front=17.0), 0.0, LAKE, transects=transects())
    change = compare_dates(before, after)
    assert change.totals["lost_m2"] == pytest.approx(60 * 3)
    assert change.totals["gained_m2"] == 0
    assert change.totals["kept_m2"] == pytest.approx(60 * 12)
    assert change.sections.retreat_m.to_numpy() == pytest.approx(np.full(5, 3.0), abs=0.01)
    back = compare_dates(after, before)
    assert back.sections.retreat_m.to_numpy() == pytest.approx(np.full(5, -3.0), abs=0.01)
    dark = compare_dates(before, measure_reed(scene(nan=25.0), 0.0, LAKE, transects=transects()))
    assert dark.totals["lost_m2"] == pytest.approx(0, abs=1e-6)
    assert dark.totals["unknown_m2"] == pytest.approx(10 * 45)
    with pytest.raises(ReedError, match="no section in common"):
        compare_dates(before, measure_reed(scene(), 0.0, LAKE))


def test_draws_reproduce_the_effect_of_a_known_error():
    model = ReedModel(scene(), 0.0, LAKE, transects=transects())
    still = propagate(model, ReedParameters(water_level_sd=0.0), draws=3)
    assert still.summary.set_index("metric").sd["extent_m2"] == 0
    # The front slopes: y = 20 + (3 - z) / 0.5, so that the extent above 0.5 m moves 2 m a metre of water.
    dsm = scene()
    y = np.asarray(dsm.y)[:, None] - SOUTH
    dsm.values[:] = np.broadcast_to(np.clip(3.0 - 0.5 * (y - 20.0), 0, 3), dsm.shape)
    sloped = ReedModel(dsm, 0.0, LAKE, transects=transects())
    drawn = propagate(sloped, ReedParameters(water_level_sd=0.1), draws=40, seed=5)
    sd = drawn.summary.set_index("metric").sd["extent_m2"]
    assert sd == pytest.approx(60 * 2 * 0.1, rel=0.3)  # 40 draws give a standard deviation to 11 %.
    same = propagate(sloped, ReedParameters(water_level_sd=0.1), draws=4, seed=5)
    assert same.summary.equals(propagate(sloped, ReedParameters(water_level_sd=0.1), draws=4, seed=5).summary)
    with pytest.raises(ReedError, match="2 or more"):
        propagate(model, draws=1)
    with pytest.raises(ReedError, match="negative"):
        propagate(model, draws=2, spread=-1.0)


def test_sensitivity_moves_one_threshold_at_a_time():
    model = ReedModel(scene(islet=True, notch=39.0), 0.0, LAKE, transects=transects())
    table = sensitivity(model, thresholds=("arsi_cut", "variance_cut"), factors=(0.3, 1.0, 2.0))
    assert table.stressed.tolist()[:3] == [5, 0, 0]
    assert table.changed[table.factor == 1.0].tolist() == [0, 0]
    with pytest.raises(ReedError, match="no threshold"):
        sensitivity(model, thresholds=("seed",))


@pytest.mark.parametrize(
    ("counts", "overall", "kappa"),
    [
        ([[1150, 107], [208, 1239]], 88.35, 0.77),
        ([[61, 11, 14], [29, 76, 15], [89, 11, 123]], 60.61, 0.41),
        ([[34, 5], [17, 61]], 81.20, 0.61),
    ],
)
def test_published_matrices_give_the_published_scores(counts, overall, kappa):
    matrix = ErrorMatrix(counts, [str(index) for index in range(len(counts))])
    assert 100 * matrix.overall_accuracy == pytest.approx(overall, abs=0.005)
    assert matrix.kappa == pytest.approx(kappa, abs=0.005)
