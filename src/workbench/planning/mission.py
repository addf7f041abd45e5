"""From an area, a camera and overlaps to a mission that an aircraft can fly."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from rasterio.crs import CRS
from shapely import MultiPolygon, Polygon

from workbench.errors import PlanningError
from workbench.planning.batteries import Budget, Leg, Part, split
from workbench.planning.heights import Relief, follow
from workbench.planning.lines import flight_lines, longest_direction
from workbench.rasters import Grid
from workbench.virtual.flight import swath
from workbench.virtual.flight_cameras import FlightCamera

_TOLERANCE = 0.04  # Of the height: the way departs upwards by no more, which changes the GSD by as much.


@dataclass(frozen=True)
class Aircraft:
    """What an aircraft can do. Defaults are those of small multicopters."""

    fastest: float = 10.0
    """Speed over ground, m/s."""
    climb: float = 3.0
    """Up and down, m/s."""
    battery: float = 20.0
    """Minutes of flight of one battery, as experienced in the field."""
    reserve: float = 0.25
    """Share of a battery that must be left at landing, 0..1."""
    release_interval: float = 2.0
    """Shortest time between two photographs, s."""
    waypoints: int = 99
    """Most waypoints of a mission file; 99 is the limit of Litchi."""

    def __post_init__(self) -> None:
        for name in ("fastest", "climb", "battery", "release_interval"):
            if not getattr(self, name) > 0:
                raise PlanningError(f"{name} of an aircraft is {getattr(self, name)}: it must be positive.")
        if not 0 <= self.reserve < 1:
            raise PlanningError(f"A reserve of {self.reserve} is impossible: give a share from 0 to below 1.")
        if self.waypoints < 4:
            raise PlanningError(f"A mission of {self.waypoints} waypoints has no line: allow 4 or more.")


@dataclass(frozen=True, eq=False)
class Mission:
    """What is flown, in parts of one battery each."""

    camera: FlightCamera
    crs: CRS
    """Of all places, in metres."""
    area: Polygon | MultiPolygon
    relief: Relief
    """What it was planned over."""
    parts: tuple[Part, ...]
    home: tuple[float, float]
    """Where the aircraft takes off and lands, east and north, m."""
    height: float
    """Above the surface (above its highest place if the altitude is constant), m."""
    base: float
    """Distance of releases, m."""
    spacing: float
    """Distance of lines, m."""
    direction: float
    """Of the first line, degrees clockwise from north; the camera keeps it on all lines."""
    speed: float
    """Over ground, m/s."""
    aircraft: Aircraft

    @property
    def gsd(self) -> float:
        """On the surface, m."""
        return self.height * self.camera.pixel_size / self.camera.focal_length

    @property
    def interval(self) -> float:
        """Between two releases, s."""
        return self.base / self.speed

    @property
    def photographs(self) -> int:
        """Number of all parts."""
        return sum(part.photographs for part in self.parts)

    @property
    def minutes(self) -> float:
        """Of flight, all parts together."""
        return sum(part.seconds for part in self.parts) / 60

    def __str__(self) -> str:
        return (
            f"{self.camera.name}: {self.height:.0f} m above the surface (GSD {100 * self.gsd:.1f} cm), "
            f"{len({leg.line for part in self.parts for leg in part.legs})} lines {self.spacing:.1f} m "
            f"apart in direction {self.direction:.0f}, a photograph every {self.base:.1f} m "
            f"({self.interval:.1f} s at {self.speed:.1f} m/s), {self.photographs} photographs, "
            f"{self.minutes:.0f} min of flight, {len(self.parts)} batteries"
        )


def plan_mission(
    area: Polygon | MultiPolygon,
    crs: CRS,
    camera: FlightCamera,
    *,
    forward_overlap: float,
    side_overlap: float,
    gsd: float | None = None,
    height: float | None = None,
    angle: float | None = None,
    direction: float | None = None,
    surface: xr.DataArray | None = None,
    follow_surface: bool = True,
    home: tuple[float, float] | None = None,
    aircraft: Aircraft = Aircraft(),
) -> Mission:
    """Plan the photographs of an area [orthomosaic paper, appendix A].

    GSD, overlaps and angle are those at the surface: over a canopy, give its surface and not the terrain.

    Parameters
    ----------
    area
        In ``crs``; a multipolygon is flown as its convex hull.
    crs
        Projected, in metres.
    camera
        Whole frames count; the long side of the photograph lies across the lines.
    forward_overlap, side_overlap
        Shares, 0 to below 1.
    gsd, height
        Ground sampling distance (m) or height above the surface (m): one of the two.
    angle
        Intersection angle of neighbouring photographs, degrees, instead of ``forward_overlap``.
    direction
        Of the first line, degrees clockwise from north; along the longer side by default.
    surface
        Heights that are flown over, m, in ``crs``; flat ground by default.
    follow_surface
        Constant height above the surface, never lower; otherwise one altitude, as high above the highest
        place.
    home
        Place of take-off and landing; the first release by default.
    aircraft
        Speed, climb, battery.

    Raises
    ------
    PlanningError
        If a value is impossible, the surface does not cover the lines, or a battery is too small.
    """
    _check(crs, forward_overlap, side_overlap, surface)
    height = _height(camera, gsd, height)
    along = camera.full_frame[1] * camera.pixel_size / camera.focal_length * height
    base = _base(along, forward_overlap, height, angle)
    spacing = (1 - side_overlap) * swath(camera, camera.full_frame[0], height)
    outline = area if isinstance(area, Polygon) else area.convex_hull
    if not isinstance(outline, Polygon):
        raise PlanningError("The area to fly is a line or a point: give a polygon.")
    direction = longest_direction(outline) if direction is None else direction % 360
    lines = flight_lines(outline, direction, spacing, base)
    speed = min(aircraft.fastest, base / aircraft.release_interval)
    relief = _relief(surface, lines, home, along)
    # Half a base around: the next photograph looks at the same places.
    top = relief.highest_within(base / 2)
    ways = [follow(line, top, height, aircraft.climb / speed, _TOLERANCE * height) for line in lines]
    if not follow_surface:
        level = max(float(way[:, 2].max()) for way in ways)
        ways = [np.concatenate([line[[0, -1]], np.full((2, 1), level)], axis=1) for line in lines]
    start = np.array(home if home is not None else lines[0][0])
    budget = Budget(
        start,
        relief,
        min(height, 30.0),
        speed,
        aircraft.climb,
        60 * aircraft.battery * (1 - aircraft.reserve),
        aircraft.waypoints,
    )
    if not np.isfinite(relief.at(start[None])).all():
        raise PlanningError(f"The surface has no height at the place of take-off {tuple(start)}: move it.")
    legs = [
        Leg(i, way, _at_releases(line, way)) for i, (line, way) in enumerate(zip(lines, ways, strict=True))
    ]
    return Mission(
        camera,
        crs,
        area,
        relief,
        split(legs, budget),
        (float(start[0]), float(start[1])),
        height,
        base,
        spacing,
        direction,
        speed,
        aircraft,
    )


def _check(
    crs: CRS,
    forward_overlap: float,
    side_overlap: float,
    surface: xr.DataArray | None,
) -> None:
    if not crs.is_projected or not math.isclose(crs.linear_units_factor[1], 1.0):
        raise PlanningError(f"Flight lines need metres, but the area is in {crs}: reproject it, say to UTM.")
    for name, overlap in (("forward", forward_overlap), ("side", side_overlap)):
        if not 0 <= overlap < 1:
            raise PlanningError(
                f"A {name} overlap of {overlap} is impossible: give 0 to below 1, not per cent."
            )
    if surface is not None and Grid.of(surface).crs != crs:
        raise PlanningError(f"The surface is in {Grid.of(surface).crs}, the area in {crs}: reproject one.")


def _height(camera: FlightCamera, gsd: float | None, height: float | None) -> float:
    """Above the surface, m, as it was asked for or from the GSD."""
    if gsd is not None and height is None:
        height = gsd * camera.focal_length / camera.pixel_size
    elif gsd is not None or height is None:
        raise PlanningError("Give either the ground sampling distance or the height above the surface.")
    if not height > 0:
        raise PlanningError(f"GSD {gsd} or height {height} must be positive, in metres.")
    return height


def _base(along: float, forward_overlap: float, height: float, angle: float | None) -> float:
    if angle is None:
        return (1 - forward_overlap) * along
    base = height * math.tan(math.radians(angle))
    if not 0 < base < along:
        raise PlanningError(
            f"At {angle} degrees neighbours stand {base:.1f} m apart and see {along:.1f} m: they do not "
            "overlap. Give a smaller angle."
        )
    return base


def _relief(
    surface: xr.DataArray | None, lines: list[np.ndarray], home: tuple[float, float] | None, along: float
) -> Relief:
    if surface is None:
        return Relief.flat()
    places = np.concatenate([*lines, np.atleast_2d(home)] if home is not None else lines)
    west, south = places.min(axis=0) - along
    east, north = places.max(axis=0) + along
    return Relief.of(surface, (west, south, east, north))


def _at_releases(line: np.ndarray, way: np.ndarray) -> np.ndarray:
    along = np.hypot(*(way[:, :2] - way[0, :2]).T)
    place = np.hypot(*(line - line[0]).T)
    return np.concatenate([line, np.interp(place, along, way[:, 2])[:, None]], axis=1)
