"""Reading photographs: what is decoded is what was written, in the frame of the sensor."""

import cv2
import numpy as np
import piexif
import pytest
import rasterio
from PIL import Image
from rasterio.enums import ColorInterp

from workbench.errors import SiteError
from workbench.photographs import count_bands, photograph_size, read_photograph, require_complete

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def gradient(rows=60, columns=90):
    row, column = np.mgrid[:rows, :columns]
    return np.stack([column * 2, row * 3, 255 - column], axis=-1).astype(np.uint8)


def write_tiff(path, values, **options):
    bands, rows, columns = values.shape
    profile = {"driver": "GTiff", "width": columns, "height": rows, "count": bands, "dtype": values.dtype}
    with rasterio.open(path, "w", **(profile | options)) as target:
        target.write(values)
    return path


def test_jpeg_comes_as_red_green_blue(tmp_path):
    path = tmp_path / "a.jpg"
    Image.fromarray(gradient()).save(path, quality=98, subsampling=0)
    image = read_photograph(path)
    assert image.shape == (60, 90, 3) and image.dtype == np.uint8
    assert np.abs(image.astype(int) - gradient()).max() <= 4
    assert photograph_size(path) == (90, 60) and count_bands(path) == 3


def test_orientation_tag_is_ignored(tmp_path):
    path = tmp_path / "a.jpg"
    exif = piexif.dump({"0th": {piexif.ImageIFD.Orientation: 6}})
    Image.fromarray(gradient()).save(path, quality=98, subsampling=0, exif=exif)
    assert read_photograph(path).shape == (60, 90, 3)
    assert photograph_size(path) == (90, 60)


def test_grey_jpeg_has_one_band(tmp_path):
    path = tmp_path / "a.jpg"
    Image.fromarray(gradient()[..., 0]).save(path)
    assert read_photograph(path).shape == (60, 90, 1)


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("bands", [1, 3, 4, 6])
def test_tiff_keeps_type_and_bands(tmp_path, dtype, bands):
    values = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (bands, 40, 50)).astype(dtype)
    path = write_tiff(tmp_path / "a.tif", values)
    assert np.array_equal(read_photograph(path), np.moveaxis(values, 0, -1))
    assert photograph_size(path) == (50, 40) and count_bands(path) == bands


def test_transparency_is_dropped_and_near_infrared_is_kept(tmp_path):
    values = np.random.default_rng(1).integers(0, 255, (4, 40, 50)).astype(np.uint8)
    path = write_tiff(tmp_path / "nir.tif", values, photometric="RGB", alpha="yes")
    with rasterio.open(path) as source:
        assert source.colorinterp[3] == ColorInterp.alpha  # As some programs label near infrared.
    assert count_bands(path) == 4 and read_photograph(path).shape == (40, 50, 4)
    values[3] = 255
    values[3, :10] = 0
    path = write_tiff(tmp_path / "alpha.tif", values, photometric="RGB", alpha="yes")
    assert count_bands(path) == 3 and read_photograph(path).shape == (40, 50, 3)


@pytest.mark.parametrize("downscale", [2, 3, 7])
def test_downscale_is_the_mean_of_whole_blocks(tmp_path, downscale):
    values = np.random.default_rng(2).integers(0, 65535, (3, 50, 71)).astype(np.uint16)
    path = write_tiff(tmp_path / "a.tif", values)
    rows, columns = 50 // downscale, 71 // downscale
    blocks = np.moveaxis(values, 0, -1)[: rows * downscale, : columns * downscale]
    mean = blocks.reshape(rows, downscale, columns, downscale, 3).mean(axis=(1, 3))
    small = read_photograph(path, downscale)
    assert small.shape == (rows, columns, 3)
    assert np.abs(small - mean).max() <= 0.51  # Rounding to whole grey values.


@pytest.mark.parametrize("downscale", [0, -1, 61])
def test_impossible_downscale(tmp_path, downscale):
    path = tmp_path / "a.jpg"
    Image.fromarray(gradient()).save(path)
    with pytest.raises(SiteError, match="cannot be reduced"):
        read_photograph(path, downscale)


def test_missing_and_unreadable_files_are_named(tmp_path):
    (tmp_path / "letter.jpg").write_text("Dear Sir or Madam")
    for function in (read_photograph, photograph_size):
        with pytest.raises(SiteError, match=r"none\.jpg"):
            function(tmp_path / "none.jpg")
        with pytest.raises(SiteError, match=r"letter\.jpg: not a readable image"):
            function(tmp_path / "letter.jpg")


def test_floating_point_pixels_are_refused(tmp_path):
    path = write_tiff(tmp_path / "a.tif", np.zeros((3, 20, 20), np.float32))
    with pytest.raises(SiteError, match="8 or 16 bit"):
        read_photograph(path)


@pytest.mark.parametrize("share", [0.3, 0.7, 0.97])
def test_truncated_jpeg_is_noticed(tmp_path, share):
    path = tmp_path / "a.jpg"
    noise = np.random.default_rng(3).integers(0, 255, (200, 300, 3), dtype=np.uint8)
    assert cv2.imwrite(str(path), noise)
    require_complete(path)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    with pytest.raises(SiteError, match=r"a\.jpg: truncated or damaged"):
        require_complete(path)
