"""The real photographs: what their site must say, with nothing stated but the vertical datum."""

import os
from datetime import UTC, datetime
from pathlib import Path

import pytest

from workbench.params import Parameters
from workbench.photographs import read_photograph
from workbench.site import check_site, new_site

DATA = Path(os.environ.get("WORKBENCH_DATA", Path(__file__).parents[3] / "shared" / "data"))
PHOTOS = DATA / "brighton_beach" / "images"

pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif(not PHOTOS.is_dir(), reason=f"{PHOTOS} is not there (set WORKBENCH_DATA)"),
]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    root = tmp_path_factory.mktemp("brighton")
    return new_site("brighton", photos=PHOTOS, root=root, vertical_datum="GNSS heights as recorded")


def test_eighteen_photographs_in_three_strips_of_six(site):
    assert len(site.photographs) == 18 and not site.set_aside
    assert [p.strip for p in site.photographs] == [0] * 6 + [1] * 6 + [2] * 6
    assert [p.order for p in site.photographs] == list(range(6)) * 3


def test_zone_camera_and_heights(site):
    assert site.crs.to_epsg() == 32615  # Duluth, 92 W.
    (camera,) = site.cameras.values()
    assert (camera.width, camera.height) == (4000, 2250)
    assert camera.focal_x == pytest.approx(2340, abs=0.5)
    heights = [p.height_above_ground for p in site.photographs]
    assert min(heights) > 39 and max(heights) < 41
    assert {p.bands for p in site.photographs} == {3}


def test_flown_along_and_against_one_direction(site):
    kappa = [p.attitude[2] for p in site.photographs]
    for strip, expected in enumerate((-43.5, 134, -42.5)):
        assert kappa[6 * strip : 6 * strip + 6] == pytest.approx([expected] * 6, abs=7)


def test_nothing_is_wrong_but_the_clock(site):
    report = check_site(site, Parameters())
    assert not report.errors
    assert [problem.text for problem in report.warnings] == [
        "the clock of the camera has no time zone, so the sun's position is unknown."
    ]
    # Base and footprint of the recorded flight: 13.7 m of 38 m forward.
    assert report.overlap.forward == pytest.approx(0.64, abs=0.02)
    assert report.overlap.across == pytest.approx(0.60, abs=0.03)


def test_sun_of_a_summer_afternoon(tmp_path):
    site = new_site("brighton", photos=PHOTOS, root=tmp_path, time_zone="America/Chicago")
    first = site.photographs[0]
    assert first.time == datetime(2016, 6, 23, 21, 31, 59, tzinfo=UTC)
    elevation, azimuth = first.sun
    assert elevation == pytest.approx(43.6, abs=0.1) and azimuth == pytest.approx(257.6, abs=0.1)


def test_photograph_is_decoded(site):
    image = read_photograph(site.photographs[0].path, downscale=10)
    assert image.shape == (225, 400, 3) and image.std() > 20
