from types import SimpleNamespace

import numpy as np
import pytest
from rasterio.crs import CRS

from workbench.cameras import Camera, Pose
from workbench.cameras.footprint import footprint
from workbench.errors import CameraError
from workbench.rasters import Grid, new_raster

CAMERA = Camera("test", 400, 300, 500, 500, 200, 150)
BENT = Camera("bent", 400, 300, 500, 500, 205, 148, (-0.15, 0.05, 0.001, -0.0008))


def terrain(height, size=400.0, cell=1.0):
    grid = Grid.from_bounds(CRS.from_epsg(32633), (0, 0, size, size), cell)
    x, y = np.meshgrid(grid.x, grid.y)
    return new_raster(height(x, y) * np.ones_like(x), grid, name="dtm", units="m", vertical_datum="test")


def photograph(pose, camera=CAMERA):
    return SimpleNamespace(name="photo", camera=camera, pose=pose)


def test_nadir_on_a_plane_is_the_frame_over_focal_length():
    pose = Pose.from_omega_phi_kappa(np.array([200.0, 200.0, 150.0]), 0, 0, 0)
    outline = footprint(photograph(pose), terrain(lambda x, y: 50.0))
    assert outline.bounds == pytest.approx((160, 170, 240, 230))
    assert outline.area == pytest.approx(80 * 60)


@pytest.mark.parametrize("angles", [(0, 0, 30), (25, -10, 200), (-20, 35, 77), (-8, 12, 310)])
@pytest.mark.parametrize("camera", [CAMERA, BENT])
def test_border_points_on_a_slope_project_back_to_the_border(angles, camera):
    roll, pitch, heading = angles
    pose = Pose.from_roll_pitch_heading(np.array([200.0, 200.0, 160.0]), roll, pitch, heading)
    ground = terrain(lambda x, y: 20 + 0.1 * x - 0.05 * y)
    corners = np.array(footprint(photograph(pose, camera), ground).exterior.coords)
    z = 20 + 0.1 * corners[:, 0] - 0.05 * corners[:, 1]
    places = camera.project(pose.to_camera(np.column_stack([corners, z])))
    edge = np.minimum(
        np.minimum(abs(places[:, 0]), abs(places[:, 0] - 400)),
        np.minimum(abs(places[:, 1]), abs(places[:, 1] - 300)),
    )
    assert edge.max() < 1e-5


def test_the_first_of_two_intersections_counts():
    ground = terrain(lambda x, y: np.where((x > 225) & (x < 229), 60.0, 0.0))
    pose = Pose.from_omega_phi_kappa(np.array([200.0, 200.0, 100.0]), 0, 0, 0)
    east = footprint(photograph(pose), ground).bounds[2]
    # The border ray falls 2.5 m a metre; the wall's face rises by 60 m from 224.5 to 225.5:
    # 100 - 2.5 (x - 200) = 60 (x - 224.5).
    assert east == pytest.approx(225.12, abs=1e-6)


def test_bad_input_is_named():
    level = terrain(lambda x, y: 0.0)
    nadir = Pose.from_omega_phi_kappa(np.array([200.0, 200.0, 100.0]), 0, 0, 0)
    with pytest.raises(CameraError, match=r"photo.*horizon"):
        footprint(photograph(Pose.from_omega_phi_kappa(np.array([200.0, 200, 100]), 80, 0, 0)), level)
    with pytest.raises(CameraError, match=r"photo.*below the terrain"):
        footprint(photograph(nadir), level + 200)
    beside = Pose.from_omega_phi_kappa(np.array([390.0, 200.0, 100.0]), 0, 0, 0)
    with pytest.raises(CameraError, match="larger terrain"):
        footprint(photograph(beside), level)
    assert footprint(photograph(beside), level, extend=True).area == pytest.approx(80 * 60)
    with pytest.raises(CameraError, match="all nodata"):
        footprint(photograph(nadir), level * np.nan)
