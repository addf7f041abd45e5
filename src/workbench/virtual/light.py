"""Light: where the sun stands and how much of it and of the sky arrives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from workbench.errors import SceneError

BANDS = ("red", "green", "blue", "nir")
_SUN_COLOUR = np.array([1.03, 1.0, 0.93, 1.03])
_SKY_COLOUR = np.array([0.72, 0.95, 1.40, 0.45])
_CLEAR_SKY_SHARE = 0.17
_LOWEST_SUN = math.radians(8.0)


@dataclass(frozen=True)
class Light:
    """Sun and sky over a scene; white paper lying flat and in full light has the radiance 1."""

    sun: tuple[float, float, float]
    """Unit vector towards the sun: east, north, up."""
    direct: tuple[float, float, float, float]
    """Sunlight on a surface that faces the sun, for red, green, blue and near infrared."""
    diffuse: tuple[float, float, float, float]
    """Light of the whole sky on a flat surface, the same bands."""

    @property
    def elevation(self) -> float:
        """Height of the sun, degrees."""
        return math.degrees(math.asin(self.sun[2]))

    @property
    def azimuth(self) -> float:
        """Direction of the sun, degrees clockwise from north, 0..360."""
        return math.degrees(math.atan2(self.sun[0], self.sun[1])) % 360


def light_at(time: datetime, longitude: float, latitude: float, *, cloudiness: float = 0.0) -> Light:
    """Light at a date, time and place.

    Parameters
    ----------
    time
        With time zone; without one it is taken as UTC.
    longitude, latitude
        Degrees, WGS84.
    cloudiness
        0 clear .. 1 overcast (no shadow is cast).

    Raises
    ------
    SceneError
        If the sun is lower than 8 degrees or the cloudiness is outside 0..1.
    """
    if not 0 <= cloudiness <= 1:
        raise SceneError(f"Cloudiness {cloudiness} is outside 0..1.")
    sun = sun_direction(time, longitude, latitude)
    if sun[2] < math.sin(_LOWEST_SUN):
        raise SceneError(
            f"At {time} the sun stands {math.degrees(math.asin(sun[2])):.0f} degrees high at "
            f"{latitude:.2f} N {longitude:.2f} E: choose a time with at least 8 degrees."
        )
    sky = _CLEAR_SKY_SHARE + (1 - _CLEAR_SKY_SHARE) * cloudiness
    # An overcast sky is white.
    sky_colour = _SKY_COLOUR + (1 - _SKY_COLOUR) * cloudiness
    direct = _SUN_COLOUR * (1 - sky) / sun[2]
    return Light(sun, _four(direct), _four(sky_colour * sky))


def sun_direction(time: datetime, longitude: float, latitude: float) -> tuple[float, float, float]:
    """Unit vector (east, north, up) towards the sun; low-precision ephemeris, about 0.02 degrees."""
    moment = time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)
    days = (moment - datetime(2000, 1, 1, 12, tzinfo=UTC)).total_seconds() / 86400
    mean_longitude = math.radians((280.460 + 0.9856474 * days) % 360)
    anomaly = math.radians((357.528 + 0.9856003 * days) % 360)
    ecliptic = mean_longitude + math.radians(1.915 * math.sin(anomaly) + 0.020 * math.sin(2 * anomaly))
    obliquity = math.radians(23.439 - 4e-7 * days)
    ascension = math.atan2(math.cos(obliquity) * math.sin(ecliptic), math.cos(ecliptic))
    declination = math.asin(math.sin(obliquity) * math.sin(ecliptic))
    sidereal = math.radians((280.46062 + 360.98564737 * days + longitude) % 360)
    hour = sidereal - ascension
    phi = math.radians(latitude)
    east = -math.cos(declination) * math.sin(hour)
    north = math.sin(declination) * math.cos(phi) - math.cos(declination) * math.cos(hour) * math.sin(phi)
    up = math.sin(declination) * math.sin(phi) + math.cos(declination) * math.cos(hour) * math.cos(phi)
    return east, north, up


def _four(values: np.ndarray) -> tuple[float, float, float, float]:
    red, green, blue, nir = (float(value) for value in values)
    return red, green, blue, nir
