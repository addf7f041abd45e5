"""Tops: brute force, plateaus and ties, tiles, the five steps, provenance, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from tree_shapes import cones, ellipsoids, places, raster

from workbench.errors import RasterError, TreesError
from workbench.trees import ConstantWindow, FunctionWindow, GrowingWindow, find_tops, search_tops


def disc(radius):
    reach = int(radius)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return x**2 + y**2 <= radius**2 + 1e-9


def brute_force(values, radius, least=3.0):
    """Row and column of the maxima in a disc, by the definition: one a plateau, one of equals in a disc."""
    cut = np.where(np.isfinite(values) & (values >= least), values, -np.inf)
    peak = (cut > -np.inf) & (
        cut >= ndimage.maximum_filter(cut, footprint=disc(radius), mode="constant", cval=-np.inf)
    )
    first = []
    for level in np.unique(cut[peak]):
        labels, count = ndimage.label(peak & (cut == level), np.ones((3, 3)))
        for k in range(1, count + 1):
            first.append(np.argwhere(labels == k)[0])
    kept: list = []
    for row, column in sorted(map(tuple, first)):
        same = [p for p in kept if cut[p] == cut[row, column]]
        if all(np.hypot(row - p[0], column - p[1]) > radius + 1e-9 for p in same):
            kept.append((row, column))
    return set(kept)


def rough(seed, shape=(90, 120), *, steps=None, holes=0.02):
    """A random canopy; whole-number heights make plateaus and ties."""
    rng = np.random.default_rng(seed)
    values = 12 + 25 * ndimage.gaussian_filter(rng.normal(size=shape), 2.0)
    values = np.round(values / steps) * steps if steps else values
    values[rng.uniform(size=shape) < holes] = np.nan
    return values.astype(np.float32)


@pytest.mark.parametrize("radius", [1.0, 1.5, 2.0, 3.2, 5.0, 8.6, 24.5])
@pytest.mark.parametrize("steps", [None, 0.5, 2.0])
def test_maxima_equal_brute_force_with_plateaus_and_ties(radius, steps):
    values = rough(int(radius * 10), steps=steps)
    tops = find_tops(raster(values, 1.0), radius=radius, working_resolution=None)
    assert places(tops) == brute_force(values, radius)


def test_radii_that_grow_with_height_equal_brute_force():
    values = rough(3)
    window = GrowingWindow(-1.0, 0.2, 1.0, 6.0)
    expected = set()
    for row, column in brute_force(values, 1.0):
        reach = np.clip(-1.0 + 0.2 * values[row, column], 1.0, 6.0)
        y, x = np.ogrid[: values.shape[0], : values.shape[1]]
        around = np.hypot(y - row, x - column) <= reach
        if values[row, column] >= np.nanmax(values[around]):
            expected.add((row, column))
    tops = find_tops(raster(values, 1.0), window=window, radius=None, working_resolution=None)
    assert places(tops) == expected
    function = FunctionWindow(lambda h: np.clip(-1.0 + 0.2 * h, 1.0, 6.0))
    assert places(find_tops(raster(values, 1.0), radius=function, working_resolution=None)) == expected


@pytest.mark.parametrize("steps", [None, 2.0])
@pytest.mark.parametrize("tile_size", [64, 97])
@pytest.mark.parametrize("working_resolution", [None, 3.0])
def test_tops_do_not_depend_on_tiles(steps, tile_size, working_resolution):
    values = rough(7, (301, 260), steps=steps)
    values[:, 100:140] = 30.0  # A plateau across many tiles.
    options = {"radius": 6.0, "working_resolution": working_resolution}
    whole = find_tops(raster(values, 1.0), tile_size=4096, **options)
    tiled = find_tops(raster(values, 1.0), tile_size=tile_size, **options)
    assert whole.equals(tiled)
    assert len(whole) > 5
    assert (whole["z_m"] == 30.0).sum() == 1
    lazy = raster(values, 1.0).chunk({"y": 50, "x": 70})
    assert whole.equals(find_tops(lazy, tile_size=tile_size, **options))


@pytest.mark.parametrize("tile_size", [64, 97])
def test_defaults_do_not_depend_on_tiles(tile_size):
    surface = raster(rough(8, (301, 260)), 0.5)
    whole = find_tops(surface, tile_size=4096)
    assert whole.equals(find_tops(surface, tile_size=tile_size))
    assert 5 < len(whole) < len(find_tops(surface, saddle_share=0.0, tile_size=4096))


def test_a_constant_raster_has_one_top():
    tops = find_tops(raster(np.full((200, 300), 10.0, np.float32), 1.0), radius=5.0, tile_size=64)
    assert len(tops) == 1


def test_each_cone_has_its_top_at_its_apex():
    trees = [(4.1, 4.1, 12.0, 2.0), (8.1, 4.3, 9.0, 1.8), (5.5, 9.3, 15.0, 2.5)]
    tops = find_tops(cones(trees, 12))
    assert len(tops) == 3
    for x, y, height, _ in trees:
        nearest = np.hypot(tops.geometry.x - x, tops.geometry.y - y)
        assert nearest.min() < 0.15
        assert tops.height_m[nearest.argmin()] == pytest.approx(height, abs=0.7)
    assert list(tops.tree_id) == [1, 2, 3]
    assert tops.geometry.y.is_monotonic_decreasing


@pytest.mark.parametrize("cell", [0.05, 0.1, 0.2, 0.5, 1.0])
def test_defaults_find_separate_trees_at_any_cell(cell):
    rng = np.random.default_rng(2)
    axis = np.arange(5.0, 60.0, 7.0)
    trees = [
        (x + rng.uniform(-1, 1), y + rng.uniform(-1, 1), rng.uniform(8, 25), 3.0) for x in axis for y in axis
    ]
    assert len(find_tops(cones(trees, 64, cell))) == len(trees)


def test_five_steps_are_visible_and_can_be_switched():
    surface = cones([(5.0, 5.0, 20.0, 2.0), (7.0, 5.0, 17.0, 1.5), (15.0, 15.0, 10.0, 2.0)], 20)
    shrub = cones([(5.0, 15.0, 2.5, 1.0)], 20)
    surface = surface.copy(data=np.maximum(surface.values, shrub.values))
    search = search_tops(surface, radius=0.8, spacing=3.0)
    # The shrub is too low; two maxima are nearer than the spacing; the higher one stays.
    assert len(search.maxima) == 3
    assert search.maxima["multiple"].sum() == 2
    np.testing.assert_allclose(sorted(search.tops["height_m"]), [10, 20], atol=1.5)
    assert search.resolution == pytest.approx(0.2)
    assert len(find_tops(surface, radius=0.8)) == 3
    assert len(find_tops(surface, radius=0.8, min_height=12.0)) == 2
    assert search_tops(surface, radius=0.8, working_resolution=0.4).resolution == pytest.approx(0.4)
    mask = surface.copy(data=(surface.x.values > 10)[None, :] & np.ones_like(surface.values, bool))
    assert len(find_tops(surface, mask, radius=0.8)) == 1


def test_only_a_top_that_stays_removes_others():
    # In a row, 3 m apart: the middle one gives way to the first and so cannot remove the third.
    trees = [(5.0, 8.0, 20.0, 2.0), (8.0, 8.0, 17.0, 2.0), (11.0, 8.0, 14.0, 2.0)]
    tops = find_tops(cones(trees, 16), radius=0.8, spacing=4.0)
    np.testing.assert_allclose(sorted(tops["height_m"]), [14, 20], atol=1.2)
    # With a distance that grows with height each top is judged by its own height.
    tops = find_tops(cones(trees, 16), radius=0.8, spacing=lambda h: np.where(h < 16, 9.0, 1.0))
    np.testing.assert_allclose(sorted(tops["height_m"]), [17, 20], atol=1.2)


@pytest.mark.parametrize(("saddle", "prominent", "expected"), [(21.0, 1, 1), (20.5, 2, 1), (19.5, 2, 2)])
def test_summits_of_one_crown_are_a_tree_unless_a_deep_saddle_parts_them(saddle, prominent, expected):
    # Summits of 22 and 21.5 m, 3 m apart. A tree of its own descends 5 % less 1.5 cells (0.8 m), and 7.5 %
    # less 1.5 cells (1.3 m) where it is nearer than trees of this height usually are (3.7 m).
    ridge = np.interp(np.arange(100) * 0.2, [5, 7, 8.5, 10, 12], [0, 22, saddle, 21.5, 0])
    fall = np.maximum(0, 1 - np.abs(np.arange(100) * 0.2 - 10) / 4) ** 0.2
    surface = raster((ridge[None, :] * fall[:, None]).astype(np.float32))
    assert len(find_tops(surface, radius=0.8, prominence_share=0.05)) == prominent
    assert len(find_tops(surface)) == expected


def test_averaging_removes_spikes_but_heights_stay_those_of_the_source():
    surface = ellipsoids([(5.0, 5.0, 8.0, 4.0)], 10, 0.05)
    rng = np.random.default_rng(0)
    noisy = surface.copy(data=surface.values + rng.normal(0, 0.3, surface.shape).astype(np.float32))
    fine = find_tops(noisy, radius=0.4, working_resolution=None)
    coarse = find_tops(noisy, radius=0.4, working_resolution=0.4)
    assert len(coarse) < len(fine) / 3
    cells = noisy.values[coarse["row"], coarse["column"]]
    np.testing.assert_array_equal(cells, coarse["z_m"].astype(np.float32))


def test_prominence_is_the_descent_to_the_saddle():
    surface = cones([(6.0, 6.0, 20.0, 3.0), (9.0, 6.0, 15.0, 3.0)], 14, 0.1)
    tops = find_tops(surface, radius=2.0, working_resolution=None).sort_values("height_m")
    low, high = tops["prominence_m"]
    # On the line between both: 20 - 16/3 a = 15 - 4 (3 - a), at a = 1.82 m from the higher top.
    saddle = 20 - 16 / 3 * (20 - 15 + 12) / (16 / 3 + 4)
    assert low == pytest.approx(15 - saddle, abs=0.5)
    # Nothing is higher than the other one: the way that descends least counts, and it is the same.
    assert high == pytest.approx(20 - saddle, abs=0.5)
    assert len(find_tops(surface, radius=2.0, working_resolution=None, min_prominence=low + 0.1)) == 1


def persistence(values):
    """Prominence of every cell by definition: cells join from the highest down, lower summits end there."""
    parent, result = {}, np.zeros(values.shape)

    def root(cell):
        while parent[cell] != cell:
            cell = parent[cell]
        return cell

    for cell in sorted(np.ndindex(values.shape), key=lambda c: -values[c]):
        parent[cell] = cell
        for step in np.ndindex(3, 3):
            other = cell[0] + step[0] - 1, cell[1] + step[1] - 1
            if other in parent:
                a, b = sorted((root(other), root(cell)), key=lambda c: values[c])
                if a != b:
                    result[a], parent[a] = values[a] - values[cell], b
    result[root(cell)] = np.inf
    return result


@pytest.mark.parametrize("least", [0.1, 0.7, 3.0])
def test_least_prominence_is_exact_on_winding_ways(least):
    values = rough(5, (40, 60), holes=0.0)
    options = {"radius": 1.5, "working_resolution": None, "min_height": 1e-3}
    tops = find_tops(raster(values, 0.1), **{**options, "radius": 0.15}, min_prominence=least)
    every = find_tops(raster(values, 0.1), **{**options, "radius": 0.15})
    true = persistence(values)
    expected = {place for place in places(every) if true[place] >= least}
    assert places(tops) == expected
    assert 1 <= len(tops) < len(every)


def test_prominence_by_tiles_and_as_a_share_of_the_height():
    values = rough(11, (200, 170), holes=0.0)
    surface = raster(values, 0.5)
    options = {"radius": 0.8, "working_resolution": None, "prominence_share": 0.1}
    tops = find_tops(surface, **options)
    assert tops.equals(find_tops(surface, tile_size=64, **options))
    every = find_tops(surface, **{**options, "prominence_share": 0.0})
    true = persistence(values)
    needed = 0.1 * every["height_m"] - 0.75
    kept = true[every["row"], every["column"]] >= needed
    assert places(tops) == places(every[kept])
    assert 0 < len(tops) < len(every)


def test_a_disc_that_is_asked_for_keeps_all_its_maxima():
    surface = ellipsoids([(5.0, 5.0, 20.0, 3.0)], 10)
    around = surface.values[23:26, 31:34]
    surface.values[24, 32] = around.max() + 0.2  # A branch 1.5 m from the top.
    assert len(find_tops(surface, radius=0.3)) == 2
    assert len(find_tops(surface, radius=0.3, prominence_share=0.05)) == 1
    assert len(find_tops(surface)) == 1


def test_smoothing_is_a_gaussian_over_what_is_known_and_keeps_heights():
    values = rough(12, (150, 130), holes=0.03)
    surface = raster(values, 0.5)
    options = {"radius": 1.6, "working_resolution": None, "smoothing": 0.6}
    tops = find_tops(surface, **options)
    assert tops.equals(find_tops(surface, tile_size=64, **options))
    known = np.isfinite(values) & (values >= 3)
    total = ndimage.gaussian_filter(
        np.where(known, values, 0.0).astype(float), 1.2, mode="constant", radius=4
    )
    weight = ndimage.gaussian_filter(known.astype(float), 1.2, mode="constant", radius=4)
    smooth = np.where(known, total / np.maximum(weight, 1e-9), np.nan).astype(np.float32)
    assert places(tops) == brute_force(smooth, 3.2, least=0.0)
    np.testing.assert_array_equal(values[tops["row"], tops["column"]], tops["height_m"].astype(np.float32))
    assert 0 < len(tops) < len(find_tops(surface, **{**options, "smoothing": 0.0}))


def test_smoothing_with_terrain_on_a_slope_finds_the_same_trees():
    flat = cones([(5.0, 5.0, 10.0, 2.5), (12.0, 9.0, 14.0, 2.5)], 16, 0.1)
    slope = flat.copy(data=np.broadcast_to(400 + 0.3 * flat.x.values, flat.shape).astype(np.float32))
    options = {"radius": 1.5, "smoothing": 0.25}
    above = find_tops(flat, **options)
    upon = find_tops(flat.copy(data=flat.values + slope.values), terrain=slope, **options)
    assert len(upon) == len(above) == 2
    np.testing.assert_allclose(upon["height_m"], above["height_m"], atol=0.5)


def test_terrain_moves_no_top_and_heights_are_above_it():
    flat = cones([(5.0, 5.0, 10.0, 2.5), (12.0, 9.0, 14.0, 2.5)], 16, 0.1)
    slope = flat.copy(data=np.broadcast_to(400 + 0.3 * flat.x.values, flat.shape).astype(np.float32))
    tops = find_tops(flat.copy(data=flat.values + slope.values), terrain=slope, radius=1.5)
    assert len(tops) == 2
    np.testing.assert_allclose(sorted(tops["height_m"]), [10, 14], atol=0.4)
    assert (tops["z_m"] > 400).all()


def test_a_top_on_an_interpolated_cell_is_flagged():
    surface = cones([(5.0, 5.0, 10.0, 2.0), (12.0, 5.0, 12.0, 2.0)], 16)
    sure = find_tops(surface)
    provenance = surface.copy(data=np.ones(surface.shape, np.uint8))
    provenance[sure["row"][0], sure["column"][0]] = 255
    assert list(find_tops(surface, provenance=provenance)["interpolated"]) == [True, False]
    assert not sure["interpolated"].any()


@pytest.mark.parametrize("values", [np.zeros((40, 50)), np.full((40, 50), np.nan), np.full((40, 50), -5.0)])
def test_no_trees_give_an_empty_table_with_all_columns(values):
    tops = find_tops(raster(values.astype(np.float32), 1.0))
    assert len(tops) == 0
    assert {"tree_id", "height_m", "z_m", "prominence_m", "interpolated", "geometry"} <= set(tops.columns)
    assert tops.crs is not None


def test_one_tree_and_a_mask_without_any_true_cell():
    surface = cones([(5.0, 5.0, 10.0, 2.0)], 10)
    assert len(find_tops(surface)) == 1
    nowhere = surface.copy(data=np.zeros(surface.shape, np.uint8))
    assert len(find_tops(surface, nowhere)) == 0


def test_infinite_cells_and_spikes_outside_the_mask_do_no_harm():
    surface = cones([(5.0, 5.0, 10.0, 2.0)], 10)
    values = surface.values.copy()
    values[0, 0], values[1, 0] = np.inf, 1e30
    mask = surface.copy(data=surface.values > 0)
    tops = find_tops(surface.copy(data=values), mask, radius=lambda h: 0.5 + 0.05 * h)
    assert len(tops) == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"radius": 0.1}, "less than one cell"),
        ({"radius": 500.0}, "larger than the raster"),
        ({"radius": 1.0, "min_height": 0.0}, "makes trees of the ground"),
        ({"saddle_share": -0.1}, "no share"),
        ({"prominence_share": 5.0}, "no share"),
        ({"min_prominence": -1.0}, "impossible"),
        ({"radius": 1.0, "spacing": -1.0}, "separates nothing"),
        ({"radius": 0.3, "working_resolution": 1.0}, "less than one cell"),
        ({"radius": 1.0, "smoothing": -0.1}, "smoothing"),
    ],
)
def test_impossible_searches_are_refused(options, words):
    with pytest.raises(TreesError, match=words):
        find_tops(cones([(5.0, 5.0, 10.0, 2.0)], 10), **options)


def test_rasters_on_other_grids_or_without_metres_are_refused():
    surface = cones([(5.0, 5.0, 10.0, 2.0)], 10)
    ones = np.ones((50, 50), np.uint8)
    with pytest.raises(RasterError, match="different grids"):
        find_tops(surface, raster(np.ones((25, 25), np.uint8), 0.4))
    with pytest.raises(RasterError, match="EPSG:32632"):
        find_tops(surface, raster(ones, crs="EPSG:32632"))
    with pytest.raises(TreesError, match="metres"):
        find_tops(raster(surface.values, 1e-6, crs="EPSG:4326"))
    with pytest.raises(RasterError, match="no CRS"):
        find_tops(surface.drop_vars("spatial_ref"))
    with pytest.raises(TreesError, match="one band"):
        find_tops(surface.expand_dims(band=2))


def test_surfaces_in_other_units_or_of_elevations_are_refused():
    surface = cones([(5.0, 5.0, 20.0, 2.0), (15.0, 15.0, 10.0, 2.0)], 20)
    with pytest.raises(TreesError, match="centimetres"):
        find_tops(raster((surface.values * 100).astype(np.int16)))
    with pytest.raises(TreesError, match="elevations"):
        find_tops(surface + 300)
    with pytest.raises(TreesError, match="foot"):
        find_tops(raster(surface.values, crs="EPSG:2263"))
    with pytest.raises(TreesError, match="read_raster"):
        find_tops(surface.values)


def test_a_window_that_lies_about_its_largest_radius_is_found_out():
    class Liar(ConstantWindow):
        def largest(self, height):
            return 0.5

    with pytest.raises(TreesError, match="larger radii"):
        find_tops(cones([(5.0, 5.0, 10.0, 2.0)], 10), radius=Liar(2.0))
