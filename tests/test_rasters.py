"""Grids, tiles and files of rasters."""

import dask
import numpy as np
import pytest
import rasterio
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.crs import CRS
from rio_cogeo import cog_validate
from scipy import ndimage

from workbench.errors import RasterError
from workbench.rasters import (
    Grid,
    RasterWriter,
    map_tiles,
    match_grid,
    new_raster,
    read_overview,
    read_raster,
    require_heights,
    require_same_grid,
    tiles,
    write_raster,
)

UTM = CRS.from_epsg(32633)
DATUM = "DHHN2016 heights"


def grid(height=120, width=150, resolution=0.5):
    return Grid(UTM, 309_000.0, 5_305_000.0, resolution, width, height)


def heights(g=None, seed=1):
    g = g or grid()
    values = np.random.default_rng(seed).normal(500, 10, g.shape).astype(np.float32)
    values[3:6, 4:9] = np.nan
    return new_raster(values, g, name="dsm", units="m", vertical_datum=DATUM)


# ---------------------------------------------------------------------------- grids


def test_grid_of_bounds_is_snapped_and_covers_them():
    g = Grid.from_bounds("EPSG:32633", (10.2, 20.7, 14.9, 23.1), 0.5)
    assert (g.west, g.north, g.width, g.height) == (10.0, 23.5, 10, 6)
    assert g.bounds == (10.0, 20.5, 15.0, 23.5)
    assert (g.x[0], g.y[0]) == (10.25, 23.25)
    assert Grid.of(new_raster(np.zeros(g.shape), g, name="a", units="1")) == g


def test_window_of_a_grid():
    part = grid().window(slice(10, 30), slice(4, 9))
    assert part.shape == (20, 5)
    assert (part.x[0], part.y[0]) == (grid().x[4], grid().y[10])


@pytest.mark.parametrize(
    ("bounds", "resolution"),
    [((1, 1, 1, 2), 1), ((2, 1, 1, 2), 1), ((0, 0, np.nan, 1), 1), ((0, 0, 1, 1), 0)],
)
def test_impossible_grids(bounds, resolution):
    with pytest.raises(RasterError, match="hold no raster"):
        Grid.from_bounds("EPSG:32633", bounds, resolution)


def test_raster_without_crs_or_with_oblong_cells_is_refused():
    bare = xr.DataArray(
        np.zeros((3, 4)), dims=("y", "x"), coords={"y": [3, 2, 1], "x": [1, 2, 3, 4]}, name="bare"
    )
    with pytest.raises(RasterError, match="bare has no CRS"):
        Grid.of(bare)
    with pytest.raises(RasterError, match="square, north-up"):
        Grid.of(bare.assign_coords(x=[2, 4, 6, 8]).rio.write_crs(32633))
    with pytest.raises(RasterError, match="square, north-up"):
        Grid.of(bare.assign_coords(y=[1, 2, 3]).rio.write_crs(32633))


# ---------------------------------------------------------------------------- tiles


@given(
    height=st.integers(1, 70), width=st.integers(1, 70), size=st.integers(1, 40), margin=st.integers(0, 12)
)
@settings(max_examples=60, deadline=None)
def test_tiles_cover_each_cell_once_and_see_their_margin(height, width, size, margin):
    if size < margin:
        with pytest.raises(RasterError, match="margin"):
            list(tiles((height, width), size=size, margin=margin))
        return
    seen = np.zeros((height, width), int)
    for tile in tiles((height, width), size=size, margin=margin):
        seen[tile.core] += 1
        for core, padded, end in zip(tile.core, tile.padded, (height, width), strict=True):
            assert padded.start == max(core.start - margin, 0) and padded.stop == min(core.stop + margin, end)
        whole = np.arange(height * width).reshape(height, width)
        assert np.array_equal(whole[tile.padded][tile.inner], whole[tile.core])
    assert (seen == 1).all()


def largest(values):
    """Largest value within three cells, missing cells apart."""
    return ndimage.maximum_filter(np.nan_to_num(values, nan=-1e9), size=7, mode="nearest")


@pytest.mark.parametrize("tile_size", [7, 16, 33, 64, 500])
@pytest.mark.parametrize("scheduler", ["threads", "synchronous"])
def test_result_is_independent_of_tiles_and_threads(tile_size, scheduler):
    raster = heights()
    expected = largest(raster.values)
    with dask.config.set(scheduler=scheduler):
        result = map_tiles(largest, raster, margin=3, tile_size=tile_size)
    assert np.array_equal(result.values, expected)
    assert result.rio.crs == UTM and result.attrs["vertical_datum"] == DATUM


def test_too_small_a_margin_is_visible():
    raster = heights()
    wrong = map_tiles(largest, raster, margin=0, tile_size=16)
    assert not np.array_equal(wrong.values, largest(raster.values))


def test_several_rasters_in_and_out():
    a, b = heights(seed=1), heights(seed=2)
    total, both = map_tiles(
        lambda x, y: (x + y, np.stack([x, y])),
        a,
        b,
        margin=0,
        tile_size=50,
        attributes=[{"units": "m", "long_name": "sum"}, {"units": "m"}],
    )
    assert np.array_equal(total.values, a.values + b.values, equal_nan=True)
    assert both.shape == (2, 120, 150) and both.dims == ("band", "y", "x")
    assert total.attrs["long_name"] == "sum"


def test_rasters_on_different_grids_are_refused():
    a = heights()
    shifted = Grid(UTM, grid().west + 0.25, grid().north, 0.5, 150, 120)
    with pytest.raises(RasterError, match="different grids"):
        map_tiles(np.add, a, heights(shifted), margin=0)
    other = Grid(CRS.from_epsg(32632), grid().west, grid().north, 0.5, 150, 120)
    with pytest.raises(RasterError, match="reproject"):
        require_same_grid(a, heights(other))


# ---------------------------------------------------------------------------- files


def test_written_is_read(tmp_path):
    path = write_raster(heights(), tmp_path / "deep" / "dsm.tif")
    back = read_raster(path)
    assert np.array_equal(back.values, heights().values, equal_nan=True)
    assert Grid.of(back) == grid()
    assert (back.attrs["units"], back.attrs["vertical_datum"]) == ("m", DATUM)
    assert require_heights(back) == DATUM
    assert list(tmp_path.rglob("*")) == [tmp_path / "deep", path]  # Nothing temporary is left.


def test_file_is_cloud_optimised_with_overviews(tmp_path):
    path = write_raster(heights(grid(1300, 1400)), tmp_path / "dsm.tif")
    valid, errors, warnings = cog_validate(path, strict=True)
    assert valid, (errors, warnings)
    with rasterio.open(path) as source:
        assert source.overviews(1) and source.nodata is not None and source.units == ("m",)


def test_same_raster_same_bytes(tmp_path):
    first = write_raster(heights(), tmp_path / "a" / "dsm.tif").read_bytes()
    assert first == write_raster(heights(), tmp_path / "b" / "dsm.tif").read_bytes()
    assert first != write_raster(heights(seed=2), tmp_path / "c" / "dsm.tif").read_bytes()


def test_windows_give_the_same_bytes_as_the_whole(tmp_path):
    raster = heights(grid(700, 900))
    whole = write_raster(raster, tmp_path / "a" / "dsm.tif").read_bytes()
    with RasterWriter(
        tmp_path / "b" / "dsm.tif", grid(700, 900), dtype="float32", attributes=raster.attrs
    ) as writer:
        for tile in grid(700, 900).tiles(512):
            writer.write(raster.values[tile.core], tile.core)
    assert whole == (tmp_path / "b" / "dsm.tif").read_bytes()


def test_integers_keep_type_nodata_and_band_names(tmp_path):
    values = np.random.default_rng(1).integers(0, 255, (3, 120, 150)).astype(np.uint8)
    raster = new_raster(
        values, grid(), name="ortho", units="1", nodata=0, band_names=["red", "green", "blue"]
    )
    back = read_raster(write_raster(raster, tmp_path / "ortho.tif"))
    assert back.dtype == np.uint8 and back.rio.nodata == 0 and np.array_equal(back.values, values)
    with rasterio.open(tmp_path / "ortho.tif") as source:
        assert source.descriptions == ("red", "green", "blue")


def test_interrupted_writing_leaves_the_old_file(tmp_path):
    path = write_raster(heights(), tmp_path / "dsm.tif")
    before = path.read_bytes()
    with pytest.raises(KeyboardInterrupt), RasterWriter(path, grid(), dtype="float32"):
        raise KeyboardInterrupt
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RasterError, match=r"cannot be written.*another root"):
        write_raster(heights(), tmp_path / "file" / "dsm.tif")


def test_unreadable_files(tmp_path):
    with pytest.raises(RasterError, match="no such raster"):
        read_raster(tmp_path / "none.tif")
    (tmp_path / "text.tif").write_text("no raster")
    with pytest.raises(RasterError, match=r"text\.tif: not a readable raster"):
        read_raster(tmp_path / "text.tif")


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_file_without_crs_is_refused(tmp_path):
    with rasterio.open(
        tmp_path / "a.tif", "w", driver="GTiff", width=4, height=3, count=1, dtype="float32"
    ) as target:
        target.write(np.zeros((1, 3, 4), np.float32))
    with pytest.raises(RasterError, match="no CRS"):
        read_raster(tmp_path / "a.tif")


def test_vertical_datum_is_stated_and_never_changed(tmp_path):
    plain = new_raster(np.zeros((120, 150), np.float32), grid(), name="dtm", units="m")
    path = write_raster(plain, tmp_path / "dtm.tif")
    with pytest.raises(RasterError, match="states no vertical datum"):
        require_heights(read_raster(path))
    assert require_heights(read_raster(path, vertical_datum="EVRF2019")) == "EVRF2019"
    path = write_raster(heights(), tmp_path / "dsm.tif")
    with pytest.raises(RasterError, match=DATUM):
        read_raster(path, vertical_datum="EVRF2019")


def test_chunks_are_lazy_and_equal(tmp_path):
    path = write_raster(heights(), tmp_path / "dsm.tif")
    lazy = read_raster(path, chunks=64)
    assert lazy.chunks is not None
    assert np.array_equal(lazy.values, read_raster(path).values, equal_nan=True)


def test_overview_is_small_and_keeps_the_extent(tmp_path):
    path = write_raster(heights(grid(900, 1200)), tmp_path / "dsm.tif")
    small = read_overview(path, longest=300)
    assert max(small.shape) == 300
    assert small.rio.bounds() == pytest.approx(grid(900, 1200).bounds)


@pytest.mark.parametrize("resolution", [0.5, 0.25, 0.3])
def test_match_grid_puts_cells_where_they_belong(resolution):
    # A plane z = x + 2 y resampled to a shifted grid still is that plane.
    g = grid(200, 200)
    plane = (g.x[None, :] - g.west) + 2 * (g.y[:, None] - g.north)
    raster = new_raster(plane, g, name="plane", units="m", vertical_datum=DATUM)
    target = Grid(UTM, g.west + 10.1, g.north - 10.3, resolution, 60, 50)
    result = match_grid(raster, target)
    expected = (target.x[None, :] - g.west) + 2 * (target.y[:, None] - g.north)
    assert np.abs(result.values - expected).max() < 1e-6
    require_same_grid(result, new_raster(expected, target, name="expected", units="m"))
    assert result.attrs["vertical_datum"] == DATUM


def test_values_that_do_not_fit_the_grid():
    with pytest.raises(RasterError, match="do not fit"):
        new_raster(np.zeros((3, 3)), grid(), name="a", units="m")
