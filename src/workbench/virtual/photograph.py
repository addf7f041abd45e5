"""A photograph of a flight: rendered, exposed, and encoded with what a camera writes into its file."""

from __future__ import annotations

import io
from dataclasses import dataclass
from datetime import UTC
from fractions import Fraction
from typing import Any

import numpy as np
import piexif
import xarray as xr
from PIL import Image
from pyproj import Transformer
from rasterio.crs import CRS

from workbench.errors import SceneError
from workbench.virtual.flight import Exposure, Flight
from workbench.virtual.light import BANDS
from workbench.virtual.optics import Optics, expose, image_motion, roll_shutter, tone
from workbench.virtual.render import render
from workbench.virtual.scene import Scene
from workbench.virtual.wind import Wind

_HALF_ALONG_ROWS = 1  # Pillow's number of 4:2:2.
_VISIBLE_WITHIN = 0.3  # Metres by which what is rendered may be nearer than a target that is seen.


@dataclass(frozen=True)
class Conditions:
    """What all photographs of a flight share besides the flight itself."""

    optics: Optics
    """Lens, shutter, sensor."""
    wind: Wind
    """Wind at the flight."""
    cloudiness: float = 0.0
    """0 clear .. 1 overcast."""
    supersampling: int = 3
    """Samples along the edge of a pixel."""
    near_infrared: bool = False
    """Four bands instead of three."""
    seed: int = 0
    """Seed of the noise."""


@dataclass(frozen=True, eq=False)
class Taken:
    """A photograph in memory."""

    pixels: np.ndarray
    """(row, column, band) uint8."""
    view: xr.Dataset
    """What the renderer saw: radiance, depth, cover, tree_id."""
    targets: dict[str, tuple[float, float]]
    """True column and row of every target that is seen."""


def take_photograph(scene: Scene, flight: Flight, exposure: Exposure, conditions: Conditions) -> Taken:
    """Render and expose one photograph.

    The same scene, flight, conditions and seed give the same pixels.

    Raises
    ------
    SceneError
        As :func:`workbench.virtual.render.render`.
    """
    camera = flight.camera.camera
    view = render(
        scene,
        camera,
        exposure.pose,
        time=exposure.time,
        exposure=exposure.release,
        wind=conditions.wind,
        supersampling=conditions.supersampling,
        bands=BANDS if conditions.near_infrared else BANDS[:3],
        cloudiness=conditions.cloudiness,
    )
    optics = conditions.optics
    motion = image_motion(camera, exposure.pose, exposure.velocity, flight.ground)
    radiance = roll_shutter(view["radiance"].values, tuple(motion * optics.readout_time))
    blur = 0 * motion if flight.camera.compensates_motion else motion
    rng = np.random.default_rng([conditions.seed, 43, exposure.release, exposure.mount])
    light = expose(radiance, optics, motion=blur, whole_frame=flight.camera.full_frame, rng=rng)
    # Band by band: the intermediate values of all at once need more memory than the photograph itself.
    pixels = np.stack([tone(band) for band in light], axis=-1)
    return Taken(pixels, view, visible_targets(scene, flight, exposure, view, motion * optics.readout_time))


def visible_targets(
    scene: Scene, flight: Flight, exposure: Exposure, view: xr.Dataset, rolled: np.ndarray
) -> dict[str, tuple[float, float]]:
    """Where the middles of the targets are in a photograph, as column and row, if nothing hides them."""
    targets = scene.targets[scene.targets.kind == "quadrant"]
    if targets.empty:
        return {}
    camera = flight.camera.camera
    points = exposure.pose.to_camera(targets[["x", "y", "z"]].to_numpy(dtype=float))
    positions = camera.project(points)
    depth = view["depth"].values
    seen = {}
    for name, (column, row), z in zip(targets.name, positions, points[:, 2], strict=True):
        edge = camera.focal_x * 0.5 / z  # Half a metre of surroundings are needed to point at a target.
        inside = edge <= column < camera.width - edge and edge <= row < camera.height - edge
        if inside and depth[int(row), int(column)] > z - _VISIBLE_WITHIN:
            moment = row / camera.height - 0.5
            seen[name] = (float(column + rolled[0] * moment), float(row + rolled[1] * moment))
    return seen


def encode_photograph(pixels: np.ndarray, exif: bytes, quality: int) -> bytes:
    """A JPEG of three bands, or a lossless TIFF of four, with its EXIF.

    Raises
    ------
    SceneError
        If there are neither three nor four bands.
    """
    out = io.BytesIO()
    if pixels.shape[2] == 3:
        Image.fromarray(pixels).save(
            out, "JPEG", quality=quality, subsampling=_HALF_ALONG_ROWS, exif=exif, optimize=False
        )
    elif pixels.shape[2] == 4:
        facts = Image.Exif()
        facts.load(exif)
        image = Image.fromarray(pixels, "RGBA")
        image.save(out, "TIFF", exif=facts)  # libtiff would drop the EXIF.
    else:
        raise SceneError(f"{pixels.shape[2]} bands cannot be stored: render three or four.")
    return out.getvalue()


def photograph_suffix(near_infrared: bool) -> str:
    """Suffix of the files of :func:`encode_photograph`."""
    return ".tif" if near_infrared else ".jpg"


def describe_exposure(flight: Flight, exposure: Exposure, crs: CRS, optics: Optics) -> bytes:
    """EXIF that the camera and its receiver write: maker, lens, time, recorded place and its accuracy.

    Heights are those of the site's vertical datum.
    """
    camera = flight.camera
    to_degrees = Transformer.from_crs(crs.to_wkt(), "EPSG:4326", always_xy=True)
    x, y, z = exposure.recorded_position
    longitude, latitude = to_degrees.transform(x, y)
    moment = exposure.time.astimezone(UTC)
    stamp = moment.strftime("%Y:%m:%d %H:%M:%S").encode()
    seconds = moment.second * 1_000_000 + moment.microsecond
    image: dict[int, Any] = {
        piexif.ImageIFD.Make: camera.make.encode(),
        piexif.ImageIFD.Model: camera.model.encode(),
        piexif.ImageIFD.Orientation: 1,
        piexif.ImageIFD.DateTime: stamp,
    }
    exif: dict[int, Any] = {
        piexif.ExifIFD.DateTimeOriginal: stamp,
        piexif.ExifIFD.SubSecTimeOriginal: f"{moment.microsecond:06d}".encode(),
        piexif.ExifIFD.OffsetTimeOriginal: b"+00:00",
        piexif.ExifIFD.FocalLength: _rational(camera.focal_length * 1000),
        piexif.ExifIFD.ExposureTime: _rational(optics.exposure_time),
        piexif.ExifIFD.PixelXDimension: camera.frame[0],
        piexif.ExifIFD.PixelYDimension: camera.frame[1],
    }
    if len(camera.tilts) > 1:
        exif[piexif.ExifIFD.BodySerialNumber] = f"{camera.name}-{exposure.mount + 1}".encode()
    gps: dict[int, Any] = {
        piexif.GPSIFD.GPSVersionID: (2, 3, 0, 0),
        piexif.GPSIFD.GPSLatitudeRef: b"N" if latitude >= 0 else b"S",
        piexif.GPSIFD.GPSLatitude: _sexagesimal(latitude),
        piexif.GPSIFD.GPSLongitudeRef: b"E" if longitude >= 0 else b"W",
        piexif.GPSIFD.GPSLongitude: _sexagesimal(longitude),
        piexif.GPSIFD.GPSAltitudeRef: 0 if z >= 0 else 1,
        piexif.GPSIFD.GPSAltitude: (round(abs(z) * 1000), 1000),
        piexif.GPSIFD.GPSTimeStamp: ((moment.hour, 1), (moment.minute, 1), (seconds, 1_000_000)),
        piexif.GPSIFD.GPSDateStamp: moment.strftime("%Y:%m:%d").encode(),
    }
    if flight.errors.position_sd[0] > 0:
        gps[piexif.GPSIFD.GPSHPositioningError] = _rational(flight.errors.position_sd[0])
    return piexif.dump({"0th": image, "Exif": exif, "GPS": gps})


def _sexagesimal(angle: float) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
    """Degrees, minutes and seconds; the seconds to 1e-6, 0.03 mm on the ground."""
    units = round(abs(angle) * 3_600_000_000)
    degrees, rest = divmod(units, 3_600_000_000)
    minutes, seconds = divmod(rest, 60_000_000)
    return (degrees, 1), (minutes, 1), (seconds, 1_000_000)


def _rational(value: float) -> tuple[int, int]:
    fraction = Fraction(value).limit_denominator(1_000_000)
    return fraction.numerator, fraction.denominator
