"""Making and checking sites from photographs whose every fact is known."""

import csv
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import rasterio
from photo_files import LATITUDE, LONGITUDE, METRE_EAST, METRE_NORTH, truncate, write_flight, write_photo
from pyproj import Transformer
from ruamel.yaml import YAML
from typer.testing import CliRunner

from workbench.cli import app
from workbench.errors import SiteError
from workbench.params import Parameters
from workbench.rasters import read_raster
from workbench.site import check_site, load_site, new_site
from workbench.vectors import read_vector

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
DATUM = "DHHN2016 heights"


def make(tmp_path, **options):
    return new_site(
        "lake", photos=tmp_path / "photos", root=tmp_path, **({"vertical_datum": DATUM} | options)
    )


def texts(site, **options):
    report = check_site(site, **options)
    return [f"{p.severity} {p.subject}: {p.text} {p.remedy}" for p in report.problems]


def edit_yaml(site, **values):
    path = site.folder / "site.yaml"
    content = YAML().load(path.read_text())
    content.update(values)
    with path.open("w") as file:
        YAML().dump(content, file)


# ---------------------------------------------------------------------------- a good flight


def test_geotagged_flight_needs_no_edits(tmp_path):
    write_flight(tmp_path / "photos", gnss_clock=(10, 0, 0))
    site = make(tmp_path)
    assert site.crs.to_epsg() == 32633  # 12.45 E
    assert site.vertical_datum == DATUM
    assert [p.strip for p in site.photographs] == [0] * 4 + [1] * 4
    assert [p.order for p in site.photographs] == [0, 1, 2, 3] * 2
    assert set(site.cameras) == {"camera1"}
    assert site.cameras["camera1"].focal_x == pytest.approx(8.8 / 13.2 * (5472 // 32), rel=2e-3)
    to_utm = Transformer.from_crs(4326, 32633, always_xy=True)
    assert site.photographs[0].position == pytest.approx(
        (*to_utm.transform(LONGITUDE, LATITUDE), 600), abs=0.01
    )
    assert site.photographs[0].height_above_ground == 50
    report = check_site(site, Parameters())
    assert not report.problems
    assert "error" in str(report)
    # 50 m above ground: 75 m wide and 50 m deep, 20 m between photographs, 40 m between strips.
    assert report.overlap.ground == pytest.approx(550)
    assert report.overlap.forward == pytest.approx(1 - 20 / 50, abs=0.02)
    assert report.overlap.across == pytest.approx(1 - 40 / 75, abs=0.02)
    assert report.cost.total_seconds > 0


def test_overlap_count_is_that_of_the_footprints(tmp_path):
    write_flight(tmp_path / "photos", strips=1, per_strip=3)
    overlap = check_site(make(tmp_path)).overlap
    # A single strip of three: 75 m x (50 + 2 * 20) m in all, 20 m less by two, 40 m less by three.
    assert overlap.area(1) == pytest.approx(75 * 90, rel=0.05)
    assert overlap.area(2) == pytest.approx(75 * 50, rel=0.05)
    assert overlap.area(3) == pytest.approx(75 * 10, rel=0.15)
    assert np.isnan(overlap.across)


def test_overlap_map_is_written(tmp_path):
    write_flight(tmp_path / "photos")
    site = make(tmp_path)
    result = CliRunner().invoke(app, ["check", "--site", "lake", "--root", str(tmp_path)])
    assert result.exit_code == 0 and "overlap map" in result.output and "expected time" in result.output
    count = read_raster(site.products / "check" / "overlap.tif")
    assert count.max() == 6 and count.rio.crs == site.crs
    assert len(read_vector(site.products / "check" / "footprints.gpkg")) == 8


def test_gimbal_angles_count_from_grid_north(tmp_path):
    gimbal = {"GimbalRollDegree": "+0.00", "GimbalPitchDegree": "-90.00", "GimbalYawDegree": "+30.00"}
    write_flight(tmp_path / "photos", xmp=gimbal)
    site = make(tmp_path)
    # West of the central meridian of zone 33 (15 E) grid north lies west of true north.
    convergence = np.degrees(np.arctan(np.tan(np.radians(LONGITUDE - 15)) * np.sin(np.radians(LATITUDE))))
    omega, phi, kappa = site.photographs[0].attitude
    assert (omega, phi) == pytest.approx((0, 0), abs=1e-6)
    assert kappa == pytest.approx(-(30 - convergence), abs=0.01)


def test_time_zone_gives_the_sun(tmp_path):
    write_flight(tmp_path / "photos")
    site = make(tmp_path)
    assert site.photographs[0].sun is None
    assert any("time zone" in text for text in texts(site))
    site = make(tmp_path, time_zone="Europe/Berlin")
    assert site.photographs[0].time == datetime(2021, 6, 21, 10, tzinfo=UTC)
    elevation, azimuth = site.photographs[0].sun
    assert 55 < elevation < 62 and 130 < azimuth < 150  # Two hours before noon on the longest day.
    assert not any("time zone" in text for text in texts(site))
    with pytest.raises(SiteError, match="Mars/Olympus"):
        make(tmp_path, time_zone="Mars/Olympus")


def test_satellite_time_needs_no_zone(tmp_path):
    write_flight(tmp_path / "photos", gnss_clock=(10, 0, 0))
    assert make(tmp_path).photographs[0].sun is not None


def test_editing_the_time_zone_is_enough(tmp_path):
    write_flight(tmp_path / "photos")
    edit_yaml(make(tmp_path), time_zone="Europe/Berlin")
    assert load_site("lake", tmp_path).photographs[0].sun is not None


def test_answers_survive_a_second_run(tmp_path):
    write_flight(tmp_path / "photos", make="Acme", model="Skycam 9")
    site = make(tmp_path)
    cameras = YAML(typ="safe").load((site.folder / "site.yaml").read_text())["cameras"]
    cameras["camera1"] |= {"sensor_width_mm": 13.2}
    edit_yaml(
        site, cameras=cameras, flight={"operator": 'J. Doe: "pilot"', "wind": "3 m/s"}, water_level=517.93
    )
    (site.folder / "control.csv").write_text(
        "name,x,y,z,sd_xy,sd_z,role\nA,309000,5305000,520,0.02,0.03,check\n"
    )
    site = make(tmp_path, vertical_datum=None)
    assert site.vertical_datum == DATUM
    assert site.flight["operator"] == 'J. Doe: "pilot"' and site.flight["wind"] == "3 m/s"
    assert site.water_level == 517.93
    assert site.control[0].role == "check"
    assert site.cameras["camera1"].focal_x == pytest.approx(8.8 / 13.2 * (5472 // 32))
    assert "source: stated" in (site.folder / "site.yaml").read_text()


def test_photographs_inside_the_site_are_relative_and_move_with_it(tmp_path):
    photos = tmp_path / "one" / "data" / "sites" / "lake" / "photographs"
    write_flight(photos)
    new_site("lake", photos=photos, root=tmp_path / "one", vertical_datum=DATUM)
    (tmp_path / "one").rename(tmp_path / "two")
    assert not check_site(load_site("lake", tmp_path / "two")).errors


# ---------------------------------------------------------------------------- cameras


def test_unknown_camera_is_a_question(tmp_path):
    write_flight(tmp_path / "photos", make="Acme", model="Skycam 9")
    site = make(tmp_path)
    assert not site.cameras
    (text,) = [text for text in texts(site) if text.startswith("error")]
    assert "sensor_width_mm" in text and "Acme Skycam 9" in text and "data sheet" in text
    cameras = YAML(typ="safe").load((site.folder / "site.yaml").read_text())["cameras"]
    edit_yaml(site, cameras={"camera1": cameras["camera1"] | {"focal_length_px": 4000}})
    assert load_site("lake", tmp_path).cameras["camera1"].focal_x == 4000


@pytest.mark.parametrize("bad", [{"width": "wide"}, {"focal_length_mm": -3}, {"distortion": ["a"]}])
def test_impossible_camera_is_named(tmp_path, bad):
    write_flight(tmp_path / "photos")
    site = make(tmp_path)
    cameras = YAML(typ="safe").load((site.folder / "site.yaml").read_text())["cameras"]
    edit_yaml(site, cameras={"camera1": cameras["camera1"] | bad})
    with pytest.raises(SiteError, match=r"cameras\.camera1"):
        load_site("lake", tmp_path)


def test_two_cameras_are_told_apart(tmp_path):
    write_flight(tmp_path / "photos" / "a")
    write_flight(tmp_path / "photos" / "b", make="Sony", model="ILCE-6000", focal=16.0, size=(150, 100))
    site = make(tmp_path)
    assert len(site.cameras) == 2
    assert any("several cameras" in text for text in texts(site))
    by_folder = {p.name.split("/")[0]: p.camera for p in site.photographs}
    assert site.cameras[by_folder["b"]].focal_x == pytest.approx(16 / 23.5 * 150)
    assert {p.strip for p in site.photographs if p.name.startswith("a")} == {0, 1}
    assert {p.strip for p in site.photographs if p.name.startswith("b")} == {2, 3}


def test_mixed_sizes_of_one_camera_are_reported(tmp_path):
    write_flight(tmp_path / "photos")
    write_photo(tmp_path / "photos" / "small.jpg", size=(60, 40), place=(LONGITUDE, LATITUDE))
    assert any("several sizes (60 x 40, 171 x 114)" in text for text in texts(make(tmp_path)))


def test_rig_of_equal_bodies_in_folders(tmp_path):
    for number, folder in enumerate(("nadir", "left", "right")):
        write_flight(tmp_path / "photos" / folder, strips=1, seed=number)
    site = make(tmp_path)
    assert len(site.cameras) == 3
    assert len({(p.name.split("/")[0], p.camera, p.strip) for p in site.photographs}) == 3


def test_a_new_folder_of_the_memory_card_is_the_same_camera(tmp_path):
    for folder, hour in (("100MEDIA", 10), ("101MEDIA", 11)):
        for n in range(3):
            place = LONGITUDE + n * 20 * METRE_EAST, LATITUDE
            write_photo(
                tmp_path / "photos" / folder / f"{folder}{n}.jpg",
                place=place,
                clock=f"2021:06:21 {hour}:00:0{n}",
            )
    assert len(make(tmp_path).cameras) == 1


def test_serial_numbers_go_before_folders(tmp_path):
    for serial in ("111", "222"):
        for n in range(2):
            write_photo(tmp_path / "photos" / f"{serial}_{n}.jpg", place=(LONGITUDE, LATITUDE), serial=serial)
    assert len(make(tmp_path).cameras) == 2


def test_near_infrared_tiff_of_16_bit(tmp_path):
    (tmp_path / "photos").mkdir()
    for n in range(3):
        values = np.random.default_rng(n).integers(0, 65535, (4, 40, 60)).astype(np.uint16)
        path = tmp_path / "photos" / f"{n}.tif"
        with rasterio.open(path, "w", driver="GTiff", width=60, height=40, count=4, dtype="uint16") as target:
            target.write(values)
    site = make(tmp_path, crs="EPSG:25833")
    assert [p.bands for p in site.photographs] == [4, 4, 4]
    assert len(site.cameras) == 0 and "camera without EXIF" in " ".join(site.unanswered)


# ---------------------------------------------------------------------------- bad input


def test_empty_folder(tmp_path):
    (tmp_path / "photos").mkdir()
    with pytest.raises(SiteError, match="holds no photograph"):
        make(tmp_path)
    with pytest.raises(SiteError, match="no such folder"):
        new_site("lake", photos=tmp_path / "nowhere", root=tmp_path)


def test_one_photograph(tmp_path):
    write_photo(tmp_path / "photos" / "only.jpg", place=(LONGITUDE, LATITUDE))
    errors = [text for text in texts(make(tmp_path)) if text.startswith("error")]
    assert any("only 1 usable photograph" in text for text in errors)


def test_damaged_files_are_set_aside_and_the_rest_goes_on(tmp_path):
    write_flight(tmp_path / "photos")
    (tmp_path / "photos" / "letter.jpg").write_text("Dear Sir or Madam")
    (tmp_path / "photos" / "empty.jpg").write_bytes(b"")
    (tmp_path / "photos" / "IMG_copy.jpg").write_bytes((tmp_path / "photos" / "IMG_0002.jpg").read_bytes())
    truncate(tmp_path / "photos" / "IMG_0003.jpg")
    site = make(tmp_path)
    reasons = {p.name: p.set_aside for p in site.set_aside}
    assert set(reasons) == {"letter.jpg", "empty.jpg", "IMG_0003.jpg", "IMG_copy.jpg"}
    assert "not a readable image" in reasons["letter.jpg"]
    assert "truncated" in reasons["IMG_0003.jpg"]
    assert "the same file as IMG_0002.jpg" in reasons["IMG_copy.jpg"]
    assert len(site.photographs) == 7
    report = check_site(site)
    assert not report.errors
    assert {p.subject for p in report.problems} >= set(reasons)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.95])
def test_truncation_anywhere_is_seen(tmp_path, share):
    write_flight(tmp_path / "photos")
    truncate(tmp_path / "photos" / "IMG_0000.jpg", share)
    assert [p.name for p in make(tmp_path).set_aside] == ["IMG_0000.jpg"]


def test_truncated_tiff(tmp_path):
    write_flight(tmp_path / "photos")
    path = tmp_path / "photos" / "cut.tif"
    values = np.random.default_rng(1).integers(0, 255, (3, 400, 300)).astype(np.uint8)
    with rasterio.open(path, "w", driver="GTiff", width=300, height=400, count=3, dtype="uint8") as target:
        target.write(values)
    truncate(path)
    assert [p.name for p in make(tmp_path).set_aside] == ["cut.tif"]


def test_no_exif_at_all(tmp_path):
    write_flight(tmp_path / "photos", exif=False, xmp={})
    site = make(tmp_path, crs="EPSG:25833")
    assert all(p.position is None for p in site.photographs)
    found = texts(site)
    assert any("no EXIF" in text for text in found)
    assert any("Three of either are needed" in text for text in found)
    assert any("focal_length_mm is open for 'a camera without EXIF'" in text for text in found)


def test_missing_crs_and_datum_are_open_questions(tmp_path):
    write_flight(tmp_path / "photos", exif=False)
    site = new_site("lake", photos=tmp_path / "photos", root=tmp_path)
    assert site.crs is None and site.vertical_datum is None
    errors = [text for text in texts(site) if text.startswith("error")]
    assert any("crs is open" in text for text in errors)
    assert any("vertical_datum is open" in text for text in errors)
    assert "vertical_datum: null" in (site.folder / "site.yaml").read_text()


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:999999", "my own", "EPSG:2263"])  # 2263 is in feet.
def test_unusable_crs_is_refused(tmp_path, crs):
    write_flight(tmp_path / "photos")
    with pytest.raises(SiteError, match="CRS"):
        make(tmp_path, crs=crs)
    assert not (tmp_path / "data").exists()


def test_zero_swapped_and_far_positions_become_notes(tmp_path):
    write_flight(tmp_path / "photos", gnss_clock=(10, 0, 0))
    write_photo(tmp_path / "photos" / "zero.jpg", place=(0.0, 0.0))
    write_photo(tmp_path / "photos" / "swapped.jpg", place=(LATITUDE, LONGITUDE))
    write_photo(tmp_path / "photos" / "far.jpg", place=(LONGITUDE + 0.5, LATITUDE))
    write_photo(tmp_path / "photos" / "impossible.jpg", place=(LONGITUDE, 95.0))
    site = make(tmp_path)
    notes = {p.name: p.note for p in site.photographs if p.note}
    assert "0, 0" in notes["zero.jpg"]
    assert "km from the others" in notes["swapped.jpg"]
    assert "37." in notes["far.jpg"]  # 0.5 degrees east at 47.87 N are 37.4 km.
    assert "swapped" in notes["impossible.jpg"]
    assert len(notes) == 4
    assert all(site.photograph(name).position is None for name in notes)
    report = check_site(site)
    assert not report.errors and {p.subject for p in report.warnings} >= set(notes)
    assert {p.strip for p in site.photographs if p.position} == {0, 1}


def test_far_position_written_by_hand_is_an_error(tmp_path):
    write_flight(tmp_path / "photos")
    site = make(tmp_path)
    path = site.folder / "photographs.csv"
    rows = list(csv.DictReader(path.open()))
    rows[2]["x"], rows[2]["y"] = rows[2]["y"], rows[2]["x"]
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    errors = [text for text in texts(load_site("lake", tmp_path)) if text.startswith("error")]
    assert any("IMG_0002" in text and "km from the others" in text for text in errors)


def test_another_zone_than_the_positions(tmp_path):
    write_flight(tmp_path / "photos")
    site = make(tmp_path, crs="EPSG:32640")
    assert any("outside of the area" in text for text in texts(site))


def test_photographs_without_overlap(tmp_path):
    write_flight(tmp_path / "photos", strips=1, along=400.0)
    found = texts(make(tmp_path))
    assert sum("shares less than a tenth" in text for text in found) == 4
    assert any("forward overlap is 0 %" in text for text in found)


def test_missing_altitude_weighs_nothing(tmp_path):
    write_flight(tmp_path / "photos", altitude=None)
    site = make(tmp_path)
    assert site.photographs[0].position_sd[2] == 10_000
    assert site.photographs[0].note == "no altitude recorded"


def test_folder_that_cannot_be_written(tmp_path):
    write_flight(tmp_path / "photos")
    (tmp_path / "data").write_text("a file where a folder should be")
    with pytest.raises(SiteError, match=r"cannot be written.*another root"):
        make(tmp_path)


def test_full_disk(tmp_path, monkeypatch):
    write_flight(tmp_path / "photos")

    def full(self, *_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(SiteError, match=r"No space left.*Free space"):
        make(tmp_path)


def test_missing_photograph_is_reported(tmp_path):
    write_flight(tmp_path / "photos")
    site = make(tmp_path)
    (tmp_path / "photos" / "IMG_0001.jpg").unlink()
    assert any("IMG_0001.jpg" in text and "is gone" in text for text in texts(site))


def test_missing_site_and_broken_yaml(tmp_path):
    with pytest.raises(SiteError, match="no such site"):
        load_site("lake", tmp_path)
    folder = tmp_path / "data" / "sites" / "lake"
    folder.mkdir(parents=True)
    (folder / "site.yaml").write_text("a: [1, 2")
    with pytest.raises(SiteError, match="not valid YAML"):
        load_site("lake", tmp_path)
    (folder / "site.yaml").write_text("just words")
    with pytest.raises(SiteError, match="must hold the description"):
        load_site("lake", tmp_path)


def test_broken_list_of_photographs_is_named_with_its_line(tmp_path):
    write_flight(tmp_path / "photos")
    path = make(tmp_path).folder / "photographs.csv"
    lines = path.read_text().splitlines()
    for broken, message in (
        (lines[2].replace(lines[2].split(",")[2], "east"), "line 3: .*east"),
        (lines[2].replace(lines[2].split(",")[2], ""), "line 3: x, y, z are filled in part"),
        (lines[1], "line 3: IMG_0000.jpg occurs twice"),
    ):
        path.write_text("\n".join([*lines[:2], broken, *lines[3:]]) + "\n")
        with pytest.raises(SiteError, match=message):
            load_site("lake", tmp_path)


def test_unknown_file_of_a_site(tmp_path):
    write_flight(tmp_path / "photos")
    with pytest.raises(SiteError, match="shorline"):
        make(tmp_path, shorline="x.gpkg")
    with pytest.raises(SiteError, match=r"dtm.*does not exist"):
        make(tmp_path, dtm=tmp_path / "none.tif")


def test_degrees_of_a_metre():
    # The helper that places the flights is right to a per mille, or the overlaps above mean nothing.
    to_utm = Transformer.from_crs(4326, 32633, always_xy=True)
    x0, y0 = to_utm.transform(LONGITUDE, LATITUDE)
    x1, y1 = to_utm.transform(LONGITUDE + 1000 * METRE_EAST, LATITUDE)
    x2, y2 = to_utm.transform(LONGITUDE, LATITUDE + 1000 * METRE_NORTH)
    assert np.hypot(x1 - x0, y1 - y0) == pytest.approx(1000, rel=2e-3)
    assert np.hypot(x2 - x0, y2 - y0) == pytest.approx(1000, rel=2e-3)
