"""Flights against the papers' figures, their own footprints, and the errors that they state."""

from __future__ import annotations

import csv
import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import shapely

from workbench.cameras import ground_sampling_distance
from workbench.errors import SceneError
from workbench.virtual.flight import Disturbance, NavigationErrors, plan_flight, swath
from workbench.virtual.flight_cameras import flight_camera, flight_camera_names

PUBLISHED = Path(__file__).parents[2] / "data" / "published"
NOON = datetime(2021, 7, 14, 11, tzinfo=UTC)
AREA = (500_000.0, 5_300_000.0, 501_000.0, 5_300_600.0)
OURS = {
    "DLR 3K (Canon EOS 1Ds Mark II, nadir)": "3K nadir",
    "DLR 3K (Canon EOS 1Ds Mark II, left and right)": "3K",
    "MACS MAR 9cm": "MACS MAR",
    "MACS MAR 15cm": "MACS MAR",
    "MACS MAR 20cm": "MACS MAR",
    "Sony NEX-5N": "Sony NEX-5N",
}


def fly(camera: str = "MACS MAR", **changes):
    options = {"ground": 400.0, "start": NOON, "forward_overlap": 0.8, "side_overlap": 0.6, "gsd": 0.1}
    options |= changes
    kept = {key: options.pop(key) for key in ("frame", "reduction") if key in options}
    extent = options.pop("extent", AREA)
    return plan_flight(extent, flight_camera(camera, **kept), **options)


def test_cameras_are_those_of_the_papers():
    with (PUBLISHED / "cameras.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        camera = flight_camera(OURS.get(row["camera"], row["camera"]))
        assert camera.full_frame == (int(row["pixels_across"]), int(row["pixels_along"]))
        # Pixels to the two digits that the table prints; the thesis gives the MACS 50 or 51.7 mm.
        assert camera.pixel_size * 1e6 == pytest.approx(float(row["pixel_um"]), abs=0.02)
        assert camera.focal_length * 1e3 == pytest.approx(float(row["focal_mm"]), abs=1.71)
        tilt = float(row["tilt_deg"] or 0)
        assert max(camera.tilts) == pytest.approx(tilt if camera.name == "3K" else 0)


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("UltraCam Eagle 80", "UltraCam Eagle 80"),
        ("UltraCam Eagle 210", "UltraCam Eagle 210"),
        ("DMC II 230", "DMC II 230"),
        ("MACS MAR", "MACS 51.7 mm"),
    ],
)
def test_intersection_angles_are_the_published_ones_also_where_frames_are_cropped(name, label):
    with (PUBLISHED / "intersection_angles.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["camera"] == label]
    assert rows
    for row in rows:
        overlap = float(row["forward_overlap_pct"]) / 100
        rows_kept = flight_camera(name).full_frame[1] * 6 // 10
        flight = fly(name, forward_overlap=overlap, frame=(600, rows_kept), strips=1)
        assert flight.intersection_angle == pytest.approx(float(row["angle_deg"]), abs=0.1)
        # And the centres really are that far apart.
        first, second = flight.exposures[0].pose.centre, flight.exposures[1].pose.centre
        angle = math.degrees(math.atan(np.linalg.norm(second - first) / flight.height))
        assert angle == pytest.approx(float(row["angle_deg"]), abs=0.1)


def test_3k_sees_a_swath_of_2_8_km_from_1000_m():
    flight = fly("3K", gsd=None, height=1000.0, forward_overlap=0.8, side_overlap=0.3)
    release = [exposure for exposure in flight.exposures if exposure.release == 3]
    assert [exposure.mount for exposure in release] == [0, 1, 2]
    _, south, _, north = shapely.union_all([flight.footprint(e) for e in release]).bounds
    width = swath(flight.camera, flight.camera.full_frame[0], 1000)
    assert round(width / 1000, 1) == 2.8
    # The barrel distortion of the lens lets the borders see a little more.
    assert north - south == pytest.approx(width, rel=0.01)
    assert flight.gsd == pytest.approx(0.144, abs=0.0005)
    # The flight goes east: left looks north, right looks south.
    left, nadir, right = (flight.footprint(exposure).centroid.y for exposure in release)
    assert left > nadir + 500 and right < nadir - 500
    assert {e.name.split("/")[0] for e in release} == {"left", "nadir", "right"}


@pytest.mark.parametrize(("forward", "side", "direction"), [(0.8, 0.6, 90.0), (0.6, 0.3, 20.0)])
def test_footprints_overlap_as_asked(forward, side, direction):
    # Without distortion, whose barrel widens the borders by some pixels.
    flight = fly("DMC II 230", forward_overlap=forward, side_overlap=side, direction=direction, gsd=0.02)
    shots = {(e.strip, e.order): flight.footprint(e) for e in flight.exposures}
    area = shots[0, 0].area
    assert shots[0, 1].intersection(shots[0, 2]).area / area == pytest.approx(forward, abs=1e-6)
    last = max(order for strip, order in shots if strip == 0)
    assert flight.strips > 1
    # The second strip is flown back: its last photograph lies beside the first one.
    assert shots[0, 0].intersection(shots[1, last]).area / area == pytest.approx(side, abs=1e-6)
    covered = shapely.union_all(list(shots.values()))
    assert covered.covers(shapely.box(*AREA))


def test_height_follows_from_gsd_and_gsd_from_height():
    from_gsd = fly(gsd=0.09)
    assert ground_sampling_distance(from_gsd.height, 35.9936e-3 / 4864, 0.0517) == pytest.approx(
        0.09, rel=1e-6
    )
    assert fly(gsd=None, height=from_gsd.height).gsd == pytest.approx(0.09)
    assert from_gsd.exposures[0].pose.centre[2] == pytest.approx(400 + from_gsd.height)


def test_reduced_photographs_keep_angle_and_footprint():
    whole, reduced = fly(gsd=0.05), fly(gsd=0.2, reduction=4)
    assert reduced.height == pytest.approx(whole.height, rel=1e-3)
    assert reduced.intersection_angle == pytest.approx(whole.intersection_angle, abs=0.01)
    assert reduced.footprint(reduced.exposures[0]).area == pytest.approx(
        whole.footprint(whole.exposures[0]).area, rel=0.005
    )


def test_crossing_strips_are_at_right_angles():
    flight = fly(crossing=True)
    headings = {round(e.attitude[2]) % 180 for e in flight.exposures}
    assert headings == {90, 0}
    times = [e.time for e in flight.exposures]
    assert times == sorted(times)


def test_recorded_positions_have_the_stated_errors():
    errors = NavigationErrors((0.5, 1.0), (0.1, 0.3), 0.4, 0.3)
    position, attitude = [], []
    for seed in range(150):
        flight = fly(errors=errors, seed=seed, gsd=0.4)
        position += [np.subtract(e.recorded_position, e.pose.centre) for e in flight.exposures]
        attitude += [np.subtract(e.recorded_attitude, e.attitude) for e in flight.exposures]
    # 150 biases of 40 % of the variance leave 7 % uncertainty of the standard deviation.
    assert np.std(position, axis=0) == pytest.approx([0.5, 0.5, 1.0], rel=0.15)
    assert np.std(attitude, axis=0) == pytest.approx([0.1, 0.1, 0.3], rel=0.15)
    only_bias = fly(errors=NavigationErrors((0.5, 1.0), (0, 0), 1.0, 0.0), seed=3)
    offsets = np.array([np.subtract(e.recorded_position, e.pose.centre) for e in only_bias.exposures])
    assert np.ptp(offsets, axis=0) == pytest.approx([0, 0, 0], abs=1e-6)
    assert np.abs(offsets[0]).min() > 0


def test_disturbances_have_the_stated_size():
    calm = fly(gsd=0.4)
    rough = [
        fly(gsd=0.4, disturbance=Disturbance(0.1, 2.0, 0.02), speed=50.0, seed=seed) for seed in range(60)
    ]
    moved = np.array(
        [
            [e.pose.centre - c.pose.centre for e, c in zip(f.exposures, calm.exposures, strict=True)]
            for f in rough
        ]
    )
    # Flown east: x is along the track, y across it.
    assert moved[..., 0].std() == pytest.approx(0.1 * 50, rel=0.1)
    assert moved[..., 1].std() == pytest.approx(0.02 * calm.height, rel=0.15)
    assert moved[..., 2].std() == pytest.approx(0.02 * calm.height, rel=0.15)
    rolls = np.array([[e.attitude[0] for e in f.exposures] for f in rough])
    assert rolls.std() == pytest.approx(2.0, rel=0.1)


def test_same_seed_same_flight():
    options = {"disturbance": Disturbance(0.1, 1.0, 0.01), "errors": NavigationErrors((0.1, 0.2))}
    first, again, other = (fly(seed=seed, **options) for seed in (4, 4, 5))
    assert all(
        np.array_equal(a.pose.centre, b.pose.centre) and a.recorded_position == b.recorded_position
        for a, b in zip(first.exposures, again.exposures, strict=True)
    )
    assert not np.array_equal(first.exposures[0].pose.centre, other.exposures[0].pose.centre)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"forward_overlap": 1.0}, "Forward overlap 1.0"),
        ({"forward_overlap": 80}, "not per cent"),
        ({"side_overlap": -0.1}, "Side overlap"),
        ({"gsd": 0.1, "height": 100.0}, "either"),
        ({"gsd": None}, "either"),
        ({"gsd": -0.1}, "positive"),
        ({"highest": 2000.0}, "not above the highest object"),
        ({"start": datetime(2021, 7, 14, 11)}, "time zone"),
        ({"frame": (1000, 600), "forward_overlap": 0.8}, "do not overlap"),
        ({"frame": (500, 3232), "side_overlap": 0.2}, "gaps"),
        ({"frame": (9000, 600)}, "cannot be cut"),
        ({"extent": (0, 0, 0, 10)}, "is empty"),
        ({"errors": NavigationErrors((1, 1), (1, 1), 0.7, 0.7)}, "exceed"),
        ({"camera": "Leica RC30"}, "unknown"),
        ({"reduction": 0.5}, "below 1"),
    ],
)
def test_impossible_flights_are_refused(changes, message):
    with pytest.raises(SceneError, match=message):
        fly(**changes)


def test_every_camera_can_be_flown():
    for name in flight_camera_names():
        camera = flight_camera(name)
        flight = fly(name, gsd=0.05, extent=(0.0, 0.0, 400.0, 200.0))
        assert flight.exposures and camera.camera.width == camera.full_frame[0]


def test_of_a_rig_only_photographs_that_see_the_area_are_kept():
    extent = (0.0, 0.0, 800.0, 90.0)
    far = fly("3K", extent=extent, gsd=0.14, frame=(900, 3328), strips=3, side_overlap=0.75)
    area = shapely.box(*extent)
    assert all(far.footprint(exposure).intersects(area) for exposure in far.exposures)
    # Strips 700 m apart: every camera sees the area from the strip that lies on the other side of its tilt.
    assert {(e.strip, e.mount) for e in far.exposures} in (
        {(0, 0), (1, 1), (2, 2)},
        {(0, 2), (1, 1), (2, 0)},
    )
    with pytest.raises(SceneError, match="No camera of the rig"):
        fly("3K", extent=extent, gsd=0.14, frame=(900, 3328), strips=2, side_overlap=0.75)
