"""Where recorded positions can and cannot be."""

from __future__ import annotations

import numpy as np
from pyproj import CRS, Transformer

_FAR = 20.0  # A place this many times the usual distance from the middle is no neighbour.
_LEAST_SPREAD = 50.0  # Metres; a hovering drone or a kite has hardly any.
_NEAR_AREA = 3.0  # Degrees by which a CRS may be used beyond its area: half a UTM zone.


def far_from_rest(xy: np.ndarray) -> np.ndarray:
    """Which of the places (n, 2), metres, lie far from the others, (n,) bool.

    Far is more than 20 times the median distance from the median place, and at least 1 km; with
    fewer than four places none is called far, because it could be either.
    """
    if len(xy) < 4:
        return np.zeros(len(xy), dtype=bool)
    away = np.hypot(*(xy - np.median(xy, axis=0)).T)
    return away > _FAR * max(float(np.median(away)), _LEAST_SPREAD)


def outside_area(xy: np.ndarray, crs: CRS) -> np.ndarray:
    """Which places (n, 2) lie where the CRS is not meant to be used, (n,) bool.

    Places up to 3 degrees beyond the area of use count as inside: a block may cross a zone's border.
    """
    # A CRS that came through GDAL has lost its area of use; the EPSG register has it.
    code = crs.to_epsg()
    area = (CRS.from_epsg(code) if code else crs).area_of_use
    if area is None or not len(xy):
        return np.zeros(len(xy), dtype=bool)
    longitude, latitude = Transformer.from_crs(crs, CRS.from_epsg(4326), always_xy=True).transform(*xy.T)
    near = (
        (longitude >= area.west - _NEAR_AREA)
        & (longitude <= area.east + _NEAR_AREA)
        & (latitude >= area.south - _NEAR_AREA)
        & (latitude <= area.north + _NEAR_AREA)
    )
    # Places that the projection cannot undo come back as infinity.
    return ~(near & np.isfinite(longitude) & np.isfinite(latitude))


def utm_zone(longitude: float, latitude: float) -> CRS:
    """WGS 84 / UTM zone of a place, degrees."""
    zone = int((longitude + 180) // 6) % 60 + 1
    return CRS.from_epsg((32600 if latitude >= 0 else 32700) + zone)


def doubtful_degrees(longitude: float | None, latitude: float | None) -> str:
    """Why a longitude and latitude cannot be a place where a photograph was taken; empty if it can."""
    if longitude is None or latitude is None:
        return ""
    if abs(longitude) < 1e-6 and abs(latitude) < 1e-6:
        return "recorded position is 0, 0: the receiver had no fix"
    if abs(latitude) > 90:
        return f"recorded latitude is {latitude:.4f}: longitude and latitude are swapped"
    if abs(longitude) > 180 or abs(latitude) > 84:
        return f"recorded position {longitude:.4f}, {latitude:.4f} is outside of every UTM zone"
    return ""
