"""The reed stage: from the surface of a site to the status of its reed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import geopandas as gpd
import pandas as pd

from workbench.errors import ReedError
from workbench.params import Parameters, ReedParameters
from workbench.rasters import read_raster, require_heights, write_raster
from workbench.reed.accuracy import References, agreements
from workbench.reed.doubts import doubts, open_water
from workbench.reed.field import read_field_points, read_plots
from workbench.reed.heights import agreement_by_area, compare_heights
from workbench.reed.measure import ReedMetrics, ReedModel
from workbench.reed.uncertainty import propagate
from workbench.site import Site
from workbench.stages import FOLDERS, Stage, open_stage
from workbench.vectors import read_vector, write_layers


def reed_site(site: Site, parameters: Parameters) -> dict:
    """Measure the reed of a site, and compare with its field campaign where there is one.

    Writes ``ohm.tif``, ``reed.gpkg`` (layers ``extent``, ``front``, ``sections``, ``density_cells``,
    ``islets_holes``, ``unknown``; empty ones are left out), ``sections.csv`` (one row a section),
    ``heights.csv`` and ``matrix_*.csv`` (where there are references), ``uncertainty.csv`` (with draws).

    Returns
    -------
    dict
        The metrics: areas, front, sections by status, agreement of heights, error matrices, warnings.

    Raises
    ------
    ReedError
        If the site has no water level or surface, or its shoreline, areas or transects do not fit it.
    SiteError
        If a table of the campaign cannot be read.
    """
    model, references = load_model(site, parameters.reed), load_references(site)
    return measure_into(site.products / FOLDERS["reed"], model, references, parameters.reed)


def measure_into(folder: Path, model: ReedModel, references: References, options: ReedParameters) -> dict:
    """Measure, compare with the references, and write everything into a folder; see :func:`reed_site`."""
    with open_stage(folder, {"reed": options}) as stage:
        metrics = model.measure(options)
        write_raster(metrics.ohm, stage.path("ohm.tif"))
        write_layers(_layers(metrics), stage.path("reed.gpkg"))
        sections = pd.DataFrame(metrics.sections.drop(columns="geometry"))
        _write_table(sections, stage.path("sections.csv"))
        stage.metrics.update(metrics.totals())
        stage.metrics["excluded_reasons"] = sections.reason[sections.reason != ""].value_counts().to_dict()
        stage.metrics["areas"] = _by_area(metrics)
        _compare(references, metrics, options, stage)
        if options.draws:
            drawn = propagate(model, options, spread=model.spread)
            _write_table(drawn.summary, stage.path("uncertainty.csv"))
            _write_table(drawn.sections, stage.path("section_uncertainty.csv"))
            stage.metrics["uncertainty"] = drawn.summary.set_index("metric").to_dict("index")
        stage.metrics["water_m"] = open_water(metrics)
        stage.metrics["warnings"] = doubts(metrics, options, shoreline=model.shoreline is not None)
    return stage.metrics


def load_model(site: Site, options: ReedParameters | None = None) -> ReedModel:
    """Surface, its spread, water level, shoreline, areas and transects of a site, ready to be measured.

    Raises
    ------
    ReedError
        If neither the site nor the parameters state the water level, or the surface has not been made.
    """
    level = site.water_level
    if level is None and (options is None or options.water_level is None):
        raise ReedError(f"{site.folder / 'site.yaml'}: water_level is open. State it in metres.")
    surface = site.products / FOLDERS["surface"] / "dsm.tif"
    if not surface.exists():
        raise ReedError(f"{surface}: missing. Run `workbench surface --site {site.name}` first.")
    spread = surface.with_name("spread.tif")
    transects = site.transects
    dsm = read_raster(surface)
    require_heights(dsm)
    return ReedModel(
        dsm,
        level,
        None if site.shoreline is None else read_vector(site.shoreline),
        areas=None if site.areas is None else read_vector(site.areas),
        transects=None if transects is None else read_vector(transects),
        spread=read_raster(spread) if spread.exists() else None,
    )


def load_references(site: Site) -> References:
    """Field points, plots and interpreted status of a site, as far as it has them.

    Raises
    ------
    SiteError, ReedError
        If a table of the campaign cannot be read.
    """
    return References(
        None if site.field_points is None else read_field_points(site.field_points),
        None if site.plots is None else read_plots(site.plots),
        None if site.reference_status is None else read_vector(site.reference_status),
    )


def _layers(metrics: ReedMetrics) -> dict[str, gpd.GeoDataFrame]:
    crs = metrics.extent.grid.crs
    unknown = metrics.extent.unknown
    layers = {
        "extent": metrics.areas,
        "front": metrics.front.lines,
        "sections": metrics.sections,
        "density_cells": metrics.cells,
        "islets_holes": metrics.front.closed,
        "unknown": gpd.GeoDataFrame(
            {"area_m2": [] if unknown.is_empty else [unknown.area]},
            geometry=[] if unknown.is_empty else [unknown],
            crs=crs,
        ),
    }
    optional = ("islets_holes", "unknown")
    return {name: frame for name, frame in layers.items() if len(frame) or name not in optional}


def _by_area(metrics: ReedMetrics) -> dict[str, dict[str, Any]]:
    rows = metrics.areas.drop(columns="geometry").set_index("aoi")
    counts = metrics.sections.groupby(["aoi", "status"]).size().unstack(fill_value=0)
    table = rows.join(counts.reindex(rows.index, fill_value=0))
    return table.to_dict("index")


def _compare(references: References, metrics: ReedMetrics, options: ReedParameters, stage: Stage) -> None:
    """Heights, extent, density and status against whatever there is of a campaign."""
    if references.points is not None:
        compared = compare_heights(metrics.ohm, references.points, radius=options.point_radius)
        _write_table(compared, stage.path("heights.csv"))
        agreement = agreement_by_area(compared).set_index("aoi")
        stage.metrics["heights"] = agreement.to_dict("index")
        stage.metrics["heights_left_out"] = int(len(compared) - agreement.n["total"])
    found = agreements(metrics, references, dense_stems=options.plot_dense_stems)
    for name, agreement_ in found.items():
        matrix = agreement_.matrix
        _write_table(matrix.intervals(), stage.path(f"matrix_{name}.csv"))
        stage.metrics[f"{name}_matrix"] = {
            "classes": list(matrix.classes),
            "counts": matrix.counts.astype(int).tolist(),
            "overall_accuracy": matrix.overall_accuracy,
            "kappa": matrix.kappa,
            "producer_accuracy": matrix.producer_accuracy.to_dict(),
            "user_accuracy": matrix.user_accuracy.to_dict(),
            "left_out": agreement_.left_out,
        }


def _write_table(table: pd.DataFrame, path: Path) -> None:
    part = path.with_name(f".{path.name}.part")
    table.to_csv(part, index=False, lineterminator="\n")
    part.replace(path)
