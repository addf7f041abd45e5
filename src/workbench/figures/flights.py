"""Interactive look at virtual flights: one place, photographed by two cameras in neighbouring exposures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np
import pandas as pd
import panel as pn
from matplotlib.figure import Figure

from workbench.errors import SceneError
from workbench.params import SimulateParameters
from workbench.virtual.flight import Exposure, Flight
from workbench.virtual.flight_cameras import flight_camera_names
from workbench.virtual.photograph import take_photograph
from workbench.virtual.scene import Scene
from workbench.virtual.stage import conditions_of, flight_of, fly_scene

_WINDOW = (360, 270)


@dataclass(frozen=True, eq=False)
class FlightLook:
    """A place as two neighbouring exposures of one flight see it."""

    flight: Flight
    """The whole flight."""
    pictures: tuple[np.ndarray, ...]
    """(row, column, 3) uint8, the windows around the place; fewer than two if only one exposure sees it."""
    facts: dict[str, float]
    """Height (m), base (m), angle (degrees), photographs: what the overlaps and the GSD decide."""


def flights_panel(scene: Scene, *, cameras: tuple[str, str] = ("MACS MAR", "DMC I")) -> pn.Column:
    """Fly a scene with two cameras; sliders for resolution, overlap, wind, hour and clouds.

    Parameters
    ----------
    scene
        A built scene; its middle is looked at.
    cameras
        What is flown first.
    """
    names = [name for name in flight_camera_names() if name != "3K"]
    first = pn.widgets.Select(name="first camera", options=names, value=cameras[0])
    second = pn.widgets.Select(name="second camera", options=names, value=cameras[1])
    gsd = pn.widgets.DiscreteSlider(name="GSD, m", options=[0.03, 0.05, 0.09, 0.15, 0.2, 0.3], value=0.15)
    overlap = pn.widgets.FloatSlider(name="forward overlap", start=0.6, end=0.95, step=0.05, value=0.8)
    wind = pn.widgets.FloatSlider(name="wind, m/s", start=0, end=10, step=0.5, value=scene.spec.flight.wind)
    hour = pn.widgets.IntSlider(name="hour, UTC", start=6, end=16, value=scene.spec.flight.time.hour)
    clouds = pn.widgets.FloatSlider(name="clouds", start=0, end=1, step=0.25, value=0)
    seen = pn.bind(
        lambda a, b, *values: _drawn(scene, (a, b), *values),
        first,
        second,
        gsd.param.value_throttled,
        overlap.param.value_throttled,
        wind.param.value_throttled,
        hour.param.value_throttled,
        clouds.param.value_throttled,
    )
    return pn.Column(pn.Row(first, second, gsd, overlap), pn.Row(wind, hour, clouds), seen)


def look(
    scene: Scene,
    camera: str,
    *,
    gsd: float,
    forward_overlap: float,
    wind: float,
    time: datetime,
    cloudiness: float = 0.0,
    window: tuple[int, int] = _WINDOW,
) -> FlightLook:
    """Photograph the middle of a scene in two neighbouring exposures of one strip.

    Parameters
    ----------
    scene
        A built scene.
    camera
        One of :func:`workbench.virtual.flight_cameras.flight_camera_names`, not a rig.
    gsd, forward_overlap, wind, time, cloudiness
        As in the flight of a scene.
    window
        Columns and rows of the pictures, px.

    Raises
    ------
    SceneError
        If the flight is impossible, or no exposure sees the middle of the scene.
    """
    settings = SimulateParameters()
    overrides = {
        "camera": camera,
        "frame": None,
        "gsd": gsd,
        "height": None,
        "forward_overlap": forward_overlap,
        "strips": 1,
        "wind": wind,
        "time": time,
        "cloudiness": cloudiness,
    }
    plan = flight_of(scene.spec.flight, settings, overrides)
    flight = fly_scene(scene, plan, settings)
    conditions = conditions_of(plan, settings)
    # A window off the middle would be darkened as if it were the whole frame.
    conditions = replace(conditions, optics=replace(conditions.optics, vignetting=0.0))
    pictures = tuple(
        take_photograph(scene, _windowed(flight, exposure, place, window), exposure, conditions).pixels
        for exposure, place in _nearest(scene, flight, window)
    )
    facts = {
        "height, m": round(flight.height, 1),
        "base, m": round(flight.base, 1),
        "angle, degrees": round(flight.intersection_angle, 2),
        "photographs": float(len(flight.exposures)),
    }
    return FlightLook(flight, pictures, facts)


def draw_looks(looks: dict[str, FlightLook]) -> Figure:
    """One row of pictures a camera: the exposure over the place, and the next one."""
    columns = max(len(one.pictures) for one in looks.values())
    made = Figure(figsize=(4.0 * columns, 3.2 * len(looks)), layout="constrained")
    axes = made.subplots(len(looks), columns, squeeze=False)
    for row, (name, one) in zip(axes, looks.items(), strict=True):
        for column, cell in enumerate(row):
            cell.set_axis_off()
            if column < len(one.pictures):
                cell.imshow(one.pictures[column])
                cell.set_title(f"{name}, {'nearest' if column == 0 else 'next'} exposure", fontsize=9)
    return made


def _drawn(
    scene: Scene,
    cameras: tuple[str, str],
    gsd: float,
    overlap: float,
    wind: float,
    hour: int,
    clouds: float,
) -> pn.Column | pn.pane.Alert:
    day = scene.spec.flight.time
    time = day.replace(hour=0, minute=0) + timedelta(hours=hour)
    try:
        looks = {
            name: look(scene, name, gsd=gsd, forward_overlap=overlap, wind=wind, time=time, cloudiness=clouds)
            for name in cameras
        }
    except SceneError as error:
        return pn.pane.Alert(str(error), alert_type="warning")
    table = pd.DataFrame({name: one.facts for name, one in looks.items()}).T
    return pn.Column(pn.pane.Matplotlib(draw_looks(looks), tight=True, width=760), pn.pane.DataFrame(table))


def _nearest(
    scene: Scene, flight: Flight, window: tuple[int, int]
) -> list[tuple[Exposure, tuple[float, float]]]:
    """The exposure nearest to the middle of the scene and its neighbour, with where they see that place."""
    west, south, east, north = scene.extent
    x, y = (west + east) / 2, (south + north) / 2
    place = np.array([x, y, float(scene.ground_z(np.array([x]), np.array([y]))[0])])
    order = sorted(flight.exposures, key=lambda e: float(np.hypot(*(e.pose.centre[:2] - place[:2]))))
    camera = flight.camera.camera
    found = []
    for exposure in order[:2]:
        column, row = camera.project(exposure.pose.to_camera(place[None]))[0]
        low, high = np.array(window) / 2, np.array(flight.camera.frame) - np.array(window) / 2
        if np.all((low <= (column, row)) & ((column, row) <= high)):
            found.append((exposure, (float(column), float(row))))
    if not found:
        raise SceneError("No exposure sees the middle of the scene: raise the overlap.")
    return found


def _windowed(
    flight: Flight, exposure: Exposure, place: tuple[float, float], window: tuple[int, int]
) -> Flight:
    """The flight with only a window of every photograph, around an image position."""
    whole = np.array(flight.camera.frame)
    corner = np.round(np.array(place) - np.array(window) / 2)
    offset = np.array(flight.camera.principal_offset) + whole / 2 - (corner + np.array(window) / 2)
    camera = replace(flight.camera, frame=window, principal_offset=(float(offset[0]), float(offset[1])))
    return replace(flight, camera=camera, exposures=(exposure,))
