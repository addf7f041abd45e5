"""Small photographs with chosen EXIF and XMP, as a camera would write them."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import piexif
from PIL import Image

LONGITUDE, LATITUDE = 12.45, 47.87  # Lake Chiemsee.
METRE_EAST, METRE_NORTH = 1 / 74_900, 1 / 111_200  # Degrees there, to one part in a thousand.


def write_photo(
    path: Path,
    *,
    place: tuple[float, float] | None = None,
    altitude: float | None = 600.0,
    clock: str | None = "2021:06:21 12:00:00",
    make: str | None = "DJI",
    model: str | None = "FC6310",
    serial: str | None = None,
    focal: float | None = 8.8,
    size: tuple[int, int] = (5472 // 32, 3648 // 32),
    xmp: dict[str, str] | None = None,
    gnss_clock: tuple[int, int, int] | None = None,
    exif: bool = True,
    seed: int | None = None,
) -> Path:
    """A textured JPEG; ``place`` is longitude and latitude, degrees."""
    path.parent.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(sum(map(ord, str(path.name))) if seed is None else seed)
    texture = random.integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    tags: dict = {"0th": {}, "Exif": {}, "GPS": {}}
    if make:
        tags["0th"][piexif.ImageIFD.Make] = make
    if model:
        tags["0th"][piexif.ImageIFD.Model] = model
    if clock:
        tags["Exif"][piexif.ExifIFD.DateTimeOriginal] = clock
    if serial:
        tags["Exif"][piexif.ExifIFD.BodySerialNumber] = serial
    if focal:
        tags["Exif"][piexif.ExifIFD.FocalLength] = _rational(focal, 1000)
    if place is not None:
        tags["GPS"] |= {
            piexif.GPSIFD.GPSLongitudeRef: "E" if place[0] >= 0 else "W",
            piexif.GPSIFD.GPSLongitude: _sexagesimal(place[0]),
            piexif.GPSIFD.GPSLatitudeRef: "N" if place[1] >= 0 else "S",
            piexif.GPSIFD.GPSLatitude: _sexagesimal(place[1]),
        }
        if altitude is not None:
            tags["GPS"][piexif.GPSIFD.GPSAltitude] = _rational(abs(altitude), 1000)
            tags["GPS"][piexif.GPSIFD.GPSAltitudeRef] = int(altitude < 0)
    if gnss_clock is not None:
        tags["GPS"][piexif.GPSIFD.GPSDateStamp] = (clock or "").split()[0]
        tags["GPS"][piexif.GPSIFD.GPSTimeStamp] = tuple((value, 1) for value in gnss_clock)
    image = Image.fromarray(texture)
    image.save(path, quality=80, **({"exif": piexif.dump(tags)} if exif else {}))
    if xmp:
        _insert_xmp(path, xmp)
    return path


def write_flight(
    folder: Path, *, strips: int = 2, per_strip: int = 4, along: float = 20.0, **options
) -> None:
    """A flight back and forth, 40 m between strips, 50 m above ground, 6 s between photographs."""
    for index in range(strips * per_strip):
        strip, step = divmod(index, per_strip)
        step = step if strip % 2 == 0 else per_strip - 1 - step
        place = LONGITUDE + step * along * METRE_EAST, LATITUDE + strip * 40 * METRE_NORTH
        clock = f"2021:06:21 12:{index // 10:02d}:{index % 10 * 6:02d}"
        xmp = {"RelativeAltitude": "+50.00"} | options.get("xmp", {})
        values = {"place": place, "clock": clock} | options | {"xmp": xmp}
        write_photo(folder / f"IMG_{index:04d}.jpg", **values)


def truncate(path: Path, share: float = 0.6) -> None:
    """Cut the end off, as an interrupted copy does."""
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])


def _insert_xmp(path: Path, values: dict[str, str]) -> None:
    attributes = " ".join(
        f'{key if ":" in key else "drone-dji:" + key}="{value}"' for key, value in values.items()
    )
    packet = (
        f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF><rdf:Description {attributes}/></rdf:RDF></x:xmpmeta>'
    )
    body = b"http://ns.adobe.com/xap/1.0/\x00" + packet.encode()
    segment = b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body
    data = path.read_bytes()
    path.write_bytes(data[:2] + segment + data[2:])


def _rational(value: float, denominator: int) -> tuple[int, int]:
    fraction = Fraction(round(value * denominator), denominator)
    return fraction.numerator, fraction.denominator


def _sexagesimal(degrees: float) -> tuple[tuple[int, int], ...]:
    value = abs(degrees)
    minutes = value % 1 * 60
    return (int(value), 1), (int(minutes), 1), _rational(minutes % 1 * 60, 100_000)
