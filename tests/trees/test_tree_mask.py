"""Tree mask: thresholds, morphology of stated sizes, tiles, sites without terrain or near infrared."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from tree_shapes import cones, raster

from workbench.errors import RasterError, TreesError
from workbench.trees import height_over_surroundings, tree_mask
from workbench.trees.indices import brightness, green_leaf_index, vegetation_index

BARE = {"close": 0.0, "open": 0.0, "min_area": 0.0}


def disc(cells):
    reach = int(cells + 1e-6)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return x**2 + y**2 <= cells**2 + 1e-6


def blobs(seed=0, shape=(120, 150)):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 3)
    return (10 * noise / noise.std()).astype(np.float32)


def test_height_and_each_index_must_reach_their_limits():
    height = raster(np.array([[2.9, 3.0, 9.0, 9.0, np.nan]], np.float32), 1.0)
    ndvi = raster(np.array([[0.9, 0.2, 0.19, np.nan, 0.9]], np.float32), 1.0)
    gli = raster(np.array([[0.1, 0.0, 0.1, 0.1, 0.1]], np.float32), 1.0)
    assert tree_mask(height, **BARE).values.tolist() == [[0, 1, 1, 1, 0]]
    assert tree_mask(height, ndvi=ndvi, **BARE).values.tolist() == [[0, 1, 0, 0, 0]]
    assert tree_mask(height, gli=gli, **BARE).values.tolist() == [[0, 1, 1, 1, 0]]
    assert tree_mask(height, ndvi=ndvi, gli=gli, min_gli=0.05, **BARE).values.tolist() == [[0, 0, 0, 0, 0]]


@pytest.mark.parametrize("radius", [0.2, 0.6, 1.0])
def test_closing_and_opening_equal_those_of_scipy(radius):
    height = raster(blobs(), 0.2)
    found = height.values >= 3
    shape = disc(radius / 0.2)
    # Beyond the border nothing is assumed: scipy closes there as if all were empty, so it is padded.
    padded = np.pad(found, 20, mode="constant")
    closed = ndimage.binary_closing(padded, shape)[20:-20, 20:-20]
    inner = (slice(12, -12), slice(12, -12))
    ours = tree_mask(height, close=radius, open=0, min_area=0).values[inner]
    np.testing.assert_array_equal(ours, closed[inner])
    opened = ndimage.binary_opening(found, shape)
    ours = tree_mask(height, close=0, open=radius, min_area=0).values[inner]
    np.testing.assert_array_equal(ours, opened[inner])


def test_sizes_are_metres_whatever_the_cell():
    for cell in (0.1, 0.2):
        scale = round(0.2 / cell)
        values = np.zeros((40, 80), np.float32)
        values[10:30, 10:30] = 10  # 4 m
        values[10:30, 40:43] = 10  # A wall of 0.6 m.
        values[5, 70] = 10  # 0.04 m2
        values[18:20, 18:20] = 0  # A gap of 0.4 m.
        height = raster(np.repeat(np.repeat(values, scale, 0), scale, 1), cell)
        mask = tree_mask(height, close=0.5, open=0.4, min_area=0.0).values
        assert mask[14 * scale, 14 * scale] == 1
        assert mask[19 * scale, 19 * scale] == 1
        assert mask[20 * scale, 41 * scale] == 0
        kept = tree_mask(height, close=0.0, open=0.0, min_area=1.0).values
        assert kept[20 * scale, 41 * scale] == 1
        assert kept[5 * scale, 70 * scale] == 0


@pytest.mark.parametrize("tile_size", [16, 64])
def test_the_mask_does_not_depend_on_tiles(tile_size):
    height, gli = raster(blobs(1, (200, 170)), 0.2), raster(blobs(2, (200, 170)), 0.2)
    whole = tree_mask(height, gli=gli, close=0.6, open=0.4, min_area=2.0)
    assert whole.equals(tree_mask(height, gli=gli, close=0.6, open=0.4, min_area=2.0, tile_size=tile_size))
    assert 0.05 < float(whole.mean()) < 0.95


def test_without_terrain_a_tree_stands_out_of_its_surroundings_on_a_slope():
    flat = cones([(20.0, 20.0, 12.0, 3.0), (40.0, 35.0, 8.0, 2.5)], 60, 0.25)
    slope = 0.1 * flat.x.values[None, :]
    surface = flat.copy(data=(flat.values + 500 + slope).astype(np.float32))
    above = height_over_surroundings(surface, 10.0)
    # Away from the border the grey opening follows the slope, but for the fall over a cell of a metre.
    error = np.abs(above - flat).values
    assert error[:, 44:-44].max() < 0.1 + 1e-3
    assert error.max() < 0.1 * 11 + 1e-3
    assert (tree_mask(above, **BARE).values == tree_mask(flat, **BARE).values).mean() > 0.99


def test_the_surroundings_skip_missing_cells():
    flat = cones([(20.0, 20.0, 12.0, 3.0)], 40, 0.25)
    values = flat.values + 100
    values[:30] = np.nan
    above = height_over_surroundings(flat.copy(data=values), 8.0)
    assert np.isnan(above.values[:30]).all()
    assert float(above.max()) == pytest.approx(12, abs=1)


def test_indices_of_known_colours():
    band = np.array([10, 0, 200], np.uint8)
    np.testing.assert_allclose(
        vegetation_index(np.array([30, 0, 100], np.uint8), band), [0.5, np.nan, -1 / 3]
    )
    np.testing.assert_allclose(
        green_leaf_index(band, np.array([30, 0, 200], np.uint8), np.array([10, 0, 200], np.uint8)),
        [0.5, np.nan, 0.0],
    )
    np.testing.assert_allclose(brightness(band, band, band, band + 4), [11, 1, 201])


def test_a_mask_without_any_true_cell_is_a_mask():
    height = raster(np.zeros((30, 40), np.float32))
    mask = tree_mask(height)
    assert mask.dtype == np.uint8
    assert int(mask.sum()) == 0
    assert int(tree_mask(raster(np.full((30, 40), np.nan, np.float32))).sum()) == 0


def test_other_grids_and_impossible_sizes_are_refused():
    height = raster(np.zeros((30, 40), np.float32))
    with pytest.raises(RasterError, match="different grids"):
        tree_mask(height, gli=raster(np.zeros((15, 20), np.float32), 0.4))
    with pytest.raises(RasterError, match="32632"):
        tree_mask(height, gli=raster(np.zeros((30, 40), np.float32), crs="EPSG:32632"))
    with pytest.raises(TreesError, match="negative"):
        tree_mask(height, close=-1.0)
    with pytest.raises(TreesError, match="positive radius"):
        height_over_surroundings(height, 0.0)
