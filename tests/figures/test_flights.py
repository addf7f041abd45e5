"""Looks at virtual flights: both cameras see one place, and the sliders answer."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import panel as pn
import pytest

from workbench.errors import SceneError
from workbench.figures.flights import draw_looks, flights_panel, look
from workbench.virtual.composition import SceneSpec
from workbench.virtual.scene import build_scene

OPTIONS = {
    "gsd": 0.1,
    "forward_overlap": 0.8,
    "wind": 0.0,
    "time": datetime(2021, 7, 14, 10, tzinfo=UTC),
    "window": (60, 50),
}


@pytest.fixture(scope="module")
def field():
    """A field with a white and black target in the middle."""
    return build_scene(
        SceneSpec(
            name="field",
            seed=1,
            crs="EPSG:25832",
            vertical_datum="DHHN2016",
            origin=(600000.0, 5300000.0),
            size=(30.0, 20.0),
            terrain={"base": 100.0, "relief": 0.1},
            targets=[{"name": "T", "x": 15.0, "y": 10.0, "edge": 2.0}],
        )
    )


@pytest.mark.parametrize("camera", ["MACS MAR", "DMC I"])
def test_the_middle_of_the_scene_is_in_the_middle_of_every_picture(field, camera):
    one = look(field, camera, **OPTIONS)
    assert len(one.pictures) == 2
    for picture in one.pictures:
        assert picture.shape == (50, 60, 3)
        grey = picture.mean(axis=2)
        bright = np.argwhere(grey > 180)  # The two white quadrants of a target of 20 x 20 pixels.
        assert 150 < len(bright) < 250
        assert bright.mean(axis=0) == pytest.approx([24.5, 29.5], abs=1.0)


def test_angle_follows_from_the_camera_and_not_from_the_height(field):
    angles = [
        look(field, "MACS MAR", **(OPTIONS | {"gsd": gsd})).facts["angle, degrees"] for gsd in (0.1, 0.2)
    ]
    assert angles[0] == angles[1]
    assert look(field, "DMC I", **OPTIONS).facts["angle, degrees"] > angles[0]


def test_an_impossible_flight_is_refused(field):
    with pytest.raises(SceneError, match="overlap"):
        look(field, "MACS MAR", **(OPTIONS | {"forward_overlap": 1.0}))


def test_pictures_stand_in_rows_of_cameras(field):
    looks = {name: look(field, name, **OPTIONS) for name in ("MACS MAR", "DMC I")}
    assert len(draw_looks(looks).axes) == 4
    assert isinstance(flights_panel(field), pn.Column)
