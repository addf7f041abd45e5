"""Matching, surface and mosaic in the report."""

from __future__ import annotations

import numpy as np

from workbench.figures.maps import (
    draw_classes,
    draw_orthophoto,
    draw_surface,
    draw_values,
    figure,
)
from workbench.figures.sections import Picture, Section, facts
from workbench.rasters import read_overview
from workbench.site import Site
from workbench.stages import FOLDERS, read_json
from workbench.vectors import read_vector

_NO_DATA, _INTERPOLATED = 0, 255
_PALETTE = ("#1f77b4", "#2ca02c", "#ff9f1c", "#d1495b", "#9467bd", "#8c564b")


def matching_section(site: Site) -> Section:
    """Pairs and their intersection angles."""
    metrics = read_json(site.products / FOLDERS["match"] / "metrics.json")
    labels = {
        "pairs": "stereo pairs",
        "pairs_across": "of them between strips",
        "downscales": "downscales",
        "ground_resolution_m": "ground resolution (m)",
        "angle_median_deg": "intersection angle, median (degrees)",
        "matched_share": "matched share of the rectified pairs",
    }
    drawing, axes = figure(height=3.6)
    axes.hist(list(metrics["pair_angles_deg"].values()), bins=24, color="#1f6f5c")
    axes.axvspan(5, 10, color="#d98200", alpha=0.15, label="usable for trees: 5-10 degrees")
    axes.set_xlabel("intersection angle on the ground (degrees)")
    axes.set_ylabel("pairs")
    axes.legend(fontsize=8)
    caption = "Intersection angles. The angle at the top of a tree is larger, and the overlap there smaller."
    return Section(
        "Matching",
        tables=[facts(metrics, labels, title="Stereo pairs.")],
        pictures=[Picture.of(drawing, caption)],
    )


def surface_section(site: Site) -> Section:
    """Hillshade, count, ratio V, spread and provenance."""
    folder = site.products / FOLDERS["surface"]
    metrics = read_json(folder / "metrics.json")
    labels = {
        "cells_m": "cell (m)",
        "coverage_ge1": "measured by at least one pair (share)",
        "coverage_ge2": "measured by at least two pairs (share)",
        "count_mean": "mean count",
        "possible_count_mean": "mean possible count",
        "spread_median_m": "median spread of the pairs (m)",
        "unmatched_share": "count zero by downscale (share)",
        "provenance_share": "cells by the downscale they were measured at (share)",
        "interpolated_share": "interpolated (share)",
        "ground_seen_share": "ground measured (share of the terrain)",
    }
    pictures = []
    drawing, axes = figure()
    draw_surface(axes, read_overview(folder / "dsm.tif"))
    pictures.append(Picture.of(drawing, "Fused surface with hillshade; white was measured at no downscale."))
    count, possible = read_overview(folder / "count.tif"), read_overview(folder / "possible_count.tif")
    drawing, axes = figure()
    draw_values(axes, count.where(possible > 0), label="pairs", cmap="viridis", vmin=0)
    pictures.append(Picture.of(drawing, "Count: pairs that measured a cell and were used."))
    pictures.append(_ratio_histogram(count.values, possible.values))
    drawing, axes = figure()
    draw_values(axes, read_overview(folder / "spread.tif"), label="spread (m)", cmap="magma_r", vmin=0)
    pictures.append(Picture.of(drawing, "Robust standard deviation of the heights that the pairs gave."))
    provenance = read_overview(folder / "provenance.tif")
    classes = {_NO_DATA: ("no data", "#ffffff")}
    for colour, value in zip(_PALETTE, [v for v in np.unique(provenance) if 0 < v < 255], strict=False):
        classes[int(value)] = (f"downscale {value}", colour)
    classes[_INTERPOLATED] = ("interpolated", "#c0c0c0")
    drawing, axes = figure()
    draw_classes(axes, provenance, classes)
    pictures.append(Picture.of(drawing, "Provenance: at which downscale a cell was measured."))
    drawing, axes = figure()
    draw_values(
        axes, read_overview(folder / "ndsm.tif"), label="height above terrain (m)", cmap="YlGn", vmin=0
    )
    pictures.append(
        Picture.of(drawing, "Height above the terrain; under closed canopy the terrain is a guess.")
    )
    return Section(
        "Surface", tables=[facts(metrics, labels, title="Coverage and precision.")], pictures=pictures
    )


def mosaic_section(site: Site) -> Section:
    """Orthophoto with seamlines, source, validity."""
    folder = site.products / FOLDERS["mosaic"]
    metrics = read_json(folder / "metrics.json")
    labels = {
        "resolution_m": "cell (m)",
        "area_m2": "area (m2)",
        "photographs_used": "photographs used",
        "interpolated_height_share": "shown on interpolated heights (share)",
        "hidden_share": "hidden from all photographs (share)",
    }
    drawing, axes = figure(9, 8)
    draw_orthophoto(axes, read_overview(folder / "ortho.tif", longest=2200))
    pictures = [Picture.of(drawing, "True orthophoto.", wide=True)]
    drawing, axes = figure()
    draw_orthophoto(axes, read_overview(folder / "ortho.tif", longest=900))
    read_vector(folder / "seamlines.gpkg").boundary.plot(ax=axes, color="#ffd400", lw=0.8)
    pictures.append(Picture.of(drawing, "Seamlines between photographs."))
    classes = {
        0: ("outside", "#ffffff"),
        1: ("on a measured height", "#7fb8a4"),
        2: ("on an interpolated height", "#ffcf87"),
        3: ("hidden from all", "#d1495b"),
        4: ("hidden, a speck: shown all the same", "#9467bd"),
    }
    drawing, axes = figure()
    draw_classes(axes, read_overview(folder / "validity.tif"), classes)
    text = "Validity: colours on interpolated heights may be displaced; hidden cells stay empty."
    pictures.append(Picture.of(drawing, text))
    return Section("Orthomosaic", tables=[facts(metrics, labels, title="The orthophoto.")], pictures=pictures)


def _ratio_histogram(count: np.ndarray, possible: np.ndarray) -> Picture:
    """V = count / possible count in the eleven classes of the thesis [3.2.1]."""
    area = possible > 0
    ratio = np.minimum(count[area] / possible[area], 1.0) * 100
    edges = np.arange(0, 101, 10)
    shares = [float((ratio == 0).mean())] if ratio.size else [0.0]
    shares += [
        float(((ratio > low) & (ratio <= low + 10)).mean()) if ratio.size else 0.0 for low in edges[:-1]
    ]
    drawing, axes = figure(height=3.6)
    names = ["0"] + [f"{low}-{low + 10}" for low in edges[:-1]]
    axes.bar(names, np.array(shares) * 100, color=["#d1495b"] + ["#1f6f5c"] * 10)
    axes.set_xlabel("count in per cent of the possible count (V)")
    axes.set_ylabel("per cent of the cells")
    axes.tick_params(axis="x", rotation=35, labelsize=8)
    return Picture.of(drawing, "Ratio V: how many of the pairs that see a cell measured it; 0 = unmatched.")
