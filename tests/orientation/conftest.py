"""A virtual block: known cameras, points and control, written straight into a model; no photographs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from flown_block import CAMERA, HEIGHT, OFFSET  # type: ignore[import-not-found]
from rasterio.crs import CRS

from workbench.cameras import Pose
from workbench.site import ControlPoint, Observation, Photograph, Site


@dataclass
class VirtualBlock:
    """A disturbed model, the site it belongs to, and the truth."""

    model: pycolmap.Reconstruction
    site: Site
    poses: dict[str, Pose]
    points: np.ndarray
    truth: dict[str, np.ndarray]


def _flight(rng: np.random.Generator, obliques: bool) -> dict[str, Pose]:
    poses = {}
    for strip in range(3):
        for place in range(6):
            centre = np.array([place * 22.0, strip * 40.0, HEIGHT]) + rng.normal(0, 1, 3) + OFFSET
            tilt = 20.0 if obliques and strip == 1 else 0.0
            omega, phi = rng.normal(0, 1.5, 2)
            pose = Pose.from_omega_phi_kappa(centre, omega + tilt, phi, 90.0 + rng.normal(0, 2))
            poses[f"{strip}_{place}.jpg"] = pose
    return poses


def _project(pose: Pose, points: np.ndarray) -> np.ndarray:
    return CAMERA.project(pose.to_camera(points))


@pytest.fixture
def virtual_block() -> Callable[..., VirtualBlock]:
    """Factory of virtual blocks."""

    def make(
        *,
        seed: int = 0,
        tie_points: int = 600,
        noise: float = 0.3,
        outliers: float = 0.0,
        gnss_sd: tuple[float, float] | None = (0.05, 0.08),
        surveyed: int = 12,
        control: int = 4,
        verify: int = 0,
        survey_sd: float = 0.005,
        obliques: bool = False,
        disturb: float = 0.0,
    ) -> VirtualBlock:
        rng = np.random.default_rng(seed)
        poses = _flight(rng, obliques)
        low, high = OFFSET + (-20, -20, -1), OFFSET + (130, 100, 1)
        points = rng.uniform(low, high, (tie_points, 3))
        points[:, 2] = 4 * np.sin(points[:, 0] / 25) + rng.normal(0, 1.5, tie_points)
        model = pycolmap.Reconstruction()
        camera = pycolmap.Camera(
            camera_id=1, model="OPENCV", width=4000, height=3000, params=[3000, 3000, 2000, 1500, 0, 0, 0, 0]
        )
        model.add_camera_with_trivial_rig(camera)
        tracks: list[list[tuple[int, int]]] = [[] for _ in points]
        for number, (name, pose) in enumerate(poses.items(), start=1):
            positions = _project(pose, points)
            inside = np.flatnonzero(CAMERA.contains(positions))
            measured = positions[inside] + rng.normal(0, noise, (len(inside), 2))
            wrong = rng.random(len(inside)) < outliers
            angle = rng.uniform(0, 2 * np.pi, len(inside))
            shift = rng.uniform(2, 50, len(inside)) * wrong
            measured += np.stack([np.cos(angle) * shift, np.sin(angle) * shift], axis=1)
            image = pycolmap.Image(name=name, keypoints=measured, camera_id=1, image_id=number)
            centre = pose.centre - OFFSET + rng.normal(0, 1, 3) * disturb
            rotation = pycolmap.Rotation3d(pose.rotation)
            model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(rotation, -(rotation * centre)))
            for index, point in enumerate(inside):
                tracks[point].append((number, index))
        for point, seen in zip(points, tracks, strict=True):
            if len(seen) > 1:
                track = pycolmap.Track([pycolmap.TrackElement(i, k) for i, k in seen])
                model.add_point3D(point - OFFSET, track, np.zeros(3, np.uint8))
        photographs = []
        for name, pose in poses.items():
            position = sd = None
            if gnss_sd is not None:
                sd = (gnss_sd[0], gnss_sd[0], gnss_sd[1])
                position = tuple(pose.centre + rng.normal(0, 1, 3) * sd)
            strip, order = (int(part) for part in name.removesuffix(".jpg").split("_"))
            photographs.append(
                Photograph(name, Path("photos") / name, "cam", position, sd, strip=strip, order=order)
            )
        where = np.stack(np.meshgrid(np.linspace(2, 108, 4), np.linspace(2, 78, -(-surveyed // 4))), -1)
        places = where.reshape(-1, 2)[rng.permutation(where.size // 2)[:surveyed]]
        truth, surveyed_points, observations = {}, [], []
        for k, (x, y) in enumerate(places):
            place = np.array([x, y, rng.normal(0, 2)]) + OFFSET
            name = f"P{k}"
            truth[name] = place
            role = "control" if k < control else "verify" if k < control + verify else "check"
            sx, sy, sz = place + rng.normal(0, survey_sd, 3)
            surveyed_points.append(ControlPoint(name, sx, sy, sz, survey_sd, survey_sd, role))
            for photo, pose in poses.items():
                position = _project(pose, place[None])
                if CAMERA.contains(position)[0]:
                    column, row = position[0] + rng.normal(0, 0.3, 2)
                    observations.append(Observation(name, photo, column, row))
        site = Site(
            "virtual",
            Path("nowhere"),
            CRS.from_epsg(32632),
            "ellipsoid",
            tuple(photographs),
            {"cam": CAMERA},
            control=tuple(surveyed_points),
            observations=tuple(observations),
        )
        model.update_point_3d_errors()
        return VirtualBlock(model, site, poses, points, truth)

    return make
