"""Bad input that reaches the chain: one message, exit code 1, and what to do."""

import subprocess
import sys

import pytest
from photo_files import write_flight, write_photo  # type: ignore[import-not-found]

from workbench.chain import run_site
from workbench.errors import OrientationError, SiteError
from workbench.orientation import orient_site
from workbench.params import Parameters
from workbench.site import load_site, new_site

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
LONGITUDE, LATITUDE = 12.4498, 47.8602
HEADER = "name,x,y,z,sd_xy,sd_z,role\n"


def site_of(tmp_path, **options):
    options = {"vertical_datum": "DHHN2016 heights"} | options
    return new_site("lake", photos=tmp_path / "photos", root=tmp_path, **options)


def test_one_photograph_cannot_be_oriented(tmp_path):
    write_photo(tmp_path / "photos" / "only.jpg", place=(LONGITUDE, LATITUDE))
    with pytest.raises(OrientationError, match=r"1 usable photograph.*overlapping ones are needed"):
        orient_site(site_of(tmp_path), Parameters())


@pytest.mark.parametrize(
    ("exif", "options", "question"),
    [
        (True, {"vertical_datum": None}, "vertical_datum is open"),
        (False, {}, "crs is open"),
        (False, {"crs": "EPSG:25833"}, "focal_length_mm is open"),
    ],
)
def test_open_questions_stop_the_chain_before_it_works(tmp_path, exif, options, question):
    write_flight(tmp_path / "photos", exif=exif, **({} if exif else {"xmp": {}}))
    with pytest.raises(OrientationError, match=question):
        orient_site(site_of(tmp_path, **options), Parameters())


def test_photographs_that_show_nothing_in_common(tmp_path):
    write_flight(tmp_path / "photos", strips=1, along=400.0)
    # The texture of each photograph is its own.
    said = []
    with pytest.raises(OrientationError, match=r"may not overlap.*overlap map"):
        run_site(site_of(tmp_path), Parameters(), {"orient": orient_site}, said.append)
    # What was wrong, how they overlap and what it would cost was said before any work.
    assert "shares less than a tenth" in said[0]
    assert "expected time" in said[0]
    assert (tmp_path / "data/products/lake/check/overlap.tif").exists()


def test_every_photograph_damaged(tmp_path):
    (tmp_path / "photos").mkdir()
    for name in ("a.jpg", "b.jpg", "c.tif"):
        (tmp_path / "photos" / name).write_text("no image")
    site = site_of(tmp_path, crs="EPSG:32633")
    assert [p.name for p in site.set_aside] == ["a.jpg", "b.jpg", "c.tif"]
    with pytest.raises(OrientationError, match="0 usable"):
        orient_site(site, Parameters())


def test_no_position_and_no_control_fix_nothing(tmp_path):
    write_flight(tmp_path / "photos", place=None, xmp={})
    with pytest.raises(OrientationError, match=r"0 photograph.*0 control points.*navigation file"):
        orient_site(site_of(tmp_path, crs="EPSG:32633"), Parameters())


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ((5305000.0, 309310.0), r"P0.*x and y are swapped.*Exchange the two columns"),
        ((757985.0, 5307615.0), r"P0.*coordinates are in WGS 84 / UTM zone 32N.*Transform them"),
        ((12.45, 47.86), r"P0.*look like degrees.*Transform them"),
    ],
)
def test_a_control_point_in_the_wrong_place_stops_the_chain(tmp_path, place, message):
    write_flight(tmp_path / "photos")
    control, observations = tmp_path / "control.csv", tmp_path / "observations.csv"
    control.write_text(f"{HEADER}P0,{place[0]},{place[1]},550,0.02,0.03,control\n")
    observations.write_text("name,photo,column,row\nP0,IMG_0000.jpg,50,60\nP0,IMG_0001.jpg,50,60\n")
    with pytest.raises(OrientationError, match=message):
        orient_site(site_of(tmp_path, control=control, observations=observations), Parameters())


def test_the_command_line_says_it_in_one_message(tmp_path):
    write_flight(tmp_path / "photos", place=None, xmp={})
    control = tmp_path / "control.csv"
    control.write_text(HEADER + "P0,309000,5305000,520,0.02,0.03,control\n")
    site_of(tmp_path, crs="EPSG:32633", control=control)
    words = [sys.executable, "-m", "workbench.cli", "run", "--site", "lake", "--root", str(tmp_path)]
    result = subprocess.run(words, capture_output=True, text=True)
    assert result.returncode == 1
    assert "Traceback" not in result.stderr
    assert "control" in result.stderr


def test_a_terrain_that_is_gone_is_named(tmp_path):
    write_flight(tmp_path / "photos")
    site = site_of(tmp_path)
    description = site.folder / "site.yaml"
    description.write_text(description.read_text().replace("dtm: null", "dtm: nowhere.tif", 1))
    with pytest.raises(SiteError, match=r"dtm: .*nowhere\.tif does not exist"):
        load_site("lake", tmp_path)
