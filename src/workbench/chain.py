"""The whole chain on one site: which stages it has inputs for, one after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from workbench.params import Parameters
from workbench.site import Site

Stage = Callable[[Site, Parameters], Any]


def stages_of(site: Site) -> tuple[str, ...]:
    """Verbs that the inputs of a site allow, in the order of the chain.

    Reed needs a water level and a shoreline; the assessment needs a truth, a field campaign,
    reference trees or a reference status; everything else needs photographs alone.
    """
    reed = site.water_level is not None and site.shoreline is not None
    reference = (site.truth, site.field_points, site.reference_trees, site.reference_status)
    wanted = {
        "orient": True,
        "match": True,
        "surface": True,
        "mosaic": True,
        "reed": reed,
        "trees": True,
        "assess": any(path is not None for path in reference),
        "report": True,
    }
    return tuple(verb for verb, possible in wanted.items() if possible)


def run_site(
    site: Site,
    parameters: Parameters,
    stages: Mapping[str, Stage],
    announce: Callable[[str], None] = print,
) -> None:
    """Run all stages of a site; one that is interrupted continues where it stopped when run again."""
    for verb in stages_of(site):
        announce(f"{verb} ...")
        started = time.perf_counter()
        stages[verb](site, parameters)
        announce(f"{verb} done in {time.perf_counter() - started:.1f} s")
