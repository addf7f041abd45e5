"""The report of a site: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any

from jinja2 import Environment

from workbench.environment import describe_environment
from workbench.errors import SiteError
from workbench.figures.advice import advice
from workbench.figures.assessment_section import assessment_section
from workbench.figures.findings_section import findings_section
from workbench.figures.orientation import orientation_section
from workbench.figures.products import (
    matching_section,
    mosaic_section,
    surface_section,
)
from workbench.figures.reed_section import reed_section
from workbench.figures.sections import Block, Section, Table, percent, written
from workbench.figures.site_section import site_section
from workbench.figures.trees_section import trees_section
from workbench.params import Parameters
from workbench.site import Site
from workbench.site.files import write_text
from workbench.stages import FOLDERS, open_stage, read_json

SECTIONS: dict[str, Callable[[Site], Section]] = {
    "orient": orientation_section,
    "match": matching_section,
    "surface": surface_section,
    "mosaic": mosaic_section,
    "reed": reed_section,
    "trees": trees_section,
    "assess": assessment_section,
}
"""Chapters of the stages, in the order of the chain."""


def report_site(site: Site, parameters: Parameters) -> dict:
    """Write ``report/report.html``: maps, residuals, metrics, warnings, parameters, environment.

    The file needs no network. Stages that were not run are left out.

    Returns
    -------
    dict
        The metrics: sections shown and number of warnings.

    Raises
    ------
    SiteError
        If not even the orientation has been made.
    """
    done = [verb for verb in SECTIONS if (site.products / FOLDERS[verb] / "metrics.json").exists()]
    if "orient" not in done:
        raise SiteError(f"Site {site.name} has no products: run `workbench run --site {site.name}` first.")
    with open_stage(site.products / FOLDERS["report"], {"report": parameters.report}) as stage:
        metrics = {verb: read_json(site.products / FOLDERS[verb] / "metrics.json") for verb in done}
        findings = findings_section(site.root)
        sections = [site_section(site), *(SECTIONS[verb](site) for verb in done)]
        sections += [*([] if findings is None else [findings]), _provenance(site, done)]
        warnings = _warnings(site, metrics)
        page = files("workbench.figures").joinpath("report.html.j2").read_text(encoding="utf-8")
        html = (
            Environment(autoescape=True)
            .from_string(page)
            .render(
                site=site,
                lead=_lead(site),
                glance=_glance(metrics),
                warnings=warnings,
                sections=sections,
            )
        )
        write_text(html, stage.path("report.html"))
        stage.metrics.update({"sections": [s.title for s in sections], "warnings": len(warnings)})
    return stage.metrics


def _lead(site: Site) -> str:
    code = site.crs.to_epsg() if site.crs is not None else None
    crs = f"EPSG:{code}" if code else "CRS of the site"
    cameras = ", ".join(sorted({camera.name for camera in site.cameras.values()}))
    kind = "Virtual site with known truth" if site.truth else "Site"
    return f"{kind}; {len(site.photographs)} photographs ({cameras}), {crs}, heights: {site.vertical_datum}."


def _glance(metrics: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, str]]:
    """The handful of numbers that a reader looks for first: value and what it is."""
    orient, match = metrics["orient"], metrics.get("match", {})
    surface, trees, reed = (metrics.get(verb, {}) for verb in ("surface", "trees", "reed"))
    found: list[tuple[str | None, str]] = [
        (f"{orient['registered']} of {orient['photos']}", "photographs registered"),
        (_metres(match.get("ground_resolution_m")), "ground resolution"),
        (_metres(orient.get("check_rms_xy_m")), "check points, horizontal"),
        (_metres(orient.get("check_rms_z_m")), "check points, vertical"),
        (_share(surface.get("coverage_ge1")), "of the area measured"),
        (_share(surface.get("coverage_ge2")), "by two or more pairs"),
        (_number(reed.get("extent_m2"), " m2"), "aquatic reed"),
        (_number(trees.get("trees")), "trees"),
    ]
    return [(value, what) for value, what in found if value is not None]


def _metres(value: float | None) -> str | None:
    return None if value is None else f"{100 * value:.1f} cm" if value < 1 else f"{value:.2f} m"


def _share(value: float | None) -> str | None:
    return None if value is None else percent(value)


def _number(value: float | None, unit: str = "") -> str | None:
    return None if value is None else f"{value:,.0f}{unit}"


def _warnings(site: Site, metrics: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """What to know before the products are used, each once, with its remedy."""
    warnings = [f"{p.name} was set aside: {p.set_aside}." for p in site.set_aside]
    for of_stage in metrics.values():
        warnings += of_stage.get("warnings", [])
    return list(dict.fromkeys([*warnings, *advice(metrics)]))


def _provenance(site: Site, done: list[str]) -> Section:
    """Run times, parameters and environment: what it takes to make this again."""
    rows = []
    for verb in done:
        path = site.products / FOLDERS[verb] / "run.json"
        if path.exists():
            run: dict[str, Any] = read_json(path)
            rows.append([verb, *(written(run[key]) for key in ("seconds", "cpu_seconds", "peak_memory_mb"))])
    blocks = [
        Block(
            f"Parameters of {verb}",
            (site.products / FOLDERS[verb] / "parameters.yaml").read_text(encoding="utf-8"),
        )
        for verb in done
    ]
    facts = "\n".join(f"{label}: {value}" for label, value in describe_environment().items())
    return Section(
        "How it was made",
        "Run time and peak memory of each stage, its resolved parameters, and the machine.",
        tables=[Table(rows, ["stage", "seconds", "CPU seconds", "peak memory (MB)"], "Cost of each stage.")],
        blocks=[*blocks, Block("Environment", facts)],
    )
