import cv2
import numpy as np
import pytest
from rasterio.crs import CRS

from workbench.errors import SurfaceError
from workbench.rasters import Grid, new_raster
from workbench.surface import bilateral

MILLIMETRE = 1e-3


def exact(z, size, sigma_range, sigma_space=None):
    """The definition, summed window cell by window cell in float64."""
    reach, sigma_space = size // 2, sigma_space or size / 6
    space = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_space) ** 2)
    z = z.astype(float)
    padded = np.pad(z, reach, constant_values=np.nan)
    total, weights = np.zeros_like(z), np.zeros_like(z)
    for i in range(size):
        for j in range(size):
            difference = padded[i : i + z.shape[0], j : j + z.shape[1]] - z
            weight = space[i] * space[j] * np.exp(-0.5 * (difference / sigma_range) ** 2)
            total += np.nan_to_num(weight * difference)
            weights += np.nan_to_num(weight)
    return z + np.divide(total, weights, out=np.full_like(z, np.nan), where=weights > 0)


def landscape(relief, shape=(90, 110), seed=1):
    """Hills, trees, noise, a cliff, spikes up and down, holes and single missing cells."""
    random = np.random.default_rng(seed)
    hills = cv2.GaussianBlur(random.normal(size=shape), (0, 0), 15)
    trees = np.abs(cv2.GaussianBlur(random.normal(size=shape), (0, 0), 3)) * 80
    z = 430 + hills / np.ptp(hills) * relief + trees + random.normal(size=shape) * 0.3
    z[50:70, 40:80] += 25
    z[20, 20] += 80
    z[75, 10] -= 60
    z[10:25, 60:90] = np.nan
    z[random.random(shape) < 0.02] = np.nan
    return z.astype(np.float32)


@pytest.mark.parametrize("size", [1, 5, 49, 101])
@pytest.mark.parametrize("relief", [5, 150])
@pytest.mark.parametrize("sigma_range", [1.5, 10.0])
def test_within_a_millimetre_of_the_definition(size, relief, sigma_range):
    z = landscape(relief)
    filtered = bilateral(z, size, sigma_range)
    assert np.array_equal(np.isnan(filtered), np.isnan(z))
    assert np.nanmax(np.abs(filtered - exact(z, size, sigma_range))) < MILLIMETRE


def test_own_sigma_in_space():
    z = landscape(20)
    assert np.nanmax(np.abs(bilateral(z, 21, 5.0, 8.0) - exact(z, 21, 5.0, 8.0))) < MILLIMETRE


def test_missing_cells_do_not_spread_and_a_plane_stays_constant():
    z = np.full((60, 60), 7.25, np.float32)
    z[30, 30] = np.nan
    filtered = bilateral(z, 49, 10)
    assert np.isnan(filtered).sum() == 1
    assert np.nanmax(np.abs(filtered - 7.25)) < 1e-5
    assert np.isnan(bilateral(np.full((5, 5), np.nan), 3, 1)).all()


@pytest.mark.parametrize("size", [9, 101])
def test_tiles_leave_no_seams_and_a_raster_keeps_its_attributes(size):
    z = landscape(60, (250, 260))
    grid = Grid(CRS.from_epsg(32633), 0.0, 250.0, 1.0, 260, 250)
    surface = new_raster(z, grid, name="ndsm", units="m", vertical_datum="test")
    whole = bilateral(surface, size, 10)
    tiled = bilateral(surface, size, 10, tile_size=101)
    assert tiled.attrs == surface.attrs and whole.attrs == surface.attrs
    assert whole.rio.crs == surface.rio.crs
    assert float(np.abs(whole - tiled).max()) < MILLIMETRE


@pytest.mark.parametrize(("size", "sigma"), [(4, 1.0), (0, 1.0), (5, 0.0), (5, float("nan"))])
def test_impossible_settings_are_refused(size, sigma):
    with pytest.raises(SurfaceError):
        bilateral(np.zeros((5, 5)), size, sigma)


def test_infinite_heights_are_refused():
    with pytest.raises(SurfaceError, match="finite"):
        bilateral(np.full((5, 5), np.inf), 5, 1.0)
