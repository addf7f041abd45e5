"""Missions as files: QGroundControl plan, MAVLink waypoints, Litchi table."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from pyproj import Transformer

from workbench.planning.batteries import Part
from workbench.planning.mission import Mission

# MAV_CMD and MAV_FRAME of MAVLink's common message set.
_WAYPOINT, _RETURN, _TAKE_OFF, _YAW, _SPEED, _TRIGGER = 16, 20, 22, 115, 178, 206
_ABSOLUTE, _NO_PLACE, _ABOVE_HOME = 0, 2, 3
_LITCHI_ACTIONS = 15
_INTERPOLATED_GIMBAL, _DOWN = 2, -90


class Item(NamedTuple):
    """One item of a MAVLink mission."""

    command: int
    frame: int
    parameters: tuple[float, float, float, float]
    latitude: float = 0.0
    longitude: float = 0.0
    altitude: float = 0.0


class Geographic:
    """Places of a mission as latitude, longitude (WGS 84) and height above the place of take-off."""

    def __init__(self, mission: Mission) -> None:
        self._transform = Transformer.from_crs(mission.crs.to_wkt(), "EPSG:4326", always_xy=True)
        self.ground = float(mission.relief.at(np.array([mission.home]))[0])
        """Height of the place of take-off, m."""
        longitude, latitude = self._transform.transform(*mission.home)
        self.home = (latitude, longitude)

    def __call__(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        longitude, latitude = self._transform.transform(x, y)
        return latitude, longitude, z - self.ground


def mission_items(mission: Mission, part: Part) -> list[Item]:
    """Take-off, way to the first line, lines with releases by distance, way back.

    Heading: every waypoint carries that of the mission, for autopilots that read it there, and a command
    for the others.
    """
    geographic, heading = Geographic(mission), mission.direction
    home = geographic.home

    def waypoint(place: np.ndarray) -> Item:
        return Item(_WAYPOINT, _ABOVE_HOME, (0, 0, 0, heading), *geographic(*place))

    def above(place: np.ndarray) -> Item:
        return waypoint(np.array([*place[:2], part.transit]))

    items = [
        Item(_TAKE_OFF, _ABOVE_HOME, (0, 0, 0, heading), *home, part.transit - geographic.ground),
        Item(_SPEED, _NO_PLACE, (1, mission.speed, -1, 0)),
        Item(_YAW, _NO_PLACE, (heading, 0, 0, 0)),
        above(part.legs[0].way[0]),
    ]
    for leg in part.legs:
        first, *others = leg.way
        items.append(waypoint(first))
        items.append(Item(_TRIGGER, _NO_PLACE, (mission.base, 0, 1, 0)))
        items += [waypoint(place) for place in others]
        items.append(Item(_TRIGGER, _NO_PLACE, (0, 0, 0, 0)))
    items.append(above(part.legs[-1].way[-1]))
    items.append(Item(_RETURN, _NO_PLACE, (0, 0, 0, 0)))
    return items


def qgroundcontrol_plan(mission: Mission, part: Part) -> str:
    """A part as JSON that QGroundControl opens (``.plan``)."""
    geographic = Geographic(mission)
    items = [
        {
            "type": "SimpleItem",
            "autoContinue": True,
            "command": item.command,
            "doJumpId": number,
            "frame": item.frame,
            "params": [
                *item.parameters,
                *(round(value, 8) for value in (item.latitude, item.longitude)),
                round(item.altitude, 2),
            ],
        }
        for number, item in enumerate(mission_items(mission, part), 1)
    ]
    plan = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
        "mission": {
            "version": 2,
            "firmwareType": 12,
            "vehicleType": 2,
            "cruiseSpeed": mission.speed,
            "hoverSpeed": mission.speed,
            "plannedHomePosition": [*(round(v, 8) for v in geographic.home), round(geographic.ground, 2)],
            "items": items,
        },
    }
    return json.dumps(plan, indent=1) + "\n"


def mavlink_waypoints(mission: Mission, part: Part) -> str:
    """A part in MAVLink's plain text (``QGC WPL 110``); item 0 is the place of take-off."""
    geographic = Geographic(mission)
    home = Item(_WAYPOINT, _ABSOLUTE, (0, 0, 0, 0), *geographic.home, geographic.ground)
    lines = ["QGC WPL 110"]
    for number, item in enumerate([home, *mission_items(mission, part)]):
        parameters = [f"{value:.6f}" for value in item.parameters]
        place = [f"{item.latitude:.8f}", f"{item.longitude:.8f}", f"{item.altitude:.2f}"]
        lines.append(
            "\t".join([str(number), str(int(number == 0)), str(item.frame), str(item.command), *parameters])
            + "\t"
            + "\t".join([*place, "1"])
        )
    return "\n".join(lines) + "\n"


def litchi_table(mission: Mission, part: Part) -> str:
    """A part as the table that Litchi imports; heights above the place of take-off."""
    geographic = Geographic(mission)
    actions = [f"action{kind}{n}" for n in range(1, _LITCHI_ACTIONS + 1) for kind in ("type", "param")]
    header = [
        "latitude", "longitude", "altitude(m)", "heading(deg)", "curvesize(m)", "rotationdir", "gimbalmode",
        "gimbalpitchangle", *actions, "altitudemode", "speed(m/s)", "poi_latitude", "poi_longitude",
        "poi_altitude(m)", "poi_altitudemode", "photo_timeinterval", "photo_distinterval",
    ]  # fmt: skip
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(header)
    for place, releasing in _litchi_places(part):
        latitude, longitude, altitude = geographic(*place)
        interval = round(mission.base, 2) if releasing else -1
        writer.writerow(
            [
                f"{latitude:.8f}", f"{longitude:.8f}", f"{altitude:.1f}", f"{mission.direction:.0f}", 0, 0,
                _INTERPOLATED_GIMBAL, _DOWN, *([-1, 0] * _LITCHI_ACTIONS), 0, f"{mission.speed:.2f}", 0, 0, 0,
                0, -1, interval,
            ]
        )  # fmt: skip
    return file.getvalue()


def _litchi_places(part: Part) -> Iterator[tuple[tuple[float, float, float], bool]]:
    """Places with whether photographs are taken from there on."""
    first, last = part.legs[0].way[0], part.legs[-1].way[-1]
    yield (float(first[0]), float(first[1]), part.transit), False
    for leg in part.legs:
        for number, (x, y, z) in enumerate(leg.way):
            yield (float(x), float(y), float(z)), number < len(leg.way) - 1
    yield (float(last[0]), float(last[1]), part.transit), False
