"""Navigation files: the same flight written in several ways gives the same positions and attitudes."""

import numpy as np
import pytest
from photo_files import write_flight
from pyproj import CRS, Proj, Transformer
from typer.testing import CliRunner

from workbench.cameras import Pose
from workbench.cli import app
from workbench.errors import SiteError
from workbench.site import NavigationFormat, check_site, new_site, read_navigation

UTM33 = CRS.from_epsg(32633)
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
X, Y, Z = 309_500.0, 5_305_500.0, 1518.0


def read(tmp_path, text, form=None, crs=UTM33):
    path = tmp_path / "navigation.txt"
    path.write_text(text)
    return read_navigation(path, crs, form)


def attitude_matrix(row):
    return Pose.from_omega_phi_kappa(np.zeros(3), *row.attitude).rotation


@pytest.mark.parametrize("separator", [",", ";", "\t", "  "])
def test_separators(tmp_path, separator):
    lines = [["photo", "x", "y", "z", "sd_x", "sd_y", "sd_z"], ["a.jpg", X, Y, Z, 0.1, 0.2, 0.3]]
    text = "\n".join(separator.join(map(str, line)) for line in lines)
    row = read(tmp_path, text)["a.jpg"]
    assert row.position == (X, Y, Z)
    assert row.position_sd == (0.1, 0.2, 0.3)
    assert row.attitude is None


def test_own_column_names_comment_header_and_no_header(tmp_path):
    names = {"photo": "IMAGE", "x": "Easting", "y": "Northing", "z": "H"}
    text = f"# IMAGE Easting Northing H\n# taken with care\na.jpg {X} {Y} {Z}\n"
    assert read(tmp_path, text, NavigationFormat(names))["a.jpg"].position == (X, Y, Z)
    numbered = NavigationFormat({"photo": "2", "x": "3", "y": "4", "z": "5"}, header=False)
    assert read(tmp_path, f"1 a.jpg {X} {Y} {Z}\n", numbered)["a.jpg"].position == (X, Y, Z)


def test_degrees_and_other_projections(tmp_path):
    longitude, latitude = Transformer.from_crs(32633, 4326, always_xy=True).transform(X, Y)
    row = read(tmp_path, f"photo,longitude,latitude,height\na,{longitude:.10f},{latitude:.10f},{Z}\n")["a"]
    assert row.position == pytest.approx((X, Y, Z), abs=1e-3)
    east, north = Transformer.from_crs(32633, 25832, always_xy=True).transform(X, Y)
    form = NavigationFormat(crs="EPSG:25832")
    row = read(tmp_path, f"photo,x,y,z\na,{east:.4f},{north:.4f},{Z}\n", form)["a"]
    assert row.position == pytest.approx((X, Y, Z), abs=1e-3)


def test_heading_from_true_north_is_turned_to_grid_north(tmp_path):
    text = f"photo,x,y,z,roll,pitch,heading\na,{X},{Y},{Z},0,0,90\n"
    longitude, latitude = Transformer.from_crs(32633, 4326, always_xy=True).transform(X, Y)
    convergence = Proj(UTM33).get_factors(longitude, latitude).meridian_convergence
    assert abs(convergence) > 1.5
    omega, phi, kappa = read(tmp_path, text)["a"].attitude
    assert (omega, phi, kappa) == pytest.approx((0, 0, -90 + convergence), abs=1e-9)
    grid = read(tmp_path, text, NavigationFormat(heading_from="grid north"))["a"]
    assert grid.attitude[2] == pytest.approx(-90, abs=1e-9)


def test_an_aircraft_flying_true_north_moves_along_its_heading(tmp_path):
    # The top of the frame looks along the heading: 100 m to true north must lie "up" in the image.
    longitude, latitude = Transformer.from_crs(32633, 4326, always_xy=True).transform(X, Y)
    ahead = Transformer.from_crs(4326, 32633, always_xy=True).transform(longitude, latitude + 100 / 111_200)
    row = read(tmp_path, f"photo,x,y,z,roll,pitch,heading\na,{X},{Y},{Z},0,0,0\n")["a"]
    camera = attitude_matrix(row) @ np.array([ahead[0] - X, ahead[1] - Y, -1000.0])
    assert camera[0] == pytest.approx(0, abs=0.05)
    assert camera[1] == pytest.approx(-100, abs=0.5)


@pytest.mark.parametrize(("unit", "factor"), [("radians", np.pi / 180), ("gon", 1 / 0.9)])
def test_units_of_angles(tmp_path, unit, factor):
    angles = np.array([3.0, -4.0, 120.0])
    text = "photo,x,y,z,omega,phi,kappa\na,{},{},{},{},{},{}\n".format(X, Y, Z, *(angles * factor))
    assert read(tmp_path, text, NavigationFormat(angles=unit))["a"].attitude == pytest.approx(
        angles, abs=1e-9
    )


def test_omega_phi_kappa_of_another_grid_keep_their_direction_in_the_world(tmp_path):
    east, north = Transformer.from_crs(32633, 25832, always_xy=True).transform(X, Y)
    text = f"photo,x,y,z,omega,phi,kappa\na,{east},{north},{Z},5,-7,40\n"
    row = read(tmp_path, text, NavigationFormat(crs="EPSG:25832"))["a"]
    # A point 100 m in front of the camera, in the old grid, seen through both descriptions.
    old = Pose.from_omega_phi_kappa(np.array([east, north, Z]), 5, -7, 40)
    target = old.centre + old.to_world(np.array([30.0, 20.0, 400.0]))
    moved = Transformer.from_crs(25832, 32633, always_xy=True).transform(*target[:2])
    new = Pose.from_omega_phi_kappa(np.array(row.position), *row.attitude)
    seen = new.to_camera(np.array([*moved, target[2]]))
    # Scale differs between the zones by some 1e-4, which is centimetres here; a turn would be metres.
    assert seen == pytest.approx([30, 20, 400], abs=0.05)


def test_side_cameras_of_the_3k_system(tmp_path):
    text = "photo,x,y,z,roll,pitch,heading\n" + "".join(
        f"{folder}/1.jpg,{X},{Y},{Z},0,0,0\n" for folder in ("nadir", "left", "right")
    )
    form = NavigationFormat(heading_from="grid north", tilts={"left": -35, "right": 35})
    rows = read(tmp_path, text, form)
    for folder, tilt in (("nadir", 0), ("left", -35), ("right", 35)):
        looks = attitude_matrix(rows[f"{folder}/1.jpg"])[2]
        assert looks == pytest.approx([np.sin(np.radians(tilt)), 0, -np.cos(np.radians(tilt))], abs=1e-12)
    column = read(
        tmp_path,
        f"photo,x,y,z,roll,pitch,heading,tilt_right\na,{X},{Y},{Z},0,0,0,35\n",
        NavigationFormat(heading_from="grid north"),
    )
    assert attitude_matrix(column["a"])[2] == pytest.approx(attitude_matrix(rows["right/1.jpg"])[2])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("photo,x,y\na,1,2\n", "no column z"),
        ("", "no column photo"),
        (f"photo,x,y,z\na,{X},north,{Z}\n", "line 2: y is 'north'"),
        (f"photo,x,y,z\na,{X},{Y},\n", "line 2: z is ''"),
        (f"photo,x,y,z\na,{X},{Y},{Z}\na,{X},{Y},{Z}\n", "line 3: photograph 'a' occurs twice"),
        (f"photo,x,y,z,sd_x,sd_y,sd_z\na,{X},{Y},{Z},-1,1,1\n", "must be positive"),
        (f"photo,x,y,z,heading\na,{X},{Y},{Z},3\n", "roll is ''"),
        (f"photo,x,y,z,time\na,{X},{Y},{Z},noon\n", "time 'noon'"),
        (f"photo,longitude,latitude,height\na,12,95,{Z}\n", "swapped"),
    ],
)
def test_broken_files_are_named_with_their_line(tmp_path, text, message):
    with pytest.raises(SiteError, match=message):
        read(tmp_path, text)


def test_unknown_column_and_crs(tmp_path):
    with pytest.raises(SiteError, match="easting"):
        NavigationFormat({"easting": "E"})
    with pytest.raises(SiteError, match="EPSG:0"):
        read(tmp_path, f"photo,x,y,z\na,{X},{Y},{Z}\n", NavigationFormat(crs="EPSG:0"))


def flight_with_navigation(tmp_path, text, **options):
    write_flight(tmp_path / "photos", place=None, xmp={})
    (tmp_path / "navigation.txt").write_text(text)
    values = {
        "crs": "EPSG:32633",
        "vertical_datum": "DHHN2016 heights",
        "navigation": tmp_path / "navigation.txt",
    }
    return new_site("lake", photos=tmp_path / "photos", root=tmp_path, **(values | options))


def test_navigation_gives_a_site_its_positions(tmp_path):
    rows = "".join(f"IMG_{n:04d} {X + 20 * n} {Y} {Z} 1 2 {85 + n}\n" for n in range(7))
    site = flight_with_navigation(tmp_path, "photo x y z roll pitch heading\n" + rows)
    assert site.photographs[2].position == (X + 40, Y, Z)
    assert site.photographs[2].attitude is not None
    assert [p.order for p in site.photographs[:7]] == list(range(7))
    report = check_site(site)
    assert not report.errors
    assert any("1 photograph(s) have no position" in problem.text for problem in report.warnings)


def test_navigation_of_other_photographs(tmp_path):
    with pytest.raises(SiteError, match=r"none of its 1 rows names a photograph.*DSC1.*IMG_0000"):
        flight_with_navigation(tmp_path, f"photo x y z\nDSC1 {X} {Y} {Z}\n")
    with pytest.raises(SiteError, match="--crs"):
        flight_with_navigation(tmp_path, f"photo x y z\nIMG_0000 {X} {Y} {Z}\n", crs=None)


def test_swapped_columns_of_a_whole_file(tmp_path):
    rows = "".join(f"IMG_{n:04d} {Y} {X + 20 * n} {Z}\n" for n in range(8))
    site = flight_with_navigation(tmp_path, "photo x y z\n" + rows)
    assert any("x and y may be swapped" in problem.remedy for problem in check_site(site).errors)


def test_one_bad_row_becomes_a_note(tmp_path):
    rows = [f"IMG_{n:04d} {X + 20 * n} {Y} {Z}\n" for n in range(8)]
    rows[5] = f"IMG_0005 0 0 {Z}\n"
    site = flight_with_navigation(tmp_path, "photo x y z\n" + "".join(rows))
    assert "km from the others" in site.photograph("IMG_0005.jpg").note
    assert site.photograph("IMG_0005.jpg").position is None


def test_command_line_names_the_columns(tmp_path):
    write_flight(tmp_path / "photos", place=None, xmp={})
    rows = "".join(f"IMG_{n:04d};{X + 20 * n};{Y};{Z}\n" for n in range(8))
    (tmp_path / "n.txt").write_text("image;E;N;H\n" + rows)
    words = ["new-site", "lake", "--photos", str(tmp_path / "photos"), "--root", str(tmp_path)]
    words += ["--navigation", str(tmp_path / "n.txt"), "--crs", "EPSG:32633", "--vertical-datum", "DHHN2016"]
    for column in ("photo=image", "x=E", "y=N", "z=H"):
        words += ["--navigation-column", column]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert "8 photographs in 1 strip(s), 0 error(s)" in result.output
