"""The site in the report: photographs, cameras, flight, survey."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from workbench.cameras import Camera
from workbench.figures.sections import Section, Table, facts, written
from workbench.site import Site

_FLIGHT = {
    "purpose": "purpose",
    "operator": "operator",
    "platform": "platform",
    "weather": "weather",
    "wind": "wind",
    "notes": "notes",
}


def site_section(site: Site) -> Section:
    """What went in: photographs and cameras, time and sun, what was documented of the flight, survey."""
    epsg = site.crs.to_epsg() if site.crs is not None else None
    values: dict[str, Any] = {
        "photographs": len(site.photographs),
        "aside": len(site.set_aside),
        "strips": _strips(site),
        "crs": f"EPSG:{epsg}" if epsg else "as in site.yaml",
        "datum": site.vertical_datum,
        "positions": sum(p.position is not None for p in site.photographs),
        "attitudes": sum(p.attitude is not None for p in site.photographs),
        "time": _time(site),
        "sun": _sun(site),
        **{f"points_{role}": count for role, count in Counter(p.role for p in site.control).items()},
        "water": site.water_level,
        **{key: site.flight.get(key) for key in _FLIGHT if site.flight.get(key)},
    }
    labels = {
        "photographs": "photographs used",
        "aside": "photographs set aside",
        "strips": "strips",
        "crs": "coordinate reference system",
        "datum": "heights refer to",
        "positions": "recorded positions",
        "attitudes": "recorded attitudes",
        "points_control": "control points",
        "points_check": "check points",
        "points_verify": "verification points",
        "water": "water level (m)",
        "time": "time of exposure",
        "sun": "sun above the horizon (degrees)",
        **_FLIGHT,
    }
    known = {key: value for key, value in values.items() if value is not None}
    tables = [facts(known, labels, title="Photographs, reference system and flight.")]
    if site.cameras:
        tables.append(_cameras(site))
    return Section("Site", tables=tables)


def _strips(site: Site) -> int | None:
    if not any(p.position is not None for p in site.photographs):
        return None  # Strips come from positions.
    return len({p.strip for p in site.photographs})


def _time(site: Site) -> str | None:
    times = [p.time for p in site.photographs if p.time is not None]
    if not times:
        return None
    aware = [time for time in times if time.tzinfo is not None]
    chosen, zone = (aware, " UTC") if len(aware) == len(times) else (times, " (clock of the camera)")
    plain = sorted(time.replace(tzinfo=None) if not aware else time for time in chosen)
    return f"{plain[0]:%Y-%m-%d %H:%M} to {plain[-1]:%Y-%m-%d %H:%M}{zone}"


def _sun(site: Site) -> str | None:
    heights = [p.sun[0] for p in site.photographs if p.sun is not None]
    if not heights:
        return None
    low, high = min(heights), max(heights)
    return f"{low:.0f}" if round(low) == round(high) else f"{low:.0f} to {high:.0f}"


def _cameras(site: Site) -> Table:
    used = Counter(p.camera for p in site.photographs)
    rows = [
        [
            camera.name,
            str(used[identifier]),
            f"{camera.width} x {camera.height}",
            f"{camera.focal_x:.1f}",
            *_physical(camera),
        ]
        for identifier, camera in sorted(site.cameras.items())
    ]
    header = ("camera", "photographs", "pixels", "focal length (px)", "focal length (mm)", "pixel (um)")
    return Table(rows, header, "Cameras before adjustment.")


def _physical(camera: Camera) -> tuple[str, str]:
    if not camera.pixel_size or not np.isfinite(camera.pixel_size):
        return "-", "-"
    return written(camera.focal_x * camera.pixel_size * 1e3), written(camera.pixel_size * 1e6)
