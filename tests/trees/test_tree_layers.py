"""Layers of an orthophoto on the grid of a surface: read by tiles, the same as read as a whole."""

import numpy as np
import pytest
from rasterio.crs import CRS

from workbench.rasters import Grid, match_grid, new_raster, read_raster, write_raster
from workbench.trees import layers

UTM = CRS.from_epsg(32633)
FINE = Grid(UTM, 500000.0, 5600060.0, 0.05, 1200, 1000)
COARSE = Grid(UTM, 499998.0, 5600062.0, 0.2, 330, 280)


@pytest.fixture
def ortho(tmp_path):
    bands = np.random.default_rng(1).integers(1, 255, (3, *FINE.shape)).astype(np.uint8)
    bands[:, :200, :300] = 0
    raster = new_raster(bands, FINE, name="ortho", units="1", nodata=0)
    write_raster(raster, tmp_path / "ortho.tif")
    return tmp_path / "ortho.tif"


def test_brightness_is_the_mean_of_pixels_and_bands(ortho, monkeypatch):
    monkeypatch.setattr(layers, "_TILE", 100)
    found = layers.read_brightness(ortho, COARSE)
    pixels = read_raster(ortho).values[:, 400:404, 800:804].mean()
    row, column = 10 + 400 // 4, 10 + 800 // 4
    assert found.values[row, column] == pytest.approx(pixels, abs=1e-3)
    assert np.isnan(found.values[:10]).all() and np.isnan(found.values[15, 15])
    assert np.isfinite(found.values[70:250, 20:300]).all()


def test_tiles_do_not_matter(ortho, monkeypatch):
    # At the very border of what is known rounding decides whether a cell touches a pixel.
    inside = slice(65, 255), slice(12, 308)
    whole = layers.read_brightness(ortho, COARSE).values[inside]
    monkeypatch.setattr(layers, "_TILE", 64)
    np.testing.assert_allclose(layers.read_brightness(ortho, COARSE).values[inside], whole, atol=1e-4)


def test_another_crs_is_reprojected(ortho, tmp_path):
    turned = match_grid(
        read_raster(ortho).isel(band=0, drop=True),
        Grid(CRS.from_epsg(25833), *(COARSE.west, COARSE.north, 0.1, 600, 560)),
        resampling="nearest",
    )
    write_raster(turned, tmp_path / "other.tif")
    found = layers.read_brightness(tmp_path / "other.tif", COARSE)
    assert found.shape == COARSE.shape and np.isfinite(found.values).mean() > 0.6
