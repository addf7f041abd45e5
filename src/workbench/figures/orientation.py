"""The orientation in the report: where the cameras stood, and how well everything fits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from workbench.figures.maps import figure
from workbench.figures.sections import Picture, Section, Table, facts, written
from workbench.orientation import Block, read_block
from workbench.points import read_points
from workbench.site import Site
from workbench.stages import FOLDERS, read_json

_LABELS = {
    "registered": "photographs registered",
    "photos": "photographs used",
    "models": "separate models",
    "reprojection_error_px": "mean reprojection error (px)",
    "tie_points": "tie points",
    "observations": "their observations",
    "gnss_rms_m": "recorded positions, RMS (m)",
    "control_rms_xy_m": "control points, RMS horizontal (m)",
    "control_rms_z_m": "control points, RMS vertical (m)",
    "check_rms_xy_m": "check points, RMS horizontal (m)",
    "check_rms_z_m": "check points, RMS vertical (m)",
    "verify_rms_xy_m": "verification points, RMS horizontal (m)",
    "verify_rms_z_m": "verification points, RMS vertical (m)",
    "focal_length_px": "focal length by camera (px)",
}


def orientation_section(site: Site) -> Section:
    """Map of cameras and footprints, residuals of tie points, positions and surveyed points."""
    folder = site.products / FOLDERS["orient"]
    metrics = read_json(folder / "metrics.json")
    block = read_block(folder, site)
    cameras = pd.read_csv(folder / "cameras.csv")
    pictures = [_map(block), _tie_points(folder)]
    if cameras["recorded_x"].notna().any():
        pictures.append(_positions(cameras))
    control = pd.read_csv(folder / "control.csv")
    tables = [facts(metrics, _LABELS)]
    if len(control):
        tables.append(_control_table(control))
        pictures.append(_control(site, control))
    lost = cameras[~cameras["registered"].astype(bool)]
    if len(lost):
        tables.append(Table(lost[["photo", "reason"]].astype(str).values.tolist(), ["not registered", "why"]))
    return Section("Orientation", tables=tables, pictures=pictures)


def _map(block: Block) -> Picture:
    drawing, axes = figure()
    ground = float(np.median(block.tie_points[:, 2]))
    for photograph in block:
        camera = photograph.camera
        corners = np.array(
            [[0, 0], [camera.width, 0], [camera.width, camera.height], [0, camera.height]], dtype=float
        )
        rays = photograph.pose.to_world(camera.rays(corners))
        if np.all(rays[:, 2] < -0.05):
            reach = (ground - photograph.pose.centre[2]) / rays[:, 2]
            places = photograph.pose.centre[:2] + rays[:, :2] * reach[:, None]
            axes.add_patch(Polygon(places, alpha=0.06, color="#1f6f5c", lw=0))
    centres = np.array([photograph.pose.centre for photograph in block])
    strips = np.array([photograph.strip for photograph in block])
    axes.scatter(centres[:, 0], centres[:, 1], c=strips, cmap="tab10", s=18, zorder=3)
    for strip in np.unique(strips):
        mine = sorted((p for p in block if p.strip == strip), key=lambda p: p.order)
        way = np.array([p.pose.centre for p in mine])
        axes.plot(way[:, 0], way[:, 1], lw=0.8, color="0.3", zorder=2)
    _metric(axes)
    return Picture.of(
        drawing,
        "Projection centres by strip, and footprints on level ground: darker where more photographs overlap.",
    )


def _tie_points(folder: Path) -> Picture:
    xyz, _, attributes = read_points(folder / "tie_points.laz")
    drawing, axes = figure()
    error = attributes["reprojection_error"]
    dots = axes.scatter(
        xyz[:, 0], xyz[:, 1], c=error, s=2, cmap="magma_r", vmin=0, vmax=float(np.percentile(error, 98))
    )
    drawing.colorbar(dots, ax=axes, label="largest reprojection error (px)", shrink=0.8)
    _metric(axes)
    return Picture.of(
        drawing, f"{len(xyz)} tie points. Gaps show where photographs could not be connected (water, canopy)."
    )


def _positions(cameras: pd.DataFrame) -> Picture:
    known = cameras[cameras["registered"].astype(bool) & cameras["recorded_x"].notna()]
    dx, dy = known.x - known.recorded_x, known.y - known.recorded_y
    dz = known.z - known.recorded_z
    drawing, axes = figure()
    arrows = axes.quiver(known.x, known.y, dx, dy, dz, cmap="coolwarm", angles="xy")
    drawing.colorbar(arrows, ax=axes, label="height difference (m)", shrink=0.8)
    _metric(axes)
    text = f"Adjusted minus recorded positions; the longest arrow is {float(np.hypot(dx, dy).max()):.2f} m."
    return Picture.of(drawing, text)


def _control_table(control: pd.DataFrame) -> Table:
    columns = ["name", "role", "photographs", "dx", "dy", "dz", "reprojection_px"]
    rows = [[written(value) for value in row] for row in control[columns].itertuples(index=False)]
    header = ["point", "role", "photographs", "dx (m)", "dy (m)", "dz (m)", "image residual (px)"]
    return Table(rows, header)


def _control(site: Site, control: pd.DataFrame) -> Picture:
    places = {point.name: (point.x, point.y) for point in site.control}
    known = control[control["dx"].notna()]
    xy = np.array([places[name] for name in known.name]).reshape(-1, 2)
    drawing, axes = figure()
    for role, marker in (("control", "^"), ("check", "o"), ("verify", "s"), ("unused", "x")):
        mine = (known.role == role).to_numpy()
        if mine.any():
            axes.scatter(xy[mine, 0], xy[mine, 1], marker=marker, label=role, s=24)
    if len(xy):
        axes.quiver(
            xy[:, 0], xy[:, 1], known.dx, known.dy, known.dz, cmap="coolwarm", angles="xy", width=0.004
        )
        axes.legend(fontsize=8)
    _metric(axes)
    return Picture.of(drawing, "Surveyed points: estimated minus surveyed; colour is the height difference.")


def _metric(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.tick_params(labelsize=7)
