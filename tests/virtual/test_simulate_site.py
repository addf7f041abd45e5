"""A virtual site from end to end: what a camera, a surveyor and the rest of the workbench see of it."""

from __future__ import annotations

import csv
from datetime import timedelta
from pathlib import Path

import cv2
import exifread
import numpy as np
import pycolmap
import pytest

from workbench.cameras import Pose
from workbench.cameras.exif import read_facts
from workbench.errors import SceneError
from workbench.params import Parameters
from workbench.photographs import read_photograph
from workbench.rasters import read_raster, require_heights
from workbench.site import check_site, load_site
from workbench.vectors import read_vector
from workbench.virtual import load_scene, simulate_scene
from workbench.virtual.stage import flight_of
from workbench.virtual.world import Cover

POND = Path(__file__).with_name("pond.yaml")
QUICK = Parameters(simulate={"truth_resolution": 0.25, "supersampling": 3})


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return tmp_path_factory.mktemp("root")


@pytest.fixture(scope="module")
def site(root):
    return simulate_scene(POND, root, QUICK)


@pytest.fixture(scope="module")
def poses(site):
    with (site.truth / "poses.csv").open(encoding="utf-8") as file:
        rows = {row["photo"]: row for row in csv.DictReader(file)}
    return {
        name: Pose.from_omega_phi_kappa(
            np.array([float(row[k]) for k in "xyz"]), *(float(row[k]) for k in ("omega", "phi", "kappa"))
        )
        for name, row in rows.items()
    }


def targets(site):
    with (site.truth / "targets.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {r["name"]: np.array([float(r[k]) for k in "xyz"]) for r in rows if r["kind"] == "quadrant"}


def test_site_is_complete_and_raises_no_question(site):
    report = check_site(site, QUICK)
    assert not site.unanswered
    assert not [problem for problem in report.problems if getattr(problem, "severity", "") == "error"]
    assert len(site.photographs) >= 6 and not site.set_aside
    assert site.water_level == 400.0
    assert {p.role for p in site.control} == {"control", "check"}
    assert {o.name for o in site.observations} == {"T1", "T2", "T3", "T4", "T5"}
    for path in (site.shoreline, site.areas, site.transects, site.field_points, site.plots):
        assert path is not None and path.exists()
    assert site.reference_trees is not None and len(read_vector(site.reference_trees)) > 3


def test_positions_and_angles_arrive_as_the_navigation_recorded_them(site, poses):
    for photo in site.photographs:
        pose = poses[Path(photo.name).stem]
        assert np.subtract(photo.position, pose.centre) == pytest.approx([0, 0, 0], abs=0.5)
        recorded = Pose.from_omega_phi_kappa(pose.centre, *photo.attitude)
        turn = np.degrees(np.arccos((np.trace(recorded.rotation @ pose.rotation.T) - 1) / 2))
        assert turn < 0.15  # Stated: 0.01 degrees for roll and pitch, 0.03 for heading.
        assert photo.position_sd == pytest.approx((0.05, 0.05, 0.08))


def test_exif_tells_what_the_camera_knows(site, poses):
    photo = site.photographs[2]
    with photo.path.open("rb") as file:
        tags = exifread.process_file(file)
    assert str(tags["Image Make"]) == "DLR" and str(tags["Image Model"]) == "MACS MAR"
    assert float(tags["EXIF FocalLength"].values[0]) == pytest.approx(51.7)
    facts = read_facts(photo.path)
    assert facts.position_sd[0] == pytest.approx(0.05, abs=1e-4)
    assert abs(facts.time - photo.time) < timedelta(milliseconds=1)
    assert facts.altitude == pytest.approx(poses[photo.path.stem].centre[2], abs=0.5)
    camera = site.cameras[photo.camera]
    assert camera.focal_x == pytest.approx(0.0517 / (35.9936e-3 / 608), rel=1e-4)


def test_targets_lie_where_an_independent_camera_model_projects_them(site, poses):
    camera = site.cameras[site.photographs[0].camera]
    params = [camera.focal_x, camera.focal_y, camera.principal_x, camera.principal_y, *camera.distortion]
    colmap = pycolmap.Camera(model="FULL_OPENCV", width=camera.width, height=camera.height, params=params)
    off = []
    for photo in site.photographs:
        pose = poses[photo.path.stem]
        grey = cv2.cvtColor(read_photograph(photo.path), cv2.COLOR_RGB2GRAY)
        visible = {o.name: o for o in site.observations if o.photo == photo.name}
        for name, place in targets(site).items():
            if name not in visible:
                continue
            expected = colmap.img_from_cam(pose.to_camera(place[None]))[0]
            # OpenCV counts from the centre of the first pixel.
            start = np.array([[expected - 0.5]], dtype=np.float32)
            criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
            found = cv2.cornerSubPix(grey, start.copy(), (4, 4), (-1, -1), criteria)[0, 0] + 0.5
            off.append(found - expected)
            measured = np.array([visible[name].column, visible[name].row])
            assert np.abs(measured - expected).max() < 0.15 * 5
    off = np.array(off)
    assert len(off) >= 12
    assert np.abs(off.mean(axis=0)).max() < 0.05
    assert np.sqrt((off**2).mean(axis=0)).max() < 0.1


def test_truth_describes_the_scene(site):
    dsm, dtm = (read_raster(site.truth / f"{name}.tif") for name in ("dsm", "dtm"))
    assert require_heights(dsm) == "DHHN2016"
    assert float((dsm - dtm).max()) > 5
    trees = read_vector(site.truth / "trees.gpkg")
    assert {"tree_id", "species_group", "top_z", "visible"} <= set(trees.columns)
    assert len(read_vector(site.truth / "reed.gpkg", layer="extent")) == 1
    # References are those of the truth, with errors of the order stated.
    scanned = read_vector(site.reference_trees).merge(trees[["tree_id", "x", "y", "top_x", "top_y", "top_z"]])
    a = (scanned.top_z - scanned.z1) / (scanned.z2 - scanned.z1)
    x = scanned.x1 + a * (scanned.x2 - scanned.x1)
    y = scanned.y1 + a * (scanned.y2 - scanned.y1)
    assert np.hypot(x - scanned.top_x, y - scanned.top_y).max() < 0.2


def test_rays_of_two_photographs_meet_on_the_true_surface(site, poses):
    first, second = site.photographs[2:4]
    camera = site.cameras[first.camera]
    sift = cv2.SIFT_create(3000, contrastThreshold=0.01)
    found = [sift.detectAndCompute(read_photograph(p.path)[..., 1], None) for p in (first, second)]
    pairs = cv2.BFMatcher().knnMatch(found[0][1], found[1][1], k=2)
    pairs = [a for a, b in pairs if a.distance < 0.7 * b.distance]
    places = [
        np.array([found[0][0][a.queryIdx].pt for a in pairs]) + 0.5,
        np.array([found[1][0][a.trainIdx].pt for a in pairs]) + 0.5,
    ]
    shots = [poses[p.path.stem] for p in (first, second)]
    rays = [pose.to_world(camera.rays(at)) for pose, at in zip(shots, places, strict=True)]
    points = np.array(
        [nearest_point(shots[0].centre, a, shots[1].centre, b) for a, b in zip(*rays, strict=True)]
    )
    dsm = read_raster(site.truth / "dsm_mean.tif")
    inside = (
        (points[:, 0] > float(dsm.x[0])) & (points[:, 0] < float(dsm.x[-1]))
        & (points[:, 1] < float(dsm.y[0])) & (points[:, 1] > float(dsm.y[-1]))
    )  # fmt: skip
    points = points[inside]
    columns = ((points[:, 0] - float(dsm.x[0])) / 0.25).round().astype(int)
    rows = ((float(dsm.y[0]) - points[:, 1]) / 0.25).round().astype(int)
    off = points[:, 2] - dsm.values[rows, columns]
    assert len(off) > 150
    # Half a pixel of parallax at the angle of this pair is the height of 0.17 m.
    angle = np.linalg.norm(shots[1].centre - shots[0].centre) / (shots[0].centre[2] - 401)
    assert abs(np.median(off)) < 0.25 * 0.06 / angle
    assert 1.4826 * np.median(np.abs(off - np.median(off))) < 0.5 * 0.06 / angle


def nearest_point(a: np.ndarray, u: np.ndarray, b: np.ndarray, v: np.ndarray) -> np.ndarray:
    s, t = np.linalg.lstsq(np.stack([u, -v], axis=1), b - a, rcond=None)[0]
    return (a + s * u + b + t * v) / 2


def contents(folder: Path) -> dict[str, bytes]:
    return {
        p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


def test_an_interrupted_simulation_continues_and_gives_the_same_bytes(site, root):
    before = contents(site.folder)
    lost, cut = site.photographs[1].path, site.photographs[3].path
    kept = site.photographs[0].path.stat().st_mtime_ns
    lost.unlink()
    (site.truth / "photographs" / f"{cut.stem}.json").write_text("{", encoding="utf-8")
    again = simulate_scene(POND, root, QUICK)
    assert again.photographs[0].path.stat().st_mtime_ns == kept
    after = contents(again.folder)
    assert before.keys() == after.keys()
    assert [name for name in before if before[name] != after[name]] == []


def test_another_seed_gives_another_survey(site, tmp_path):
    short = {"strips": 1, "gsd": 0.2, "reduction": 16}
    first, other = (
        simulate_scene(POND, tmp_path, QUICK, flight_overrides=short, seed=seed, site_name=f"s{seed}")
        for seed in (1, 2)
    )
    assert first.control[0].x != other.control[0].x
    assert first.photographs[0].position != other.photographs[0].position
    assert not np.array_equal(
        read_photograph(first.photographs[0].path), read_photograph(other.photographs[0].path)
    )


def test_near_infrared_arrives_as_a_fourth_band_and_truth_beside_every_photograph(tmp_path):
    parameters = Parameters(
        simulate={
            "near_infrared": True,
            "truth_resolution": 0.5,
            "supersampling": 1,
            "truth_per_photograph": True,
        }
    )
    short = {"gsd": 0.2, "reduction": 16}
    site = simulate_scene(POND, tmp_path, parameters, flight_overrides=short)
    photo = site.photographs[2]
    seen = np.load(site.folder / "truth" / "photographs" / f"{Path(photo.name).stem}.npz")
    frame = read_photograph(photo.path).shape[:2]
    assert seen["depth"].shape == seen["cover"].shape == seen["tree_id"].shape == frame
    assert set(np.unique(seen["cover"])) <= {cover.value for cover in Cover}
    trees = np.isin(seen["cover"], (Cover.BROADLEAF.value, Cover.CONIFER.value, Cover.DEAD_TREE.value))
    assert np.array_equal(seen["tree_id"] > 0, trees)
    pixels = read_photograph(photo.path)
    assert photo.path.suffix == ".tif" and pixels.shape[2] == 4 and photo.bands == 4
    facts = read_facts(photo.path)
    assert facts.model == "MACS MAR" and facts.focal_length == pytest.approx(0.0517)
    assert facts.latitude == pytest.approx(47.9, abs=0.2)
    assert not site.unanswered
    # On land plants are brighter in near infrared than in red.
    land = pixels[pixels.shape[0] // 2 :, pixels.shape[1] // 2 :]
    assert np.median(land[..., 3]) > np.median(land[..., 0])


def test_a_rig_is_read_as_three_cameras(tmp_path):
    parameters = Parameters(simulate={"truth_resolution": 0.5, "supersampling": 1})
    # Strips as far apart as the tilted cameras look aside: each camera sees the pond from one of them.
    rig = {
        "camera": "3K",
        "reduction": 16,
        "frame": (200, 160),
        "gsd": 0.3,
        "strips": 3,
        "side_overlap": 0.75,
    }
    site = simulate_scene(POND, tmp_path, parameters, flight_overrides=rig)
    assert len(site.cameras) == 3
    assert {p.name.split("/")[0] for p in site.photographs} == {"left", "nadir", "right"}
    for photo in site.photographs:
        axis = Pose.from_omega_phi_kappa(np.zeros(3), *photo.attitude).view_direction
        tilt = np.degrees(np.arccos(-axis[2]))
        assert tilt == pytest.approx(0 if photo.name.startswith("nadir") else 35, abs=4)
    camera = site.cameras[site.photographs[0].camera]
    assert camera.focal_x == pytest.approx(0.05 / (0.036 / 312), rel=1e-3)


def test_parameters_and_overrides_replace_the_flight_of_the_scene():
    spec = load_scene(POND).flight
    settings = Parameters(simulate={"gsd": 0.1, "wind": 0.0}).simulate
    plan = flight_of(spec, settings, {"forward_overlap": 0.9})
    assert (plan.gsd, plan.wind, plan.forward_overlap, plan.camera) == (0.1, 0.0, 0.9, spec.camera)
    assert flight_of(spec, Parameters().simulate, {"height": 50.0}).gsd is None
    other = flight_of(spec, Parameters().simulate, {"camera": "DMC I"})
    assert other.reduction == 1.0
    with pytest.raises(SceneError, match="no_such"):
        flight_of(spec, settings, {"no_such": 1})


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"height": 6.0}, "not above the highest object"),
        ({"forward_overlap": 1.2}, "Forward overlap"),
        ({"camera": "Brownie"}, "unknown"),
        ({"wind": -1.0}, "wind"),
    ],
)
def test_impossible_flights_stop_before_anything_is_written(overrides, message, tmp_path):
    with pytest.raises(SceneError, match=message):
        simulate_scene(POND, tmp_path, QUICK, flight_overrides=overrides)
    assert not list(tmp_path.rglob("*"))


def test_a_real_site_is_never_overwritten(tmp_path):
    folder = tmp_path / "data" / "sites" / "pond"
    folder.mkdir(parents=True)
    (folder / "site.yaml").write_text("name: pond\n", encoding="utf-8")
    with pytest.raises(SceneError, match="real site"):
        simulate_scene(POND, tmp_path, QUICK)


def test_an_earlier_flight_leaves_no_photographs_behind(tmp_path):
    parameters = Parameters(simulate={"truth_resolution": 0.5, "supersampling": 1})
    short = {"gsd": 0.2, "reduction": 16}
    first = simulate_scene(POND, tmp_path, parameters, flight_overrides={**short, "forward_overlap": 0.9})
    second = simulate_scene(POND, tmp_path, parameters, flight_overrides={**short, "forward_overlap": 0.7})
    assert len(second.photographs) < len(first.photographs)
    assert len(load_site("pond", tmp_path).photographs) == len(second.photographs)
