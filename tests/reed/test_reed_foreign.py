"""A surface from anywhere: one GeoTIFF, one polygon file, a number, and functions."""

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from rasterio.transform import from_origin

from workbench.errors import RasterError, ReedError
from workbench.params import Parameters, ReedParameters
from workbench.rasters import read_raster, write_raster
from workbench.reed import (
    ReedModel,
    density_cells,
    doubts,
    extent,
    load_model,
    map_extent,
    measure_reed,
    object_height,
    open_water,
    reed_files,
    reed_site,
)
from workbench.site import load_site, new_site
from workbench.vectors import read_vector

WEST, NORTH, LEVEL = 4_400_000.0, 2_800_000.0, 395.3


@pytest.fixture
def files(tmp_path):
    """As another program writes them: float64, nodata -9999, another CRS."""
    y, x = (np.mgrid[0:240, 0:400] + 0.5) * 0.25
    reed = (y > 18) & (y < 34 + np.sin(x / 5))
    heights = np.where(reed, LEVEL + 2.8 - 0.02 * y, LEVEL + 0.02 * np.sin(x))
    heights[100:110, 200:212] = -9999
    dsm = tmp_path / "lidar.tif"
    with rasterio.open(
        dsm,
        "w",
        driver="GTiff",
        width=400,
        height=240,
        count=1,
        dtype="float64",
        crs="EPSG:3035",
        transform=from_origin(WEST, NORTH, 0.25, 0.25),
        nodata=-9999,
    ) as file:
        file.write(heights, 1)
    lake = gpd.GeoDataFrame(
        {"name": ["lake"]}, geometry=[shapely.box(WEST - 50, NORTH - 300, WEST + 300, NORTH - 20)], crs=3035
    )
    shore = tmp_path / "lake.geojson"
    lake.segmentize(2.0).to_crs(4326).to_file(shore, driver="GeoJSON")
    return dsm, shore


def test_everything_is_measured_from_two_files_and_a_number(files):
    dsm, lake = read_raster(files[0], vertical_datum="EVRF2007"), read_vector(files[1])
    metrics = measure_reed(dsm, LEVEL, lake)
    totals = metrics.totals()
    # 100 m of belt, 14 m from the shore at 20 m to the front at 34 m on average, less 7.5 m2 unknown.
    front = 34 + np.sin(np.linspace(0.125, 99.875, 400) / 5)
    assert totals["extent_m2"] == pytest.approx(100 * (front.mean() - 20) - 7.5, rel=5e-3)
    assert totals["unknown_m2"] == pytest.approx(10 * 12 / 16)
    assert totals["sections"] == 10
    assert totals["healthy"] == 10
    assert totals["holes"] == 0
    assert metrics.ohm.attrs["vertical_datum"] == "EVRF2007"


def test_the_four_functions_alone_agree_with_the_whole(files):
    dsm, lake = read_raster(files[0]), read_vector(files[1])
    reed = extent(dsm, LEVEL, 0.5, 6.0, lake)
    ohm = object_height(dsm, LEVEL)
    assert reed.geometry[0].equals(map_extent(ohm, lake).frame.geometry[0])
    cells = density_cells(ohm, reed)
    metrics = measure_reed(dsm, LEVEL, lake)
    assert cells.reed_m2.sum() == pytest.approx(metrics.cells.reed_m2.sum())
    assert cells.density.to_list() == metrics.cells.density.to_list()


def test_shoreline_problems_of_files_are_said(files, tmp_path):
    dsm = read_raster(files[0])
    line = read_vector(files[1])
    line["geometry"] = line.boundary
    with pytest.raises(ReedError, match="give the polygon of the lake side"):
        ReedModel(dsm, LEVEL, line).measure()
    away = read_vector(files[1]).to_crs(3035)
    away["geometry"] = away.translate(5000)
    with pytest.raises(ReedError, match="does not touch"):
        ReedModel(dsm, LEVEL, away).measure()


def test_the_stage_demands_a_datum(files, tmp_path):
    """Functions compare with the level that the caller states; a site's files must say what heights mean."""
    photos = tmp_path / "photos"
    photos.mkdir()
    from PIL import Image

    Image.new("RGB", (64, 48)).save(photos / "a.jpg")
    new_site(
        "other",
        photos=photos,
        root=tmp_path,
        crs="EPSG:3035",
        vertical_datum="EVRF2007",
        water_level=LEVEL,
        shoreline=files[1],
    )
    site = load_site("other", tmp_path)
    surface = site.products / "surface"
    surface.mkdir(parents=True)
    (surface / "dsm.tif").write_bytes(files[0].read_bytes())
    with pytest.raises(RasterError, match="vertical datum"):
        load_model(site)
    write_raster(read_raster(files[0], vertical_datum="EVRF2007").astype("float32"), surface / "dsm.tif")
    found = reed_site(site, Parameters())
    assert found["healthy"] == 10
    layers = gpd.list_layers(site.products / "reed" / "reed.gpkg").name.to_list()
    assert {"extent", "front", "sections", "density_cells", "unknown"} <= set(layers)


def altered(path, tmp_path, heights, **profile):
    """A copy of a raster with other heights or another description."""
    other = tmp_path / "altered.tif"
    with rasterio.open(path) as file:
        described = file.profile | profile
        values = heights(file.read(1))
    with rasterio.open(other, "w", **described) as file:
        file.write(values.astype(described["dtype"]), 1)
    return other


def test_files_go_in_and_files_come_out(files, tmp_path):
    found = reed_files(
        files[0], tmp_path / "out", water_level=LEVEL, vertical_datum="EVRF2007", shoreline=files[1]
    )
    assert found["healthy"] == 10
    assert found["warnings"] == []
    assert found["water_m"] == pytest.approx(0, abs=0.02)
    layers = gpd.list_layers(tmp_path / "out" / "reed" / "reed.gpkg").name.to_list()
    assert {"extent", "front", "sections", "density_cells", "unknown"} <= set(layers)
    with pytest.raises(ReedError, match="vertical-datum"):
        reed_files(files[0], tmp_path / "out", water_level=LEVEL, shoreline=files[1])
    with pytest.raises(ReedError, match="water level is open"):
        reed_files(files[0], tmp_path / "out", vertical_datum="EVRF2007")


@pytest.mark.parametrize("filler", [-9999, 0, -32767, 99999])
def test_a_filler_that_no_one_declared_is_refused(files, tmp_path, filler):
    silent = altered(files[0], tmp_path, lambda h: np.where(h == -9999, filler, h), nodata=None)
    with pytest.raises(ReedError, match=f"exactly {filler}.*a_nodata {filler}"):
        measure_reed(read_raster(silent), LEVEL, read_vector(files[1]))


def test_whole_numbers_keep_their_gaps(files, tmp_path):
    whole = altered(files[0], tmp_path, np.round, dtype="int16")
    metrics = measure_reed(read_raster(whole), LEVEL, read_vector(files[1]))
    assert metrics.totals()["unknown_m2"] == pytest.approx(10 * 12 / 16)


def test_feet_and_degrees_are_refused(files, tmp_path):
    degrees = altered(
        files[0], tmp_path, lambda h: h, crs="EPSG:4326", transform=from_origin(12.4, 47.9, 3e-6, 3e-6)
    )
    with pytest.raises(ReedError, match=r"in degrees.*EPSG:32633"):
        measure_reed(read_raster(degrees), LEVEL)
    with pytest.raises(ReedError, match="US survey foot"):
        measure_reed(read_raster(altered(files[0], tmp_path, lambda h: h, crs="EPSG:2225")), LEVEL)
    with pytest.raises(ReedError, match="heights of the surface are in 'ft'"):
        extent(read_raster(files[0]).assign_attrs(units="ft"), LEVEL)


def test_what_does_not_fit_is_doubted(files):
    dsm, lake = read_raster(files[0]), read_vector(files[1])
    options = ReedParameters()
    assert doubts(measure_reed(dsm, LEVEL, lake), options) == []
    low = measure_reed(dsm, LEVEL - 0.4, lake)
    assert open_water(low) == pytest.approx(0.4, abs=0.02)
    assert "0.40 m above the stated level" in doubts(low, options)[0]
    ellipsoid = doubts(measure_reed(dsm + 47.2, LEVEL, lake), options)
    assert "No reed" in ellipsoid[0] and "47.2 m in the middle" in ellipsoid[0]
    assert "Nearly all" in doubts(measure_reed(dsm + 1.5, LEVEL, lake), options)[0]
    # The land is a meadow a metre and a half above the lake.
    y = dsm.y.values[:, None]
    meadow = dsm.where((y < NORTH - 20) & (y < NORTH), LEVEL + 1.5)
    land = gpd.GeoDataFrame(geometry=[shapely.box(WEST - 50, NORTH - 20, WEST + 300, NORTH + 50)], crs=3035)
    assert "polygon of the land" in doubts(measure_reed(meadow, LEVEL, land), options)[0]
