"""The assessment in the report: heights by land cover, tree mask, tops and crowns against references."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from workbench.figures.maps import draw_orthophoto, figure
from workbench.figures.sections import Picture, Section, Table, facts, matrix_table, written
from workbench.rasters import read_overview
from workbench.site import Site
from workbench.stages import FOLDERS, read_json
from workbench.vectors import layer_names, read_vector

_HEIGHTS = {
    "cover": "land cover",
    "cells": "cells",
    "coverage": "measured (share)",
    "bias_m": "median error (m)",
    "nmad_m": "NMAD (m)",
    "rmse_m": "RMSE (m)",
    "p95_m": "95 % below (m)",
    "gross_share": "gross (share)",
}
_TOPS = {
    "found": "found",
    "missed": "missed",
    "false": "false",
    "completeness": "completeness",
    "correctness": "correctness",
    "f1": "F1",
}
_CROWNS = {
    "completeness": "completeness (overlap factor above 0.5)",
    "correctness": "correctness",
    "mean_iou": "mean intersection over union",
    "mean_overlap_factor": "mean overlap factor",
    "cases": "topological cases",
}
_JUDGED = {
    "found": ("#1b9e5a", "^", "found"),
    "false": ("#d1495b", "x", "no reference near"),
    "missed": ("#0b3d91", "o", "reference without a top"),
}
_LEAST_CELLS = 100  # Fewer cells of a cover say nothing.


def assessment_section(site: Site) -> Section:
    """Tables and pictures of everything that had a reference."""
    folder = site.products / FOLDERS["assess"]
    metrics = read_json(folder / "metrics.json")
    if "skipped" in metrics or not metrics.get("compared"):
        reason = metrics.get("skipped", "the site has no reference of surface or trees.")
        return Section("Assessment", f"Nothing was compared: {reason}")
    tables, pictures = [], []
    if (folder / "heights.csv").exists() and "surface" in metrics["compared"]:
        table = pd.read_csv(folder / "heights.csv")
        rows = [[written(value) for value in row] for row in table[list(_HEIGHTS)].itertuples(index=False)]
        title = "Errors of the surface by land cover; gross is more than the stated limit off."
        tables.append(Table(rows, list(_HEIGHTS.values()), title))
        pictures.append(_heights(table))
    if "tree_mask" in metrics:
        tables.append(
            matrix_table(metrics["tree_mask"], "Error matrix of the tree mask", classes=("tree", "other"))
        )
    if "tops" in metrics:
        tables.append(_tops(metrics["tops"]))
    if "crowns" in metrics:
        tables.append(
            facts(metrics["crowns"], _CROWNS, title="Crowns against the true ones seen from above.")
        )
    if (folder / "trees.gpkg").exists():
        pictures.append(_judged(site, folder / "trees.gpkg"))
    text = "Compared: " + ", ".join(name.replace("_", " ") for name in metrics["compared"]) + "."
    return Section("Assessment", text, tables=tables, pictures=pictures)


def _tops(scores: dict[str, dict[str, Any]]) -> Table:
    rows = [[name, *(written(row.get(key)) for key in _TOPS)] for name, row in scores.items()]
    return Table(rows, ["reference", *_TOPS.values()], "Tree tops against reference trees.")


def _heights(table: pd.DataFrame) -> Picture:
    shown = table[(table.cells >= _LEAST_CELLS) & (table.cover != "all")].sort_values("nmad_m")
    drawing, axes = figure(6.2, 0.6 + 0.32 * max(len(shown), 3))
    place = np.arange(len(shown))
    axes.barh(place + 0.2, shown.nmad_m, height=0.38, color="#1f6f5c", label="NMAD")
    axes.barh(
        place - 0.2, shown.bias_m.abs(), height=0.38, color="#f2c14e", label="median error, without sign"
    )
    axes.set_yticks(place, [name.replace("_", " ") for name in shown.cover])
    axes.set_xscale("log")
    axes.set_xlabel("metres")
    axes.legend(fontsize=8)
    return Picture.of(drawing, "Errors of the surface by land cover, on a logarithmic scale.")


def _judged(site: Site, path: Path) -> Picture:
    drawing, axes = figure()
    ortho = site.products / FOLDERS["mosaic"] / "ortho.tif"
    if ortho.exists():
        draw_orthophoto(axes, read_overview(ortho, longest=2400))
    names = layer_names(path)
    bounds = []
    for name, (colour, marker, label) in _JUDGED.items():
        if name in names:
            places = read_vector(path, layer=name).geometry
            bounds.append(places.total_bounds)
            axes.scatter(
                places.x, places.y, c=colour, marker=marker, s=22, lw=1.2, label=f"{label} ({len(places)})"
            )
    west, south = np.min([b[:2] for b in bounds], axis=0) - 5
    east, north = np.max([b[2:] for b in bounds], axis=0) + 5
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)
    axes.legend(loc="upper right", fontsize=8, framealpha=0.9)
    return Picture.of(drawing, "Tops judged against the reference trees of the first row of the table.")
