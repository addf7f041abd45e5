"""Shifts between dates: mosaics that are moved by a known amount."""

import geopandas as gpd
import numpy as np
import pytest
from scipy import ndimage
from shapely.geometry import box

from workbench.errors import RasterError, StudyError
from workbench.rasters import Grid, new_raster
from workbench.studies import coregistration, follow_objects, object_shifts
from workbench.studies.registration import window_shifts

GRID = Grid.from_bounds("EPSG:32633", (1000, 2000, 1030, 2024), 0.1)
EAST, NORTH = 0.237, -0.152


def mosaic(values, grid=GRID):
    return new_raster(np.clip(values, 1, 255).astype(np.uint8), grid, name="ortho", units="1", nodata=0)


@pytest.fixture(scope="module")
def ground():
    random = np.random.default_rng(4)
    return 128 + 60 * ndimage.gaussian_filter(random.normal(size=GRID.shape), 2.0) / 0.14


@pytest.fixture(scope="module")
def pair(ground):
    """The land of one date, and the same moved east and south, darker and with noise."""
    random = np.random.default_rng(5)
    moved = ndimage.shift(ground, (-NORTH / 0.1, EAST / 0.1), order=3, mode="nearest")
    colours = [mosaic(np.stack([v, 0.9 * v, 0.7 * v])) for v in (ground, 0.8 * moved)]
    colours[1].values[:] += random.integers(0, 4, colours[1].shape, dtype=np.uint8)
    return colours


def areas(*parts):
    return gpd.GeoDataFrame({"object": range(len(parts))}, geometry=list(parts), crs="EPSG:32633")


def test_stable_ground_shows_the_shift_to_a_tenth_of_a_cell(pair):
    patches = coregistration(*pair, areas(box(1002, 2002, 1028, 2022)), patch=3.0, search=1.0)
    assert len(patches) == 8 * 6
    assert patches.east_m.to_numpy() == pytest.approx(EAST, abs=0.02)
    assert patches.north_m.to_numpy() == pytest.approx(NORTH, abs=0.02)
    assert patches.east_m.median() == pytest.approx(EAST, abs=0.01)


def test_objects_are_followed_and_their_shift_is_that_of_the_land(pair):
    objects = areas(box(1005, 2005, 1009, 2008), box(1015, 2012, 1017, 2016))
    later = follow_objects(objects, *pair, search=1.0)
    shifts = object_shifts({"2013": objects, "2015": later})
    assert shifts.table.east_m.to_numpy() == pytest.approx(EAST, abs=0.02)
    assert shifts.maximum_m == pytest.approx(np.hypot(EAST, NORTH), abs=0.02)


def test_what_is_not_there_is_not_found(ground, pair):
    other = mosaic(np.stack([np.random.default_rng(6).normal(128, 40, GRID.shape)] * 3))
    area = areas(box(1005, 2005, 1009, 2008))
    with pytest.raises(StudyError, match="within 1 m"):
        follow_objects(area, pair[0], other, search=1.0)
    with pytest.raises(StudyError, match="same place"):
        coregistration(pair[0], other, area, patch=2.0, search=1.0)
    with pytest.raises(StudyError, match="larger areas"):
        coregistration(*pair, area, patch=9.0, search=1.0)


def test_windows_without_an_answer_are_nan(ground, pair):
    flat = mosaic(np.full((3, *GRID.shape), 90.0))
    hole = pair[1].copy(deep=True)
    hole.values[:, 100:120, 100:120] = 0
    windows = [(1000, 2000, 1003, 2003), (1009, 2011, 1012, 2014), (1020, 2010, 1023, 2013)]
    assert window_shifts(flat, flat, windows, search=1.0).isna().all(axis=None)
    found = window_shifts(pair[0], hole, windows, search=1.0)
    assert found.score.isna().tolist() == [True, True, False]
    too_far = window_shifts(*pair, windows[2:], search=0.2)
    assert too_far.score.isna().all()


def test_other_grids_are_refused(pair):
    other = mosaic(pair[1].values, Grid.from_bounds("EPSG:32633", (1000.1, 2000, 1030.1, 2024), 0.1))
    with pytest.raises(RasterError, match="different grids"):
        window_shifts(pair[0], other, [(1005, 2005, 1009, 2008)], search=1.0)
