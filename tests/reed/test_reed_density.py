"""Cells of one square metre against a loop over pixels, exactextract and pixels by hand."""

import geopandas as gpd
import numpy as np
import pytest
import shapely
from exactextract import exact_extract
from rasterio.crs import CRS

from workbench.errors import ReedError
from workbench.rasters import Grid, new_raster
from workbench.reed import cell_statistics, density_cells

CRS_ = CRS.from_epsg(32633)


def raster(values, resolution=0.136, west=400000.03, north=5300000.47):
    values = np.asarray(values, dtype=np.float32)
    grid = Grid(CRS_, west, north, resolution, values.shape[1], values.shape[0])
    return new_raster(values, grid, name="ohm", units="m", vertical_datum="x")


@pytest.fixture(scope="module")
def ohm():
    rng = np.random.default_rng(8)
    values = rng.gamma(4, 0.6, (90, 110))
    values[rng.uniform(size=values.shape) < 0.1] = np.nan
    values[40:60, 40:70] = np.nan
    return raster(values)


def squares(statistics):
    cells = statistics.grid
    rows, columns = np.indices(cells.shape)
    west, north = cells.west + columns * cells.resolution, cells.north - rows * cells.resolution
    shapes = shapely.box(west, north - cells.resolution, west + cells.resolution, north)
    return gpd.GeoDataFrame(geometry=shapes.ravel(), crs=cells.crs)


@pytest.mark.parametrize("size", [1.0, 0.7, 2.3])
def test_equal_to_exactextract(ohm, size):
    found = cell_statistics(ohm, cell_size=size)
    cells = squares(found)
    exact = exact_extract(ohm, cells, ["mean", "variance", "count"], output="pandas")
    shape = found.grid.shape
    assert found.known * size**2 == pytest.approx(
        exact["count"].to_numpy().reshape(shape) * 0.136**2, abs=1e-6
    )
    some = found.known > 1e-6
    assert found.mean[some] == pytest.approx(exact["mean"].to_numpy().reshape(shape)[some], abs=1e-6)
    assert found.variance[some] == pytest.approx(exact["variance"].to_numpy().reshape(shape)[some], abs=1e-6)


@pytest.mark.parametrize("divisor", ["population", "sample"])
def test_centre_rule_counts_whole_pixels(ohm, divisor):
    found = cell_statistics(ohm, weights="centre", variance=divisor)
    cells, pixels = found.grid, Grid.of(ohm)
    x, y = np.meshgrid(pixels.x, pixels.y)
    column = ((x - cells.west) // 1.0).astype(int)
    row = ((cells.north - y) // 1.0).astype(int)
    for place in [(3, 4), (7, 10), (11, 13), (1, 1), (2, 14)]:
        inside = ohm.values[(row == place[0]) & (column == place[1])].astype(float)
        inside = inside[np.isfinite(inside)]
        assert found.mean[place] == pytest.approx(inside.mean(), abs=1e-9)
        ddof = 1 if divisor == "sample" else 0
        assert found.variance[place] == pytest.approx(inside.var(ddof=ddof), abs=1e-9)


def test_result_does_not_depend_on_bands_or_on_the_piece(ohm):
    whole = cell_statistics(ohm, band=1000)
    for band in (1, 3, 7):
        part = cell_statistics(ohm, band=band)
        assert np.array_equal(part.mean, whole.mean, equal_nan=True)
        assert np.array_equal(part.variance, whole.variance, equal_nan=True)
    piece = cell_statistics(ohm.isel(y=slice(30, 90), x=slice(22, 110)))
    down = round(whole.grid.north - piece.grid.north)
    across = round(piece.grid.west - whole.grid.west)
    common = whole.variance[down + 1 : down + piece.grid.height, across + 1 : across + piece.grid.width]
    assert piece.variance[1:, 1:] == pytest.approx(common, nan_ok=True)


def test_cells_lie_on_whole_metres():
    grid = cell_statistics(raster(np.ones((40, 40)))).grid
    assert (grid.west % 1, grid.north % 1) == (0, 0)
    assert grid.bounds[0] <= 400000.03
    assert grid.bounds[3] >= 5300000.47
    aligned = cell_statistics(raster(np.ones((40, 40)), resolution=0.1, west=400000.0, north=5300000.0)).grid
    assert aligned.shape == (4, 4)


def by_class(values, **options):
    """Density of a raster of metre cells, 0.5 m pixels, all of it reed."""
    ohm = raster(values, resolution=0.5, west=400000.0, north=5300000.0)
    return density_cells(ohm, shapely.box(*Grid.of(ohm).bounds), **options)


def test_sparse_needs_high_variance_and_low_mean():
    low_rough, low_even = [[0, 2], [2, 0]], [[1, 1], [1, 1]]
    high_rough, high_even = [[5, 3], [3, 5]], [[3, 3], [3, 3]]
    cells = by_class(np.hstack([low_rough, low_even, high_rough, high_even]))
    assert cells.density.tolist() == ["sparse", "dense", "dense", "dense"]
    assert cells.variance_m2.tolist() == [1, 0, 1, 0]
    assert cells.reed_m2.tolist() == [1, 1, 1, 1]


def test_on_a_cut_a_cell_is_dense():
    assert by_class([[0, 2], [2, 0]], variance=1.0).density[0] == "dense"
    assert by_class([[0, 2], [2, 0]], mean_height=1.0).density[0] == "dense"
    assert by_class([[0, 2], [2, 0]], variance=0.999, mean_height=1.001).density[0] == "sparse"


def test_cells_without_enough_heights_are_unknown():
    nan = np.nan
    assert by_class([[nan, nan], [nan, 0]]).density[0] == "unknown"
    assert by_class([[nan, nan], [2, 0]]).density[0] == "sparse"
    assert by_class([[nan, nan], [nan, nan]]).density[0] == "unknown"


def test_only_cells_with_reed_are_listed():
    ohm = raster(np.full((20, 20), 3.0), resolution=0.5, west=400000.0, north=5300000.0)
    cells = density_cells(ohm, shapely.box(400002, 5299994, 400004.5, 5299997))
    assert len(cells) == 9
    assert cells.reed_m2.sum() == pytest.approx(7.5)
    assert density_cells(ohm, shapely.Polygon()).empty


def test_extent_in_another_crs_is_moved_and_without_one_refused():
    ohm = raster(np.full((20, 20), 3.0), resolution=0.5, west=400000.0, north=5300000.0)
    reed = gpd.GeoDataFrame(geometry=[shapely.box(400002, 5299994, 400004.5, 5299997)], crs=CRS_)
    moved = density_cells(ohm, reed.segmentize(0.5).to_crs(4326))
    assert moved.reed_m2.sum() == pytest.approx(7.5)
    with pytest.raises(ReedError, match="no CRS"):
        density_cells(ohm, gpd.GeoSeries([reed.geometry[0]]))


def test_cells_smaller_than_pixels_are_refused(ohm):
    with pytest.raises(ReedError, match="smaller than the pixels"):
        cell_statistics(ohm, cell_size=0.1)


def test_spread_adds_the_variance_within_pixels() -> None:
    """Heights of many pairs, ten a pixel: their variance in a cell is found from mean and spread alone."""
    rng = np.random.default_rng(3)
    heights = 2.0 + rng.normal(0, 0.2, (1, 40, 40)) + rng.normal(0, 0.3, (10, 40, 40))
    mean, spread = heights.mean(axis=0), heights.std(axis=0)
    aligned = {"resolution": 0.25, "west": 400000.0, "north": 5300000.0}
    found = cell_statistics(raster(mean, **aligned), spread=raster(spread, **aligned))
    inside = heights.reshape(10, 10, 4, 10, 4)
    np.testing.assert_allclose(found.variance, inside.var(axis=(0, 2, 4)), rtol=1e-5)
    np.testing.assert_allclose(found.mean, inside.mean(axis=(0, 2, 4)), rtol=1e-6)


def test_pixels_without_a_spread_add_none() -> None:
    ohm = raster(np.full((40, 40), 2.0))
    gaps = raster(np.full((40, 40), np.nan))
    assert np.all(cell_statistics(ohm, spread=gaps).variance == 0)
    holes = ohm.copy(data=np.where(np.arange(40) < 20, np.nan, ohm.values))
    spread = raster(np.full((40, 40), 0.5))
    variance = cell_statistics(holes, spread=spread).variance
    np.testing.assert_allclose(variance[np.isfinite(variance)], 0.25, rtol=1e-6)


def test_spread_of_other_pixels_is_refused() -> None:
    with pytest.raises(ReedError, match="other pixels"):
        cell_statistics(raster(np.ones((40, 40))), spread=raster(np.ones((20, 20))))
