"""``site.yaml`` as text: what is known, what is asked, and what each line means."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from workbench.cameras.table import SensorModel, find_sensor
from workbench.site.scan import CameraKind

OPTIONAL_FILES = {
    "shoreline": "lake side of the official shoreline: polygons",
    "dtm": "terrain raster, for example from lidar",
    "areas": "areas of interest: polygons with a column aoi",
    "transects": "lines from the water to the shore with columns aoi, transect",
    "field_points": "reed field campaign: table of points",
    "plots": "reed field campaign: table of 1 m2 plots",
    "reference_status": "status of reed per section from visual interpretation",
    "reference_trees": "surveyed trees",
}
"""Inputs of the later stages, and what each is."""

FLIGHT = ("purpose", "operator", "platform", "weather", "wind", "notes")
"""What a reproducible study documents of its flight."""


@dataclass(frozen=True)
class Description:
    """Content of ``site.yaml``."""

    name: str
    """Name of the site."""
    crs: str | None
    """Projected CRS; None is an open question."""
    crs_is_proposed: bool
    """Whether the CRS is the zone of the positions rather than somebody's choice."""
    vertical_datum: str | None
    """What heights refer to, in words; None is an open question."""
    photographs: str
    """Folder of the photographs."""
    time_zone: str | None
    """Zone of the cameras' clocks."""
    water_level: float | None
    """Metres."""
    files: Mapping[str, str | None]
    """Paths of :data:`OPTIONAL_FILES`."""
    flight: Mapping[str, Any]
    """Notes on the flight."""
    cameras: Mapping[str, CameraKind]
    """Cameras by identifier."""
    answers: Mapping[str, Any] = field(default_factory=dict)
    """``cameras`` of an earlier ``site.yaml``, whose answers are kept."""


def render_site(site: Description) -> str:
    """Text of ``site.yaml``."""
    origin = (
        "  # proposed: the UTM zone of the positions, or that of gcp_list.txt"
        if site.crs_is_proposed and site.crs
        else ""
    )
    lines = [
        f"# Site {site.name}. null is an open question or something that the site does not have.",
        f"name: {_value(site.name)}",
        "# Projected CRS of positions, control and products, metres, as EPSG:n.",
        f"crs: {_value(site.crs)}{origin}",
        "# What heights of positions, control and products refer to, in words, such as DHHN2016 heights.",
        f"vertical_datum: {_value(site.vertical_datum)}",
        "# Heights in EXIF may be ellipsoidal, above the geoid or barometric; files do not tell which. They",
        "# are taken as recorded, and control points decide where there are any.",
        "gnss_height: as recorded",
        "# Folder of the photographs; names in photographs.csv are relative to it.",
        f"photographs: {_value(site.photographs)}",
        "# Zone of the cameras' clocks (IANA name such as Europe/Berlin) where the files state none; without",
        "# it the sun's position is unknown.",
        f"time_zone: {_value(site.time_zone)}",
        "# Water level in the vertical datum, metres.",
        f"water_level: {_value(site.water_level)}",
    ]
    lines += [f"{key}: {_value(site.files.get(key))}  # {text}" for key, text in OPTIONAL_FILES.items()]
    lines += ["# A reproducible study documents its flight.", "flight:"]
    lines += [f"  {key}: {_value(site.flight.get(key))}" for key in dict.fromkeys((*FLIGHT, *site.flight))]
    lines += [
        "# Inner orientation a priori: focal length of the lens (not the 35 mm equivalent) and width of the",
        "# part of the sensor that the photograph's columns cover. focal_length_px goes first where stated.",
        "# distortion: k1, k2, p1, p2, k3 ... where known.",
        "cameras:",
    ]
    for identifier, kind in site.cameras.items():
        lines += _camera(identifier, kind, site.answers.get(identifier) or {})
    return "\n".join(lines) + "\n"


def _camera(identifier: str, kind: CameraKind, answers: Mapping[str, Any]) -> list[str]:
    same = all(answers.get(key) == value for key, value in _identity(kind).items())
    kept = answers if same else {}
    sensor = find_sensor(kind.make, kind.model)
    focal, width = _table_values(kind, sensor)
    stated_focal, stated_width = kept.get("focal_length_mm"), kept.get("sensor_width_mm")
    source = "camera table" if focal and width else "question"
    if kept.get("focal_length_px") or (stated_focal, stated_width) not in ((None, None), (focal, width)):
        source = "stated"
    focal, width = stated_focal or focal, stated_width or width
    lines = [f"  {identifier}:"]
    lines += [f"    {key}: {_value(value)}" for key, value in _identity(kind).items()]
    lines += [
        f"    focal_length_mm: {_value(focal)}{'' if focal else _LOOK_UP_FOCAL}",
        f"    sensor_width_mm: {_value(width)}{'' if width else _look_up_width(kind, sensor)}",
        f"    focal_length_px: {_value(kept.get('focal_length_px'))}{_derived(focal, width, kind.width)}",
        f"    source: {source}",
        f"    distortion: {json.dumps(list(kept.get('distortion') or []))}",
    ]
    return lines


def _identity(kind: CameraKind) -> dict[str, Any]:
    return {
        "make": kind.make or None,
        "model": kind.model or None,
        "serial": kind.serial or None,
        "folder": kind.folder or None,
        "width": kind.width,
        "height": kind.height,
        "bands": kind.bands,
    }


def _table_values(kind: CameraKind, sensor: SensorModel | None) -> tuple[float | None, float | None]:
    """Focal length and used sensor width, mm, as far as EXIF and the table tell."""
    focal = kind.focal_length or (sensor.focal_length if sensor else None)
    pixel = sensor.pixel_size(kind.width, kind.height) if sensor else None
    return (
        round(focal * 1000, 4) if focal else None,
        round(pixel * kind.width * 1000, 4) if pixel else None,
    )


_LOOK_UP_FOCAL = "  # ? the lens's real focal length: its engraving or data sheet, not the 35 mm equivalent"


def _look_up_width(kind: CameraKind, sensor: SensorModel | None) -> str:
    if sensor is None:
        return "  # ? the camera is not in our table: look up the sensor size in its data sheet"
    return (
        f"  # ? {kind.width} x {kind.height} px is no usual frame of this {sensor.sensor_width * 1000:g} mm "
        f"({sensor.pixels_wide} px) sensor: cropped or resampled?"
    )


def _derived(focal: float | None, width: float | None, columns: int) -> str:
    if not focal or not width:
        return ""
    return f"  # from the two above: {focal / width * columns:.1f} px of {width / columns * 1000:.3f} um"


def _value(value: Any) -> str:
    """A YAML scalar; JSON's are valid YAML, with every awkward character quoted."""
    return json.dumps(value, ensure_ascii=False)
