"""The camera table, EXIF and XMP, and the sun."""

from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pandas as pd
import piexif
import pytest
import rasterio
from PIL import Image

from workbench.cameras.exif import read_facts
from workbench.cameras.sun import sun_position
from workbench.cameras.table import find_sensor, known_sensors

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
PUBLISHED = Path(__file__).parents[2] / "data" / "published"


# ---------------------------------------------------------------------------- table


def test_table_is_large_and_consistent():
    sensors = known_sensors()
    assert len(sensors) >= 40
    for s in sensors:
        pixel = s.sensor_width / s.pixels_wide
        assert 1e-6 < pixel < 13e-6, s.model
        # Pixels are square, so width and height tell the same size.
        assert s.sensor_height / s.pixels_high == pytest.approx(pixel, rel=2e-3), s.model
        assert s.focal_length is None or 2e-3 < s.focal_length < 0.3, s.model


@pytest.mark.parametrize(
    ("make", "model", "camera"),
    [
        ("DJI", "FC300S", None),
        ("Vexcel", "UltraCam Eagle 80", "UltraCam Eagle 80"),
        ("Vexcel", "UltraCam Eagle 210", "UltraCam Eagle 210"),
        ("Intergraph", "DMC II 230", "DMC II 230"),
        ("Intergraph", "DMC I", "DMC I"),
        ("DLR", "MACS Hale", "MACS Hale"),
        ("DLR", "MACS MAR", "MACS MAR 9cm"),
        ("Canon", "Canon EOS-1Ds Mark II", "DLR 3K (Canon EOS 1Ds Mark II, nadir)"),
        ("GoPro", "HERO7 Black", "GoPro Hero 7"),
        ("SONY", "NEX-5N", "Sony NEX-5N"),
        ("SONY", "NEX-7", "Sony NEX-7"),
        ("SONY", "ILCE-7RM2", "Sony ILCE-7RM2"),
    ],
)
def test_cameras_of_the_papers(make, model, camera):
    sensor = find_sensor(make, model)
    assert sensor is not None
    if camera is None:
        assert (sensor.sensor_width, sensor.focal_length) == (6.17e-3, 3.61e-3)
        return
    cameras = pd.read_csv(PUBLISHED / "cameras.csv")
    row = cameras[cameras.camera == camera].iloc[0]
    assert (sensor.pixels_wide, sensor.pixels_high) == (row.pixels_across, row.pixels_along)
    assert sensor.sensor_width / sensor.pixels_wide == pytest.approx(row.pixel_um * 1e-6, rel=3e-3)


def test_spelling_of_makes_and_models_does_not_matter():
    assert find_sensor("Canon", "Canon EOS 5D Mark II") == find_sensor("CANON ", "EOS 5D Mark II")
    assert find_sensor("NIKON CORPORATION", "NIKON D800") is not None
    assert find_sensor("dji", "fc 300s") == find_sensor("DJI", "FC300S")


@pytest.mark.parametrize(("make", "model"), [("", ""), ("DJI", "FC9999"), ("DJI", ""), ("Sony", "FC300S")])
def test_unknown_models_are_unknown(make, model):
    assert find_sensor(make, model) is None


@pytest.mark.parametrize(
    ("size", "factor"),
    [
        ((5472, 3648), 1),  # whole
        ((5472, 3078), 1),  # cropped to 16:9
        ((4864, 3648), 1),  # cropped to 4:3
        ((3648, 5472), 1),  # turned upright
        ((2736, 1824), 2),  # reduced by two
        ((1368, 912), 4),
        ((4000, 2000), None),  # cropped and reduced: who knows
        ((6000, 4000), None),  # larger than the sensor: enlarged, or another camera
    ],
)
def test_pixel_size_of_cropped_and_reduced_frames(size, factor):
    sensor = find_sensor("DJI", "FC6310")
    pixel = sensor.pixel_size(*size)
    expected = None if factor is None else pytest.approx(factor * 13.2e-3 / 5472)
    assert pixel == expected


# ---------------------------------------------------------------------------- EXIF and XMP


def jpeg(path, *, zeroth=None, exif=None, gps=None, xmp=""):
    tags = {"0th": zeroth or {}, "Exif": exif or {}, "GPS": gps or {}}
    Image.new("RGB", (32, 24)).save(path, exif=piexif.dump(tags), **({"xmp": xmp.encode()} if xmp else {}))
    return read_facts(path)


def xmp_packet(attributes):
    return (
        f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF><rdf:Description {attributes}/></rdf:RDF></x:xmpmeta>'
    )


def test_dji_with_rtk(tmp_path):
    facts = jpeg(
        tmp_path / "a.jpg",
        zeroth={piexif.ImageIFD.Make: "DJI", piexif.ImageIFD.Model: "FC6310R"},
        exif={piexif.ExifIFD.FocalLength: (88, 10), piexif.ExifIFD.DateTimeOriginal: "2022:05:10 11:09:10"},
        gps={
            piexif.GPSIFD.GPSLatitudeRef: "S",
            piexif.GPSIFD.GPSLatitude: ((33, 1), (30, 1), (36, 1)),
            piexif.GPSIFD.GPSLongitudeRef: "W",
            piexif.GPSIFD.GPSLongitude: ((70, 1), (15, 1), (18, 1)),
            piexif.GPSIFD.GPSAltitude: (12345, 100),
            piexif.GPSIFD.GPSAltitudeRef: 1,
        },
        xmp=xmp_packet(
            'drone-dji:RelativeAltitude="+99.70" drone-dji:GimbalRollDegree="+0.10" '
            'drone-dji:GimbalPitchDegree="-89.90" drone-dji:GimbalYawDegree="-12.50" '
            'drone-dji:RtkStdLon="0.01100" drone-dji:RtkStdLat="0.01200" drone-dji:RtkStdHgt="0.02500" '
            'drone-dji:UTCAtExposure="2022-05-10T09:10:11.123456"'
        ),
    )
    assert (facts.make, facts.model, facts.focal_length) == ("DJI", "FC6310R", pytest.approx(8.8e-3))
    assert facts.latitude == pytest.approx(-33.51) and facts.longitude == pytest.approx(-70.255)
    assert facts.altitude == pytest.approx(-123.45)
    assert facts.relative_altitude == 99.7
    assert facts.position_sd == (0.011, 0.012, 0.025)
    assert facts.gimbal == (0.1, -89.9, -12.5)
    assert facts.time == datetime(2022, 5, 10, 9, 10, 11, 123456, tzinfo=UTC)


def test_xmp_written_as_elements(tmp_path):
    packet = xmp_packet("").replace(
        "/></rdf:RDF>",
        "><drone-dji:RelativeAltitude>+42.0</drone-dji:RelativeAltitude></rdf:Description></rdf:RDF>",
    )
    assert jpeg(tmp_path / "a.jpg", xmp=packet).relative_altitude == 42


def test_accuracy_of_mapping_drones_and_of_plain_exif(tmp_path):
    facts = jpeg(tmp_path / "a.jpg", xmp=xmp_packet('Camera:GPSXYAccuracy="0.03" Camera:GPSZAccuracy="0.05"'))
    assert facts.position_sd == (0.03, 0.03, 0.05)
    facts = jpeg(tmp_path / "b.jpg", gps={piexif.GPSIFD.GPSHPositioningError: (35, 10)})
    assert facts.position_sd == (3.5, 3.5, 7.0)


@pytest.mark.parametrize(
    ("make", "model", "focal"),
    [("Canon", "Canon EOS 5D Mark II", 24.0), ("SONY", "NEX-7", 18.0), ("GoPro", "HERO7 Black", 3.0)],
)
def test_other_makers(tmp_path, make, model, focal):
    facts = jpeg(
        tmp_path / "a.jpg",
        zeroth={piexif.ImageIFD.Make: make, piexif.ImageIFD.Model: model},
        exif={
            piexif.ExifIFD.FocalLength: (int(focal * 10), 10),
            piexif.ExifIFD.BodySerialNumber: "0123",
            piexif.ExifIFD.DateTimeOriginal: "2017:09:30 08:15:59",
            piexif.ExifIFD.SubSecTimeOriginal: "25",
        },
    )
    assert find_sensor(facts.make, facts.model) is not None
    assert facts.focal_length == pytest.approx(focal / 1000)
    assert facts.serial == "0123"
    assert facts.time == datetime(2017, 9, 30, 8, 15, 59, 250_000)
    assert facts.gimbal is None and facts.position_sd is None


def test_offset_of_the_clock(tmp_path):
    stamp = {
        piexif.ExifIFD.DateTimeOriginal: "2020:06:01 12:00:00",
        piexif.ExifIFD.OffsetTimeOriginal: "-05:00",
    }
    assert jpeg(tmp_path / "a.jpg", exif=stamp).time == datetime(2020, 6, 1, 17, tzinfo=UTC)


def test_focal_plane_resolution_is_a_hint_only(tmp_path):
    tags = {
        piexif.ExifIFD.FocalPlaneXResolution: (5184 * 100, 2230),
        piexif.ExifIFD.FocalPlaneResolutionUnit: 4,
        piexif.ExifIFD.PixelXDimension: 5184,
    }
    assert jpeg(tmp_path / "a.jpg", exif=tags).sensor_width_hint == pytest.approx(22.3e-3, rel=1e-3)


def test_tiff_whose_directory_stands_behind_the_pixels(tmp_path):
    path = tmp_path / "a.tif"
    values = np.random.default_rng(1).integers(0, 65535, (3, 500, 400)).astype(np.uint16)
    with rasterio.open(path, "w", driver="GTiff", width=400, height=500, count=3, dtype="uint16") as target:
        target.write(values)
    with rasterio.open(path, "r+") as target:
        target.update_tags(TIFFTAG_DATETIME="2021:06:21 12:00:00")
        target.update_tags(ns="xml:XMP", **{"xml:XMP": xmp_packet('drone-dji:RelativeAltitude="+51.5"')})
    assert path.stat().st_size > 512 * 1024
    assert read_facts(path).time == datetime(2021, 6, 21, 12)


@pytest.mark.parametrize(
    "content", [b"", b"Dear Sir", b"\xff\xd8\xff\xe1\x00\x10Exif\x00\x00II*\x00\xff\xff\xff\xff"]
)
def test_files_without_facts(tmp_path, content):
    path = tmp_path / "a.jpg"
    path.write_bytes(content)
    facts = read_facts(path)
    assert facts.make == "" and facts.longitude is None and facts.time is None


def test_zeros_before_the_first_fix(tmp_path):
    gps = {piexif.GPSIFD.GPSDateStamp: "0000:00:00", piexif.GPSIFD.GPSTimeStamp: ((0, 1), (0, 1), (0, 1))}
    exif = {piexif.ExifIFD.DateTimeOriginal: "2020:06:01 12:00:00"}
    assert jpeg(tmp_path / "a.jpg", gps=gps, exif=exif).time == datetime(2020, 6, 1, 12)


# ---------------------------------------------------------------------------- sun


@pytest.mark.parametrize(
    ("time", "declination"),
    [
        # Equinoxes and solstices of 2024 by the almanac (UTC): declination 0 and +-23.436 degrees.
        (datetime(2024, 3, 20, 3, 6, tzinfo=UTC), 0.0),
        (datetime(2024, 6, 20, 20, 51, tzinfo=UTC), 23.436),
        (datetime(2024, 9, 22, 12, 44, tzinfo=UTC), 0.0),
        (datetime(2024, 12, 21, 9, 21, tzinfo=UTC), -23.436),
    ],
)
def test_declination_at_the_seasons(time, declination):
    # At the pole the sun stands as high as its declination, at any hour.
    assert sun_position(time, 0, 90)[0] == pytest.approx(declination, abs=0.02)


@pytest.mark.parametrize(
    ("day", "minutes"),
    # Equation of time (apparent minus mean solar time) at its four extremes, minutes.
    [((2023, 2, 11), -14.2), ((2023, 5, 14), 3.7), ((2023, 7, 26), -6.5), ((2023, 11, 3), 16.4)],
)
def test_noon_of_greenwich_follows_the_equation_of_time(day, minutes):
    noon = datetime(*day, 12, tzinfo=UTC) - timedelta(minutes=minutes)
    elevation, azimuth = sun_position(noon, 0, 51.48)
    assert azimuth == pytest.approx(180, abs=0.1)
    later, earlier = (sun_position(noon + timedelta(minutes=m), 0, 51.48)[0] for m in (30, -30))
    assert elevation > later and elevation > earlier


def test_worked_example_of_the_literature():
    # Reda and Andreas 2004 (NREL SPA), 17 October 2003, 12:30:30 at UTC-7, 105.1786 W, 39.742476 N:
    # topocentric zenith 50.11162 (with refraction, here about 0.02 degree), azimuth 194.34024 degrees.
    time = datetime(2003, 10, 17, 12, 30, 30, tzinfo=timezone(timedelta(hours=-7)))
    elevation, azimuth = sun_position(time, -105.1786, 39.742476)
    assert elevation == pytest.approx(90 - 50.11162, abs=0.03)
    assert azimuth == pytest.approx(194.34024, abs=0.03)


def test_the_sun_rises_in_the_east_and_stands_north_in_the_south():
    assert 60 < sun_position(datetime(2021, 6, 21, 4, tzinfo=UTC), 12.45, 47.87)[1] < 70
    elevation, azimuth = sun_position(datetime(2021, 12, 21, 4, 15, tzinfo=UTC), 115.86, -31.95)
    assert azimuth > 340 or azimuth < 20
    assert elevation == pytest.approx(90 - 31.95 + 23.43, abs=0.1)


def test_time_without_zone_is_refused():
    with pytest.raises(ValueError, match="time zone"):
        sun_position(datetime(2021, 6, 21, 12), 0, 0)
