"""Rectification, triangulation and gridding on geometry that is known in closed form."""

import numpy as np
import pytest
from rasterio.crs import CRS

from workbench.cameras import Camera, Pose
from workbench.errors import MatchingError
from workbench.matching.guide import guide_disparity
from workbench.matching.levels import choose_downscales, search_heights
from workbench.matching.pairs import StereoPair, intersection_angle_at, overlap_at, select_pairs
from workbench.matching.rectify import rectify_pair, resample
from workbench.matching.store import MatchedPair, PairStore, load_pair, pack, save_pair
from workbench.orientation import Block, OrientedPhotograph
from workbench.params import MatchParameters
from workbench.rasters import Grid, new_raster
from workbench.surface.filling import fill_heights
from workbench.surface.gridding import grid_pair

UTM = CRS.from_epsg(32633)
ORIGIN = np.array([400_000.0, 5_300_000.0, 0.0])
CAMERA = Camera.from_focal_length(
    "test", 640, 480, focal_length=0.02, pixel_size=2e-5, distortion=(-0.05, 0.02, 0.001, -0.002)
)


def photograph(name, x, y, z=100.0, heading=90.0, strip=0, order=0, tilt=0.0, roll=0.0):
    pose = Pose.from_roll_pitch_heading(ORIGIN + (x, y, z), roll, 1.0, heading, tilt_right=tilt)
    return OrientedPhotograph(name, None, CAMERA, pose, strip, order)


PAIRS = {
    "east": (photograph("a", 0, 0), photograph("b", 10, 1, 101)),
    "west": (photograph("a", 0, 0, heading=270), photograph("b", -10, 0.5, heading=270)),
    "diagonal": (photograph("a", 0, 0, heading=45), photograph("b", 8, 8, heading=45, roll=3)),
    "across": (photograph("a", 0, 0, heading=90), photograph("b", 1, 14, heading=270)),
    "oblique": (photograph("a", 0, 0, heading=0, tilt=35), photograph("b", 0, 12, heading=0, tilt=35)),
}


@pytest.mark.parametrize("kind", PAIRS)
def test_points_lie_in_one_row_and_triangulate_back(kind):
    first, second = PAIRS[kind]
    rectification, swapped = rectify_pair(StereoPair(first, second, "inflight"), (-5, 20), downscale=2)
    left, right = (second, first) if swapped else (first, second)
    random = np.random.default_rng(0)
    axis = left.pose.centre + left.pose.view_direction * 95
    points = axis + random.uniform(-20, 20, (400, 3)) * (1, 1, 0)
    points[:, 2] = random.uniform(-4, 19, 400)
    points = points[left.sees(points) & right.sees(points)]
    assert len(points) > 50

    def seen(centre, shift):
        camera = (points - centre) @ rectification.rotation.T
        plane = camera[:, :2] / camera[:, 2:] * rectification.focal
        return plane + (rectification.principal[0] + shift, rectification.principal[1])

    in_left, in_right = seen(left.pose.centre, 0.0), seen(right.pose.centre, rectification.shift)
    np.testing.assert_allclose(in_left[:, 1], in_right[:, 1], atol=1e-8)
    disparity = in_left[:, 0] - in_right[:, 0]
    assert disparity.min() >= 0
    assert disparity.max() <= rectification.disparities
    assert in_left.min() >= 0
    assert in_right.min() >= 0
    assert np.all(in_left < rectification.shape[::-1])
    assert np.all(in_right < rectification.shape[::-1])
    back = rectification.points(in_left[:, 0], in_left[:, 1], disparity)
    np.testing.assert_allclose(back, points, atol=1e-6)


def test_resampling_agrees_with_projection():
    first, second = PAIRS["diagonal"]
    rectification, swapped = rectify_pair(StereoPair(first, second, "inflight"), (-5, 20), downscale=1)
    left = second if swapped else first
    rows, columns = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    # An image that tells its own columns and rows: what is sampled is where it was sampled.
    for values, axis in ((columns + 0.5, 0), (rows + 0.5, 1)):
        sampled = resample(values.astype(np.float32), CAMERA, left.pose, rectification, right=False)
        i, j = np.nonzero(np.isfinite(sampled))
        keep = slice(None, None, 997)
        world = rectification.points(j[keep] + 0.5, i[keep] + 0.5, np.full(len(j[keep]), 30.0))
        expected = left.project(world)[:, axis]
        np.testing.assert_allclose(sampled[i[keep], j[keep]], expected, atol=0.02)


def test_a_reduced_photograph_keeps_its_scale_though_its_remainder_is_cut_off():
    first, second = PAIRS["diagonal"]
    factor = 7
    assert CAMERA.height % factor and CAMERA.width % factor
    rectification, swapped = rectify_pair(StereoPair(first, second, "inflight"), (-5, 20), downscale=factor)
    left = second if swapped else first
    columns = np.arange(CAMERA.width // factor) * factor + factor / 2
    values = np.broadcast_to(columns, (CAMERA.height // factor, len(columns))).astype(np.float32)
    sampled = resample(values, CAMERA, left.pose, rectification, right=False)
    i, j = np.nonzero(np.isfinite(sampled))
    world = rectification.points(j + 0.5, i + 0.5, np.full(len(j), 5.0))
    np.testing.assert_allclose(sampled[i, j], left.project(world)[:, 0], atol=0.1)


def matched_plane(height, slope=0.0, downscale=2):
    """A pair whose disparities are exactly those of a plane z = height + slope * x."""
    rectification, _ = rectify_pair(StereoPair(*PAIRS["east"], "inflight"), (-5, 20), downscale=downscale)
    rows, columns = rectification.shape
    u, v = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    plane = np.stack(
        [
            (u - rectification.principal[0]) / rectification.focal,
            (v - rectification.principal[1]) / rectification.focal,
            np.ones_like(u),
        ],
        -1,
    )
    rays = plane @ rectification.rotation
    centre = rectification.centre - ORIGIN
    depth = (height + slope * centre[0] - centre[2]) / (rays[..., 2] - slope * rays[..., 0])
    disparity = rectification.focal * rectification.base / depth - rectification.shift
    return MatchedPair(
        "a__b",
        downscale,
        rectification,
        disparity.astype(np.float32),
        np.full((rows, columns), 200, np.uint8),
    )


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_a_plane_is_gridded_exactly_and_without_holes(slope):
    pair = matched_plane(4.0, slope)
    grid = Grid.from_bounds(UTM, (*(ORIGIN[:2] + (-5, -8)), *(ORIGIN[:2] + (12, 8))), 0.25)
    height, confidence = grid_pair(pair, grid, (-5, 20))
    x = np.broadcast_to(grid.x - ORIGIN[0], grid.shape)
    assert np.isfinite(height).all()
    np.testing.assert_allclose(height, 4.0 + slope * x, atol=0.01)
    assert (confidence > 0).all()


def test_nothing_is_interpolated_across_a_step():
    pair = matched_plane(0.0)
    half = pair.disparity.shape[1] // 2
    raised = matched_plane(10.0).disparity
    pair.disparity[:, half:] = raised[:, half:]
    grid = Grid.from_bounds(UTM, (*(ORIGIN[:2] + (-15, -15)), *(ORIGIN[:2] + (25, 15))), 0.25)
    height, _ = grid_pair(pair, grid, (-5, 20))
    known = height[np.isfinite(height)]
    assert np.all((np.abs(known) < 0.05) | (np.abs(known - 10) < 0.05))
    assert (np.abs(known - 10) < 0.05).any()


def test_tiles_of_a_pair_are_parts_of_the_whole():
    pair = matched_plane(2.0, 0.1)
    grid = Grid.from_bounds(UTM, (*(ORIGIN[:2] - 15), *(ORIGIN[:2] + 20)), 0.25)
    whole, _ = grid_pair(pair, grid, (-5, 20))
    for tile in grid.tiles(50):
        found = grid_pair(pair, grid, (-5, 20), window=tile.core)
        part = np.full(whole[tile.core].shape, np.nan) if found is None else found[0]
        np.testing.assert_array_equal(part, whole[tile.core])


def test_the_guide_is_the_disparity_of_the_surface():
    pair = matched_plane(4.0)
    grid = Grid.from_bounds(UTM, (*(ORIGIN[:2] - 60), *(ORIGIN[:2] + 60)), 0.5)
    surface = new_raster(np.full(grid.shape, 4.0, np.float32), grid, name="s", units="m", vertical_datum="t")
    guide = guide_disparity(pair.rectification, fill_heights(surface), 20.0, -5.0)
    assert guide.shape == pair.disparity.shape
    assert np.nanmax(np.abs(guide - pair.disparity)) < 1.0


def test_a_stored_pair_comes_back_and_has_the_same_bytes(tmp_path):
    pair = matched_plane(4.0)
    pair.disparity[10:20, 10:20] = np.nan
    save_pair(pair, tmp_path / "a.zip")
    save_pair(pair, tmp_path / "b.zip")
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    back = load_pair(tmp_path / "a.zip")
    np.testing.assert_allclose(back.disparity, pair.disparity, atol=0.5 / 64 + 1e-6)
    np.testing.assert_array_equal(back.confidence, pair.confidence)
    pack([("ds2/a.zip", tmp_path / "a.zip")], tmp_path / "pairs.zip")
    store = PairStore(tmp_path / "pairs.zip")
    assert store.downscales == (2,)
    np.testing.assert_array_equal(store.load(store.pairs(2)[0]).disparity, back.disparity)


def test_damaged_and_missing_pairs_are_named(tmp_path):
    (tmp_path / "a.zip").write_bytes(b"nothing")
    with pytest.raises(MatchingError, match="damaged"):
        load_pair(tmp_path / "a.zip")
    with pytest.raises(MatchingError, match="workbench match"):
        PairStore(tmp_path / "pairs.zip")


@pytest.fixture
def block():
    """Two strips of four, flown there and back; neighbours overlap by 84 % along and 50 % across."""
    photographs = [
        photograph(f"{strip}{k}", 10.0 * (k if strip == 0 else 3 - k), 24.0 * strip, strip=strip, order=k)
        for strip in range(2)
        for k in range(4)
    ]
    return Block(tuple(photographs), UTM, "test", np.zeros((5, 3)) + ORIGIN)


def test_inflight_and_across_choose_the_pairs_of_the_thesis(block):
    strip = select_pairs(block, inflight=1, across=False, ground=0.0)
    assert {(p.left.name, p.right.name) for p in strip} == {
        *(("00", "01"), ("01", "02"), ("02", "03")),
        *(("10", "11"), ("11", "12"), ("12", "13")),
    }
    assert len(select_pairs(block, inflight=2, across=False, ground=0.0)) == 10
    across = select_pairs(block, inflight=1, across=True, ground=0.0)
    assert {(p.left.name, p.right.name) for p in across if p.kind == "across"} == {
        ("00", "13"), ("01", "12"), ("02", "11"), ("03", "10"),
    }  # fmt: skip


def test_between_distant_stations_of_the_other_strip_both_are_taken():
    first = [photograph(f"0{k}", 20 * k, 0, order=k) for k in range(4)]
    second = [photograph(f"1{k}", 20 * k + 9, 20, strip=1, order=k) for k in range(4)]
    sparse = Block((*first, *second), UTM, "t", np.zeros((1, 3)))
    across = [p for p in select_pairs(sparse, inflight=1, across=True, ground=0.0) if p.kind == "across"]
    assert {(p.left.name, p.right.name) for p in across} == {
        ("00", "10"), ("01", "11"), ("02", "12"), ("03", "13"),
        ("01", "10"), ("02", "11"), ("03", "12"), ("00", "11"), ("02", "13"),
    }  # fmt: skip


def test_overlap_and_angle_follow_their_definitions(block):
    first, second = block.photographs[0], block.photographs[1]
    along = 480 * 2e-5 / 0.02 * 100
    assert overlap_at(first, second, 0.0) == pytest.approx(1 - 10 / along, abs=0.02)
    angle = intersection_angle_at(StereoPair(first, second, "inflight"), 0.0)
    assert angle == pytest.approx(2 * np.degrees(np.arctan(5 / 100)), abs=0.1)


def test_photographs_without_overlap_are_refused():
    far = Block((photograph("a", 0, 0), photograph("b", 900, 0, order=1)), UTM, "t", np.zeros((1, 3)))
    with pytest.raises(MatchingError, match="overlap"):
        select_pairs(far, inflight=1, across=None, ground=0.0)


def test_two_photographs_at_one_place_have_no_base():
    with pytest.raises(MatchingError, match="no base"):
        rectify_pair(
            StereoPair(photograph("a", 0, 0), photograph("b", 0, 0), "inflight"), (0, 5), downscale=1
        )


@pytest.mark.parametrize(
    ("resolution", "factors"),
    [(0.15, (1, 2, 3)), (0.05, (1, 2, 3)), (0.016, (3, 6, 12)), (0.025, (2, 4, 8)), (0.03, (1, 2, 4, 6))],
)
def test_downscales_reach_15_to_20_centimetres(resolution, factors):
    assert choose_downscales(resolution) == factors


def test_heights_are_searched_generously_upwards_but_not_up_to_the_camera(block):
    low, high = search_heights(block, MatchParameters())
    assert low == pytest.approx(-5)
    assert high == pytest.approx(45)
    near = Block(tuple(photograph(str(k), 10 * k, 0, 30) for k in range(3)), UTM, "t", block.tie_points)
    assert search_heights(near, MatchParameters())[1] == pytest.approx(21)
