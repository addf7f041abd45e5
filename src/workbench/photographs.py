"""Photographs as arrays, in the geometry of the sensor."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import rasterio
from PIL import Image, UnidentifiedImageError

from workbench.errors import SiteError

# Aerial frames exceed the decompression guard of Pillow, which only reads headers here.
Image.MAX_IMAGE_PIXELS = None


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
    jpeg = path.suffix.lower() in {".jpg", ".jpeg"}
    image = cv2.imread(str(path), flags) if jpeg else None
    if image is None:
        image = _read_with_gdal(path)
    elif image.ndim == 3:
        image = image[..., [2, 1, 0, *range(3, image.shape[2])]]
    if image.ndim == 2:
        image = image[..., None]
    return _reduce(image, downscale, path)


def is_complete(path: Path | str) -> bool:
    """Whether a JPEG reaches its end marker; other formats count as complete.

    A truncated JPEG decodes without an error, but grey below the break.
    """
    path = Path(path)
    if path.suffix.lower() not in {".jpg", ".jpeg"}:
        return True
    with path.open("rb") as file:
        size = file.seek(0, 2)
        # Some cameras append previews and metadata, so the marker need not be the very last bytes.
        file.seek(max(size - 65536, 0))
        return b"\xff\xd9" in file.read()


def _read_with_gdal(path: Path) -> np.ndarray:
    try:
        with rasterio.open(path) as source:
            image = np.moveaxis(source.read(), 0, -1)
    except rasterio.errors.RasterioError as error:
        raise SiteError(f"{path}: not a readable image ({error}). Set it aside or copy it again.") from error
    if image.dtype not in (np.uint8, np.uint16):
        raise SiteError(f"{path}: pixels of type {image.dtype}; 8 or 16 bit unsigned are needed.")
    return image


def _reduce(image: np.ndarray, downscale: int, path: Path) -> np.ndarray:
    if downscale == 1:
        return np.ascontiguousarray(image)
    rows, columns = image.shape[0] // downscale, image.shape[1] // downscale
    if downscale < 1 or min(rows, columns) < 1:
        raise SiteError(
            f"{path}: {image.shape[1]} x {image.shape[0]} pixels cannot be reduced by {downscale}."
        )
    whole = np.ascontiguousarray(image[: rows * downscale, : columns * downscale])
    small = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    return small if small.ndim == 3 else small[..., None]
