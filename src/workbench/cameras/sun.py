"""Where the sun stands."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np


def sun_position(time: datetime, longitude: float, latitude: float) -> tuple[float, float]:
    """Elevation and azimuth of the sun, degrees.

    Low-precision formulas of the Astronomical Almanac (0.01 degree between 1950 and 2050), without
    refraction.

    Parameters
    ----------
    time
        Aware of its time zone.
    longitude, latitude
        Degrees, east and north positive.

    Returns
    -------
    elevation, azimuth
        -90..90 above the horizon; 0..360 clockwise from north.

    Raises
    ------
    ValueError
        If the time has no time zone.
    """
    if time.tzinfo is None:
        raise ValueError("The sun's position needs a time with its time zone.")
    days = (time.astimezone(UTC) - datetime(2000, 1, 1, 12, tzinfo=UTC)).total_seconds() / 86400
    mean_longitude = 280.460 + 0.9856474 * days
    anomaly = np.radians(357.528 + 0.9856003 * days)
    ecliptic = np.radians(mean_longitude + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    obliquity = np.radians(23.439 - 4e-7 * days)
    ascension = np.arctan2(np.cos(obliquity) * np.sin(ecliptic), np.cos(ecliptic))
    declination = np.arcsin(np.sin(obliquity) * np.sin(ecliptic))
    sidereal = np.radians(280.46062 + 360.98564737 * days + longitude)
    hour = sidereal - ascension
    north = np.radians(latitude)
    elevation = np.arcsin(
        np.sin(north) * np.sin(declination) + np.cos(north) * np.cos(declination) * np.cos(hour)
    )
    azimuth = np.arctan2(-np.sin(hour), np.tan(declination) * np.cos(north) - np.sin(north) * np.cos(hour))
    return float(np.degrees(elevation)), float(np.degrees(azimuth) % 360)
