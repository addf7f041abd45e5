"""Photographs as arrays, in the geometry of the sensor."""

from __future__ import annotations

import warnings
from pathlib import Path

import cv2
import numpy as np
import rasterio
from PIL import Image, UnidentifiedImageError

from workbench.errors import SiteError

# Aerial frames exceed the decompression guard of Pillow, which only reads headers here.
Image.MAX_IMAGE_PIXELS = None
# Photographs have no place on the ground yet; GDAL would say so at each one.
warnings.filterwarnings("ignore", category=rasterio.errors.NotGeoreferencedWarning)
_JPEG = frozenset({".jpg", ".jpeg"})


def photograph_size(path: Path | str) -> tuple[int, int]:
    """Columns and rows of a photograph, from its header.

    Raises
    ------
    SiteError
        If the file is missing or no image.
    """
    try:
        with Image.open(path) as image:
            return image.size
    except FileNotFoundError as error:
        raise SiteError(f"{path}: no such photograph. Restore it or take it off the site's list.") from error
    except (UnidentifiedImageError, OSError):
        pass  # TIFF with four or more bands of 16 bit: Pillow does not know it, GDAL does.
    try:
        with rasterio.open(path) as source:
            return source.width, source.height
    except rasterio.errors.RasterioError as error:
        raise SiteError(f"{path}: not a readable image ({error}).") from error


def is_8_bit(path: Path | str) -> bool:
    """Whether the samples of a TIFF have 8 bits.

    Raises
    ------
    SiteError
        If it cannot be read.
    """
    try:
        with rasterio.open(path) as source:
            return source.dtypes[0] == "uint8"
    except rasterio.errors.RasterioError as error:
        raise SiteError(f"{path}: not a readable image ({error}).") from error


def read_photograph(path: Path | str, downscale: int = 1) -> np.ndarray:
    """Decode a photograph.

    The EXIF orientation is deliberately ignored: cameras are calibrated in the frame of the sensor.

    Parameters
    ----------
    path
        JPEG or TIFF, 8 or 16 bit, any number of bands.
    downscale
        Whole factor to reduce by; each pixel is the mean of ``downscale`` x ``downscale`` ones, and
        a remainder at the right and lower edge is cut off.

    Returns
    -------
    ndarray (rows, columns, bands) uint8 or uint16
        Bands in the order red, green, blue (, near infrared ...).

    Raises
    ------
    SiteError
        If the file is missing, damaged, or too small for the factor.
    """
    path = Path(path)
    if not path.exists():
        raise SiteError(f"{path}: no such photograph. Restore it or take it off the site's list.")
    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    jpeg = path.suffix.lower() in _JPEG
    image = cv2.imread(str(path), flags) if jpeg else None
    if image is None:
        image = _read_with_gdal(path)
    elif image.ndim == 3:
        image = image[..., [2, 1, 0, *range(3, image.shape[2])]]
    if image.ndim == 2:
        image = image[..., None]
    return _reduce(image, downscale, path)


def require_complete(path: Path | str) -> None:
    """Decode a photograph once, coarsely, to find out whether it can be decoded to its end.

    A truncated JPEG is otherwise read without an error, but grey below the break.

    Raises
    ------
    SiteError
        Naming the file and where it came to grief.
    """
    path = Path(path)
    try:
        if path.suffix.lower() in _JPEG:
            with Image.open(path) as image:
                image.draft("RGB", (image.width // 8, image.height // 8))
                image.load()
        else:
            with rasterio.open(path) as source:
                for _, window in source.block_windows(1):
                    source.read(1, window=window)
    except (OSError, SyntaxError, rasterio.errors.RasterioError) as error:
        raise SiteError(f"{path}: truncated or damaged ({error}). Copy it again.") from error


def count_bands(path: Path | str) -> int:
    """Bands that :func:`read_photograph` gives, from the header.

    Raises
    ------
    SiteError
        If the file is missing or no image.
    """
    try:
        with rasterio.open(path) as source:
            return len(_bands_of_light(source))
    except rasterio.errors.RasterioError as error:
        raise SiteError(f"{path}: not a readable image ({error}).") from error


def _read_with_gdal(path: Path) -> np.ndarray:
    try:
        with rasterio.open(path) as source:
            image = np.moveaxis(source.read(_bands_of_light(source)), 0, -1)
    except rasterio.errors.RasterioError as error:
        raise SiteError(f"{path}: not a readable image ({error}). Set it aside or copy it again.") from error
    if image.dtype not in (np.uint8, np.uint16):
        raise SiteError(f"{path}: pixels of type {image.dtype}; 8 or 16 bit unsigned are needed.")
    return image


def _bands_of_light(source: rasterio.DatasetReader) -> list[int]:
    """Bands of a file without the transparency that some programs add.

    Near infrared is now and then labelled as transparency; it takes more values than all or nothing.
    """
    alpha = rasterio.enums.ColorInterp.alpha
    labelled = [band for band in source.indexes if source.colorinterp[band - 1] == alpha]
    opacity = {band for band in labelled if _all_or_nothing(source.read(band))}
    return [band for band in source.indexes if band not in opacity]


def _all_or_nothing(values: np.ndarray) -> bool:
    return bool(np.all((values == 0) | (values == np.iinfo(values.dtype).max)))


def _reduce(image: np.ndarray, downscale: int, path: Path) -> np.ndarray:
    if downscale == 1:
        return np.ascontiguousarray(image)
    rows, columns = image.shape[0] // max(downscale, 1), image.shape[1] // max(downscale, 1)
    if downscale < 1 or min(rows, columns) < 1:
        raise SiteError(
            f"{path}: {image.shape[1]} x {image.shape[0]} pixels cannot be reduced by {downscale}."
        )
    whole = np.ascontiguousarray(image[: rows * downscale, : columns * downscale])
    small = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    return small if small.ndim == 3 else small[..., None]
