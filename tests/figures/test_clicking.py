"""The tool to measure control points: predictions, residuals, files, and clicks without a browser."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from rasterio.crs import CRS

from workbench.cameras import Camera, Pose
from workbench.errors import OrientationError
from workbench.figures.clicking import Measurements, click_tool
from workbench.orientation import Block, OrientedPhotograph
from workbench.site import ControlPoint, Photograph, Site
from workbench.site.control import read_observations

UTM = CRS.from_epsg(32633)
CAMERA = Camera("cam", 600, 400, 500.0, 500.0, 300.0, 200.0, (-0.05, 0.01, 0, 0, 0, 0, 0, 0))
PLACES = {"T1": (500_010.0, 5_000_005.0, 2.0), "T2": (500_018.0, 5_000_011.0, 0.5)}


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A site of four photographs and the block of their true poses."""
    folder = tmp_path_factory.mktemp("root")
    random = np.random.default_rng(2)
    photographs, oriented = [], []
    for number in range(4):
        name = f"p{number}.png"
        cv2.imwrite(str(folder / name), random.integers(0, 255, (400, 600, 3), dtype=np.uint8))
        centre = np.array([500_004.0 + 7 * number, 5_000_008.0, 40.0])
        pose = Pose.from_roll_pitch_heading(centre, 2.0, -1.0, 90.0)
        photographs.append(Photograph(name, folder / name, "cam"))
        oriented.append(OrientedPhotograph(name, folder / name, CAMERA, pose, 0, number))
    control = tuple(ControlPoint(name, *place, 0.01, 0.02, "control") for name, place in PLACES.items())
    site = Site("s", folder, UTM, "test", tuple(photographs), {"cam": CAMERA}, control=control)
    return site, Block(tuple(oriented), UTM, "test")


def true_place(block, point, photo):
    return block[photo].project(np.array([PLACES[point]]))[0]


def test_two_measurements_predict_the_others(flown):
    site, block = flown
    measured = Measurements(site, block)
    for photo in ("p0.png", "p2.png"):
        measured.measure("T1", photo, *true_place(block, "T1", photo))
    places, source = measured.predict("T1")
    assert source == "measured"
    for photo in ("p1.png", "p3.png"):
        assert places[photo] == pytest.approx(true_place(block, "T1", photo), abs=1e-5)


def test_before_that_the_surveyed_place_helps(flown):
    site, block = flown
    places, source = Measurements(site, block).predict("T2")
    assert source == "surveyed"
    assert places["p3.png"] == pytest.approx(true_place(block, "T2", "p3.png"))
    assert Measurements(site).predict("T2") == ({}, "nothing")


def test_a_wrong_click_stands_out(flown):
    site, block = flown
    measured = Measurements(site, block)
    for photo in ("p0.png", "p1.png", "p2.png", "p3.png"):
        column, row = true_place(block, "T1", photo)
        measured.measure("T1", photo, column + 25 * (photo == "p1.png"), row + 6 * (photo == "p1.png"))
    residuals = measured.residuals("T1")
    assert residuals.photo[0] == "p1.png"
    assert residuals.residual_px[0] == pytest.approx(np.hypot(25, 6), rel=1e-3)
    measured.remove("T1", "p1.png")
    assert measured.residuals("T1").residual_px.max() < 1e-4


def test_impossible_measurements_are_refused(flown):
    measured = Measurements(*flown)
    with pytest.raises(OrientationError, match="600 x 400"):
        measured.measure("T1", "p0.png", 700.0, 10.0)
    with pytest.raises(OrientationError, match="add its coordinates"):
        measured.measure("T9", "p0.png", 70.0, 10.0)
    with pytest.raises(OrientationError, match="no photograph of site s"):
        measured.measure("T1", "p9.png", 70.0, 10.0)
    with pytest.raises(OrientationError, match=r"no control\.csv"):
        click_tool(Site("bare", Path(), UTM, "test", ()))


def test_clicks_become_a_file_that_the_chain_reads(flown, tmp_path):
    site, block = flown
    path = tmp_path / "observations.csv"
    tool = click_tool(site, block, path)
    tool.point.value = "T1"
    for photo in ("p0.png", "p1.png", "p2.png"):
        tool.photo.value = photo
        column, row = true_place(block, "T1", photo)
        tool.rough.event(x=column + 9, y=row - 14)
        assert tool.centre == pytest.approx((column + 9, row - 14))
        tool.exact.event(x=column, y=row)
    assert tool.table.object.residual_px.max() < 1e-3
    tool.photo.value = "p3.png"
    assert tool.centre == pytest.approx(true_place(block, "T1", "p3.png"), abs=1e-4)
    tool.exact.event(x=20.0, y=30.0)
    assert "p3.png contradicts" in tool.message.object
    tool.save()
    assert [(o.name, o.photo) for o in read_observations(path)] == [("T1", f"p{k}.png") for k in range(4)]
    again = Measurements(site, block, {(o.name, o.photo): (o.column, o.row) for o in read_observations(path)})
    assert len(again.observations("T1")) == 4


def test_pictures_show_each_pixel_where_it_is(flown):
    """A click on what one sees gives the coordinates of the pixel that one sees."""
    tool = click_tool(*flown)
    tool.rough.event(x=120.5, y=300.5)
    picture = tool.chip.object.traverse(lambda element: element, ["RGB"])[0]
    column, row = 100.5, 290.5
    cell = picture[column, row]
    shown = [255 * float(cell.dimension_values(band)[0]) for band in "RGB"]
    assert shown == pytest.approx(tool.image[int(row), int(column)], abs=0.5)
