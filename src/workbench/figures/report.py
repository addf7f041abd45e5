"""The report of a site: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from typing import Any

from jinja2 import Environment

from workbench.environment import describe_environment
from workbench.errors import SiteError
from workbench.figures.orientation import orientation_section
from workbench.figures.products import (
    matching_section,
    mosaic_section,
    surface_section,
)
from workbench.figures.sections import Block, Section, Table, written
from workbench.params import Parameters
from workbench.site import Site
from workbench.stages import FOLDERS, open_stage, read_json

SECTIONS: dict[str, Callable[[Site], Section]] = {
    "orient": orientation_section,
    "match": matching_section,
    "surface": surface_section,
    "mosaic": mosaic_section,
}


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
        sections = [SECTIONS[verb](site) for verb in done] + [_provenance(site, done)]
        warnings = _warnings(site, done)
        page = files("workbench.figures").joinpath("report.html.j2").read_text(encoding="utf-8")
        html = (
            Environment(autoescape=True)
            .from_string(page)
            .render(site=site, lead=_lead(site), warnings=warnings, sections=sections)
        )
        part = stage.path(".report.html.part")
        part.write_text(html, encoding="utf-8")
        part.replace(stage.path("report.html"))
        stage.metrics.update({"sections": [s.title for s in sections], "warnings": len(warnings)})
    return stage.metrics


def _lead(site: Site) -> str:
    code = site.crs.to_epsg() if site.crs is not None else None
    crs = f"EPSG:{code}" if code else "CRS of the site"
    cameras = ", ".join(sorted({camera.name for camera in site.cameras.values()}))
    kind = "Virtual site with known truth" if site.truth else "Site"
    return f"{kind}; {len(site.photographs)} photographs ({cameras}), {crs}, heights: {site.vertical_datum}."


def _warnings(site: Site, done: list[str]) -> list[str]:
    warnings = [f"{p.name} was set aside: {p.set_aside}." for p in site.set_aside]
    for verb in done:
        warnings += read_json(site.products / FOLDERS[verb] / "metrics.json").get("warnings", [])
    return warnings


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
        tables=[Table(rows, ["stage", "seconds", "CPU seconds", "peak memory (MB)"])],
        blocks=[*blocks, Block("Environment", facts)],
    )
