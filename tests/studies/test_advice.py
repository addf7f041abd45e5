"""Advice: geometry at the height of the canopy, and what given photographs can measure."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from workbench.cameras import intersection_angle
from workbench.errors import StudyError
from workbench.studies.advice import TARGETS, advise, unmatched_lines, what_can_be_measured
from workbench.studies.collapse import disparity_collapse
from workbench.virtual import simulate_scene
from workbench.virtual.flight_cameras import flight_camera

PUBLISHED = Path(__file__).parents[2] / "data" / "published"


@pytest.fixture
def root(tmp_path):
    shutil.copytree(PUBLISHED, tmp_path / "data" / "published")
    return tmp_path


@pytest.mark.parametrize("purpose", TARGETS)
def test_overlap_and_angle_belong_together_at_the_canopy_and_on_the_ground(root, purpose):
    advice = advise("MACS MAR", 25.0, purpose, root=root)
    camera = flight_camera("MACS MAR")
    for overlap, angle in (
        (advice.forward_overlap, advice.angle_ground),
        (advice.forward_overlap_canopy, advice.angle_canopy),
    ):
        formula = intersection_angle(overlap, camera.full_frame[1], camera.pixel_size, camera.focal_length)
        assert angle == pytest.approx(formula, abs=1e-6)
    assert advice.forward_overlap > advice.forward_overlap_canopy
    assert advice.gsd_canopy == pytest.approx(advice.gsd_ground * (advice.height - 25) / advice.height)


def test_a_limit_of_height_is_met_by_reducing_the_photographs(root):
    advice = advise("DJI FC6310", 17.0, "broadleaf", highest=120.0, root=root)
    assert advice.height == 120.0
    low, high = TARGETS["broadleaf"].gsd
    assert low < advice.gsd_canopy * advice.downscale < high


def test_the_unmatched_share_is_expected_around_the_published_table(root):
    # 17.5 cm and 6.5 degrees lie between cells of Table 4.1 that hold 0.20 and 3.18 %.
    low, high = advise("MACS MAR", 25.0, "conifer", root=root).unmatched["published"]
    assert 0.2 < low < high < 3.2
    assert advise("3K nadir", 3.0, "reed", root=root).unmatched == {}


def test_impossible_wishes_are_refused(root):
    with pytest.raises(StudyError, match="choose from conifer"):
        advise("MACS MAR", 25.0, "moss", root=root)
    with pytest.raises(StudyError, match="nothing to fly"):
        advise("MACS MAR", 25.0, "conifer", highest=20.0, root=root)


def test_the_published_table_collapses_as_the_notes_measured(root):
    line = unmatched_lines(root)["published"]
    assert line.slope == pytest.approx(3.4, abs=0.05)
    assert line.r2 == pytest.approx(0.97, abs=0.01)
    assert line.holds
    assert line.percent(math.tan(math.radians(10.5)) / 0.09) == pytest.approx(38.4, abs=6)


def test_a_table_that_does_not_collapse_says_where_it_breaks():
    gsd = np.repeat([10.0, 20.0], 3)
    angle = np.tile([3.0, 6.0, 9.0], 2)
    logit = 3 * np.log(np.tan(np.radians(angle)) / (gsd / 100)) - 3 + np.where(gsd == 20, 2.0, 0.0)
    line = disparity_collapse(gsd, angle, 100 / (1 + np.exp(-logit)))
    assert not line.holds
    assert line.offsets[20.0] > 0.5 > -0.5 > line.offsets[10.0]
    with pytest.raises(StudyError, match="needs three"):
        disparity_collapse(gsd[:2], angle[:2], np.array([1.0, 0.0]))


def test_overlap_at_the_crowns_is_less_than_on_the_ground(tmp_path):
    flight = {"camera": "3K nadir", "reduction": 16, "gsd": 0.3, "forward_overlap": 0.8, "wind": 0.0}
    site = simulate_scene("meadow", tmp_path, flight_overrides=flight)
    measured = what_can_be_measured(site, heights=(0.0, 30.0, 1e4)).levels
    assert measured["height_m"].tolist() == [0.0, 30.0]
    height = measured["gsd_m"][0] * site.cameras[site.photographs[0].camera].focal_x
    # 1 - overlap grows as the distance to the camera shrinks.
    expected = 1 - 0.2 * height / (height - 30)
    assert measured["forward_overlap"][0] == pytest.approx(0.8, abs=0.02)
    assert measured["forward_overlap"][1] == pytest.approx(expected, abs=0.03)
    assert measured["angle_deg"][1] > measured["angle_deg"][0]
