"""Aquatic reed in the report: extent, front, status of the sections, heights against the field campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from workbench.figures.maps import draw_orthophoto, draw_values, extent, figure, hillshade
from workbench.figures.sections import Picture, Section, Table, facts, matrix_table, written
from workbench.rasters import read_overview
from workbench.site import Site
from workbench.stages import FOLDERS, read_json
from workbench.vectors import layer_names, read_vector

_LABELS = {
    "extent_m2": "extent (m2)",
    "dense_m2": "dense reed (m2)",
    "sparse_m2": "sparse reed (m2)",
    "unknown_density_m2": "reed of unknown density (m2)",
    "unknown_m2": "lake side without a height (m2)",
    "front_m": "front (m)",
    "islets": "islets",
    "holes": "holes",
    "sections": "sections",
    "healthy": "of them healthy",
    "stressed": "of them stressed",
    "excluded": "of them excluded",
}
_STATUS = {"healthy": "#1b9e5a", "stressed": "#d1495b", "excluded": "#8a8f98"}
_DENSITY = {"dense": "#1f6f5c", "sparse": "#f2c14e", "unknown": "#8a8f98"}
_MARGIN = 12.0  # Metres around the reed that a map shows.


def reed_section(site: Site) -> Section:
    """Maps of status and height, areas, sections, and the agreement with the field campaign."""
    folder = site.products / FOLDERS["reed"]
    metrics = read_json(folder / "metrics.json")
    if "skipped" in metrics:
        return Section("Aquatic reed", f"Not measured: {metrics['skipped']}")
    tables = [facts(metrics, _LABELS, title="Extent, density, front and status.")]
    areas = metrics.get("areas") or {}
    if areas:
        tables.append(_areas(areas))
    if metrics.get("heights"):
        tables.append(_agreement(metrics["heights"]))
    for name in ("extent", "density", "status"):
        if f"{name}_matrix" in metrics:
            tables.append(matrix_table(metrics[f"{name}_matrix"], f"Error matrix of the {name}"))
    pictures = []
    layers = {
        name: read_vector(folder / "reed.gpkg", layer=name) for name in layer_names(folder / "reed.gpkg")
    }
    if len(layers["extent"]) and not layers["extent"].geometry.is_empty.all():
        pictures += [_status_map(site, layers), _height_map(folder, layers)]
        if len(layers.get("density_cells", ())):
            pictures.append(_density_map(site, layers))
    if (folder / "heights.csv").exists():
        pictures.append(_heights(pd.read_csv(folder / "heights.csv")))
    if len(layers.get("sections", ())):
        pictures.append(_indices(layers["sections"]))
    return Section("Aquatic reed", tables=tables, pictures=pictures)


def _areas(areas: dict[str, dict[str, Any]]) -> Table:
    columns = {
        "extent_m2": "extent (m2)",
        "dense_m2": "dense (m2)",
        "sparse_m2": "sparse (m2)",
        "healthy": "healthy",
        "stressed": "stressed",
    }
    shown = {key: label for key, label in columns.items() if any(key in row for row in areas.values())}
    rows = [[aoi, *(written(row.get(key)) for key in shown)] for aoi, row in areas.items()]
    return Table(rows, ["area", *shown.values()], "Reed by area of interest.")


def _agreement(heights: dict[str, dict[str, float]]) -> Table:
    columns = {"n": "points", "rmse": "RMSE (m)", "bias": "bias (m)", "r2": "R2"}
    rows = [[aoi, *(written(row.get(key)) for key in columns)] for aoi, row in heights.items()]
    return Table(rows, ["area", *columns.values()], "Heights against the field campaign.")


def _status_map(site: Site, layers: dict[str, gpd.GeoDataFrame]) -> Picture:
    drawing, axes = figure(9, 5.5)
    _background(site, axes)
    layers["extent"].boundary.plot(ax=axes, color="white", lw=0.8)
    sections = layers.get("sections")
    if sections is not None and len(sections):
        for status, colour in _STATUS.items():
            mine = sections[sections["status"] == status]
            if len(mine):
                mine.plot(ax=axes, facecolor=colour, edgecolor="white", lw=0.8, alpha=0.45)
                axes.plot([], [], "s", color=colour, label=f"{status} ({len(mine)})")
        for row in sections.itertuples():
            place = row.geometry.representative_point()
            axes.text(
                place.x,
                place.y,
                str(row.section),
                ha="center",
                va="center",
                fontsize=7,
                path_effects=[withStroke(linewidth=2, foreground="white")],
            )
    if len(layers.get("front", ())):
        layers["front"].plot(ax=axes, color="#0b3d91", lw=1.6)
        axes.plot([], [], color="#0b3d91", label="front")
    axes.legend(loc="upper right", fontsize=8, framealpha=0.9)
    _zoom(axes, layers)
    text = (
        "Status of the sections along the front. White: outline of the reed; the front is what faces water."
    )
    return Picture.of(drawing, text, wide=True)


def _height_map(folder: Path, layers: dict[str, gpd.GeoDataFrame]) -> Picture:
    drawing, axes = figure()
    ohm = read_overview(folder / "ohm.tif", longest=2400)
    draw_values(axes, ohm, label="height above the water (m)", cmap="YlGn", vmin=0, vmax=_top(ohm))
    axes.imshow(hillshade(ohm), extent=extent(ohm), cmap="gray", alpha=0.25, vmin=0, vmax=1)
    layers["extent"].boundary.plot(ax=axes, color="#0b3d91", lw=0.9)
    _zoom(axes, layers)
    return Picture.of(
        drawing, "Object height model: surface minus water level, with the outline of the reed."
    )


def _density_map(site: Site, layers: dict[str, gpd.GeoDataFrame]) -> Picture:
    drawing, axes = figure()
    _background(site, axes)
    cells = layers["density_cells"]
    for density, colour in _DENSITY.items():
        mine = cells[cells["density"] == density]
        if len(mine):
            mine.plot(ax=axes, facecolor=colour, edgecolor="none", alpha=0.75)
            axes.plot([], [], "s", color=colour, label=density)
    axes.legend(loc="upper right", fontsize=8, framealpha=0.9)
    _zoom(axes, layers)
    return Picture.of(drawing, "Density of the reed, from mean and variance of the heights in each cell.")


def _heights(points: pd.DataFrame) -> Picture:
    """Heights of the surface against those of the field."""
    drawing, axes = figure(5.5, 5.2)
    known = points.dropna(subset=["field_m", "surface_m"])
    for (aoi, mine), marker in zip(known.groupby("aoi"), "o^sDvPX*<>" * 10, strict=False):
        axes.scatter(mine.field_m, mine.surface_m, s=16, alpha=0.75, marker=marker, label=str(aoi))
    top = 1.05 * float(np.nanmax([known.field_m.max(), known.surface_m.max(), 1.0])) if len(known) else 1.0
    axes.plot([0, top], [0, top], color="0.5", lw=1)
    axes.set_xlim(0, top)
    axes.set_ylim(min(0.0, float(known.surface_m.min()) if len(known) else 0.0), top)
    axes.set_xlabel("field: stem height minus water depth (m)")
    axes.set_ylabel("surface: highest cell near the point (m)")
    axes.set_aspect("equal")
    axes.legend(fontsize=8)
    return Picture.of(
        drawing, f"Heights at {len(known)} points of the field campaign; the line is agreement."
    )


def _indices(sections: gpd.GeoDataFrame) -> Picture:
    drawing, axes = figure(6.2, 3.8)
    known = sections.dropna(subset=["arsi"])
    names = [f"{row.aoi} {row.section}" for row in known.itertuples()]
    colours = [_STATUS.get(status, "0.5") for status in known.status]
    axes.bar(range(len(known)), known.arsi, color=colours)
    if len(known) <= 40:
        axes.set_xticks(range(len(known)), names, rotation=60, ha="right", fontsize=7)
    else:
        axes.set_xlabel("section")
    axes.set_ylabel("aRSI")
    return Picture.of(drawing, "Index of the reed's status (aRSI) by section; low is healthy.")


def _background(site: Site, axes: Axes) -> None:
    ortho = site.products / FOLDERS["mosaic"] / "ortho.tif"
    if ortho.exists():
        draw_orthophoto(axes, read_overview(ortho, longest=2400))


def _zoom(axes: Axes, layers: dict[str, gpd.GeoDataFrame]) -> None:
    bounds = np.array(
        [frame.total_bounds for name, frame in layers.items() if name in ("extent", "sections")]
    )
    bounds = bounds[np.isfinite(bounds).all(axis=1)]
    if len(bounds):
        west, south = bounds[:, :2].min(axis=0) - _MARGIN
        east, north = bounds[:, 2:].max(axis=0) + _MARGIN
        axes.set_xlim(west, east)
        axes.set_ylim(south, north)


def _top(ohm: Any) -> float:
    known = ohm.values[np.isfinite(ohm.values)]
    return float(np.clip(np.percentile(known, 98), 1.0, 8.0)) if known.size else 1.0
