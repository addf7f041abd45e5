"""What a photograph says of itself: EXIF and the XMP of drones."""

from __future__ import annotations

import io
import logging
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import exifread

_HEADER = 512 * 1024  # EXIF and XMP stand within the first segments of a JPEG.
_XMP = re.compile(rb"<x:xmpmeta.*?</x:xmpmeta>", re.DOTALL)
_ENTRY = re.compile(r'(drone-dji|Camera):(\w+)(?:\s*=\s*"([^"]*)"|>([^<]*)<)')
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0}  # EXIF FocalPlaneResolutionUnit: inch, centimetre, millimetre.
logging.getLogger("exifread").setLevel(logging.ERROR)


@dataclass(frozen=True)
class PhotographFacts:
    """Everything that EXIF and XMP tell; None where they are silent."""

    make: str = ""
    """Maker."""
    model: str = ""
    """Model."""
    serial: str = ""
    """Serial number of the body, tells two cameras of one model apart."""
    focal_length: float | None = None
    """Metres."""
    sensor_width_hint: float | None = None
    """Metres, from the focal plane resolution: often wrong, a help for whoever looks it up."""
    longitude: float | None = None
    """Degrees, WGS 84, east positive."""
    latitude: float | None = None
    """Degrees, WGS 84, north positive."""
    altitude: float | None = None
    """Metres as recorded: ellipsoidal, above the geoid or barometric, the file does not tell."""
    relative_altitude: float | None = None
    """Metres above the place of take-off."""
    position_sd: tuple[float, float, float] | None = None
    """Standard deviations east, north, up, metres."""
    gimbal: tuple[float, float, float] | None = None
    """Roll, pitch (-90 is straight down) and yaw (from true north) of the camera, degrees."""
    time: datetime | None = None
    """Exposure; in UTC where GNSS time or an offset is given, without a time zone otherwise."""


def read_facts(path: Path) -> PhotographFacts:
    """Read EXIF and XMP; a file without either, or with damaged ones, gives empty facts."""
    with path.open("rb") as file:
        head = file.read(_HEADER)
        file.seek(0)
        # The directory of a TIFF may stand behind the pixels, so it is read from the file itself.
        tags = _read_tags(file if head[:2] in (b"II", b"MM") else io.BytesIO(head))
    xmp = _read_xmp(head, tags)
    altitude = _number(tags.get("GPS GPSAltitude"))
    if altitude is not None and str(tags.get("GPS GPSAltitudeRef", "0")).strip() in {"1", "[1]"}:
        altitude = -altitude
    focal = _number(tags.get("EXIF FocalLength"))
    return PhotographFacts(
        make=_text(tags.get("Image Make")),
        model=_text(tags.get("Image Model")),
        serial=_text(tags.get("EXIF BodySerialNumber")),
        focal_length=focal / 1000 if focal and focal > 0 else None,
        sensor_width_hint=_sensor_width_hint(tags),
        longitude=_degrees(tags.get("GPS GPSLongitude"), tags.get("GPS GPSLongitudeRef")),
        latitude=_degrees(tags.get("GPS GPSLatitude"), tags.get("GPS GPSLatitudeRef")),
        altitude=altitude,
        relative_altitude=_float(xmp.get("RelativeAltitude")),
        position_sd=_position_sd(tags, xmp),
        gimbal=_gimbal(xmp),
        time=_time(tags, xmp),
    )


def _read_tags(file: BinaryIO) -> dict[str, Any]:
    try:
        return exifread.process_file(file, details=False)
    except (ValueError, KeyError, IndexError, TypeError, OSError, OverflowError):
        return {}  # A damaged header says nothing: the site then asks for what it would have told.


def _read_xmp(head: bytes, tags: dict[str, Any]) -> dict[str, str]:
    """Entries of DJI and of Pix4D's ``Camera`` schema (senseFly, MicaSense, Parrot), by name."""
    block = _XMP.search(head)
    packet = tags.get("Image ApplicationNotes")  # Where TIFF keeps XMP.
    if block is not None:
        text = block.group().decode("utf-8", "replace")
    elif packet is not None and isinstance(packet.values, list | bytes):
        text = bytes(packet.values).decode("utf-8", "replace")
    else:
        return {}
    entries = {}
    for _, name, attribute, element in _ENTRY.findall(text):
        if value := (attribute or element).strip():  # A closing tag looks like an empty element.
            entries[name] = value
    return entries


def _gimbal(xmp: dict[str, str]) -> tuple[float, float, float] | None:
    """Of DJI only: the zero of the pitch of the ``Camera`` schema differs from maker to maker."""
    roll, pitch, yaw = (_float(xmp.get(f"Gimbal{axis}Degree")) for axis in ("Roll", "Pitch", "Yaw"))
    if roll is None or pitch is None or yaw is None:
        return None
    return roll, pitch, yaw


def _position_sd(tags: dict[str, Any], xmp: dict[str, str]) -> tuple[float, float, float] | None:
    east, north, height = (_float(xmp.get(key)) for key in ("RtkStdLon", "RtkStdLat", "RtkStdHgt"))
    if east and north and height and min(east, north, height) > 0:
        return east, north, height
    across, up = _float(xmp.get("GPSXYAccuracy")), _float(xmp.get("GPSZAccuracy"))
    if across and up and min(across, up) > 0:
        return across, across, up
    error = _number(tags.get("GPS GPSHPositioningError") or tags.get("GPS Tag 0x001F"))
    # EXIF states the horizontal error only; satellites all above make the height about twice as bad.
    return (error, error, 2 * error) if error and error > 0 else None


def _sensor_width_hint(tags: dict[str, Any]) -> float | None:
    resolution = _number(tags.get("EXIF FocalPlaneXResolution"))
    unit = _number(tags.get("EXIF FocalPlaneResolutionUnit")) or 2
    width = _number(tags.get("EXIF ExifImageWidth"))
    if not resolution or not width or int(unit) not in _MM_PER_UNIT:
        return None
    return width / resolution * _MM_PER_UNIT[int(unit)] / 1000


def _time(tags: dict[str, Any], xmp: dict[str, str]) -> datetime | None:
    return _satellite_time(tags, xmp) or _camera_time(tags)


def _satellite_time(tags: dict[str, Any], xmp: dict[str, str]) -> datetime | None:
    if "UTCAtExposure" in xmp:
        try:
            return datetime.fromisoformat(xmp["UTCAtExposure"].rstrip("Z")).replace(tzinfo=UTC)
        except ValueError:
            pass  # Written before the receiver had a fix; EXIF may know more.
    date, clock = tags.get("GPS GPSDate"), tags.get("GPS GPSTimeStamp")
    if date is None or clock is None:
        return None
    try:
        hour, minute, second = (float(value) for value in clock.values)
        day = datetime.strptime(str(date).strip(), "%Y:%m:%d").replace(tzinfo=UTC)
        return day.replace(
            hour=int(hour), minute=int(minute), second=int(second), microsecond=int(second % 1 * 1e6)
        )
    except (ValueError, ZeroDivisionError, TypeError):
        return None  # Some cameras write zeros until they have a fix; the clock of the camera goes on.


def _camera_time(tags: dict[str, Any]) -> datetime | None:
    stamp = tags.get("EXIF DateTimeOriginal") or tags.get("Image DateTime")
    fraction = re.sub(r"\D", "", _text(tags.get("EXIF SubSecTimeOriginal")))[:6] or "0"
    offset = _text(tags.get("EXIF OffsetTimeOriginal"))
    try:
        time = datetime.strptime(f"{_text(stamp)}.{fraction}", "%Y:%m:%d %H:%M:%S.%f")
        return datetime.fromisoformat(f"{time.isoformat()}{offset}").astimezone(UTC) if offset else time
    except ValueError:
        return None


def _text(tag: Any) -> str:
    return "" if tag is None else str(tag).replace("\x00", "").strip()


def _float(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def _number(tag: Any) -> float | None:
    if tag is None or not tag.values:
        return None
    value = tag.values[0] if isinstance(tag.values, list) else tag.values
    try:
        return float(value)
    except (ValueError, ZeroDivisionError, TypeError):
        return None


def _degrees(tag: Any, reference: Any) -> float | None:
    if tag is None or len(tag.values) != 3:
        return None
    try:
        degree, minute, second = (float(value) for value in tag.values)
    except (ValueError, ZeroDivisionError, TypeError):
        return None
    sign = -1 if str(reference).strip().upper()[:1] in {"S", "W"} else 1
    return sign * (degree + minute / 60 + second / 3600)
