"""The products of the orientation, written and read."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pycolmap

from workbench.cameras import Camera, Pose
from workbench.errors import OrientationError
from workbench.orientation.block import Block, OrientedPhotograph
from workbench.orientation.control import PointResidual
from workbench.site import Site
from workbench.stages import read_json

# Coarser than what threads or the order of sums disturb (1e-12), finer than anything measurable.
_CENTRE_DIGITS, _QUATERNION_DIGITS, _LENS_DIGITS = 5, 9, 9


def round_model(model: pycolmap.Reconstruction) -> None:
    """Round poses, lenses and points in place, so that noise of the arithmetic does not travel on."""
    for camera in model.cameras.values():
        camera.params = np.round(camera.params, _LENS_DIGITS)
    for number in model.reg_frame_ids():
        frame = model.frame(number)
        pose = frame.rig_from_world
        centre = np.round(pose.inverse().translation, _CENTRE_DIGITS)
        quaternion = np.round(pose.rotation.quat, _QUATERNION_DIGITS)
        rotation = pycolmap.Rotation3d(quaternion / np.linalg.norm(quaternion))
        frame.rig_from_world = pycolmap.Rigid3d(rotation, -(rotation * centre))
    for point in model.points3D.values():
        point.xyz = np.round(point.xyz, _CENTRE_DIGITS)


def write_model(model: pycolmap.Reconstruction, folder: Path) -> None:
    """Write a COLMAP binary model."""
    folder.mkdir(parents=True, exist_ok=True)
    model.write_binary(folder)


def write_cameras(
    model: pycolmap.Reconstruction, site: Site, offset: np.ndarray, reasons: dict[str, str], path: Path
) -> None:
    """Write ``cameras.csv``: pose of every photograph, or why it has none."""
    header = "photo,x,y,z,omega,phi,kappa,registered,recorded_x,recorded_y,recorded_z,tie_points,reason"
    with _replacing(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header.split(","))
        for photograph in site.photographs:
            image = model.find_image_with_name(photograph.name)
            recorded = photograph.position or ("", "", "")
            if image is None or not image.has_pose:
                reason = reasons.get(photograph.name, "")
                writer.writerow([photograph.name, *[""] * 6, False, *recorded, 0, reason])
                continue
            pose = _pose(image, offset)
            centre = [f"{value:.5f}" for value in pose.centre]
            angles = [f"{value:.7f}" for value in pose.omega_phi_kappa]
            writer.writerow([photograph.name, *centre, *angles, True, *recorded, image.num_points3D, ""])


def write_control(rows: Sequence[PointResidual], path: Path) -> None:
    """Write ``control.csv``: residual and role of every surveyed point."""
    with _replacing(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["name", "role", "photographs", "dx", "dy", "dz", "reprojection_px"])
        for row in rows:
            numbers = [f"{value:.5f}" for value in (row.dx, row.dy, row.dz, row.reprojection_px)]
            writer.writerow([row.name, row.role, row.photographs, *numbers])


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV, lengths to a hundredth of a millimetre."""
    with _replacing(path) as part:
        table.to_csv(part, index=False, float_format="%.5f", lineterminator="\n")


def read_block(folder: Path, site: Site) -> Block:
    """Oriented photographs of a site.

    Parameters
    ----------
    folder
        ``data/products/<site>/orientation``.
    site
        The site, for paths, strips, CRS and datum.

    Raises
    ------
    OrientationError
        If the orientation is missing or was not completed, or CRS or datum are open.
    """
    if site.crs is None or not site.vertical_datum:
        raise OrientationError(
            f"{site.folder / 'site.yaml'}: crs and vertical_datum must be stated before products are made."
        )
    metrics = read_json(folder / "metrics.json")
    offset = np.array(metrics["offset"])
    model = pycolmap.Reconstruction(folder / "sparse")
    by_name = {photograph.name: photograph for photograph in site.photographs}
    photographs = []
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        if image.name not in by_name:
            continue
        known = by_name[image.name]
        photographs.append(
            OrientedPhotograph(
                known.name,
                known.path,
                _camera(image.camera, known.camera),
                _pose(image, offset),
                known.strip,
                known.order,
            )
        )
    photographs.sort(key=lambda photograph: photograph.name)
    xyz = np.array([model.point3D(n).xyz for n in sorted(model.point3D_ids())]).reshape(-1, 3)
    return Block(tuple(photographs), site.crs, site.vertical_datum, xyz + offset)


def _pose(image: pycolmap.Image, offset: np.ndarray) -> Pose:
    rotation = image.cam_from_world().rotation.matrix()
    return Pose(rotation, image.projection_center() + offset)


def _camera(camera: pycolmap.Camera, name: str) -> Camera:
    if camera.model_name in ("OPENCV", "FULL_OPENCV"):
        fx, fy, cx, cy, *distortion = camera.params
        return Camera(name, camera.width, camera.height, fx, fy, cx, cy, tuple(distortion))
    raise OrientationError(f"Camera model {camera.model_name} of the orientation is unknown: orient again.")


class _replacing:
    """Path to write to; it takes the place of the target when the block succeeds."""

    def __init__(self, path: Path) -> None:
        self.path, self.part = path, path.with_name(f".{path.name}.part")

    def __enter__(self) -> Path:
        return self.part

    def __exit__(self, kind: type | None, *_: object) -> None:
        if kind is None:
            self.part.replace(self.path)
