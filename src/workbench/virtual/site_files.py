"""Files of a virtual site: what a real one has, and beside it ``truth/``."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import xarray as xr
from pyproj import CRS, Transformer

from workbench.errors import SiteError
from workbench.rasters import write_raster
from workbench.site import ControlPoint, Observation
from workbench.site.control import render_control, render_observations
from workbench.site.files import write_text
from workbench.site.navigation import grid_convergence
from workbench.vectors import write_layers
from workbench.virtual.campaign import ReedCampaign
from workbench.virtual.flight import Flight
from workbench.virtual.scene import Scene
from workbench.virtual.world import Cover

NAVIGATION_COLUMNS = (
    *("photo", "time", "longitude", "latitude", "height", "roll", "pitch", "heading", "tilt_right"),
    *("sd_x", "sd_y", "sd_z", "sd_roll", "sd_pitch", "sd_heading"),
)


def write_bytes(data: bytes, path: Path) -> Path:
    """Write a file under a temporary name, then rename it.

    Raises
    ------
    SiteError
        If the folder cannot be written.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        raise SiteError(f"{path}: cannot be written ({error}). Free space or choose another root.") from error
    return path


def write_navigation(flight: Flight, scene: Scene, suffix: str, path: Path) -> Path:
    """Position and attitude of every photograph as recorded, with their standard deviations.

    Longitude and latitude are WGS 84, heights those of the scene's vertical datum, headings from true
    north.
    """
    to_degrees = Transformer.from_crs(scene.crs.to_wkt(), "EPSG:4326", always_xy=True)
    crs = CRS.from_wkt(scene.crs.to_wkt())
    horizontal, vertical = flight.errors.position_sd
    angle, heading_sd = flight.errors.attitude_sd
    deviations = [f"{horizontal:.3f}", f"{horizontal:.3f}", f"{vertical:.3f}"]
    deviations += [f"{angle:.4f}", f"{angle:.4f}", f"{heading_sd:.4f}"]
    rows = []
    for exposure in flight.exposures:
        x, y, z = exposure.recorded_position
        longitude, latitude = to_degrees.transform(x, y)
        roll, pitch, heading = exposure.recorded_attitude
        true_north = heading + grid_convergence(x, y, crs)
        rows.append(
            [
                exposure.name + suffix,
                exposure.time.isoformat(),
                f"{longitude:.10f}",
                f"{latitude:.10f}",
                f"{z:.4f}",
                f"{roll:.5f}",
                f"{pitch:.5f}",
                f"{true_north % 360:.5f}",
                f"{flight.camera.tilts[exposure.mount]:.3f}",
                *deviations,
            ]
        )
    return _write_csv(NAVIGATION_COLUMNS, rows, path)


def write_survey(
    points: tuple[ControlPoint, ...], observations: tuple[Observation, ...], folder: Path
) -> tuple[Path, Path]:
    """``control.csv`` and ``observations.csv``."""
    control, measured = folder / "control.csv", folder / "observations.csv"
    write_text(render_control(points), control)
    write_text(render_observations(observations), measured)
    return control, measured


def write_campaign(campaign: ReedCampaign, folder: Path) -> dict[str, Path]:
    """The reed campaign as files, by the names that a site has for them."""
    files = {
        "areas": write_layers({"areas": campaign.areas}, folder / "areas.gpkg"),
        "transects": write_layers({"transects": campaign.transects}, folder / "transects.gpkg"),
        "reference_status": write_layers({"status": campaign.status}, folder / "reference_status.gpkg"),
    }
    for name, table in (("field_points", campaign.points), ("plots", campaign.plots)):
        files[name] = folder / f"{name}.csv"
        write_text(_table_text(table), files[name])
    return files


def write_shoreline(scene: Scene, folder: Path) -> Path:
    """Polygon of the lake side."""
    frame = gpd.GeoDataFrame({"name": [scene.spec.name]}, geometry=[scene.shoreline], crs=scene.spec.crs)
    return write_layers({"shoreline": frame}, folder / "shoreline.gpkg")


def write_trees(trees: gpd.GeoDataFrame, path: Path) -> Path:
    """A table of trees as a layer ``trees``."""
    return write_layers({"trees": trees}, path)


def write_truth(
    scene: Scene, truth: xr.Dataset, campaign: ReedCampaign, flight: Flight, folder: Path
) -> None:
    """Rasters, trees, reed, poses and legend of the truth."""
    for name in truth.data_vars:
        write_raster(truth[name], folder / f"{name}.tif")
    write_trees(scene.trees, folder / "trees.gpkg")
    if not scene.buildings.empty:
        write_layers({"buildings": scene.buildings}, folder / "buildings.gpkg")
    if scene.spec.reed:
        reed = {name: getattr(scene.reed, name) for name in ("extent", "front", "islets", "holes")}
        layers = reed | {"sections": campaign.true_sections, "transects": campaign.true_transects}
        write_layers({name: frame for name, frame in layers.items() if len(frame)}, folder / "reed.gpkg")
    targets = scene.targets.drop(columns="geometry")
    write_text(_table_text(targets), folder / "targets.csv")
    _write_csv(("code", "cover"), [[int(code), code.name.lower()] for code in Cover], folder / "cover.csv")
    _write_poses(flight, folder / "poses.csv")


def write_view(view: xr.Dataset, path: Path) -> Path:
    """Depth, land cover and tree of every pixel of one photograph, as compressed arrays."""
    out = io.BytesIO()
    depth, cover, tree = (view[name].values for name in ("depth", "cover", "tree_id"))
    np.savez_compressed(out, depth=depth, cover=cover, tree_id=tree)
    return write_bytes(out.getvalue(), path)


def read_record(path: Path) -> dict:
    """What was noted of a photograph when it was taken; empty if it was not."""
    if not path.exists():
        return {}
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError:
        return {}  # Cut off by an interruption: the photograph is taken again.


def write_record(record: Mapping, path: Path) -> None:
    """Note that a photograph is complete."""
    write_text(json.dumps(record, indent=1, sort_keys=True) + "\n", path)


def _write_poses(flight: Flight, path: Path) -> None:
    header = ("photo", "x", "y", "z", "omega", "phi", "kappa", "time", "strip", "order")
    rows = [
        [
            exposure.name,
            *(f"{value:.5f}" for value in exposure.pose.centre),
            *(f"{value:.6f}" for value in exposure.pose.omega_phi_kappa),
            exposure.time.isoformat(),
            exposure.strip,
            exposure.order,
        ]
        for exposure in flight.exposures
    ]
    _write_csv(header, rows, path)


def _write_csv(header: Iterable[str], rows: Iterable[Iterable[object]], path: Path) -> Path:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_text(out.getvalue(), path)
    return path


def _table_text(table: pd.DataFrame) -> str:
    return table.to_csv(index=False, lineterminator="\n")
