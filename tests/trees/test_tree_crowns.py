"""Crowns: analytic shapes, order of seeds, tiles, criteria, other methods, bad input."""

from __future__ import annotations

from collections import deque

import geopandas as gpd
import numpy as np
import pytest
from scipy import ndimage
from shapely.geometry import Point
from tree_shapes import CRS, cones, ellipsoids, raster, tops_at

from workbench.errors import RasterError, TreesError
from workbench.trees import (
    AtLeast,
    Change,
    Dalponte,
    MarkerWatershed,
    Reach,
    RegionGrowing,
    Slope,
    crown_labels,
    find_tops,
    grow_crowns,
)

METHODS = [RegionGrowing(), MarkerWatershed(), Dalponte(top_share=0.1, mean_share=0.1)]
PLAIN = {"working_resolution": None, "smoothing_size": 1}


@pytest.mark.parametrize("method", METHODS, ids=lambda m: type(m).__name__)
@pytest.mark.parametrize("shape", [cones, ellipsoids])
@pytest.mark.parametrize("radius", [1.5, 3.0, 5.0])
def test_crown_of_a_free_standing_tree_has_its_radius(method, shape, radius):
    surface = shape([(8.0, 8.0, 20.0, radius)], 16, 0.1)
    crowns = grow_crowns(find_tops(surface), surface, method, **PLAIN)
    assert len(crowns) == 1
    # The border runs along cells: the radius of equal area is within half a cell.
    assert crowns.diameter_m[0] / 2 == pytest.approx(radius, abs=0.05)
    assert crowns.area_m2[0] == pytest.approx(crowns.geometry[0].area)
    circle = Point(8.0, 8.0).buffer(radius)
    assert crowns.geometry[0].intersection(circle).area / crowns.geometry[0].union(circle).area > 0.93


def test_slope_criterion_stops_at_the_edge_of_an_ellipsoid():
    # On level ground of another stand (10 m high) only the steep edge ends the crown.
    surface = ellipsoids([(8.0, 8.0, 30.0, 4.0)], 16, 0.1)
    floor = surface.copy(data=np.maximum(surface.values, 10.0).astype(np.float32))
    open_end = grow_crowns(tops_at([(8.0, 8.0, 30.0)]), floor, RegionGrowing(), **PLAIN)
    assert open_end.diameter_m[0] > 12
    sloped = RegionGrowing((Slope(-90, 80),))
    crowns = grow_crowns(tops_at([(8.0, 8.0, 30.0)]), floor, sloped, **PLAIN)
    # z' = 15 r / (16 sqrt(1 - r^2 / 16)) reaches tan 80 at r = 3.34 m; winding ways come nearer to 4 m.
    r = 4 * np.sqrt(1 / (1 + (15 / 4 / np.tan(np.radians(80))) ** 2))
    assert r - 0.1 <= crowns.diameter_m[0] / 2 <= 4.0


def test_aspect_criterion_ends_at_the_valley_between_two_cones():
    trees = [(5.05, 8.05, 20.0, 4.0), (9.95, 8.05, 20.0, 4.0)]
    surface = cones(trees, 16, 0.1)
    with_aspect = RegionGrowing((), Reach(7.0, 0.1, aspect=2))
    only_left = grow_crowns(tops_at(trees[:1]), surface, with_aspect, **PLAIN)
    assert only_left.total_bounds[2] == pytest.approx(7.5, abs=0.3)
    without = grow_crowns(tops_at(trees[:1]), surface, RegionGrowing((), Reach(7.0, 0.1)), **PLAIN)
    assert without.total_bounds[2] > 11


def test_equal_neighbours_share_the_cells_half_and_half():
    trees = [(5.05, 8.05, 20.0, 4.0), (9.95, 8.05, 20.0, 4.0)]
    crowns = grow_crowns(tops_at(trees), cones(trees, 16, 0.1), **PLAIN)
    assert crowns.area_m2[0] == pytest.approx(crowns.area_m2[1], rel=0.01)
    assert crowns.total_bounds[[0, 2]] == pytest.approx([1.05, 13.95], abs=0.2)
    assert crowns.geometry[0].bounds[2] == pytest.approx(7.5, abs=0.11)


def stand(seed=0, size=40.0, count=60):
    rng = np.random.default_rng(seed)
    place = rng.uniform(2, size - 2, (count, 2))
    trees = [(x, y, rng.uniform(8, 25), rng.uniform(1.5, 3.5)) for x, y in place]
    surface = cones(trees, size, 0.2)
    rough = ndimage.gaussian_filter(rng.normal(size=surface.shape), 1.5)
    values = np.maximum(surface.values + rough, 0).astype(np.float32)
    return surface.copy(data=values), rng


ALL_CRITERIA = RegionGrowing(
    (Slope(-45, 85), Change("gli", 0.2), AtLeast("brightness", 30.0)), Reach(4.0, 0.3, aspect=5, area=25.0)
)


def with_layers(surface, rng):
    return {
        "gli": surface.copy(data=rng.uniform(0, 0.25, surface.shape).astype(np.float32)),
        "brightness": surface.copy(data=rng.uniform(25, 200, surface.shape).astype(np.float32)),
    }


@pytest.mark.parametrize("seed", range(3))
def test_order_of_seeds_does_not_matter(seed):
    surface, rng = stand(seed)
    layers = with_layers(surface, rng)
    tops = find_tops(surface)
    # Equal heights too: then the northern, then the western top is preferred.
    tops.loc[::2, "height_m"] = 15.0
    for method in (RegionGrowing(), ALL_CRITERIA):
        first = crown_labels(tops, surface, method, layers=layers)
        for _ in range(4):
            shuffled = tops.iloc[rng.permutation(len(tops))]
            assert first.equals(crown_labels(shuffled, surface, method, layers=layers))
        assert len(np.unique(first)) > 20


def appendix_3(surface, seeds, step):
    """Region growing as the appendix prints it: each seed floods all it may, one seed after the other."""
    owner = np.full(surface.shape, -1)
    for number, seed in enumerate(seeds):
        owner[seed] = number
        front = deque([seed])
        while front:
            i, j = front.popleft()
            for y in range(max(i - 1, 0), min(i + 2, surface.shape[0])):
                for x in range(max(j - 1, 0), min(j + 2, surface.shape[1])):
                    if owner[y, x] < 0 and step(surface[i, j], surface[y, x], seed, (y, x)):
                        owner[y, x] = number
                        front.append((y, x))
    return owner


def test_growing_of_the_appendix_depends_on_order_and_ours_does_not():
    trees = [(5.1, 8.1, 20.0, 4.0), (8.9, 8.1, 20.0, 4.0)]
    surface, tops = cones(trees, 16, 0.2), tops_at(trees)
    rows = np.floor((16.0 - tops.geometry.y) / 0.2).astype(int)
    columns = np.floor(tops.geometry.x / 0.2).astype(int)
    seeds = list(zip(rows, columns, strict=True))

    def within(here, there, seed, place):
        return there >= 3.0 and np.hypot(place[0] - seed[0], place[1] - seed[1]) * 0.2 <= 7.0

    forward = appendix_3(surface.values, seeds, within)
    backward = appendix_3(surface.values, seeds[::-1], within)
    # The first seed takes nearly the whole group, also the other crown; it only leaves the other's top.
    assert (forward == 0).sum() > 3 * (forward == 1).sum()
    assert (forward == 0).sum() == pytest.approx((backward == 0).sum(), rel=0.02)
    assert np.mean((forward == 0) != (backward == 1)) > 0.1
    ours = crown_labels(tops, surface, **PLAIN)
    turned = crown_labels(tops.iloc[::-1], surface, **PLAIN)
    assert ours.equals(turned)
    assert (ours == 1).sum() == pytest.approx(int((ours == 2).sum()), rel=0.02)


@pytest.mark.parametrize("tile_size", [64, 101])
def test_crowns_do_not_depend_on_tiles(tile_size):
    surface, rng = stand(5, 60.0, 140)
    layers = with_layers(surface, rng)
    tops = find_tops(surface)
    for method in (RegionGrowing(), ALL_CRITERIA, MarkerWatershed(), Dalponte()):
        whole = crown_labels(tops, surface, method, layers=layers, tile_size=4096)
        tiled = crown_labels(tops, surface, method, layers=layers, tile_size=tile_size)
        assert whole.equals(tiled)
    tables = [grow_crowns(tops, surface, layers=layers, tile_size=size) for size in (4096, tile_size)]
    assert tables[0].equals(tables[1])


def test_limits_of_size_and_radius_hold():
    surface, _ = stand(1)
    tops = find_tops(surface)
    crowns = grow_crowns(tops, surface, RegionGrowing((), Reach(2.0, 0.1, area=6.0)), working_resolution=None)
    assert crowns.area_m2.max() <= 6.0 + 1e-9
    joined = crowns.merge(tops[["tree_id", "geometry"]], on="tree_id", suffixes=("", "_top"))
    farthest = [c.hausdorff_distance(t) for c, t in zip(joined.geometry, joined.geometry_top, strict=True)]
    # A cell's middle is within the radius; its corner, seen from a corner of the top's cell, may not be.
    assert max(farthest) <= 2.0 + 2 * 0.2


def test_radius_of_each_top_may_come_from_its_row():
    trees = [(5.0, 8.0, 20.0, 4.0), (13.0, 8.0, 20.0, 4.0)]
    tops = tops_at(trees).assign(reach=[1.0, 3.0])
    crowns = grow_crowns(tops, cones(trees, 18, 0.1), RegionGrowing((), Reach("reach", 0.0)), **PLAIN)
    np.testing.assert_allclose(crowns.diameter_m / 2, [1.0, 3.0], atol=0.06)


def test_shadow_and_a_change_of_index_end_a_crown():
    surface = cones([(8.0, 8.0, 20.0, 5.0)], 16, 0.1)
    east = np.broadcast_to(surface.x.values > 9.0, surface.shape)
    dark = surface.copy(data=np.where(east, 10.0, 90.0).astype(np.float32))
    for method, layers in (
        (RegionGrowing((AtLeast("brightness", 30.0),)), {"brightness": dark}),
        (RegionGrowing((Change("ndvi", 0.3),)), {"ndvi": dark / 100}),
    ):
        layers = {name: layer.rio.write_crs(CRS) for name, layer in layers.items()}
        crowns = grow_crowns(tops_at([(8.0, 8.0, 20.0)]), surface, method, layers=layers, **PLAIN)
        assert crowns.total_bounds[2] == pytest.approx(9.0, abs=0.11)
        name = next(iter(layers))
        assert crowns[f"{name}_mean"][0] == pytest.approx(float(layers[name].max()))


def test_mask_and_missing_cells_belong_to_no_crown():
    surface = cones([(5.0, 5.0, 20.0, 3.0), (11.0, 5.0, 15.0, 2.0)], 14, 0.1)
    mask = surface.copy(data=np.broadcast_to(surface.x.values < 9, surface.shape).astype(np.uint8))
    tops = find_tops(surface)
    assert len(grow_crowns(tops, surface, mask=mask, **PLAIN)) == 1
    values = surface.values.copy()
    values[:, :50] = np.nan
    crowns = grow_crowns(tops, surface.copy(data=values), **PLAIN)
    assert crowns.total_bounds[0] >= 5.0 - 1e-9


def test_two_tops_in_one_cell_make_one_crown():
    surface = cones([(5.0, 5.0, 20.0, 3.0)], 10, 0.2)
    tops = tops_at([(5.01, 5.01, 18.0), (5.05, 5.05, 20.0)])
    for method in METHODS:
        assert list(grow_crowns(tops, surface, method)["tree_id"]) == [2]


def test_heights_are_read_where_the_tops_have_none():
    surface = cones([(5.0, 5.0, 20.0, 3.0)], 10, 0.2)
    tops = find_tops(surface)
    assert grow_crowns(tops, surface).equals(grow_crowns(tops.drop(columns="height_m"), surface))


@pytest.mark.parametrize("method", METHODS, ids=lambda m: type(m).__name__)
def test_no_tops_and_one_cell(method):
    surface = cones([(5.0, 5.0, 20.0, 3.0)], 10, 0.2)
    empty = grow_crowns(find_tops(surface).iloc[:0], surface, method)
    assert len(empty) == 0
    assert {"tree_id", "area_m2", "diameter_m", "geometry"} <= set(empty.columns)
    assert empty.crs is not None


def test_region_growing_and_watershed_agree_on_separate_trees():
    surface = cones([(4.0, 4.0, 12.0, 2.0), (10.0, 4.0, 15.0, 2.5), (7.0, 11.0, 20.0, 3.0)], 15, 0.1)
    tops = find_tops(surface)
    growing, flooding = (
        crown_labels(tops, surface, m, **PLAIN) for m in (RegionGrowing(), MarkerWatershed())
    )
    assert np.mean(growing.values != flooding.values) < 0.002


def test_bad_tops_and_layers_are_refused():
    surface = cones([(5.0, 5.0, 20.0, 3.0)], 10, 0.2)
    tops = tops_at([(5.0, 5.0, 20.0)])
    for bad, words in (
        (tops.set_crs("EPSG:32632", allow_override=True), "32632"),
        (tops.assign(tree_id=0), "positive"),
        (gpd.GeoDataFrame(np.repeat(tops, 2, axis=0), columns=tops.columns, crs=CRS), "each once"),
        (tops.drop(columns="tree_id"), "tree_id"),
        (tops_at([(50.0, 5.0, 20.0)]), "outside"),
    ):
        with pytest.raises(TreesError, match=words):
            grow_crowns(bad, surface)
    with pytest.raises(TreesError, match="ndvi"):
        grow_crowns(tops, surface, RegionGrowing((Change("ndvi", 0.1),)))
    with pytest.raises(TreesError, match="aspect"):
        grow_crowns(tops, surface, RegionGrowing((), Reach(aspect="aspect")))
    with pytest.raises(TreesError, match="impossible"):
        grow_crowns(tops, surface, RegionGrowing((), Reach(float("inf"))))
    with pytest.raises(TreesError, match="allow nothing"):
        Slope(50, 10)
    with pytest.raises(RasterError, match="different grids"):
        grow_crowns(tops, surface, mask=raster(np.ones((20, 20), np.uint8), 0.5))
