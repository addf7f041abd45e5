"""Extent, front and closed lines on shapes whose area and length are known."""

import geopandas as gpd
import numpy as np
import pytest
import rasterio.features
import shapely
from rasterio.crs import CRS
from scipy.ndimage import uniform_filter
from shapely import affinity

from workbench.errors import RasterError, ReedError
from workbench.rasters import Grid, new_raster
from workbench.reed import (
    extent,
    lay_transects,
    map_extent,
    measure_reed,
    object_height,
    sinuosity,
    trace_front,
)
from workbench.reed.extent import stand_height

CRS_ = CRS.from_epsg(32633)
WEST, NORTH = 400000.0, 5300100.0
LEVEL = 517.93


def surface(shape, *, resolution=0.1, width=600, height=400, reed=2.0, water=0.0, datum="DHHN2016"):
    """A surface with reed of one height where ``shape`` is, and flat water elsewhere."""
    grid = Grid(CRS_, WEST, NORTH, resolution, width, height)
    mask = rasterio.features.rasterize([shape], out_shape=grid.shape, transform=grid.transform)
    values = np.where(mask == 1, LEVEL + reed, LEVEL + water).astype(np.float32)
    return new_raster(values, grid, name="dsm", units="m", vertical_datum=datum)


def here(shape):
    return affinity.translate(shape, WEST, NORTH - 40)


def lake(shape):
    return gpd.GeoSeries([here(shape)], crs=CRS_)


def belt(front, foot=0.0):
    """Polygon between a front (n, 2) and the line y = foot."""
    return shapely.Polygon([*front, (front[-1][0], foot), (front[0][0], foot)])


LAKE = shapely.box(-100, 5, 200, 200)  # The shore is the line y = 5.


def test_area_of_a_rectangle_is_cut_at_the_shoreline():
    dsm = surface(here(shapely.box(10, 2, 50, 15)))
    found = extent(dsm, LEVEL, 0.5, 6.0, lake(LAKE))
    assert len(found) == 1
    assert found.area_m2[0] == pytest.approx(40 * 10, rel=1e-6)
    assert found.crs == CRS_


def test_limits_are_exclusive_and_relative_to_the_water():
    dsm = surface(here(shapely.box(10, 10, 20, 20)), reed=2.0)
    assert extent(dsm, LEVEL, 0.5, 1.9).empty
    assert extent(dsm, LEVEL, 2.1, 6.0).empty
    assert extent(dsm, LEVEL, 1.9, 2.1).area_m2[0] == pytest.approx(100)
    exact = dsm.copy(data=np.round(dsm.values * 0 + 3.0).astype(np.float32))
    assert extent(exact, 1.0, 2.0, 6.0).empty
    assert extent(exact, 1.0, 1.0, 2.0).empty


def test_holes_stay_holes_and_small_ones_are_closed():
    shape = here(shapely.box(10, 10, 50, 30))
    shape = shape.difference(here(shapely.box(20, 15, 23, 18))).difference(
        here(shapely.box(30, 15, 30.5, 15.5))
    )
    mapped = map_extent(object_height(surface(shape), LEVEL))
    (patch,) = shapely.get_parts(mapped.reed)
    assert len(patch.interiors) == 1
    assert mapped.reed.area == pytest.approx(800 - 9)
    kept = map_extent(object_height(surface(shape), LEVEL), min_hole=0)
    assert kept.reed.area == pytest.approx(800 - 9.25)


def test_small_patches_and_slivers_at_the_shoreline_are_dropped():
    shapes = shapely.union_all(
        [shapely.box(10, 10, 20, 20), shapely.box(30, 30, 30.5, 30.5), shapely.box(30, 0, 50, 5.2)]
    )
    mapped = map_extent(object_height(surface(here(shapes)), LEVEL), lake(LAKE))
    assert mapped.reed.area == pytest.approx(100)
    all_of_it = map_extent(
        object_height(surface(here(shapes)), LEVEL), lake(LAKE), min_area=0, sliver_width=0
    )
    assert all_of_it.reed.area == pytest.approx(100 + 0.25 + 20 * 0.2)


def test_polygons_equal_the_union_of_their_cells():
    rng = np.random.default_rng(3)
    grid = Grid(CRS_, WEST, NORTH, 0.137, 60, 50)
    heights = rng.uniform(0, 1, grid.shape).astype(np.float32)
    ohm = new_raster(heights, grid, name="ohm", units="m", vertical_datum="x")
    found = map_extent(ohm, min_height=0.4, max_height=6, min_area=0, min_hole=0, sliver_width=0).reed
    rows, columns = np.nonzero(heights > 0.4)
    cells = shapely.union_all(
        shapely.box(
            grid.west + columns * 0.137,
            grid.north - (rows + 1) * 0.137,
            grid.west + (columns + 1) * 0.137,
            grid.north - rows * 0.137,
        )
    )
    assert found.area == pytest.approx(len(rows) * 0.137**2)
    assert found.symmetric_difference(cells).area < 1e-6


def test_a_hole_in_the_surface_is_unknown_and_no_hole_in_the_reed():
    dsm = surface(here(shapely.box(10, 2, 50, 25)))
    rows, columns = slice(200, 230), slice(250, 280)  # y 17..20, x 25..28
    dsm.values[rows, columns] = np.nan
    mapped = map_extent(object_height(dsm, LEVEL), lake(LAKE))
    assert mapped.unknown.area == pytest.approx(9)
    assert mapped.reed.area == pytest.approx(40 * 20 - 9)
    closed = trace_front(mapped).closed
    assert closed.kind.tolist() == ["unknown"]


def test_a_hole_with_unknown_water_in_it_is_a_hole_and_a_patch_cut_off_by_unknown_ground_no_islet():
    dsm = surface(here(shapely.box(10, 2, 50, 25).difference(shapely.box(20, 15, 24, 19))))
    dsm.values[220:240, 210:230] = np.nan  # Two metres in the middle of the hole of four.
    assert trace_front(map_extent(object_height(dsm, LEVEL), lake(LAKE))).closed.kind.tolist() == ["hole"]
    dsm = surface(here(shapely.box(10, 2, 50, 25)))
    values = dsm.values.copy()
    values[150:160, 100:500] = np.nan  # y 24..25
    values[150:200, 400:410] = np.nan  # x 40..41, y 20..25
    values[195:200, 400:500] = np.nan  # y 20..20.5
    values[150:200, 490:500] = np.nan  # x 49..50
    closed = trace_front(map_extent(object_height(dsm.copy(data=values), LEVEL), lake(LAKE))).closed
    assert closed.kind.tolist() == ["unknown"]
    assert closed.area_m2[0] == pytest.approx(8 * 3.5)


def test_a_ring_with_little_water_around_unknown_ground_is_unknown():
    """The gap of 0.9 x 0.9 m would be closed if all of its heights were known; two cells of it are not."""
    dsm = surface(here(shapely.box(10, 2, 50, 25).difference(shapely.box(20, 15, 20.9, 15.9))))
    assert trace_front(map_extent(object_height(dsm, LEVEL), lake(LAKE))).closed.empty
    dsm.values[244:246, 204] = np.nan
    mapped = map_extent(object_height(dsm, LEVEL), lake(LAKE))
    closed = trace_front(mapped).closed
    assert closed.kind.tolist() == ["unknown"]
    assert closed.area_m2[0] == pytest.approx(0.81)
    assert trace_front(mapped, min_hole=0.7).closed.kind.tolist() == ["hole"]


def test_a_cell_of_water_that_hangs_on_open_water_by_a_corner_is_no_hole():
    dsm = surface(here(shapely.box(10, 2, 50, 25)))
    dsm.values[150, 300] = LEVEL  # In the outermost row of reed, y 24.9..25: a notch of one cell.
    dsm.values[151, 301] = LEVEL  # Behind it, and beside it by a corner only.
    front = trace_front(map_extent(object_height(dsm, LEVEL), lake(LAKE)))
    assert front.closed.empty
    dsm.values[200, 300] = LEVEL  # Alone in the reed: closed.
    assert trace_front(map_extent(object_height(dsm, LEVEL), lake(LAKE))).closed.empty


def test_front_beside_unknown_ground_is_no_front():
    dsm = surface(here(shapely.box(10, 2, 50, 25)))
    dsm.values[:, 500:] = np.nan  # x > 50: the east side of the reed.
    mapped = map_extent(object_height(dsm, LEVEL), lake(LAKE))
    front = trace_front(mapped, smoothing=0)
    assert front.lines.length_m.sum() == pytest.approx(40 + 19.5, abs=0.2)  # Half a metre at the shore.


@pytest.mark.parametrize("angle", [0, 17, 45, 71, 90, 200])
def test_sine_front_has_its_length_at_any_angle(angle):
    x = np.linspace(0, 40, 2000)
    wave = np.column_stack([x, 12 + 2.0 * np.sin(2 * np.pi * x / 20)])
    length = np.hypot(*np.diff(wave, axis=0).T).sum()
    around = (30, 20)

    def turned(shape):
        moved = affinity.translate(shape, 10, 5)
        return affinity.translate(affinity.rotate(moved, angle, origin=around), WEST, NORTH - 40)

    water = turned(shapely.box(-200, 5, 200, 200))
    mapped = map_extent(
        object_height(surface(turned(belt(wave, foot=3.0)), resolution=0.1), LEVEL),
        gpd.GeoSeries([water], crs=CRS_),
    )
    lines = trace_front(mapped).lines
    line = shapely.intersection(
        shapely.union_all(lines.geometry.to_numpy()), turned(shapely.box(0.3, 7, 39.7, 30))
    )
    part = np.hypot(*np.diff(wave[(x > 0.3) & (x < 39.7)], axis=0).T).sum()
    assert line.length == pytest.approx(part, rel=0.025)
    assert sinuosity(shapely.line_merge(line)) == pytest.approx(length / 40, rel=0.025)


@pytest.mark.parametrize("angle", [0, 10, 30, 45])
def test_straight_front_has_sinuosity_one_at_any_angle(angle):
    around = (30, 20)

    def turned(shape):
        return affinity.translate(affinity.rotate(shape, angle, origin=around), WEST, NORTH - 40)

    mapped = map_extent(
        object_height(surface(turned(shapely.box(10, -100, 50, 20))), LEVEL),
        gpd.GeoSeries([turned(shapely.box(-200, 5, 200, 200))], crs=CRS_),
    )
    strip = turned(shapely.box(20, 15, 40, 25))
    line = shapely.intersection(shapely.union_all(trace_front(mapped).lines.geometry.to_numpy()), strip)
    assert sinuosity(shapely.line_merge(line)) == pytest.approx(1, abs=0.005)


def test_circles_are_islets_and_rings_are_holes():
    shapes = [here(shapely.box(5, 2, 55, 15))]
    shapes += [here(shapely.Point(x, 25).buffer(2)) for x in (12, 20, 28)]
    shape = shapely.union_all(shapes).difference(here(shapely.Point(30, 10).buffer(1.5)))
    front = trace_front(map_extent(object_height(surface(shape), LEVEL), lake(LAKE)))
    assert (front.closed.kind == "islet").sum() == 3
    assert (front.closed.kind == "hole").sum() == 1
    islets = front.closed[front.closed.kind == "islet"]
    assert islets.area_m2.to_numpy() == pytest.approx(np.full(3, np.pi * 4), rel=0.02)
    assert len(front.lines) == 1


def test_sinuosity_of_known_lines():
    assert sinuosity(shapely.LineString([(0, 0), (3, 4)])) == 1
    assert sinuosity(shapely.LineString([(0, 0), (0, 1), (1, 1), (1, 0)])) == 3
    two = shapely.MultiLineString([[(0, 0), (4, 0)], [(10, 0), (10, 3), (14, 3)]])
    assert sinuosity(two) == pytest.approx((4 + 7) / (4 + 5))
    half = np.linspace(0, np.pi, 2001)
    assert sinuosity(shapely.LineString(np.column_stack([np.cos(half), np.sin(half)]))) == pytest.approx(
        np.pi / 2, rel=1e-5
    )
    assert np.isnan(sinuosity(shapely.LinearRing([(0, 0), (1, 0), (1, 1)])))
    assert np.isnan(sinuosity(shapely.Point(5, 5).buffer(2).exterior))
    assert np.isnan(sinuosity(shapely.LineString()))
    bent = shapely.MultiLineString([[(0, 0), (3, 0)], [(3, 0), (3, 4)]])
    assert sinuosity(bent) == pytest.approx(7 / 5)  # Pieces that meet are one line.
    for same in (
        gpd.GeoSeries([bent], crs=CRS_),
        gpd.GeoDataFrame(geometry=[bent]),
        [(0, 0), (3, 0), (3, 4)],
    ):
        assert sinuosity(same) == pytest.approx(7 / 5)
    with pytest.raises(ReedError, match="Polygon"):
        sinuosity(shapely.box(0, 0, 1, 1))
    with pytest.raises(ReedError, match="coordinates"):
        sinuosity([1.0, 2.0, 3.0])


def test_shoreline_in_another_crs_is_reprojected():
    dsm = surface(here(shapely.box(10, 2, 50, 15)))
    degrees = lake(LAKE.buffer(0)).segmentize(5).to_crs(4326)
    assert extent(dsm, LEVEL, shoreline=degrees).area_m2[0] == pytest.approx(400, rel=1e-3)


@pytest.mark.parametrize(
    ("shoreline", "message"),
    [
        (gpd.GeoSeries([shapely.LineString([(WEST, NORTH), (WEST + 9, NORTH)])], crs=CRS_), "lake side"),
        (gpd.GeoSeries([shapely.box(0, 0, 1, 1)], crs=CRS_), "does not touch"),
        (gpd.GeoSeries([shapely.Polygon()], crs=CRS_), "empty"),
        (gpd.GeoSeries([shapely.box(WEST, NORTH - 40, WEST + 9, NORTH)]), "no CRS"),
    ],
)
def test_impossible_shorelines_are_refused(shoreline, message):
    with pytest.raises(ReedError, match=message):
        extent(surface(here(shapely.box(10, 10, 20, 20))), LEVEL, shoreline=shoreline)


def test_water_above_everything_is_refused_and_above_the_reed_is_empty():
    dsm = surface(here(shapely.box(10, 10, 20, 20)))
    with pytest.raises(ReedError, match="above everything"):
        extent(dsm, LEVEL + 2.5)
    metrics = measure_reed(dsm, LEVEL + 1.9, lake(LAKE))
    assert metrics.extent.frame.empty
    assert metrics.totals()["extent_m2"] == 0
    assert set(metrics.sections.status) == {"excluded"}
    assert set(metrics.sections.reason) == {"no reed"}
    assert metrics.cells.empty


def test_impossible_limits_and_levels_are_refused():
    dsm = surface(here(shapely.box(10, 10, 20, 20)))
    with pytest.raises(ReedError, match="minimum < maximum"):
        extent(dsm, LEVEL, 3.0, 2.0)
    with pytest.raises(ReedError, match="water level"):
        measure_reed(dsm, None)
    with pytest.raises(ReedError, match="nan"):
        extent(dsm, float("nan"))


def test_impossible_surfaces_are_refused():
    dsm = surface(here(shapely.box(10, 10, 20, 20)))
    with pytest.raises(ReedError, match="one band"):
        extent(dsm.expand_dims("band"), LEVEL)
    with pytest.raises(ReedError, match="no height at all"):
        extent(dsm * np.nan, LEVEL)
    with pytest.raises(RasterError, match="no CRS"):
        extent(dsm.drop_vars("spatial_ref"), LEVEL)


def test_a_surface_without_datum_is_measured_against_the_level_that_is_stated():
    """The caller states both; the datum is demanded where files are read."""
    dsm = surface(here(shapely.box(10, 10, 20, 20)), datum=None)
    assert extent(dsm, LEVEL).area_m2[0] == pytest.approx(100)
    assert "vertical_datum" not in object_height(dsm, LEVEL).attrs


def test_extent_accepts_polygons_and_numbers_of_any_kind():
    dsm = surface(here(shapely.box(10, 2, 50, 15)))
    for shoreline in (here(LAKE), gpd.GeoDataFrame(geometry=[here(LAKE)], crs=CRS_), lake(LAKE)):
        found = extent(dsm.astype("float64"), np.float32(LEVEL), 0, np.int64(6), shoreline)
        assert found.area_m2[0] == pytest.approx(400, rel=1e-6)


def test_laid_transects_stand_at_right_angles_every_ten_metres():
    shore = shapely.LineString([(0, 0), (60, 80)])
    water = shapely.Polygon([(0, 0), (60, 80), (-200, 300), (-300, 100)])
    lines = lay_transects(shore, water, CRS_, spacing=10, length=30)
    assert len(lines) == 11
    feet = np.array([line.coords[-1] for line in lines.geometry])
    heads = np.array([line.coords[0] for line in lines.geometry])
    assert np.hypot(*np.diff(feet, axis=0).T) == pytest.approx(np.full(10, 10))
    assert (heads - feet) @ [0.6, 0.8] == pytest.approx(np.zeros(11), abs=1e-6)
    assert (heads - feet) @ [-0.8, 0.6] == pytest.approx(np.full(11, 30))


def smeared(shape, window=1.5):
    """Reed of 2.4 m over flat water, averaged over square windows as matching does."""
    dsm = surface(shape, reed=2.4)
    cells = 2 * round(window / 0.1 / 2) + 1
    return dsm.copy(
        data=(uniform_filter(dsm.values - LEVEL, cells, mode="nearest") + LEVEL).astype(np.float32)
    )


def test_a_smeared_front_lies_at_half_the_height_of_the_stand():
    ohm = object_height(smeared(here(shapely.box(-10, 0, 70, 20))), LEVEL)
    by_height = map_extent(ohm, lake(LAKE)).reed
    at_half = map_extent(ohm, lake(LAKE), edge_share=0.5).reed
    for found, front in ((by_height, 20.45), (at_half, 20.0)):
        middle = shapely.intersection(found, here(shapely.box(20, 5, 40, 30)))
        assert middle.bounds[3] - (NORTH - 40) == pytest.approx(front, abs=0.11)


def test_a_smeared_hole_is_open_at_half_the_height_of_the_stand():
    hole = shapely.Point(30, 15).buffer(0.9)
    ohm = object_height(smeared(here(shapely.difference(shapely.box(-10, 0, 70, 25), hole))), LEVEL)
    assert map_extent(ohm, lake(LAKE), min_height=0.3).reed.geoms[0].interiors[:] == []
    (ring,) = map_extent(ohm, lake(LAKE), min_height=0.3, edge_share=0.5).reed.geoms[0].interiors
    assert shapely.Polygon(ring).centroid.distance(here(shapely.Point(30, 15))) < 0.1


def test_trees_beside_the_reed_are_no_stand():
    grid_shape = here(shapely.box(10, 10, 20, 20))
    dsm = surface(grid_shape, reed=2.0)
    tree = surface(here(shapely.box(20, 10, 25, 20)), reed=9.0)
    both = dsm.copy(data=np.maximum(dsm.values, tree.values))
    found = map_extent(object_height(both, LEVEL), edge_share=0.9).reed
    assert found.area == pytest.approx(100, rel=1e-6)


def test_stand_height_is_the_highest_pixel_in_a_disc():
    values = np.full((21, 21), np.nan)
    values[10, 10] = 2.0
    values[0, 0] = 7.0
    grid = Grid(CRS_, WEST, NORTH, 0.25, 21, 21)
    stand = stand_height(new_raster(values, grid, name="ohm", units="m"), 1.0, 6.0)
    rows, columns = np.indices(values.shape)
    inside = np.hypot(rows - 10, columns - 10) * 0.25 <= 1.0
    np.testing.assert_array_equal(stand, np.where(inside, 2.0, -1.0))
