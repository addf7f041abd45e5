"""The whole chain on one site, one stage after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from workbench.params import Parameters
from workbench.site import Site

Stage = Callable[[Site, Parameters], Any]


def run_site(
    site: Site,
    parameters: Parameters,
    stages: Mapping[str, Stage],
    announce: Callable[[str], None] = print,
) -> None:
    """Run all stages of a site; one that is interrupted continues where it stopped when run again."""
    for verb, stage in stages.items():
        announce(f"{verb} ...")
        started = time.perf_counter()
        stage(site, parameters)
        announce(f"{verb} done in {time.perf_counter() - started:.1f} s")
