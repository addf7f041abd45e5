"""What a photograph says of itself: EXIF and the XMP of drones."""

from __future__ import annotations

import io
import logging
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import exifread

_HEADER = 512 * 1024  # XMP stands within the first segments of a JPEG.
_XMP = re.compile(rb"<x:xmpmeta.*?</x:xmpmeta>", re.DOTALL)
_DJI = re.compile(r'drone-dji:(\w+)(?:="([^"]*)"|>([^<]*)<)')
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
    """Roll, pitch (-90 is straight down) and yaw (from north) of the camera, degrees."""
    time: datetime | None = None
    """Exposure; with UTC where GNSS time is given, without a time zone otherwise."""


def read_facts(path: Path) -> PhotographFacts:
    """Read EXIF and XMP; a file without either gives empty facts."""
    with path.open("rb") as file:
        head = file.read(_HEADER)
    try:
        tags = exifread.process_file(io.BytesIO(head), details=False)
    except (ValueError, KeyError, IndexError, TypeError, OSError):
        tags = {}  # A damaged header says nothing; `check` reports the photograph.
    xmp = _read_xmp(head)
    longitude = _degrees(tags.get("GPS GPSLongitude"), tags.get("GPS GPSLongitudeRef"))
    latitude = _degrees(tags.get("GPS GPSLatitude"), tags.get("GPS GPSLatitudeRef"))
    altitude = _number(tags.get("GPS GPSAltitude"))
    if altitude is not None and str(tags.get("GPS GPSAltitudeRef", "0")).strip() in {"1", "[1]"}:
        altitude = -altitude
    focal = _number(tags.get("EXIF FocalLength"))
    return PhotographFacts(
        make=str(tags.get("Image Make", "")).strip(),
        model=str(tags.get("Image Model", "")).strip(),
        serial=str(tags.get("EXIF BodySerialNumber", "")).strip(),
        focal_length=focal / 1000 if focal else None,
        longitude=longitude,
        latitude=latitude,
        altitude=altitude,
        relative_altitude=xmp.get("RelativeAltitude"),
        position_sd=_position_sd(tags, xmp),
        gimbal=_gimbal(xmp),
        time=_time(tags),
    )


def _read_xmp(head: bytes) -> dict[str, float]:
    found = _XMP.search(head)
    values = {}
    if found:
        for name, attribute, element in _DJI.findall(found.group().decode("utf-8", "replace")):
            try:
                values[name] = float(attribute or element)
            except ValueError:
                continue  # Texts such as the model of the drone.
    return values


def _gimbal(xmp: dict[str, float]) -> tuple[float, float, float] | None:
    keys = ("GimbalRollDegree", "GimbalPitchDegree", "GimbalYawDegree")
    if not all(key in xmp for key in keys):
        return None
    roll, pitch, yaw = (xmp[key] for key in keys)
    return roll, pitch, yaw


def _position_sd(tags: dict[str, Any], xmp: dict[str, float]) -> tuple[float, float, float] | None:
    keys = ("RtkStdLon", "RtkStdLat", "RtkStdHgt")
    if all(xmp.get(key, 0) > 0 for key in keys):
        east, north, up = (xmp[key] for key in keys)
        return east, north, up
    error = _number(tags.get("GPS GPSHPositioningError") or tags.get("GPS Tag 0x001F"))
    return (error, error, 2 * error) if error else None


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
    except (ValueError, ZeroDivisionError):
        return None
    sign = -1 if str(reference).strip().upper()[:1] in {"S", "W"} else 1
    return sign * (degree + minute / 60 + second / 3600)


def _time(tags: dict[str, Any]) -> datetime | None:
    date, clock = tags.get("GPS GPSDate"), tags.get("GPS GPSTimeStamp")
    if date is not None and clock is not None:
        try:
            hour, minute, second = (float(value) for value in clock.values)
            day = datetime.strptime(str(date), "%Y:%m:%d").replace(tzinfo=UTC)
            return day.replace(
                hour=int(hour), minute=int(minute), second=int(second), microsecond=int(second % 1 * 1e6)
            )
        except (ValueError, ZeroDivisionError):
            pass  # Some cameras write zeros until they have a fix; the clock of the camera goes on.
    stamp = tags.get("EXIF DateTimeOriginal") or tags.get("Image DateTime")
    try:
        return datetime.strptime(str(stamp), "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None
