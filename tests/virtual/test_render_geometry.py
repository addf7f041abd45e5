"""Photographs of virtual scenes: projection, occlusion, depth, shadow, mirror."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pycolmap
import pytest

from workbench.cameras import Camera, Pose
from workbench.rasters import Grid
from workbench.virtual.composition import SceneSpec
from workbench.virtual.render import render
from workbench.virtual.scene import build_scene
from workbench.virtual.truth import scene_truth
from workbench.virtual.wind import Wind
from workbench.virtual.world import Cover

NOON = datetime(2020, 6, 21, 11, 0, tzinfo=UTC)
CALM = Wind.calm()


@pytest.fixture(scope="module")
def yard():
    """A slope with targets, a letter and a flat-roofed box."""
    targets = [
        {"name": f"T{i}", "x": x, "y": y, "edge": 0.8}
        for i, (x, y) in enumerate([(4.3, 5.1), (25.2, 4.4), (24.6, 24.9), (5.7, 25.3), (15.2, 9.1)])
    ]
    spec = SceneSpec(
        name="yard",
        seed=3,
        crs="EPSG:25832",
        vertical_datum="DHHN2016",
        origin=(600000.0, 5300000.0),
        size=(30.0, 30.0),
        terrain={"base": 100.0, "relief": 0.5, "longest": 15.0, "slope": (0.05, -0.03)},
        targets=[*targets, {"name": "F", "x": 9.0, "y": 15.0, "edge": 3.5, "kind": "letter"}],
        buildings=[
            {"x": 20.0, "y": 15.0, "length": 4.0, "width": 3.0, "eaves": 5.5, "ridge": 6.0, "roof": "flat"}
        ],
    )
    return build_scene(spec)


@pytest.fixture(scope="module")
def photograph(yard):
    """A tilted photograph through a lens with strong distortion, and its camera and pose."""
    camera = Camera("lens", 480, 480, 510, 507, 245.3, 236.1, (-0.11, 0.05, 0.0015, -0.0009, 0.004))
    pose = Pose.from_omega_phi_kappa((600014.0, 5300013.0, 140.0), 4.0, -3.0, 25.0)
    return render(yard, camera, pose, time=NOON, wind=CALM, supersampling=5), camera, pose


def test_targets_are_where_an_independent_camera_projects_them(yard, photograph):
    dataset, camera, pose = photograph
    k = camera.distortion
    # COLMAP's FULL_OPENCV has the coefficients in the same order.
    model = pycolmap.Camera(
        model="FULL_OPENCV",
        width=camera.width,
        height=camera.height,
        params=[camera.focal_x, camera.focal_y, camera.principal_x, camera.principal_y, *k],
    )
    green = dataset.radiance.sel(band="green").values
    quadrants = yard.targets[yard.targets.kind == "quadrant"]
    errors = []
    for x, y, z in zip(quadrants.x, quadrants.y, quadrants.z, strict=True):
        expected = model.img_from_cam(pose.to_camera(np.array([[x, y, z]])))[0]
        errors.append(np.hypot(*(_saddle(green, expected) - expected)))
    assert max(errors) < 0.1


def test_letter_reads_right(yard, photograph):
    dataset, camera, pose = photograph
    green = dataset.radiance.sel(band="green").values
    letter = yard.targets[yard.targets.kind == "letter"].iloc[0]
    cells = np.full((7, 7), np.nan)
    for i in range(7):
        for j in range(7):
            x = letter.x + (j - 3) / 7 * letter.edge_m
            y = letter.y + (3 - i) / 7 * letter.edge_m
            z = yard.ground_z(np.array([x]), np.array([y]))[0]
            column, row = camera.project(pose.to_camera(np.array([[x, y, z]])))[0]
            cells[i, j] = green[int(row), int(column)]
    white = cells > 0.4
    # Upright on the left, two arms to the right, nothing below them: an F from south to north.
    assert white[1:6, 1].all() and white[1, 1:6].all() and white[3, 1:4].all()
    assert white.sum() == 11


def test_depth_agrees_with_rays_through_the_surface(yard, photograph):
    dataset, camera, pose = photograph
    rng = np.random.default_rng(0)
    columns, rows = rng.integers(5, 475, (2, 300))
    rays = pose.to_world(camera.rays(np.stack([columns + 0.5, rows + 0.5], axis=1)))
    depth = dataset.depth.values[rows, columns].astype(float)
    points = pose.centre + depth[:, None] * rays
    ground = np.isin(dataset.cover.values[rows, columns], [Cover.MEADOW, Cover.TARGET])
    inside = (points[:, 0] > 600000) & (points[:, 0] < 600030) & (points[:, 1] > 5300000)
    chosen = ground & inside & (points[:, 1] < 5300030)
    assert chosen.sum() > 100
    gap = points[chosen, 2] - yard.ground_z(points[chosen, 0], points[chosen, 1])
    assert np.abs(gap).max() < 0.005
    roof = dataset.cover.values == Cover.BUILDING
    i, j = np.argwhere(roof).mean(axis=0).astype(int)
    ray = pose.to_world(camera.rays(np.array([[j + 0.5, i + 0.5]])))[0]
    top = (pose.centre + float(dataset.depth[i, j]) * ray)[2]
    assert top == pytest.approx(yard.buildings.ridge_z[0], abs=0.01)


def test_points_behind_the_building_are_hidden(yard, photograph):
    dataset, camera, pose = photograph
    house = yard.buildings.geometry[0]
    middle = np.array([house.centroid.x, house.centroid.y])
    outward = (middle - pose.centre[:2]) / np.linalg.norm(middle - pose.centre[:2])
    hidden = middle + outward * 1.9
    z = yard.ground_z(hidden[:1], hidden[1:])[0]
    column, row = camera.project(pose.to_camera(np.array([[*hidden, z]])))[0]
    distance = pose.to_camera(np.array([[*hidden, z]]))[0, 2]
    assert dataset.cover.values[int(row), int(column)] == Cover.BUILDING
    assert dataset.depth.values[int(row), int(column)] < distance - 1


def test_shadow_falls_where_the_sun_says(yard):
    camera = Camera("plain", 400, 400, 400, 400, 200, 200)
    pose = Pose.from_omega_phi_kappa((600015.0, 5300015.0, 140.0), 0, 0, 0)
    time = datetime(2020, 6, 21, 15, 30, tzinfo=UTC)
    shade = render(yard, camera, pose, time=time, wind=CALM).radiance.sel(band="nir").values
    from workbench.virtual.light import sun_direction

    sun = np.array(sun_direction(time, *yard.longitude_latitude))
    roof = np.array([600020.0, 5300015.0, yard.buildings.ridge_z[0]])
    # The shadow of the middle of the roof, by walking down the ray until it meets the slope.
    for t in np.arange(0, 40, 0.02):
        point = roof - t * sun
        if point[2] <= yard.ground_z(point[:1], point[1:2])[0]:
            break
    mirrored = roof[:2] * 2 - point[:2]
    values = []
    for x, y in (point[:2], mirrored):
        z = yard.ground_z(np.array([x]), np.array([y]))[0]
        column, row = camera.project(pose.to_camera(np.array([[x, y, z]])))[0]
        values.append(shade[int(row) - 1 : int(row) + 2, int(column) - 1 : int(column) + 2].mean())
    assert values[0] < 0.4 * values[1]
    cloudy = render(yard, camera, pose, time=time, wind=CALM, cloudiness=1.0).radiance.sel(band="nir").values
    assert cloudy[int(row) - 1 : int(row) + 2, int(column) - 1 : int(column) + 2].mean() > 0.2


def test_truth_holds_roof_ground_and_cover(yard):
    grid = Grid.from_bounds(yard.crs, yard.extent, 0.25)
    truth = scene_truth(yard, grid)
    roof = truth.cover.values == Cover.BUILDING
    area = roof.sum() * 0.25**2
    assert area == pytest.approx(12.0, rel=0.1)
    highest = truth.dsm.values[roof]
    assert np.median(highest) == pytest.approx(yard.buildings.ridge_z[0], abs=0.01)
    expected = yard.ground_z(*(a.ravel() for a in np.meshgrid(grid.x, grid.y))).reshape(grid.shape)
    assert np.abs(truth.dtm.values - expected).max() < 0.01
    assert np.all(truth.dsm.values >= truth.dsm_mean.values - 1e-4)
    assert truth.dsm.attrs["vertical_datum"] == "DHHN2016"


def _saddle(image: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Centre (column, row) of a quadrant signal: the saddle of a paraboloid fitted to the blurred image."""
    from scipy import ndimage

    smooth = ndimage.gaussian_filter(image.astype(float), 1.2)
    column, row = guess
    for _ in range(4):
        i0, j0 = int(np.floor(row)), int(np.floor(column))
        i, j = np.mgrid[i0 - 2 : i0 + 3, j0 - 2 : j0 + 3]
        v, u = (i + 0.5 - row).ravel(), (j + 0.5 - column).ravel()
        basis = np.stack([u * u, u * v, v * v, u, v, np.ones_like(u)], axis=1)
        a, b, c, d, e, _ = np.linalg.lstsq(basis, smooth[i, j].ravel(), rcond=None)[0]
        step = np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e])
        column, row = column + step[0], row + step[1]
    return np.array([column, row])


def test_roofs_roads_and_soil_are_not_taken_for_plants():
    spec = SceneSpec(
        name="street",
        seed=4,
        crs="EPSG:25832",
        vertical_datum="DHHN2016",
        origin=(600000.0, 5300000.0),
        size=(40.0, 40.0),
        terrain={"base": 100.0, "relief": 0.1},
        roads=[{"points": [(-10, 8), (50, 8)], "width": 5.0}],
        paths=[{"points": [(-10, 33), (50, 33)], "width": 3.0}],
        buildings=[
            {"x": 10 + 10 * i, "y": 20.0, "length": 7.0, "width": 6.0, "colour": colour}
            for i, colour in enumerate(("red", "grey", "brown"))
        ],
    )
    camera = Camera("plain", 320, 320, 800, 800, 160, 160)
    pose = Pose.from_omega_phi_kappa((600020.0, 5300020.0, 200.0), 0, 0, 0)
    street = render(build_scene(spec), camera, pose, time=NOON, wind=CALM)
    red, green, blue, nir = street.radiance.values
    ndvi, gli = (nir - red) / (nir + red), (2 * green - red - blue) / (2 * green + red + blue)
    for code in (Cover.ROAD, Cover.PATH, Cover.BUILDING):
        cells = street.cover.values == code
        assert cells.sum() > 1000
        assert -0.15 < np.median(ndvi[cells]) < 0.25, code.name
        assert np.median(gli[cells]) < 0.03, code.name
