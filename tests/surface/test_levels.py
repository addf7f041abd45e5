"""Levels on disk: the same for every tile size; what the surface needs to know of crowns."""

from itertools import pairwise

import numpy as np
import pytest
from rasterio.crs import CRS

from workbench.cameras import Camera, Pose
from workbench.matching.pairs import StereoPair
from workbench.matching.rectify import rectify_pair
from workbench.matching.store import MatchedPair, StoredPair
from workbench.orientation import OrientedPhotograph
from workbench.params import SurfaceParameters
from workbench.rasters import Grid
from workbench.surface.canopy import CanopyHeights, crown_warnings, view_of_crowns
from workbench.surface.levels import fuse_levels, grid_level, level_grid

UTM = CRS.from_epsg(32633)
CAMERA = Camera.from_focal_length("test", 640, 480, focal_length=0.02, pixel_size=2e-5)


def photograph(name, x, order):
    pose = Pose.from_roll_pitch_heading(np.array([400_000.0 + x, 5_300_000.0, 100.0]), 0, 0, 90)
    return OrientedPhotograph(name, None, CAMERA, pose, 0, order)


STRIP = [photograph(str(k), 10.0 * k, k) for k in range(4)]


def matched(first, second, downscale, seed):
    """A bumpy surface with holes, specks and noise, as one pair measures it."""
    frame, _ = rectify_pair(StereoPair(first, second, "inflight"), (-5, 20), downscale=downscale)
    random = np.random.default_rng(seed)
    rows = np.arange(frame.shape[0])[:, None]
    level = frame.focal * frame.base / 97.0 - frame.shift
    disparity = level + 0.3 * np.sin(rows / 9) + 0.1 * random.normal(size=frame.shape)
    disparity[random.random(frame.shape) < 0.05] = np.nan
    disparity[20:26, 20:26] = level + 3
    confidence = random.integers(100, 250, frame.shape).astype(np.uint8)
    return MatchedPair("p", downscale, frame, disparity.astype(np.float32), confidence)


def stored(downscale):
    pairs = [matched(a, b, downscale, k) for k, (a, b) in enumerate(pairwise(STRIP))]
    return [StoredPair(pair.rectification, lambda pair=pair: pair) for pair in pairs]


def fused(folder, tile_size):
    grid = Grid.from_bounds(UTM, (399_985, 5_299_985, 400_045, 5_300_015), 0.4)
    options = SurfaceParameters(tile_size=tile_size, min_patch=2.0)
    levels = [grid_level(stored(d), d, level_grid(grid, d, 2), (-5.0, 20.0), folder, options) for d in (2, 4)]
    parts = {
        "height": np.empty(grid.shape),
        "provenance": np.empty(grid.shape),
        "spread": np.empty(grid.shape),
    }
    for tile in grid.tiles(tile_size):
        found = fuse_levels(levels, grid, tile.core, options.patch_step)
        for name, whole in parts.items():
            whole[tile.core] = getattr(found, name)
    for level in levels:
        level.__exit__()
    return parts


def test_levels_are_identical_for_every_tile_size_and_leave_no_files(tmp_path):
    whole, tiled = fused(tmp_path, 512), fused(tmp_path, 64)
    assert np.isfinite(whole["height"]).mean() > 0.3
    for name in whole:
        np.testing.assert_array_equal(tiled[name], whole[name])
    assert not list(tmp_path.iterdir())


def test_overlap_and_angle_are_those_at_the_crowns():
    pairs = [StereoPair(a, b, "inflight") for a, b in pairwise(STRIP)]
    view = view_of_crowns(pairs, 0.0, 50.0)
    along = 480 * 2e-5 / 0.02  # Frame along the strip per metre of height.
    assert view.overlap_ground == pytest.approx(1 - 10 / (100 * along), abs=0.07)
    assert view.overlap == pytest.approx(1 - 10 / (50 * along), abs=0.1)
    assert view.angle == pytest.approx(np.degrees(2 * np.arctan(5 / 50)), abs=0.2)
    wide = [StereoPair(a, b, "inflight") for a, b in zip(STRIP, STRIP[2:], strict=False)]
    view = view_of_crowns(wide, 0.0, 50.0)
    assert view.angle > 20
    (warning,) = crown_warnings(view, 0.2, 0.4)
    assert "50 m" in warning and "40%" in warning
    assert crown_warnings(view, 0.0, 0.4) == []
    assert crown_warnings(None, 0.2, 0.4) == []
    assert view_of_crowns([StereoPair(*STRIP[:2], "across")], 0.0, 10.0) is None


def test_heights_of_trees_are_counted_from_three_metres():
    canopy = CanopyHeights()
    canopy.add(np.array([[0.0, 1.0, np.nan, 2.9], [10.0, 12.0, 14.0, 30.0]]))
    assert canopy.share == pytest.approx(4 / 7)
    assert canopy.crown_height == pytest.approx(30.0, abs=0.1)
    assert CanopyHeights().crown_height is None


@pytest.mark.parametrize(("other", "kept"), [(1, True), (3, False)])
def test_small_patch_of_one_pair_is_believed_at_a_small_angle_only(tmp_path, other, kept):
    """9 square metres that one pair measured: at 6 degrees they stay, at 17 degrees they are a speck."""
    frame, _ = rectify_pair(StereoPair(STRIP[0], STRIP[other], "inflight"), (-5, 20), downscale=1)
    disparity = np.full(frame.shape, np.nan, np.float32)
    row, column = frame.shape[0] // 2, frame.shape[1] // 2
    disparity[row : row + 31, column : column + 31] = frame.focal * frame.base / 97.0 - frame.shift
    pair = MatchedPair("p", 1, frame, disparity, np.full(frame.shape, 200, np.uint8))
    grid = Grid.from_bounds(UTM, (399_960, 5_299_960, 400_060, 5_300_040), 0.15)
    with grid_level([StoredPair(frame, lambda: pair)], 1, grid, (-5.0, 20.0), tmp_path) as level:
        found = np.isfinite(level.arrays.read("height", (slice(0, grid.height), slice(0, grid.width))))
    assert found.sum() * 0.15**2 == pytest.approx(9 if kept else 0, rel=0.1)


def flat(first, second, downscale, height):
    """A level plane as one pair measures it."""
    frame, _ = rectify_pair(StereoPair(first, second, "inflight"), (-5, 20), downscale=downscale)
    disparity = np.full(frame.shape, frame.focal * frame.base / (100.0 - height) - frame.shift, np.float32)
    pair = MatchedPair("p", downscale, frame, disparity, np.full(frame.shape, 200, np.uint8))
    return StoredPair(frame, lambda: pair)


@pytest.mark.parametrize(("other", "source"), [(1, 1), (3, 2)])
def test_two_witnesses_at_a_coarse_downscale_come_before_one_wide_pair_at_a_fine_one(tmp_path, other, source):
    """One pair at 6 degrees is believed like two; at 17 degrees the agreement of two is preferred."""
    grid = Grid.from_bounds(UTM, (400_003, 5_299_995, 400_013, 5_300_005), 0.2)
    fine = [flat(STRIP[0], STRIP[other], 1, 3.0)]
    coarse = [flat(STRIP[0], STRIP[3], 2, 4.0), flat(STRIP[0], STRIP[2], 2, 4.0)]
    with (
        grid_level(fine, 1, grid, (-5.0, 20.0), tmp_path) as first,
        grid_level(coarse, 2, level_grid(grid, 2, 1), (-5.0, 20.0), tmp_path) as second,
    ):
        found = fuse_levels([first, second], grid, (slice(0, grid.height), slice(0, grid.width)), 0.5)
    assert np.isfinite(found.height).all()
    assert (found.provenance == source).all()
    np.testing.assert_allclose(found.height, {1: 3.0, 2: 4.0}[source], atol=0.02)
    assert found.count.max() == source
