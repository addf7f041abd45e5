"""Polygons against rasterio's own, cells against exactextract, on a surface as rough as a real one."""

import geopandas as gpd
import numpy as np
import pytest
import rasterio.features
import shapely
from exactextract import exact_extract
from exactextract.raster import NumPyRasterSource
from rasterio.crs import CRS
from scipy.ndimage import gaussian_filter

from workbench.rasters import Grid, new_raster
from workbench.reed import cell_statistics, density_cells, map_extent, object_height

CRS_ = CRS.from_epsg(25833)
LEVEL = 517.93


@pytest.fixture(scope="module")
def dsm():
    rng = np.random.default_rng(11)
    grid = Grid(CRS_, 316000.07, 5303000.02, 0.136, 420, 360)
    rough = gaussian_filter(rng.normal(size=grid.shape), 3) * 6
    heights = LEVEL + 2.0 * (np.arange(360)[:, None] / 360) + rough
    heights[gaussian_filter(rng.normal(size=grid.shape), 2) > 0.25] = np.nan
    return new_raster(heights.astype(np.float32), grid, name="dsm", units="m", vertical_datum="DHHN2016")


@pytest.fixture(scope="module")
def lake():
    return gpd.GeoDataFrame(
        geometry=[
            shapely.Point(316030, 5302975).buffer(24).union(shapely.box(316000, 5302980, 316050, 5303000))
        ],
        crs=CRS_,
    )


def zonal(raster, cells, statistics):
    """exactextract on an array: from a DataArray it is a thousand times slower."""
    grid = Grid.of(raster)
    source = NumPyRasterSource(
        raster.values.astype(float), *grid.bounds, nodata=np.nan, srs_wkt=grid.crs.to_wkt()
    )
    return exact_extract(source, cells, statistics, output="pandas")


def polygons(mask, grid):
    """What rasterio makes of a mask, dissolved by shapely."""
    shapes = rasterio.features.shapes(mask.astype(np.int16), mask=mask, transform=grid.transform)
    return shapely.union_all([shapely.geometry.shape(shape) for shape, _ in shapes])


def test_extent_equals_the_raster_calculator_and_polygonise(dsm, lake):
    found = map_extent(object_height(dsm, LEVEL), lake, min_area=0, min_hole=0, sliver_width=0)
    heights, grid = dsm.values.astype(float), Grid.of(dsm)
    reed = (heights > LEVEL + 0.5) & (heights < LEVEL + 6.0)
    expected = polygons(reed, grid).intersection(lake.geometry.iloc[0])
    assert found.reed.area == pytest.approx(expected.area, rel=1e-9)
    assert found.reed.symmetric_difference(expected).area < 1e-6
    unknown = polygons(np.isnan(heights), grid).intersection(lake.geometry.iloc[0])
    assert found.unknown.symmetric_difference(unknown).area < 1e-6
    assert found.reed.intersection(found.unknown).area < 1e-6


def test_burning_the_extent_gives_back_the_cells(dsm):
    found = map_extent(object_height(dsm, LEVEL), min_area=0, min_hole=0)
    grid = Grid.of(dsm)
    burnt = rasterio.features.rasterize([found.reed], out_shape=grid.shape, transform=grid.transform)
    assert np.array_equal(burnt == 1, (dsm.values > LEVEL + 0.5) & (dsm.values < LEVEL + 6.0))


def test_patches_are_dropped_and_gaps_closed_as_gdal_sieve_would_see_them(dsm):
    """Every patch that is left is large enough, every gap with heights too; nothing else changed."""
    ohm = object_height(dsm, LEVEL)
    raw = map_extent(ohm, min_area=0, min_hole=0)
    clean = map_extent(ohm, min_area=1.0, min_hole=1.0)
    assert shapely.area(shapely.get_parts(clean.reed)).min() >= 1.0 - 1e-6
    for patch in shapely.get_parts(clean.reed):
        for ring in patch.interiors:
            hole = shapely.Polygon(ring)
            assert hole.area >= 1.0 - 1e-6 or hole.intersects(raw.unknown)
    changed = shapely.get_parts(raw.reed.symmetric_difference(clean.reed))
    assert len(changed) > 5
    assert shapely.area(changed).max() < 1.0


@pytest.mark.parametrize("size", [1.0, 0.5])
def test_classes_equal_those_of_exactextract(dsm, size):
    ohm = object_height(dsm, LEVEL)
    mapped = map_extent(ohm)
    cells = density_cells(ohm, mapped.frame, cell_size=size)
    exact = zonal(ohm, cells, ["mean", "variance", "count"])
    part = exact["count"].to_numpy() * 0.136**2 / size**2
    assert cells.known.to_numpy() == pytest.approx(part, abs=1e-6)
    known = cells.known.to_numpy() > 1e-6
    assert cells.mean_m.to_numpy()[known] == pytest.approx(exact["mean"].to_numpy()[known], abs=1e-6)
    assert cells.variance_m2.to_numpy()[known] == pytest.approx(exact["variance"].to_numpy()[known], abs=1e-6)
    sparse = (exact["variance"] > 0.1) & (exact["mean"] < 2.5)
    expected = np.where(part < 0.5 - 1e-9, "unknown", np.where(sparse, "sparse", "dense"))
    assert np.array_equal(cells.density.to_numpy(), expected)
    # Reed in a cell: exactextract's coverage of the same pixels.
    grid = Grid.of(ohm)
    burnt = rasterio.features.rasterize([mapped.reed], out_shape=grid.shape, transform=grid.transform)
    reed = new_raster(burnt.astype(np.float32), grid, name="reed", units="1")
    covered = zonal(reed, cells, ["sum"])["sum"].to_numpy() * 0.136**2
    assert cells.reed_m2.to_numpy() == pytest.approx(covered, abs=1e-5)


def test_heights_with_a_large_offset_lose_nothing(dsm):
    """Statistics of the surface itself, half a kilometre above the sea, are those of heights above water."""
    low = cell_statistics(object_height(dsm, LEVEL))
    high = cell_statistics(dsm)
    some = low.known > 0.2
    assert high.variance[some] == pytest.approx(low.variance[some], abs=1e-4)
    assert high.mean[some] - LEVEL == pytest.approx(low.mean[some], abs=1e-4)
