"""Control files, gcp_list.txt, and what the check says of wrong points."""

from dataclasses import replace

import pytest
from photo_files import write_flight
from pyproj import CRS, Transformer

from workbench.errors import SiteError
from workbench.site import check_site, load_site, new_site, read_control, read_gcp_list, read_observations

UTM33 = CRS.from_epsg(32633)
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
HEADER = "name,x,y,z,sd_xy,sd_z,role\n"


def write(path, text):
    path.write_text(text)
    return path


# ---------------------------------------------------------------------------- reading


def test_control_file(tmp_path):
    path = write(tmp_path / "c.csv", HEADER + "A,1.5,2.5,3.5,0.01,0.02,control\n\nB,4,5,6,0.1,0.2,CHECK\n")
    a, b = read_control(path)
    assert (a.name, a.x, a.y, a.z, a.sd_xy, a.sd_z, a.role) == ("A", 1.5, 2.5, 3.5, 0.01, 0.02, "control")
    assert b.role == "check"


def test_comments_above_the_header(tmp_path):
    text = "# surveyed 2021-07-08\n# by RTK\n#Name\tx\ty\tz\n# first\nA\t1.5\t2.5\t3.5\n"
    (point,) = read_control(write(tmp_path / "c.csv", text))
    assert (point.name, point.x, point.y, point.z) == ("A", 1.5, 2.5, 3.5)


def test_semicolons_decimal_commas_comments_and_byte_order_mark(tmp_path):
    text = "﻿Name;X;Y;Z;sd_xy;sd_z;role\n# a comment\nA;4500000,25;5300000,5;517,93;0,02;0,03;verify\n"
    (point,) = read_control(write(tmp_path / "c.csv", text))
    assert (point.x, point.y, point.z, point.sd_z, point.role) == (
        4500000.25,
        5300000.5,
        517.93,
        0.03,
        "verify",
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,x,y\nA,1,2\n", "no column z"),
        ("", "no column name"),
        (HEADER + "A,one,2,3,,,\n", "line 2: x is 'one'"),
        (HEADER + "A,1,2,nan,,,\n", "line 2: z is 'nan'"),
        (HEADER + "A,1,2,,,,\n", "line 2: z is ''"),
        (HEADER + "A,1,2,3,0.1,0.1,tie\n", "line 2: role 'tie'"),
        (HEADER + "A,1,2,3,0,0.1,check\n", "must be positive"),
        (HEADER + "A,1,2,3,,,\nA,4,5,6,,,\n", "line 3: point 'A' occurs twice"),
    ],
)
def test_broken_control_file_is_named_with_its_line(tmp_path, text, message):
    with pytest.raises(SiteError, match=message):
        read_control(write(tmp_path / "c.csv", text))


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(SiteError, match="no such file"):
        read_observations(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00name")
    with pytest.raises(SiteError, match="not a text file"):
        read_control(tmp_path / "binary.csv")


@pytest.mark.parametrize(
    ("header", "epsg"),
    [
        ("EPSG:32632", 32632),
        ("WGS84 UTM 32N", 32632),
        ("+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs", 32632),
        ("EPSG:4326", 4326),
    ],
)
def test_gcp_list_of_opendronemap(tmp_path, header, epsg):
    x, y = Transformer.from_crs(32633, epsg, always_xy=True).transform(310000, 5305000)
    row = f"{x:.9f} {y:.9f} 520.5"
    text = f"{header}\n# comment\n{row} 100.5 200.25 a.jpg P1\n{row} 10 20 b.jpg P1\n"
    text += f"{x:.9f} {y:.9f} 521 1 2 b.jpg\n"
    points, observations = read_gcp_list(write(tmp_path / "gcp_list.txt", text), UTM33)
    assert [p.name for p in points] == ["P1", "gcp2"]
    assert (points[0].x, points[0].y, points[0].z) == pytest.approx((310000, 5305000, 520.5), abs=1e-3)
    assert [(o.name, o.photo, o.column, o.row) for o in observations] == [
        ("P1", "a.jpg", 100.5, 200.25),
        ("P1", "b.jpg", 10, 20),
        ("gcp2", "b.jpg", 1, 2),
    ]


@pytest.mark.parametrize(
    "header", ["WGS 84 / UTM zone 33N", "wgs84 utm 33n", "EPSG 32633", "'EPSG:32633'", "EPSG:32633+5773"]
)
@pytest.mark.parametrize(
    "row",
    [
        "310000 5305000.25 520.5 100.5 200 a.jpg P1",
        "310000\t5305000.25\t520.5\t100.5\t200\ta.jpg\tP1",
        "310000,5305000.25,520.5,100.5,200,a.jpg,P1",
        "310000, 5305000.25, 520.5, 100.5, 200, a.jpg, P1",
        "310000;5305000,25;520,5;100,5;200;a.jpg;P1",
        "310000,00 5305000,25 520,5 100,5 200,0 a.jpg P1",
    ],
)
def test_gcp_list_as_people_write_it(tmp_path, header, row):
    path = write(tmp_path / "gcp_list.txt", f"# x, y, z, column, row, photo, name\n\n{header}\n# P1\n{row}\n")
    (point,), (seen,) = read_gcp_list(path, UTM33)
    assert (point.name, point.x, point.y, point.z) == ("P1", 310000, 5305000.25, 520.5)
    assert (seen.photo, seen.column, seen.row) == ("a.jpg", 100.5, 200)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lat/lon\n47.9 12.4 520 1 2 a.jpg\n", "line 1: 'lat/lon' is neither"),
        ("EPSG:2263\n1 2 3 4 5 a.jpg\n", "line 1: .* counts in US survey foot"),
        ("WGS84 UTM 33\n1 2 3 4 5 a.jpg\n", "with N or S"),
        ("EPSG:4326\n47.9 12.4 520 1 2 a.jpg\n", "line 2: 47.9 12.4 is latitude before longitude"),
        ("EPSG:32633\n1 2 NaN 4 5 a.jpg\n", "line 2: z is 'NaN', not a number"),
        ("some words\n1 2 3 4 5 a.jpg\n", "line 1: 'some words' is neither"),
        ("EPSG:32633\n1 2 3 4 a.jpg\n", "line 2: expected 'x y z column row photo"),
        ("EPSG:32633\n1 2 3 4 5 a.jpg P\n9 2 3 4 5 b.jpg P\n", "line 3: point 'P' has other coordinates"),
        ("EPSG:32633\n1 2 3 4 5 a.jpg P\n1 2 3 4 5 b.jpg Q\n", "line 3: point 'Q' is 'P'"),
    ],
)
def test_broken_gcp_list(tmp_path, text, message):
    with pytest.raises(SiteError, match=message):
        read_gcp_list(write(tmp_path / "gcp_list.txt", text), UTM33)


# ---------------------------------------------------------------------------- checking


@pytest.fixture
def site_with(tmp_path):
    """A site whose control points are given as (x, y) offsets or lines of text."""
    write_flight(tmp_path / "photos")
    base = new_site("lake", photos=tmp_path / "photos", root=tmp_path, vertical_datum="DHHN2016 heights")
    x0, y0, _ = base.photographs[0].position

    def build(*points, photos=("IMG_0000.jpg", "IMG_0001.jpg")):
        lines = [f"P{n},{x},{y},{z},0.02,0.03,control" for n, (x, y, z) in enumerate(points)]
        seen = [f"P{n},{photo},50,60" for n in range(len(points)) for photo in photos]
        write(base.folder / "control.csv", HEADER + "\n".join(lines) + "\n")
        write(base.folder / "observations.csv", "name,photo,column,row\n" + "\n".join(seen) + "\n")
        return load_site("lake", tmp_path)

    build.x0, build.y0 = x0, y0
    return build


def problems(site):
    return [str(problem) for problem in check_site(site).problems if "time zone" not in problem.text]


def test_good_points_are_silent(site_with):
    assert (
        problems(site_with((site_with.x0, site_with.y0, 550), (site_with.x0 + 150, site_with.y0, 551))) == []
    )


def test_swapped_axes(site_with):
    (text,) = problems(site_with((site_with.y0, site_with.x0, 550)))
    assert text.startswith("error") and "P0" in text and "x and y are swapped" in text


def test_one_swapped_point_among_others_makes_no_line(site_with):
    x, y = site_with.x0, site_with.y0
    site = site_with((x, y, 550), (x + 150, y, 551), (x, y + 90, 550), (y, x, 552))
    site = replace(site, photographs=tuple(replace(p, position=None) for p in site.photographs))
    (text,) = [line for line in problems(site) if line.startswith("error")]
    assert "P3" in text and "x and y are swapped" in text


@pytest.mark.parametrize("zone", [31, 32, 34, 35])
def test_wrong_zone_is_recognised(site_with, zone):
    to_zone = Transformer.from_crs(32633, 32600 + zone, always_xy=True)
    (text,) = problems(site_with((*to_zone.transform(site_with.x0, site_with.y0), 550)))
    assert f"UTM zone {zone}N" in text and "WGS 84 / UTM zone 33N" in text


def test_point_outside_of_the_block_and_degrees(site_with):
    (text,) = problems(site_with((site_with.x0 + 5000, site_with.y0, 550)))
    assert "km from the photographs" in text
    (text,) = problems(site_with((12.45, 47.87, 550)))
    assert "look like degrees" in text


def test_impossible_height(site_with):
    (text,) = problems(site_with((site_with.x0, site_with.y0, 5305000)))[:1]
    assert "its height is" in text


def test_point_observed_once(site_with):
    (text,) = problems(site_with((site_with.x0, site_with.y0, 550), photos=("IMG_0000.jpg",)))
    assert text.startswith("warning") and "observed in 1 photograph(s)" in text and "at least two" in text


def test_observations_that_fit_nothing(site_with):
    site = site_with((site_with.x0, site_with.y0, 550))
    with (site.folder / "observations.csv").open("a") as file:
        file.write("P0,IMG_0000.jpg,51,61\nP9,IMG_0000.jpg,1,1\nP0,none.jpg,1,1\nP0,IMG_0002.jpg,5000,1\n")
    found = "\n".join(problems(load_site("lake", site.root)))
    assert "(P0 in IMG_0000.jpg): measured 2 times" in found
    assert "(P9 in IMG_0000.jpg): no such control point" in found
    assert "(P0 in none.jpg): no such photograph" in found
    assert "column 5000, row 1 lies outside the 171 x 114 px" in found


def blind_site(tmp_path, places, seen_in=2, crs="EPSG:32633"):
    write_flight(tmp_path / "photos", place=None, xmp={})
    lines = [f"P{n},{x},{y},{z},0.02,0.03,control" for n, (x, y, z) in enumerate(places)]
    seen = [f"P{n},IMG_000{i}.jpg,50,60" for n in range(len(places)) for i in range(seen_in)]
    control = write(tmp_path / "c.csv", HEADER + "\n".join(lines) + "\n")
    observations = write(tmp_path / "o.csv", "name,photo,column,row\n" + "\n".join(seen) + "\n")
    return new_site(
        "lake",
        photos=tmp_path / "photos",
        root=tmp_path,
        control=control,
        observations=observations,
        crs=crs,
        vertical_datum="DHHN2016 heights",
    )


def test_control_points_without_satellite_positions(tmp_path):
    site = blind_site(
        tmp_path,
        [(309000, 5305000, 520), (309100, 5305000, 521), (309000, 5305100, 522), (309050, 5305050, 520)],
    )
    assert not check_site(site).errors
    assert all(p.position is None for p in site.photographs)


@pytest.mark.parametrize(
    ("places", "seen_in", "message"),
    [
        ([(309000, 5305000, 520), (309100, 5305000, 521)], 2, "Three of either are needed"),
        ([(309000, 5305000, 520), (309100, 5305000, 521), (309000, 5305100, 522)], 1, "0 control point"),
        ([(309000, 5305000, 520), (309100, 5305100, 521), (309200, 5305200, 522)], 2, "on a line"),
        ([(5305000, 309000, 520), (5305000, 309100, 521), (5305100, 309000, 522)], 2, "x and y are swapped"),
    ],
)
def test_control_points_that_fix_nothing(tmp_path, places, seen_in, message):
    errors = [str(problem) for problem in check_site(blind_site(tmp_path, places, seen_in)).errors]
    assert any(message in text for text in errors)


@pytest.mark.parametrize(("header", "epsg"), [("EPSG:32633", 32633), ("WGS84", 4326)])
def test_gcp_list_states_the_crs_of_a_site_that_has_no_other(tmp_path, header, epsg):
    x, y = Transformer.from_crs(32633, epsg, always_xy=True).transform(309000, 5305000)
    place = f"{x:.9f} {y:.9f}"
    write_flight(tmp_path / "photos", place=None)
    path = write(tmp_path / "gcp_list.txt", f"{header}\n{place} 520 1 2 IMG_0000.jpg\n")
    site = new_site("lake", photos=tmp_path / "photos", root=tmp_path, control=path)
    assert site.crs.to_epsg() == 32633
    assert (site.control[0].x, site.control[0].y) == pytest.approx((309000, 5305000), abs=1e-3)
    assert site.observations[0].photo == "IMG_0000.jpg"


@pytest.mark.parametrize("photo", ["img_0000.JPG", "IMG_0000", "IMG_0000.tif", "D:\\flight\\IMG_0000.JPG"])
def test_photographs_are_found_under_other_ways_to_write_their_names(tmp_path, photo):
    write_flight(tmp_path / "photos")
    path = write(tmp_path / "gcp_list.txt", f"EPSG:32633\n309000\t5305000\t520\t1\t2\t{photo}\tP 1\n")
    site = new_site("lake", photos=tmp_path / "photos", root=tmp_path, control=path)
    assert (site.observations[0].photo, site.observations[0].name) == ("IMG_0000.jpg", "P 1")
    text = f"name,photo,column,row\nP 1,{photo},1,2\n"
    write(site.folder / "observations.csv", text)
    assert load_site("lake", tmp_path).observations[0].photo == "IMG_0000.jpg"


def test_measurements_of_other_photographs_are_refused(tmp_path):
    write_flight(tmp_path / "photos")
    path = write(tmp_path / "gcp_list.txt", "EPSG:32633\n309000 5305000 520 1 2 DSC1.jpg\n")
    with pytest.raises(SiteError, match=r"none of its 1 measurements .* 'DSC1.jpg', .* 'IMG_0000.jpg'"):
        new_site("lake", photos=tmp_path / "photos", root=tmp_path, control=path)
    site = new_site("lake", photos=tmp_path / "photos", root=tmp_path)
    write(site.folder / "control.csv", HEADER + "A,309000,5305000,520,,,\n")
    write(site.folder / "observations.csv", "name,photo,column,row\nA,DSC1.jpg,1,2\n")
    assert "none of its 1 measurements" in "\n".join(problems(load_site("lake", tmp_path)))
