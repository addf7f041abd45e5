"""The interactive panels of a site as pages in a browser, without a notebook."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import panel as pn

from workbench.errors import SiteError
from workbench.figures.reed import reed_panel
from workbench.figures.surface_panel import pair_panel, surface_panel
from workbench.figures.sweeps_panel import study_names, sweeps_panel
from workbench.figures.trees import tree_panel
from workbench.params import Parameters
from workbench.site import Site
from workbench.stages import FOLDERS


def site_pages(
    site: Site, parameters: Parameters, *, parameters_file: Path | None = None, root: Path = Path()
) -> dict[str, Callable[[], Any]]:
    """What can be explored of a site: the panels of the notebooks whose inputs are there.

    Parameters
    ----------
    site
        With at least an orientation.
    parameters
        Where sliders begin.
    parameters_file
        ``params.yaml`` that buttons write to; without it there are no buttons.
    root
        Folder with the tables of the studies.

    Returns
    -------
    dict
        Title of a page and the function that makes it: ``surface`` (layers by least count), ``pairs`` (one
        stereo pair at any distance and downscale), ``reed``, ``trees``, ``sweeps`` (tables of studies).

    Raises
    ------
    SiteError
        If nothing of the site has been made.
    """
    made = {verb: (site.products / folder / "metrics.json").exists() for verb, folder in FOLDERS.items()}
    # Functions, not partials: a server shows any other callable as text.
    pages: dict[str, Callable[[], Any]] = {}
    if made["surface"]:
        pages["surface"] = lambda: surface_panel(site)
    if made["orient"]:
        pages["pairs"] = lambda: pair_panel(site, parameters)
    level = parameters.reed.water_level if site.water_level is None else site.water_level
    if made["surface"] and level is not None:
        pages["reed"] = lambda: reed_panel(site, options=parameters.reed, parameters_file=parameters_file)
    if made["surface"]:
        pages["trees"] = lambda: tree_panel(
            site,
            options=parameters.trees,
            assessment=parameters.assess,
            parameters_file=parameters_file,
        )
    if not pages:
        raise SiteError(f"{site.name}: nothing to explore yet. Run `workbench run --site {site.name}` first.")
    if study_names(root):
        pages["sweeps"] = lambda: sweeps_panel(root)
    return pages


def serve_pages(pages: dict[str, Callable[[], Any]], *, port: int = 5006, show: bool = True) -> None:
    """Serve pages on this machine alone, until interrupted."""
    pn.serve(
        dict(pages), port=port, show=show, address="127.0.0.1", title=dict(zip(pages, pages, strict=True))
    )
