import geopandas as gpd
import numpy as np
import pytest
from shapely.geometry import box

from workbench.errors import RasterError, StudyError
from workbench.rasters import Grid, new_raster
from workbench.studies import (
    agreement,
    object_shifts,
    reproducibility,
    reproducible_dates,
    share_by_distance,
)

GRID = Grid.from_bounds("EPSG:32633", (0, 0, 60, 40), 1.0)


def mosaic(values, grid=GRID):
    return new_raster(values.astype(np.uint8), grid, name="ortho", units="1", nodata=0)


@pytest.fixture
def repetitions():
    """Five mosaics: equal on the left, independent noise on the right, one without data at the top."""
    random = np.random.default_rng(0)
    base = random.integers(20, 200, (3, *GRID.shape))
    made = []
    for _ in range(5):
        values = base.copy()
        values[:, :, 40:] = random.integers(20, 200, (3, 40, 20))
        made.append(values)
    made[2][:, :4] = 0
    return [mosaic(values) for values in made]


def test_layer_counts_the_pairs_that_agree(repetitions):
    result = reproducibility(repetitions)
    layer = result.layer.values
    assert result.pairs == 10
    assert (layer[:4] == 65535).all()
    assert (layer[6:, :38] == 10).all()
    assert layer[6:, 42:].max() <= 1
    assert result.histogram().pixels.sum() == (layer != 65535).sum()


def test_share_by_land_cover(repetitions):
    cover = np.ones(GRID.shape, np.uint8)
    cover[:, 42:] = 2
    cover = new_raster(cover, GRID, name="cover", units="1", nodata=0)
    table = reproducibility(repetitions).share_by(cover, {1: "meadow", 2: "forest"}).set_index("cover")
    assert table.share["meadow"] > 0.9
    assert table.share["forest"] == 0
    assert table.pixels["total"] == table.pixels["meadow"] + table.pixels["forest"]


def test_tiles_do_not_matter(repetitions):
    whole, tiled = reproducibility(repetitions), reproducibility(repetitions, tile_size=16)
    np.testing.assert_array_equal(whole.layer, tiled.layer)


def test_inside_of_crop_masks_only(repetitions):
    result = reproducibility(repetitions)
    crops = [
        gpd.GeoDataFrame(geometry=[area], crs="EPSG:32633")
        for area in (box(0, 0, 30, 40), box(10, 0, 60, 20))
    ]
    inside = result.within(crops).layer.values != 65535
    expected = np.zeros(GRID.shape, bool)
    expected[20:, 10:30] = True
    np.testing.assert_array_equal(inside, expected)
    assert result.within([]).share == result.share


def test_few_repetitions_against_many(repetitions):
    few, many = reproducibility(repetitions[:2]), reproducibility(repetitions)
    found = agreement(few, many)
    assert found["share_few"] >= found["share_many"]
    # Whatever two of them tell apart, all of them do; on the right every pair differs.
    assert found["found_any"] > 0.97
    assert found["overlap_most"] > 0.97
    assert found["correlation"] > 0.97
    same = agreement(many, many)
    assert (same["found_any"], same["overlap_most"]) == (1, 1)
    assert same["correlation"] == pytest.approx(1)
    equal = agreement(*[reproducibility(repetitions[:1] * 2)] * 2)
    assert np.isnan(equal["overlap_any"])


def test_share_by_distance_to_gaps(repetitions):
    result = reproducibility(repetitions)
    column = np.broadcast_to(np.arange(60), GRID.shape)
    gaps = new_raster((column >= 42).astype(np.uint8), GRID, name="gaps", units="1")
    area = new_raster((column < 42).astype(np.uint8), GRID, name="area", units="1")
    table = share_by_distance(result, gaps, area, edges=(0, 5, 20))
    # The four rows at the top are not compared.
    assert table.pixels.tolist() == [36 * 4, 36 * 15, 36 * 23]
    assert table.share[0] < 1
    assert table.share[1:].tolist() == [1, 1]
    assert table.identical[2] == 1


def test_dates_add_up(repetitions):
    one = reproducibility(repetitions)
    dates = reproducible_dates([one, one, one])
    assert dates.values[20, 10] == 3
    assert dates.values[20, 50] == 0
    assert dates.values[0, 0] == 65535


def test_bad_repetitions_are_refused(repetitions):
    with pytest.raises(StudyError, match="at least two"):
        reproducibility(repetitions[:1])
    other = Grid.from_bounds("EPSG:32633", (1, 0, 61, 40), 1.0)
    with pytest.raises(RasterError, match="different grids"):
        reproducibility([repetitions[0], mosaic(np.ones((3, *GRID.shape)), other)])
    elsewhere = Grid.from_bounds("EPSG:25832", (0, 0, 60, 40), 1.0)
    with pytest.raises(RasterError, match="reproject"):
        reproducibility([repetitions[0], mosaic(np.ones((3, *GRID.shape)), elsewhere)])


def objects(shift, names=("roof", "stone")):
    geometry = [box(0, 0, 4, 2), box(10, 10, 11, 11)]
    frame = gpd.GeoDataFrame({"object": names}, geometry=geometry, crs="EPSG:32633")
    frame["geometry"] = frame.translate(*shift)
    return frame


def test_objects_shift_by_what_they_were_moved():
    shifts = object_shifts({"2013": objects((0, 0)), "2015": objects((0.3, 0.4)), "2017": objects((0, 0))})
    assert len(shifts.table) == 6
    assert shifts.maximum_m == pytest.approx(0.5)
    assert shifts.mean_m == pytest.approx(1 / 3)
    row = shifts.table.iloc[0]
    assert (row.east_m, row.north_m) == pytest.approx((0.3, 0.4))
    assert row.geometry.length == pytest.approx(0.5)


def test_bad_objects_are_named():
    with pytest.raises(StudyError, match="two"):
        object_shifts({"2013": objects((0, 0))})
    with pytest.raises(StudyError, match="more than once"):
        object_shifts({"2013": objects((0, 0), ("a", "a")), "2015": objects((0, 0))})
    with pytest.raises(StudyError, match="reproject"):
        object_shifts({"2013": objects((0, 0)), "2015": objects((0, 0)).to_crs("EPSG:25833")})
    with pytest.raises(StudyError, match="same"):
        object_shifts({"2013": objects((0, 0), ("a", "b")), "2015": objects((0, 0), ("c", "d"))})
