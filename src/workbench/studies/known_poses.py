"""Orientation of a virtual site by its true poses: surfaces without the errors of structure from motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from workbench.cameras import Camera, Pose
from workbench.errors import StudyError
from workbench.orientation.files import round_model, write_cameras, write_model
from workbench.params import Parameters
from workbench.rasters import Grid, read_raster
from workbench.site import Site
from workbench.site.tables import number, read_table
from workbench.stages import FOLDERS, open_stage
from workbench.studies.known_frames import cut_photographs

_TIE_POINTS = 1500


def orient_by_truth(
    site: Site, parameters: Parameters, folder: Path | None = None, *, cut: bool = False
) -> dict:
    """Write the orientation of a virtual site from ``truth/poses.csv`` and the stated lenses.

    Tie points are random places of the true surface, so that the stages that follow find their heights
    as in any block. For studies of flight and matching, where an error of the orientation would hide
    what is looked for, or cost more than the rest.

    Parameters
    ----------
    site
        A virtual site; all its photographs are oriented.
    parameters
        ``simulate.seed`` chooses the tie points.
    folder
        Where the orientation goes; that of the site by default.
    cut
        Cut photographs to what they show of the scene and a little around it, and leave those out that show
        nothing of it. A strip runs in by half a frame and more: most of what is photographed of a small
        scene lies outside, where nothing is known and nothing is counted. The stages that follow need
        :func:`workbench.studies.known_frames.with_cut_photographs`.

    Raises
    ------
    StudyError
        If the site has no truth, or fewer than two photographs show the scene.
    """
    if site.truth is None:
        raise StudyError(f"Site {site.name} has no truth/: orient it by its photographs.")
    poses = true_poses(site)
    with open_stage(folder or site.products / FOLDERS["orient"], {}) as stage:
        offset = np.asarray(np.round(np.mean([pose.centre for pose in poses.values()], axis=0), -2))
        model = pycolmap.Reconstruction()
        lenses = {p.name: site.cameras[p.camera] for p in site.photographs}
        if cut:
            lenses = cut_photographs(site, poses, stage.folder)
        points = _surface_points(site, parameters.simulate.seed)
        tracks: list[list[tuple[int, int]]] = [[] for _ in points]
        for image_id, (name, lens) in enumerate(lenses.items(), start=1):
            pose = poses[name.rpartition(".")[0]]
            camera = pycolmap.Camera(
                camera_id=image_id,
                model="FULL_OPENCV",
                width=lens.width,
                height=lens.height,
                params=_opencv(lens),
            )
            model.add_camera_with_trivial_rig(camera)
            places = lens.project(pose.to_camera(points))
            seen = np.flatnonzero(lens.contains(places))
            image = pycolmap.Image(name=name, keypoints=places[seen], camera_id=image_id, image_id=image_id)
            rotation = pycolmap.Rotation3d(pose.rotation)
            model.add_image_with_trivial_frame(
                image, pycolmap.Rigid3d(rotation, -(rotation * (pose.centre - offset)))
            )
            for place, point in enumerate(seen):
                tracks[point].append((image_id, place))
        for point, track in zip(points, tracks, strict=True):
            if len(track) > 1:
                elements = [pycolmap.TrackElement(image, place) for image, place in track]
                model.add_point3D(point - offset, pycolmap.Track(elements), np.zeros(3, np.uint8))
        round_model(model)
        write_model(model, stage.path("sparse"))
        write_cameras(model, site, offset, {}, stage.path("cameras.csv"))
        stage.metrics.update(
            {
                "registered": len(lenses),
                "photos": len(lenses),
                "orientation": "true poses",
                "offset": offset.tolist(),
                "warnings": [],
            }
        )
    return stage.metrics


def _opencv(lens: Camera) -> list[float]:
    """Parameters of COLMAP's FULL_OPENCV model: focal lengths, principal point, eight of distortion."""
    distortion = [*lens.distortion, *[0.0] * (8 - len(lens.distortion))]
    return [lens.focal_x, lens.focal_y, lens.principal_x, lens.principal_y, *distortion]


def true_poses(site: Site) -> dict[str, Pose]:
    """Poses of ``truth/poses.csv`` by the name of the photograph without its ending."""
    path = (site.truth or site.folder) / "poses.csv"
    names = ("x", "y", "z", "omega", "phi", "kappa")
    poses = {}
    for line, row in read_table(path, ["photo", *names]):
        x, y, z, *angles = (number(row, name, path, line) for name in names)
        poses[row["photo"]] = Pose.from_omega_phi_kappa(np.array([x, y, z]), *angles)
    return poses


def _surface_points(site: Site, seed: int) -> np.ndarray:
    surface = read_raster((site.truth or site.folder) / "dsm_mean.tif")
    grid = Grid.of(surface)
    heights = surface.to_numpy().ravel()
    known = np.flatnonzero(np.isfinite(heights))
    cells = np.random.default_rng(seed).choice(known, min(_TIE_POINTS, len(known)), replace=False)
    row, column = np.divmod(np.sort(cells), grid.width)
    return np.column_stack([grid.x[column], grid.y[row], heights[np.sort(cells)].astype(float)])
