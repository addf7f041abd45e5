"""Vector files and point clouds."""

import time

import geopandas as gpd
import numpy as np
import pytest
from pyproj import CRS
from shapely import Point, box

from workbench.errors import PointsError, VectorError
from workbench.points import read_points, write_points
from workbench.vectors import read_vector, write_layers


def reed():
    return gpd.GeoDataFrame({"aoi": ["1", "2"]}, geometry=[box(0, 0, 5, 5), box(9, 9, 11, 11)], crs=32633)


def test_layers_are_read_as_written(tmp_path):
    tops = gpd.GeoDataFrame({"tree_id": [1]}, geometry=[Point(3, 4)], crs=32633)
    path = write_layers({"extent": reed(), "tops": tops}, tmp_path / "deep" / "reed.gpkg")
    back = read_vector(path, layer="extent")
    assert back.aoi.tolist() == ["1", "2"] and back.geometry.geom_equals(reed().geometry).all()
    assert read_vector(path, layer="tops").tree_id.tolist() == [1]
    assert [p.name for p in path.parent.iterdir()] == ["reed.gpkg"]


def test_reprojection_on_reading(tmp_path):
    path = write_layers({"a": reed().translate(309000, 5305000).to_frame("geometry")}, tmp_path / "a.gpkg")
    west, south, *_ = read_vector(path, crs=4326).total_bounds
    assert 12 < west < 13 and 47 < south < 48


def test_rewriting_replaces_all_layers(tmp_path):
    path = write_layers({"old": reed()}, tmp_path / "a.gpkg")
    write_layers({"new": reed()}, path)
    with pytest.raises(VectorError, match="layer old"):
        read_vector(path, layer="old")


def test_same_layers_same_bytes_at_another_time(tmp_path):
    first = write_layers({"a": reed(), "b": reed()}, tmp_path / "1" / "a.gpkg").read_bytes()
    time.sleep(1.1)  # GeoPackage notes seconds.
    assert first == write_layers({"a": reed(), "b": reed()}, tmp_path / "2" / "a.gpkg").read_bytes()


@pytest.mark.parametrize("content", [None, "no vector file"])
def test_unreadable_vectors(tmp_path, content):
    path = tmp_path / "a.gpkg"
    if content is not None:
        path.write_text(content)
    with pytest.raises(VectorError, match=r"a\.gpkg"):
        read_vector(path)


def test_vectors_without_crs_are_refused(tmp_path):
    bare = gpd.GeoDataFrame(geometry=[Point(1, 2)])
    with pytest.raises(VectorError, match="layer a has no CRS"):
        write_layers({"a": bare}, tmp_path / "a.gpkg")
    bare.to_file(tmp_path / "b.shp")
    with pytest.raises(VectorError, match="no CRS"):
        read_vector(tmp_path / "b.shp")


def test_vectors_in_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(VectorError, match="cannot be written"):
        write_layers({"a": reed()}, tmp_path / "file" / "a.gpkg")


def cloud(n=500):
    return np.random.default_rng(1).uniform((309000, 5305000, 500), (309100, 5305100, 540), (n, 3))


def test_points_are_read_as_written(tmp_path):
    count = np.arange(500, dtype=np.uint16)
    path = write_points(
        cloud(), tmp_path / "deep" / "a.laz", crs="EPSG:32633", attributes={"image_count": count}
    )
    xyz, crs, attributes = read_points(path)
    assert np.abs(xyz - cloud()).max() <= 0.00051
    assert crs is not None and CRS.from_user_input(crs).to_epsg() == 32633
    assert np.array_equal(attributes["image_count"], count)


def test_same_points_same_bytes(tmp_path):
    first = write_points(cloud(), tmp_path / "a.laz", crs=32633).read_bytes()
    assert first == write_points(cloud(), tmp_path / "b.laz", crs=32633).read_bytes()


def test_no_points(tmp_path):
    xyz, _, _ = read_points(write_points(np.empty((0, 3)), tmp_path / "a.laz", crs=32633))
    assert xyz.shape == (0, 3)


@pytest.mark.parametrize("content", [None, "no point cloud"])
def test_unreadable_points(tmp_path, content):
    path = tmp_path / "a.laz"
    if content is not None:
        path.write_text(content)
    with pytest.raises(PointsError, match=r"a\.laz: not a readable point cloud"):
        read_points(path)


def test_points_in_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(PointsError, match="cannot be written"):
        write_points(cloud(), tmp_path / "file" / "a.laz", crs=32633)
