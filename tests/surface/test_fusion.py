"""Fusion of pairs and downscales, specks, refinement, terrain."""

import numpy as np
import pytest
from rasterio.warp import transform

from workbench.errors import RasterError, SurfaceError
from workbench.rasters import Grid, new_raster
from workbench.surface import fuse_downscales, fuse_pairs
from workbench.surface.filling import fill_heights
from workbench.surface.refine import refine
from workbench.surface.specks import patches, remove_specks
from workbench.surface.terrain import UserTerrain, filled_from_rims, ground_filter, height_above, user_terrain

NAN = np.nan


def one_cell(*heights, confidence=None, precision=None, tolerance=0.1):
    stack = np.array(heights, np.float32).reshape(-1, 1, 1)
    trust = np.ones_like(stack) if confidence is None else np.array(confidence, np.float32).reshape(-1, 1, 1)
    sd = np.full(len(heights), 0.01) if precision is None else np.array(precision)
    height, count, spread = fuse_pairs(stack, trust, sd, tolerance=tolerance)
    return float(height[0, 0]), int(count[0, 0]), float(spread[0, 0])


def test_a_mixed_cell_gets_crown_or_ground_but_nothing_between():
    assert one_cell(10.0, 10.02, 10.04, 0.0, 0.01)[:2] == (pytest.approx(10.02), 3)
    assert one_cell(10.0, 0.0, 0.01, 0.02)[:2] == (pytest.approx(0.01), 3)


def test_of_two_equal_groups_the_upper_one_is_the_surface():
    assert one_cell(10.0, 0.0)[:2] == (10.0, 1)


def test_precise_and_confident_pairs_weigh_more():
    assert one_cell(10.0, 0.0, 0.02, precision=[0.01, 0.1, 0.1])[0] == 10.0
    assert one_cell(10.0, 0.0, 0.02, confidence=[9, 1, 1])[0] == 10.0


def test_spread_is_the_robust_deviation_and_unknown_for_one():
    height, count, spread = one_cell(1.00, 1.02, 1.04, 1.06, 1.08)
    assert (height, count) == (pytest.approx(1.04), 5)
    assert spread == pytest.approx(1.4826 * 0.02, rel=1e-3)
    assert np.isnan(one_cell(1.0)[2])


def test_no_height_stays_no_height():
    height, count, _ = one_cell(NAN, NAN)
    assert np.isnan(height)
    assert count == 0


GRID = Grid.from_bounds("EPSG:32633", (0, 0, 4, 1), 1.0)


def surface(*values, grid=GRID):
    return new_raster(np.array([values], np.float32), grid, name="dsm", units="m", vertical_datum="test")


def test_holes_are_filled_by_the_next_downscale_and_never_invented():
    fused = fuse_downscales([surface(1, NAN, NAN, NAN), surface(9, 2, NAN, NAN), surface(9, 9, 3, NAN)])
    np.testing.assert_array_equal(fused.height, [[1, 2, 3, NAN]])
    np.testing.assert_array_equal(fused.provenance, [[1, 2, 3, 0]])
    assert fused.provenance.dtype == np.uint8


def test_other_downscales_keep_their_numbers():
    fused = fuse_downscales([surface(1, NAN, NAN, 4), surface(9, 2, NAN, 9)], [2, 12])
    np.testing.assert_array_equal(fused.provenance, [[2, 12, 0, 2]])


@pytest.mark.parametrize(
    ("surfaces", "numbers", "message"),
    [
        ([], None, "No surfaces"),
        ([surface(1, 2, 3, 4)] * 2, [1], "as many"),
        ([surface(1, 2, 3, 4)] * 2, [1, 1], "different"),
        ([surface(1, 2, 3, 4)], [255], "1..254"),
    ],
)
def test_impossible_fusions_are_refused(surfaces, numbers, message):
    with pytest.raises(SurfaceError, match=message):
        fuse_downscales(surfaces, numbers)


def test_surfaces_on_other_grids_are_refused():
    elsewhere = Grid.from_bounds("EPSG:32633", (1, 0, 5, 1), 1.0)
    with pytest.raises(RasterError, match="different grids"):
        fuse_downscales([surface(1, 2, 3, 4), surface(1, 2, 3, 4, grid=elsewhere)])


def test_specks_go_and_patches_stay():
    height = np.full((20, 20), NAN, np.float32)
    height[2:10, 2:10] = 1.0
    height[15, 15:17] = 5.0
    height[5, 5] = 9.0  # a spike inside the patch is not connected to it
    remove_specks(height, 10, 0.5)
    assert np.isnan(height[15, 15])
    assert np.isnan(height[5, 5])
    assert np.isfinite(height[2:10, 2:10]).sum() == 63


def test_patches_connect_by_small_steps_only():
    labels = patches(np.array([[0.0, 0.4, 0.8, 2.0, NAN, 2.0]], np.float32), 0.5)
    assert labels[0, 0] == labels[0, 2] != labels[0, 3]
    assert labels[0, 4] == 0
    assert len({labels[0, 0], labels[0, 3], labels[0, 5]}) == 3


def test_refinement_is_smooth_on_a_slope_and_sharp_at_a_step():
    coarse = Grid.from_bounds("EPSG:32633", (0, 0, 40, 40), 4.0)
    fine = Grid.from_bounds("EPSG:32633", (0, 0, 40, 40), 1.0)
    slope = np.broadcast_to(0.1 * coarse.x, coarse.shape).astype(np.float32)
    refined = refine(slope, coarse, fine, step=1.0)
    inner = slice(2, -2)
    np.testing.assert_allclose(
        refined[:, inner], np.broadcast_to(0.1 * fine.x, fine.shape)[:, inner], atol=1e-5
    )
    wall = np.where(coarse.x < 20, 0.0, 10.0) * np.ones(coarse.shape)
    assert set(np.unique(refine(wall.astype(np.float32), coarse, fine, step=1.0))) == {0.0, 10.0}


def test_holes_are_closed_from_their_rim_and_measured_cells_stay():
    grid = Grid.from_bounds("EPSG:32633", (0, 0, 100, 100), 1.0)
    values = np.broadcast_to(0.05 * grid.x, grid.shape).astype(np.float32).copy()
    values[30:70, 30:70] = NAN
    raster = new_raster(values, grid, name="dsm", units="m", vertical_datum="test")
    filled, measured = fill_heights(raster).window(slice(0, 100), slice(0, 100))
    assert np.isfinite(filled).all()
    np.testing.assert_array_equal(filled[measured], values[np.isfinite(values)])
    assert filled[~measured].min() > 1.0
    assert filled[~measured].max() < 4.0


@pytest.fixture(scope="module")
def hillside():
    """A slope with a forest of 12 m and its gap."""
    grid = Grid.from_bounds("EPSG:32633", (0, 0, 80, 80), 0.5)
    x, y = np.meshgrid(grid.x, grid.y)
    ground = 100 + 0.1 * x
    canopy = (x > 30) & (x < 50) & (y > 30) & (y < 50)
    heights = np.where(canopy, ground + 12, ground).astype(np.float32)
    return new_raster(heights, grid, name="dsm", units="m", vertical_datum="test"), ground, canopy


def test_the_ground_below_a_forest_is_bridged_and_flagged(hillside):
    dsm, ground, canopy = hillside
    terrain, seen = ground_filter(dsm)
    truth = new_raster(ground.astype(np.float32), Grid.of(dsm), name="t", units="m", vertical_datum="test")
    error = height_above(truth, terrain)
    assert np.nanpercentile(np.abs(error), 95) < 0.3
    ndsm = height_above(dsm, terrain)
    assert np.nanmedian(ndsm.values[canopy]) == pytest.approx(12, abs=0.5)
    coarse = refine(seen.values, Grid.of(seen), Grid.of(dsm))
    assert coarse[canopy].mean() < 0.1
    assert coarse[~canopy].mean() > 0.8


def test_holes_of_a_terrain_lie_in_the_plane_of_their_rims():
    rows, columns = np.mgrid[:60, :80]
    plane = (100 + 0.3 * columns - 0.2 * rows).astype(np.float32)
    holes = np.hypot(rows - 30, columns - 35) < 18
    holes |= (rows > 40) & (columns > 60) | (np.random.default_rng(3).uniform(size=rows.shape) < 0.2)
    holes[:3] = True
    found = filled_from_rims(np.where(holes, NAN, plane).astype(np.float32))
    assert np.array_equal(found[~holes], plane[~holes])
    inside = (rows > 5) & (rows < 55) & (columns > 5) & (columns < 75)
    corner = (rows > 40) & (columns > 60)
    assert found[inside & ~corner] == pytest.approx(plane[inside & ~corner], abs=1e-3)
    # Beyond everything measured: the nearest, and never outside of what was measured.
    assert np.isfinite(found).all()
    assert found.min() >= plane[~holes].min() - 1e-3 and found.max() <= plane[~holes].max() + 1e-3


def test_a_terrain_of_another_datum_or_too_small_is_refused(hillside):
    dsm, ground, _ = hillside
    grid = Grid.of(dsm)
    other = new_raster(ground.astype(np.float32), grid, name="dtm", units="m", vertical_datum="ellipsoid")
    with pytest.raises(SurfaceError, match="ellipsoid"):
        user_terrain(other, dsm)
    small = Grid.from_bounds(grid.crs, (0, 0, 40, 80), 0.5)
    part = new_raster(np.zeros(small.shape, np.float32), small, name="dtm", units="m", vertical_datum="test")
    with pytest.raises(SurfaceError, match="does not cover"):
        user_terrain(part, dsm)
    bare = new_raster(np.zeros(small.shape, np.float32), small, name="dtm", units="m")
    with pytest.raises(RasterError, match="no vertical datum"):
        user_terrain(bare, dsm)


def test_an_empty_surface_has_no_ground(hillside):
    dsm, _, _ = hillside
    empty = dsm.copy(data=np.full(dsm.shape, NAN, np.float32))
    with pytest.raises(SurfaceError, match="too few"):
        ground_filter(empty)


@pytest.mark.parametrize("tile_size", [7, 16, 64])
def test_specks_do_not_depend_on_the_tiles(tile_size):
    random = np.random.default_rng(2)
    height = np.where(random.random((60, 70)) < 0.62, random.integers(0, 2, (60, 70)) * 0.3, NAN)
    height = height.astype(np.float32)
    height[20:24, :] = 5.0  # a snake through all tiles
    whole, tiled = height.copy(), height.copy()
    remove_specks(whole, 30, 0.5)
    remove_specks(tiled, 30, 0.5, tile_size=tile_size)
    assert 0 < np.isnan(whole).sum() - np.isnan(height).sum() < height.size / 2
    np.testing.assert_array_equal(tiled, whole)


def test_a_terrain_in_another_crs_and_cell_is_interpolated_exactly():
    grid = Grid.from_bounds("EPSG:25832", (500_000, 5_300_000, 500_040, 5_300_030), 0.5)
    dsm = new_raster(np.zeros(grid.shape, np.float32), grid, name="dsm", units="m", vertical_datum="test")
    cells = np.meshgrid(grid.x, grid.y)
    moved = np.array(transform(grid.crs, "EPSG:25833", *(axis.ravel() for axis in cells)))
    west, south, east, north = moved[0].min(), moved[1].min(), moved[0].max(), moved[1].max()
    there = Grid.from_bounds("EPSG:25833", (west - 5, south - 5, east + 5, north + 5), 2.0)
    x, y = np.meshgrid(there.x, there.y)
    plane = (0.8 * (x - west) - 0.3 * (y - south)).astype(np.float32)
    dtm = new_raster(plane, there, name="dtm", units="m", vertical_datum="test")
    truth = (0.8 * (moved[0] - west) - 0.3 * (moved[1] - south)).reshape(grid.shape)
    np.testing.assert_allclose(user_terrain(dtm, dsm), truth, atol=1e-3)
    terrain = UserTerrain(dtm, dsm)
    for tile in grid.tiles(17):
        np.testing.assert_array_equal(terrain.window(*tile.core), user_terrain(dtm, dsm).values[tile.core])


@pytest.mark.parametrize("tile_size", [5, 64])
def test_patches_of_one_pair_must_be_larger(tile_size):
    height, count = np.full((40, 40), NAN, np.float32), np.zeros((40, 40), np.uint8)
    for rows, pairs in ((slice(2, 8), 1), (slice(12, 18), 2), (slice(22, 38), 1)):
        height[rows, 3:19], count[rows, 3:19] = 1.0, pairs
    remove_specks(height, 20, 0.5, agreed=count >= 2, least_alone=150, tile_size=tile_size)
    assert np.isnan(height[2:8]).all()
    assert np.isfinite(height[12:18, 3:19]).all()
    assert np.isfinite(height[22:38, 3:19]).all()
