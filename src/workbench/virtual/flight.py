"""Flights: from overlaps and ground resolution to exposures, with what the navigation records of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from shapely.geometry import Polygon, box

from workbench.cameras import Camera, Pose, intersection_angle
from workbench.errors import SceneError
from workbench.virtual.flight_cameras import FlightCamera

_STEADINESS = 0.7  # Correlation of the disturbances of two neighbouring exposures.
_TURN = 40.0  # Seconds from the end of a strip to the start of the next.
_CLEARANCE = 2.0  # Metres that must be left above the highest object.


@dataclass(frozen=True)
class Disturbance:
    """How the aircraft departs from its plan; all zero flies the plan itself."""

    trigger: float = 0.0
    """Standard deviation of the moment of release, s."""
    attitude: float = 0.0
    """Standard deviation of roll, pitch and heading, degrees."""
    track: float = 0.0
    """Standard deviation of cross-track position and of height, as a share of the height above ground."""


@dataclass(frozen=True)
class NavigationErrors:
    """How far the recorded positions and angles are from the truth."""

    position_sd: tuple[float, float] = (0.0, 0.0)
    """Standard deviation of x and of y, and of z, m."""
    attitude_sd: tuple[float, float] = (0.0, 0.0)
    """Standard deviation of roll and of pitch, and of heading, degrees."""
    bias_share: float = 0.0
    """Share of the variance that is one bias of the flight, 0..1."""
    drift_share: float = 0.0
    """Share of the variance that drifts from strip to strip, 0..1; the rest is noise."""


@dataclass(frozen=True, eq=False)
class Exposure:
    """One photograph of a flight."""

    name: str
    """Path below the folder of photographs, without suffix."""
    mount: int
    """Index of the camera of the rig."""
    release: int
    """Number of the release, from 0; cameras of a rig share it, and with it the wind."""
    time: datetime
    """Moment of the exposure."""
    strip: int
    """From 0."""
    order: int
    """Place in the strip, from 0."""
    pose: Pose
    """True pose, in the CRS of the scene."""
    attitude: tuple[float, float, float]
    """True roll, pitch and heading (from grid north) of the aircraft, degrees."""
    velocity: np.ndarray
    """(3,) m/s."""
    recorded_position: tuple[float, float, float]
    """x, y, z as the navigation records them, m."""
    recorded_attitude: tuple[float, float, float]
    """Roll, pitch and heading (from grid north) as recorded, degrees."""


@dataclass(frozen=True, eq=False)
class Flight:
    """All exposures of a flight and the figures that they were planned with."""

    camera: FlightCamera
    """What was flown."""
    exposures: tuple[Exposure, ...]
    """In order of time, cameras of a rig one after the other."""
    ground: float
    """Height of the ground that the plan refers to, m."""
    height: float
    """Of flight above it, m."""
    gsd: float
    """Ground sampling distance of a camera that looks straight down, m."""
    base: float
    """Planned distance of neighbouring exposures, m."""
    spacing: float
    """Planned distance of neighbouring strips, m."""
    forward_overlap: float
    """Planned for whole frames, 0..1."""
    side_overlap: float
    """Planned for whole frames (of a rig: its swath), 0..1."""
    direction: float
    """Of the first strip, degrees clockwise from north."""
    errors: NavigationErrors
    """Standard deviations that the navigation states."""

    @property
    def intersection_angle(self) -> float:
        """Of neighbouring photographs of a strip at the image centre, degrees."""
        camera = self.camera
        return intersection_angle(
            self.forward_overlap, camera.full_frame[1], camera.pixel_size, camera.focal_length
        )

    @property
    def strips(self) -> int:
        """Number of strips."""
        return 1 + max(exposure.strip for exposure in self.exposures)

    def footprint(self, exposure: Exposure, z: float | None = None) -> Polygon:
        """What a photograph sees of a plane at height ``z`` (the ground by default), in the CRS."""
        return footprint(self.camera.camera, exposure.pose, self.ground if z is None else z)


def plan_flight(
    extent: tuple[float, float, float, float],
    camera: FlightCamera,
    *,
    ground: float,
    start: datetime,
    forward_overlap: float,
    side_overlap: float,
    gsd: float | None = None,
    height: float | None = None,
    direction: float = 90.0,
    strips: int | None = None,
    run_in: float = 0.0,
    crossing: bool = False,
    speed: float = 50.0,
    highest: float | None = None,
    disturbance: Disturbance | None = None,
    errors: NavigationErrors | None = None,
    seed: int = 0,
) -> Flight:
    """Plan and fly an area: exposures with true poses and recorded navigation.

    Strips are flown to and fro, centred on the area; one more base is flown at either end. Overlaps
    and the base follow the whole frame of the camera, also where only its middle is kept. Of a rig, the
    photographs that look past the area are left out.

    Parameters
    ----------
    extent
        West, south, east, north, m.
    camera
        Camera or rig.
    ground
        Height of the ground that GSD, height and overlaps refer to, m.
    start
        Moment of the first exposure, with its time zone.
    forward_overlap, side_overlap
        Shares, 0 to below 1; the side overlap of a rig is that of its swath.
    gsd, height
        Ground sampling distance (m) or height above ground (m): one of the two.
    direction
        Of the first strip, degrees clockwise from north.
    strips
        Their number; as many as cover the area by default.
    run_in
        Lengths of a frame flown beyond the area at either end: with half a frame every place of a small
        area is seen by as many photographs as in a large block.
    crossing
        Fly a second set at right angles.
    speed
        Over ground, m/s.
    highest
        Highest tree top or roof, m; the flight must be above it.
    disturbance, errors
        None by default.
    seed
        Same seed, same flight.

    Raises
    ------
    SceneError
        If overlaps are impossible, both or neither of GSD and height are given, the flight is not
        above the highest object, or the frames that are kept leave gaps.
    """
    _check(camera, forward_overlap, side_overlap, start)
    gsd = _resolution(camera, gsd, height)
    height = gsd * camera.focal_length / camera.pixel_size
    if highest is not None and ground + height <= highest + _CLEARANCE:
        raise SceneError(
            f"A flight at {ground + height:.1f} m is not above the highest object ({highest:.1f} m): "
            "raise the GSD or the height."
        )
    base = (1 - forward_overlap) * camera.full_frame[1] * gsd
    spacing = (1 - side_overlap) * swath(camera, camera.full_frame[0], height)
    kept = swath(camera, camera.frame[0], height)
    if camera.frame[1] * gsd <= base:
        raise SceneError(
            f"{camera.name}: the {camera.frame[1]} rows that are kept see {camera.frame[1] * gsd:.1f} m, the "
            f"base is {base:.1f} m: neighbours do not overlap. Keep more rows or raise the forward overlap."
        )
    turns = (0.0, 90.0) if crossing else (0.0,)
    beyond = run_in * camera.full_frame[1] * gsd
    runs = [_runs(extent, direction + t, base, spacing, kept, strips, camera.name, beyond) for t in turns]
    exposures = _fly(
        [run for set_of_strips in runs for run in set_of_strips],
        camera,
        ground + height,
        height,
        base,
        start,
        speed,
        disturbance or Disturbance(),
        errors or NavigationErrors(),
        seed,
    )
    if len(camera.tilts) > 1:
        exposures = _that_see(extent, camera.camera, exposures, ground)
    return Flight(
        camera,
        exposures,
        ground,
        height,
        gsd,
        base,
        spacing,
        forward_overlap,
        side_overlap,
        direction,
        errors or NavigationErrors(),
    )


def swath(camera: FlightCamera, columns: int, height: float) -> float:
    """Width on flat ground that a camera or rig sees across track with so many columns, m."""
    half = math.atan(columns * camera.pixel_size / 2 / camera.focal_length)
    left, right = math.radians(min(camera.tilts)) - half, math.radians(max(camera.tilts)) + half
    return height * (math.tan(right) - math.tan(left))


def footprint(camera: Camera, pose: Pose, z: float, steps: int = 8) -> Polygon:
    """Border of a photograph on a plane at height ``z``, in the frame of the pose.

    Raises
    ------
    SceneError
        If a border ray does not go down.
    """
    t = np.linspace(0, 1, steps, endpoint=False)
    w, h = camera.width, camera.height
    sides = [(t * w, 0 * t), (w + 0 * t, t * h), (w - t * w, h + 0 * t), (0 * t, h - t * h)]
    rays = pose.to_world(camera.rays(np.concatenate([np.stack(side, axis=-1) for side in sides])))
    if np.any(rays[:, 2] >= 0):
        raise SceneError("The photograph sees the horizon: its footprint has no end.")
    reach = (z - pose.centre[2]) / rays[:, 2]
    return Polygon(pose.centre[:2] + reach[:, None] * rays[:, :2])


def _that_see(
    extent: tuple[float, float, float, float],
    camera: Camera,
    exposures: tuple[Exposure, ...],
    ground: float,
) -> tuple[Exposure, ...]:
    """Exposures whose footprint meets the area."""
    area = box(*extent)
    seeing = tuple(e for e in exposures if footprint(camera, e.pose, ground).intersects(area))
    if not seeing:
        raise SceneError("No camera of the rig sees the area: fly more strips, or with another side overlap.")
    return seeing


@dataclass(frozen=True, eq=False)
class _Run:
    """One planned strip."""

    points: np.ndarray
    """(n, 2) places of release, in order of flight."""
    heading: float
    """Degrees clockwise from north."""


def _check(
    camera: FlightCamera,
    forward_overlap: float,
    side_overlap: float,
    start: datetime,
) -> None:
    for name, overlap in (("Forward", forward_overlap), ("Side", side_overlap)):
        if not 0 <= overlap < 1:
            raise SceneError(
                f"{name} overlap {overlap} is impossible: give a share from 0 to below 1, not per cent."
            )
    if start.tzinfo is None:
        raise SceneError(f"The time of the flight, {start}, needs a time zone: the sun depends on it.")
    if max(map(abs, camera.tilts)) >= 70:
        raise SceneError(f"Camera {camera.name} is tilted to the horizon: 70 degrees are too much.")


def _resolution(camera: FlightCamera, gsd: float | None, height: float | None) -> float:
    """Ground sampling distance, m, as it was asked for or from the height."""
    if height is not None and gsd is None:
        gsd = height * camera.pixel_size / camera.focal_length
    elif height is not None or gsd is None:
        raise SceneError("Give either the ground sampling distance or the height above ground.")
    if not gsd > 0:
        raise SceneError(f"GSD {gsd} or height {height} must be positive, in metres.")
    return gsd


def _runs(
    extent: tuple[float, float, float, float],
    direction: float,
    base: float,
    spacing: float,
    kept: float,
    strips: int | None,
    name: str,
    beyond: float,
) -> list[_Run]:
    west, south, east, north = extent
    if not (west < east and south < north):
        raise SceneError(f"The area {extent} is empty: give west < east and south < north.")
    middle = np.array([(west + east) / 2, (south + north) / 2])
    angle = math.radians(direction)
    along, across = (
        np.array([math.sin(angle), math.cos(angle)]),
        np.array([math.cos(angle), -math.sin(angle)]),
    )
    corners = np.array([(x, y) for x in (west, east) for y in (south, north)]) - middle
    length, width = np.ptp(corners @ along), np.ptp(corners @ across)
    number = strips or max(1, math.ceil((width - kept) / spacing) + 1)
    if number > 1 and kept <= spacing:
        raise SceneError(
            f"{name}: strips lie {spacing:.1f} m apart, the columns that are kept see {kept:.1f} m: "
            "gaps remain. Keep more columns, raise the side overlap, or fly one strip."
        )
    releases = math.ceil((length + 2 * beyond) / base) + 3
    steps = (np.arange(releases) - (releases - 1) / 2) * base
    runs = []
    for index in range(number):
        line = middle + (index - (number - 1) / 2) * spacing * across
        sense = 1 if index % 2 == 0 else -1
        heading = direction if sense == 1 else direction + 180
        runs.append(_Run(line + sense * steps[:, None] * along, heading % 360))
    return runs


def _fly(
    runs: list[_Run],
    camera: FlightCamera,
    altitude: float,
    height: float,
    base: float,
    start: datetime,
    speed: float,
    disturbance: Disturbance,
    errors: NavigationErrors,
    seed: int,
) -> tuple[Exposure, ...]:
    rng = np.random.default_rng([seed, 41])
    total = sum(len(run.points) for run in runs)
    strip_of = np.repeat(np.arange(len(runs)), [len(run.points) for run in runs])
    late = rng.normal(0, 1, total) * disturbance.trigger
    turned = _steady(rng, total, 3) * disturbance.attitude
    pushed = _steady(rng, total, 2) * disturbance.track * height
    sd = np.array([errors.position_sd[0]] * 2 + [errors.position_sd[1]])
    moved = _errors(rng, strip_of, errors) * sd
    sd = np.array([errors.attitude_sd[0]] * 2 + [errors.attitude_sd[1]])
    misread = _errors(rng, strip_of, errors) * sd
    exposures: list[Exposure] = []
    clock, release = 0.0, 0
    for strip, run in enumerate(runs):
        angle = math.radians(run.heading)
        along = np.array([math.sin(angle), math.cos(angle), 0.0])
        right = np.array([math.cos(angle), -math.sin(angle), 0.0])
        for order, point in enumerate(run.points):
            centre = np.array([*point, altitude]) + speed * late[release] * along
            centre = centre + pushed[release, 0] * right + (0, 0, pushed[release, 1])
            attitude = tuple(float(v) for v in turned[release] + (0, 0, run.heading))
            moment = start + timedelta(seconds=round(clock + order * base / speed + late[release], 6))
            for mount, (tilt, folder) in enumerate(zip(camera.tilts, camera.folders, strict=True)):
                exposures.append(
                    Exposure(
                        f"{folder}/{folder}_{release + 1:04d}" if folder else f"IMG_{release + 1:04d}",
                        mount,
                        release,
                        moment,
                        strip,
                        order,
                        Pose.from_roll_pitch_heading(centre, *attitude, tilt_right=tilt),
                        attitude,  # type: ignore[arg-type]
                        speed * along,
                        tuple(float(v) for v in centre + moved[release]),  # type: ignore[arg-type]
                        tuple(float(v) for v in np.array(attitude) + misread[release]),  # type: ignore[arg-type]
                    )
                )
            release += 1
        clock += (len(run.points) - 1) * base / speed + _TURN
    return tuple(exposures)


def _steady(rng: np.random.Generator, number: int, axes: int) -> np.ndarray:
    """(number, axes) of standard deviation 1 that change slowly from one exposure to the next."""
    fresh = rng.normal(0, 1, (number, axes))
    values = fresh.copy()
    for i in range(1, number):
        values[i] = _STEADINESS * values[i - 1] + math.sqrt(1 - _STEADINESS**2) * fresh[i]
    return values


def _errors(rng: np.random.Generator, strip_of: np.ndarray, errors: NavigationErrors) -> np.ndarray:
    """(n, 3) of standard deviation 1 over many flights: bias, drift from strip to strip, noise."""
    noise_share = 1 - errors.bias_share - errors.drift_share
    if min(errors.bias_share, errors.drift_share) < 0 or noise_share < -1e-9:
        raise SceneError(
            f"Shares of bias {errors.bias_share} and drift {errors.drift_share} exceed the whole variance: "
            "keep their sum at 1 or below."
        )
    number, strips = len(strip_of), int(strip_of[-1]) + 1
    bias = rng.normal(0, 1, 3)
    walk = _steady(rng, strips, 3)
    noise = rng.normal(0, 1, (number, 3))
    return (
        math.sqrt(errors.bias_share) * bias
        + math.sqrt(errors.drift_share) * walk[strip_of]
        + math.sqrt(max(noise_share, 0)) * noise
    )
