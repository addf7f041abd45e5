"""The orientation in the report: where the cameras stood, and how well everything fits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from workbench.figures.maps import colour_bar, figure
from workbench.figures.sections import Picture, Section, Table, facts
from workbench.orientation import Block, read_block
from workbench.points import read_points
from workbench.rasters import read_overview
from workbench.site import Site
from workbench.stages import FOLDERS, read_json

_CELLS = 300  # Of the overlap map along its longer edge.
_ROLES = {
    "control": ("^", "#d1495b"),
    "check": ("o", "#0b3d91"),
    "verify": ("s", "#7b2d8b"),
    "unused": ("x", "#5b6875"),
}
"""Marker and colour of surveyed points by their role."""
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
    "pose_sd_xy_m": "precision of a position, horizontal (m)",
    "pose_sd_z_m": "precision of a position, vertical (m)",
    "pose_sd_turn_deg": "precision of an angle (degrees)",
}


def orientation_section(site: Site) -> Section:
    """Map of cameras and footprints, residuals of tie points, positions and surveyed points."""
    folder = site.products / FOLDERS["orient"]
    metrics = read_json(folder / "metrics.json")
    block = read_block(folder, site)
    cameras = pd.read_csv(folder / "cameras.csv")
    heights = _heights(site, block)
    pictures = [_map(block, site), _overlap(block, heights), _tie_points(folder, block), _errors(folder)]
    if cameras["recorded_x"].notna().any():
        pictures.append(_positions(cameras))
    control = pd.read_csv(folder / "control.csv")
    tables = [facts(metrics, _LABELS, title="The block.")]
    if cameras["recorded_x"].notna().any():
        tables.append(_position_table(cameras))
    if len(control):
        tables.append(_control_table(control))
        pictures.append(_control(site, control))
    lost = cameras[~cameras["registered"].astype(bool)]
    if len(lost):
        rows = lost[["photo", "reason"]].astype(str).values.tolist()
        tables.append(Table(rows, ["photograph", "why"], "Photographs that were not registered."))
    return Section("Orientation", tables=tables, pictures=pictures)


def _heights(site: Site, block: Block) -> xr.DataArray | float:
    """The measured surface, coarse; before there is one, the level of the tie points."""
    surface = site.products / FOLDERS["surface"]
    if (surface / "metrics.json").exists():
        return read_overview(surface / "dsm.tif", longest=_CELLS)
    return float(np.median(block.tie_points[:, 2]))


def _map(block: Block, site: Site) -> Picture:
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
            axes.add_patch(Polygon(places, facecolor="none", edgecolor="#1f6f5c", alpha=0.35, lw=0.6))
    centres = np.array([photograph.pose.centre for photograph in block])
    strips = np.array([photograph.strip for photograph in block])
    axes.scatter(centres[:, 0], centres[:, 1], c=strips, cmap="tab10", s=18, zorder=3)
    for strip in np.unique(strips):
        mine = sorted((p for p in block if p.strip == strip), key=lambda p: p.order)
        way = np.array([p.pose.centre for p in mine])
        axes.plot(way[:, 0], way[:, 1], lw=0.8, color="0.3", zorder=2)
    for role, (marker, colour) in _ROLES.items():
        points = np.array([(p.x, p.y) for p in site.control if p.role == role]).reshape(-1, 2)
        if len(points):
            axes.scatter(points[:, 0], points[:, 1], marker=marker, c=colour, s=30, label=role, zorder=4)
    if site.control:
        axes.legend(fontsize=8)
    _metric(axes)
    text = "Projection centres, coloured by strip, with their footprints on level ground"
    return Picture.of(drawing, text + (" and the surveyed points." if site.control else "."))


def _overlap(block: Block, heights: xr.DataArray | float) -> Picture:
    """How many photographs see each place, at the height of the surface."""
    if isinstance(heights, float):
        corners = block.tie_points[:, :2]
        x, y = (np.linspace(low, high, 160) for low, high in zip(corners.min(0), corners.max(0), strict=True))
        y = y[::-1]
        z = np.full((len(y), len(x)), heights)
    else:
        x, y, z = heights.x.values, heights.y.values, heights.values.astype(float)
        z = np.where(np.isfinite(z), z, np.nanmedian(z))
    places = np.stack([*np.meshgrid(x, y), z], axis=-1).reshape(-1, 3)
    count = sum(photograph.sees(places).astype(int) for photograph in block)
    seen = np.asarray(count).reshape(z.shape)
    drawing, axes = figure()
    steps = np.arange(0, min(int(seen.max()), 12) + 2) - 0.5
    image = axes.imshow(
        np.where(seen > 0, seen, np.nan),
        extent=(x[0], x[-1], y[-1], y[0]),
        cmap=colormaps["viridis"].resampled(max(len(steps) - 1, 1)),
        vmin=steps[0],
        vmax=steps[-1],
        interpolation="nearest",
    )
    colour_bar(axes, image, "photographs (12: or more)" if seen.max() >= 12 else "photographs")
    _metric(axes)
    shares = ", ".join(f"{n} or more {100 * float((seen >= n).mean()):.0f} %" for n in (1, 2, 3, 5))
    text = (
        "Overlap: photographs that look at each place of the surface, obstacles not counted. Share of map: "
    )
    return Picture.of(drawing, text + shares + ".")


def _tie_points(folder: Path, block: Block) -> Picture:
    xyz, _, attributes = read_points(folder / "tie_points.laz")
    drawing, axes = figure()
    error = attributes["reprojection_error"]
    dots = axes.scatter(
        xyz[:, 0], xyz[:, 1], c=error, s=2, cmap="magma_r", vmin=0, vmax=float(np.percentile(error, 98))
    )
    colour_bar(axes, dots, "largest reprojection error (px)")
    _metric(axes)
    # A few points far outside would shrink the block to a spot.
    low, high = np.percentile(xyz[:, :2], [0.5, 99.5], axis=0)
    room = 0.08 * (high - low)
    axes.set_xlim(low[0] - room[0], high[0] + room[0])
    axes.set_ylim(low[1] - room[1], high[1] + room[1])
    return Picture.of(
        drawing, f"{len(xyz)} tie points. Gaps show where photographs could not be connected (water, canopy)."
    )


def _errors(folder: Path) -> Picture:
    """Distribution of reprojection errors and of the number of photographs of a tie point."""
    _, _, attributes = read_points(folder / "tie_points.laz")
    error, seen = attributes["reprojection_error"], attributes["image_count"]
    drawing = Figure(figsize=(6.2, 3.2), layout="constrained")
    left, right = drawing.subplots(1, 2)
    left.hist(error, bins=np.linspace(0, float(np.percentile(error, 99.5)), 40), color="#1f6f5c")
    left.set_xlabel("largest reprojection error (px)")
    left.set_ylabel("tie points")
    right.hist(seen, bins=np.arange(1.5, float(seen.max()) + 1), color="#1f6f5c")
    right.set_xlabel("photographs that show a tie point")
    right.set_yscale("log")
    text = f"Tie points: median of the largest reprojection error {float(np.median(error)):.2f} px, "
    return Picture.of(drawing, text + f"seen in {float(np.mean(seen)):.1f} photographs on average.")


def _position_table(cameras: pd.DataFrame) -> Table:
    known = cameras[cameras["registered"].astype(bool) & cameras["recorded_x"].notna()]
    rows = []
    for axis, label in (("x", "east"), ("y", "north"), ("z", "height")):
        difference = known[axis] - known[f"recorded_{axis}"]
        numbers = (difference.mean(), difference.std(ddof=0), float(np.sqrt((difference**2).mean())))
        rows.append([label, *(f"{value:.3f}" for value in (*numbers, difference.abs().max()))])
    header = ("axis", "mean (m)", "standard deviation (m)", "RMS (m)", "largest (m)")
    return Table(rows, header, f"Adjusted minus recorded positions of {len(known)} photographs.")


def _positions(cameras: pd.DataFrame) -> Picture:
    known = cameras[cameras["registered"].astype(bool) & cameras["recorded_x"].notna()]
    dx, dy = known.x - known.recorded_x, known.y - known.recorded_y
    dz = known.z - known.recorded_z
    drawing, axes = figure()
    _room(axes, known[["x", "y"]].to_numpy())
    arrows = axes.quiver(known.x, known.y, dx, dy, dz, cmap="coolwarm", angles="xy")
    colour_bar(axes, arrows, "height difference (m)")
    _metric(axes)
    text = f"Adjusted minus recorded positions; the longest arrow is {float(np.hypot(dx, dy).max()):.2f} m."
    return Picture.of(drawing, text)


def _control_table(control: pd.DataFrame) -> Table:
    axes = ("dx", "dy", "dz", "reprojection_px")
    rows = [
        [str(row["name"]), str(row["role"]), str(row["photographs"]), *(_length(float(row[a])) for a in axes)]
        for row in control.to_dict("records")
    ]
    for role in _ROLES:
        mine = control[control["role"] == role]
        if len(mine):
            rms = [float(np.sqrt(np.mean(mine[axis] ** 2))) for axis in axes]
            rows.append([f"RMS {role}", "", "", *map(_length, rms)])
    header = ["point", "role", "photographs", "dx (m)", "dy (m)", "dz (m)", "image residual (px)"]
    return Table(rows, header, "Surveyed points: estimated minus surveyed. Only control was used.")


def _length(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.3f}"


def _control(site: Site, control: pd.DataFrame) -> Picture:
    places = {point.name: (point.x, point.y) for point in site.control}
    known = control[control["dx"].notna()]
    xy = np.array([places[name] for name in known.name]).reshape(-1, 2)
    drawing, axes = figure()
    _room(axes, xy)
    for role, (marker, colour) in _ROLES.items():
        mine = (known.role == role).to_numpy()
        if mine.any():
            axes.scatter(xy[mine, 0], xy[mine, 1], marker=marker, c=colour, label=role, s=24)
    text = "Surveyed points: estimated minus surveyed; colour is the height difference."
    if len(xy):
        arrows = axes.quiver(
            xy[:, 0], xy[:, 1], known.dx, known.dy, known.dz, cmap="coolwarm", angles="xy", width=0.004
        )
        colour_bar(axes, arrows, "height difference (m)")
        axes.legend(fontsize=8)
        text += f" The longest arrow is {float(np.hypot(known.dx, known.dy).max()):.3f} m."
    _metric(axes)
    return Picture.of(drawing, text)


def _room(axes: Axes, xy: np.ndarray) -> None:
    """Show places (n, 2) with room for arrows around them, in a frame that is not flatter than 1 : 2."""
    if not len(xy):
        return
    low, high = xy.min(axis=0), xy.max(axis=0)
    half = np.maximum((high - low) / 2, np.max(high - low) / 4) * 1.15 + 1
    axes.set_xlim(*((low + high)[0] / 2 + half[0] * np.array([-1, 1])))
    axes.set_ylim(*((low + high)[1] / 2 + half[1] * np.array([-1, 1])))


def _metric(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.tick_params(labelsize=7)
