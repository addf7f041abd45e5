"""The whole chain on one site, one stage after the other."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

from workbench.params import Parameters
from workbench.site import Site, check_site, write_overlap
from workbench.stages import FOLDERS, open_stage

Stage = Callable[[Site, Parameters], Any]


def run_site(
    site: Site,
    parameters: Parameters,
    stages: Mapping[str, Stage],
    announce: Callable[[str], None] = print,
) -> None:
    """Run all stages that a site has inputs for; an interrupted one continues when run again.

    First says what is wrong with the site, how its photographs overlap and what time and memory to expect.
    """
    report = check_site(site, parameters)
    announce(str(report))
    if report.overlap is not None:
        announce(f"overlap map: {write_overlap(report.overlap, site.products / 'check')}")
    for verb, stage in stages.items():
        announce(f"{verb} ...")
        started = time.perf_counter()
        run_stage(verb, stage, site, parameters, announce, where_possible=True)
        announce(f"{verb} done in {time.perf_counter() - started:.1f} s")
        _return_memory()


def _return_memory() -> None:
    """Give what a stage has freed back to the system, so that the next one does not come on top of it."""
    gc.collect()
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):  # Other C libraries keep it.
            ctypes.CDLL(None).malloc_trim(0)


def run_stage(
    verb: str,
    stage: Stage,
    site: Site,
    parameters: Parameters,
    announce: Callable[[str], None],
    where_possible: bool = False,
) -> None:
    """Run one stage.

    With ``where_possible`` a stage whose input the site lacks leaves ``metrics.json`` with the reason
    under ``skipped`` instead of failing, so that one pipeline serves sites with and without a lake.
    """
    reason = lacking(verb, site, parameters) if where_possible else None
    if reason is None:
        stage(site, parameters)
        return
    announce(f"{verb} skipped: {reason}")
    # What an earlier run left would pass for a result of this one.
    shutil.rmtree(site.products / FOLDERS[verb], ignore_errors=True)
    with open_stage(site.products / FOLDERS[verb], {}) as skipped:
        skipped.metrics["skipped"] = reason


def lacking(verb: str, site: Site, parameters: Parameters) -> str | None:
    """What a site lacks for a stage, or None."""
    if verb == "reed" and site.water_level is None and parameters.reed.water_level is None:
        return "site.yaml has no water_level, so reed is not measured."
    return None
