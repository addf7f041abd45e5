"""Missions: lines, heights, batteries and files, on cases whose answers are known."""

from __future__ import annotations

import csv
import io
import json
import math

import geopandas as gpd
import numpy as np
import pytest
import shapely
from pyproj import Transformer
from rasterio.crs import CRS

from workbench.errors import PlanningError
from workbench.planning import Aircraft, plan_files, plan_mission, reached
from workbench.planning.export import litchi_table, mavlink_waypoints, mission_items, qgroundcontrol_plan
from workbench.planning.purpose import advised_overlaps
from workbench.rasters import Grid, new_raster, write_raster
from workbench.vectors import write_layers
from workbench.virtual.flight_cameras import flight_camera

UTM = CRS.from_epsg(25832)
FIELD = shapely.box(500000, 5600000, 500200, 5600100)
DRONE = flight_camera("DJI FC6310")
ASKED = {"gsd": 0.02, "forward_overlap": 0.8, "side_overlap": 0.7}


def surface(heights, west=499800.0, north=5600300.0, cell=2.0):
    grid = Grid(UTM, west, north, cell, heights.shape[1], heights.shape[0])
    return new_raster(heights.astype(np.float32), grid, name="height", units="m")


def hill(x, y):
    """A ridge of 40 m across the field."""
    return 300 + 40 * np.exp(-(((x - 500100) / 60) ** 2)) + 0 * y


def over_hill():
    x, y = np.meshgrid(499800 + 2 * np.arange(300) + 1.0, 5600300 - 2 * np.arange(250) - 1.0)
    return surface(hill(x, y))


def all_releases(mission):
    return np.concatenate([leg.releases for part in mission.parts for leg in part.legs])


def test_base_spacing_and_height_follow_the_arithmetic_of_overlaps():
    mission = plan_mission(FIELD, UTM, DRONE, **ASKED)
    columns, rows = DRONE.full_frame
    assert mission.height == pytest.approx(0.02 * DRONE.focal_length / DRONE.pixel_size)
    assert mission.base == pytest.approx(0.2 * rows * 0.02)
    assert mission.spacing == pytest.approx(0.3 * columns * 0.02)
    assert mission.direction == pytest.approx(90)
    table = reached(mission)
    assert table.forward_overlap.to_numpy() == pytest.approx(0.8)
    assert table.side_overlap_least.to_numpy() == pytest.approx(0.7)
    assert table.gsd_m.to_numpy() == pytest.approx(0.02)


def test_an_angle_may_be_asked_for_instead_of_the_forward_overlap():
    mission = plan_mission(FIELD, UTM, DRONE, height=60, forward_overlap=0.8, side_overlap=0.7, angle=6)
    assert reached(mission).angle_deg.to_numpy() == pytest.approx(6)
    with pytest.raises(PlanningError, match="do not overlap"):
        plan_mission(FIELD, UTM, DRONE, height=60, forward_overlap=0.8, side_overlap=0.7, angle=70)


@pytest.mark.parametrize("direction", [0.0, 33.0, 90.0, 200.0])
def test_every_place_of_the_area_is_in_as_many_photographs_as_overlaps_promise(direction):
    mission = plan_mission(FIELD, UTM, DRONE, direction=direction, **ASKED)
    releases = all_releases(mission)
    angle = math.radians(direction)
    along = np.array([math.sin(angle), math.cos(angle)])
    across = np.array([math.cos(angle), -math.sin(angle)])
    half = np.array(DRONE.full_frame) * 0.02 / 2
    for place in np.random.default_rng(1).uniform((500000, 5600000), (500200, 5600100), (100, 2)):
        offset = releases[:, :2] - place
        seen = (np.abs(offset @ along) <= half[1]) & (np.abs(offset @ across) <= half[0])
        # Five in a line at 80 %, at least three lines at 70 %.
        assert seen.sum() >= 5 * 3 - 3


def test_neighbouring_lines_are_flown_to_and_fro():
    mission = plan_mission(FIELD, UTM, DRONE, **ASKED)
    legs = [leg for part in mission.parts for leg in part.legs]
    headings = [np.sign(leg.way[-1, 0] - leg.way[0, 0]) for leg in legs]
    assert headings == [(-1.0) ** i for i in range(len(legs))]


def test_over_a_ridge_the_way_is_never_lower_and_hardly_higher_than_asked_for():
    mission = plan_mission(FIELD, UTM, DRONE, surface=over_hill(), **ASKED)
    releases = all_releases(mission)
    above = releases[:, 2] - hill(releases[:, 0], releases[:, 1])
    assert above.min() >= mission.height - 0.5
    # Half a base up the flank, the tolerance, and cells of two metres.
    steepest = 40 / 60 * math.sqrt(2 / math.e)
    assert above.max() <= mission.height * 1.04 + (mission.base / 2 + 4) * steepest + 0.5
    slopes = [
        np.abs(np.diff(leg.way[:, 2])) / np.hypot(*np.diff(leg.way[:, :2], axis=0).T)
        for part in mission.parts
        for leg in part.legs
    ]
    assert np.concatenate(slopes).max() <= 1.05 * mission.aircraft.climb / mission.speed
    table = reached(mission)
    assert table.forward_overlap_least.min() > 0.75


def test_a_constant_altitude_is_as_high_above_the_highest_place():
    mission = plan_mission(FIELD, UTM, DRONE, surface=over_hill(), follow_surface=False, **ASKED)
    releases = all_releases(mission)
    assert np.ptp(releases[:, 2]) == 0
    assert releases[0, 2] == pytest.approx(340 + mission.height, abs=0.05 * mission.height)
    table = reached(mission)
    assert table.gsd_m.max() > 1.4 * table.gsd_m.min()


def test_batteries_end_in_time_and_no_photograph_is_lost_between_them():
    aircraft = Aircraft(battery=6)
    whole = plan_mission(FIELD, UTM, DRONE, aircraft=Aircraft(battery=90), **ASKED)
    mission = plan_mission(FIELD, UTM, DRONE, aircraft=aircraft, **ASKED)
    assert len(whole.parts) == 1 and len(mission.parts) > 1
    assert all(part.seconds <= 6 * 60 * 0.75 for part in mission.parts)
    places = {tuple(np.round(place, 3)) for place in all_releases(whole)}
    assert {tuple(np.round(place, 3)) for place in all_releases(mission)} == places
    with pytest.raises(PlanningError, match="take off nearer"):
        plan_mission(FIELD, UTM, DRONE, home=(505000, 5600000), aircraft=aircraft, **ASKED)


def test_approach_and_return_pass_above_what_lies_between():
    mission = plan_mission(
        shapely.box(500160, 5600000, 500200, 5600100),
        UTM,
        DRONE,
        surface=over_hill(),
        home=(499900.0, 5600050.0),
        **ASKED,
    )
    assert all(part.transit >= 340 + 29 for part in mission.parts)


def test_files_hold_the_same_places_and_the_camera_keeps_its_heading():
    mission = plan_mission(FIELD, UTM, DRONE, surface=over_hill(), direction=45, **ASKED)
    part = mission.parts[0]
    home = float(mission.relief.at(np.array([mission.home]))[0])
    back = Transformer.from_crs("EPSG:4326", UTM.to_wkt(), always_xy=True)
    corners = np.concatenate([leg.way for leg in part.legs])

    plan = json.loads(qgroundcontrol_plan(mission, part))
    items = plan["mission"]["items"]
    flown = [i["params"] for i in items if i["command"] == 16][1:-1]
    x, y = back.transform([p[5] for p in flown], [p[4] for p in flown])
    assert np.stack([x, y], axis=1) == pytest.approx(corners[:, :2], abs=0.01)
    assert np.array([p[6] for p in flown]) + home == pytest.approx(corners[:, 2], abs=0.01)
    assert {p[3] for p in flown} == {45.0}
    triggers = [i["params"][0] for i in items if i["command"] == 206]
    assert triggers == [mission.base, 0] * len(part.legs)
    assert items[0]["command"] == 22 and items[-1]["command"] == 20
    assert plan["fileType"] == "Plan" and len(plan["mission"]["plannedHomePosition"]) == 3

    lines = mavlink_waypoints(mission, part).splitlines()
    assert lines[0] == "QGC WPL 110"
    fields = [line.split("\t") for line in lines[1:]]
    assert all(len(row) == 12 for row in fields) and [int(row[0]) for row in fields] == list(
        range(len(fields))
    )
    assert [int(row[3]) for row in fields[1:]] == [item.command for item in mission_items(mission, part)]

    table = list(csv.DictReader(io.StringIO(litchi_table(mission, part))))
    assert len(table) == part.corners <= 99
    assert len(table[0]) == 46
    assert {row["heading(deg)"] for row in table} == {"45"}
    assert {row["gimbalpitchangle"] for row in table} == {"-90"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"forward_overlap": 80}, "not per cent"),
        ({"side_overlap": 1.0}, "side overlap"),
        ({"height": 50}, "either"),
        ({"gsd": None}, "either"),
        ({"gsd": -0.1}, "positive"),
        ({"surface": surface(np.full((9, 9), 300.0), west=600000)}, "does not meet"),
        ({"surface": surface(np.full((150, 150), 300.0))}, "no height at"),
        ({"aircraft": Aircraft(battery=0.5)}, "battery"),
    ],
)
def test_what_cannot_be_flown_is_refused_with_the_remedy(change, message):
    with pytest.raises(PlanningError, match=message):
        plan_mission(FIELD, UTM, DRONE, **(ASKED | change))


def test_degrees_are_refused():
    with pytest.raises(PlanningError, match="metres"):
        plan_mission(shapely.box(10, 50, 10.01, 50.01), CRS.from_epsg(4326), DRONE, **ASKED)


@pytest.mark.parametrize("change", [{"battery": 0}, {"reserve": 1.0}, {"waypoints": 2}])
def test_impossible_aircraft_are_refused(change):
    with pytest.raises(PlanningError):
        Aircraft(**change)


def test_a_mission_from_files_over_a_canopy_for_a_purpose(tmp_path):
    area = tmp_path / "area.gpkg"
    write_layers({"area": gpd.GeoDataFrame({"geometry": [FIELD]}, crs=UTM).to_crs(4326)}, area)
    canopy = tmp_path / "dsm.tif"
    write_raster(over_hill(), canopy)
    options, advice = advised_overlaps("DJI FC6310", "conifer", 25.0, over_canopy=True, highest=120.0)
    mission = plan_files(area, DRONE, tmp_path / "out", surface=canopy, **options)
    table = gpd.read_file(tmp_path / "out" / "mission.gpkg", layer="photographs")
    assert len(table) == mission.photographs
    assert mission.height == pytest.approx(120 - 25)
    assert table["angle_deg"].median() == pytest.approx(advice.angle_canopy, abs=0.7)
    suffixes = sorted(path.name.partition(".")[2] for path in (tmp_path / "out").glob("part_1.*"))
    assert suffixes == ["litchi.csv", "plan", "waypoints"]
    # The same mission gives the same bytes.
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    plan_files(area, DRONE, tmp_path / "out", surface=canopy, **options)
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before


def test_an_area_of_points_is_refused(tmp_path):
    write_layers({"a": gpd.GeoDataFrame({"geometry": [shapely.Point(1, 2)]}, crs=UTM)}, tmp_path / "a.gpkg")
    with pytest.raises(PlanningError, match="no polygon"):
        plan_files(tmp_path / "a.gpkg", DRONE, tmp_path / "out", **ASKED)
