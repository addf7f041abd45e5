"""Running a study: cell by cell, each step once, continued where it stopped."""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import shutil
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import dask
import pandas as pd
from rich.console import Console

from workbench.environment import describe_environment
from workbench.errors import StudyError, WorkbenchError
from workbench.params import Parameters
from workbench.site import Site, load_site
from workbench.stages import FOLDERS, write_json
from workbench.studies.design import (
    Cell,
    Study,
    cells_of,
    flight_overrides,
    parameters_of,
    thinning,
)
from workbench.studies.responses import GROUPS, require_groups
from workbench.virtual import simulate_scene

_STEPS = ("orient", "match", "surface", "mosaic", "trees", "reed")
_NEEDS = {
    "match": ("orient",),
    "surface": ("orient", "match"),
    "mosaic": ("orient", "surface"),
    "trees": ("surface", "mosaic"),
    "reed": ("surface",),
}
_CODE = {
    "simulate": "virtual",
    "orient": "orientation",
    "match": "matching",
    "surface": "surface",
    "mosaic": "mosaic",
    "trees": "trees",
    "reed": "reed",
}
_STAGES = {
    "orient": ("workbench.orientation", "orient_site"),
    "match": ("workbench.matching", "match_site"),
    "surface": ("workbench.surface", "surface_site"),
    "mosaic": ("workbench.mosaic", "mosaic_site"),
    "trees": ("workbench.trees", "trees_site"),
    "reed": ("workbench.reed", "reed_site"),
}


@dataclass(frozen=True, eq=False)
class StudyResult:
    """A study that has run."""

    folder: Path
    """``data/studies/<name>``."""
    table: pd.DataFrame
    """Tidy: a column per factor, seed, response, value, unit."""
    failed: pd.DataFrame
    """A row per cell that failed: factors, seed, error."""
    costs: pd.DataFrame
    """Seconds and peak memory of the steps that this run computed."""

    def _repr_html_(self) -> str:
        return str(self.table.head(50).to_html(index=False))


@dataclass(frozen=True)
class _Step:
    """One stage of one or more cells that share everything it depends on."""

    verb: str
    key: str
    folder: Path
    before: tuple[Path, ...]


def run_study(
    study: Study,
    root: Path = Path(),
    parameters: Parameters | None = None,
    *,
    workers: int = 1,
    memory_gb: float = 16.0,
    announce: Callable[[str], None] = print,
) -> StudyResult:
    """Run all cells of a study that have not been run yet, and write its table.

    Steps that cells share (rendering, orientation, matching ...) are done once. Every finished step and
    cell stays on disk: an interrupted study continues, an added level computes only what is new. A cell
    that fails is recorded with its error, and the rest goes on. Values are the same for any number of
    workers.

    Written below ``data/studies/<name>``: ``table.csv`` and ``table.parquet``, ``failed.csv``,
    ``costs.csv``, ``design.json``, ``environment.json``.

    Parameters
    ----------
    study
        See :func:`load_study`.
    root
        Folder that holds ``data/``.
    parameters
        Base of all cells; defaults if None.
    workers
        Steps at the same time, in processes of their own. Where ``DASK_SCHEDULER_ADDRESS`` is set they go to
        that cluster, which must see the folder.
    memory_gb
        Budget: no more workers than it has room for, at 3 GB each.
    announce
        Told what is done, with the time that is left.

    Raises
    ------
    StudyError
        If factors, levels or responses are unknown, or the study was changed while it ran.
    """
    require_groups(study.responses)
    base = parameters or Parameters()
    cells = cells_of(study)
    folder = Path(root) / "data" / "studies" / study.name
    folder.mkdir(parents=True, exist_ok=True)
    _write_design(study, cells, folder)
    runner = _Runner(study, base, Path(root), folder, min(workers, max(int(memory_gb // 3), 1)), announce)
    try:
        results = runner.run(cells)
    finally:
        runner.write_costs()
    if json.loads((folder / "design.json").read_text(encoding="utf-8")) != _design(study, cells):
        raise StudyError(
            f"{folder / 'design.json'} was changed while the study ran, perhaps by a second run of it. "
            "Run it again: what is done is kept."
        )
    return _write_tables(study, cells, results, folder, runner.costs())


class _Runner:
    """State of one run: which steps are there, what failed, how long it takes."""

    def __init__(
        self,
        study: Study,
        base: Parameters,
        root: Path,
        folder: Path,
        workers: int,
        announce: Callable[[str], None],
    ) -> None:
        self.study, self.base, self.root, self.folder = study, base, root, folder
        self.workers, self.announce = workers, announce
        self.failed: dict[str, str] = {}
        self.spent: list[dict[str, Any]] = []
        self.code = {verb: _hash_of_code(package) for verb, package in _CODE.items()}

    def run(self, cells: Iterable[Cell]) -> dict[Cell, dict[str, Any]]:
        """Results of all cells, those of earlier runs included."""
        plans = {cell: self._plan(cell) for cell in cells}
        todo = [cell for cell in plans if not self._result(plans[cell]).exists()]
        self.announce(f"{len(plans)} cells, {len(plans) - len(todo)} of them done before")
        for verb in ("simulate", *_STEPS):
            jobs: dict[str, tuple[_Step, Cell]] = {}
            for cell in todo:
                for step in plans[cell]:
                    if step.verb == verb and not _is_done(step):
                        jobs.setdefault(step.key, (step, cell))
            self._compute(verb, jobs)
        for cell in todo:
            self._respond(cell, plans[cell])
        return {cell: self._read(plans[cell]) for cell in plans}

    def _plan(self, cell: Cell) -> list[_Step]:
        """Steps of a cell; the key of each holds all that it depends on."""
        parameters = parameters_of(self.study, cell, self.base)
        wanted = {verb for group in self.study.responses for verb in GROUPS[group][1]}
        needed = set(wanted)
        for verb in reversed(_STEPS):
            if verb in needed:
                needed |= set(_NEEDS.get(verb, ()))
        origin = {
            "scene": self.study.scene,
            "site": self.study.site,
            "flight": flight_overrides(self.study, cell),
            "simulate": parameters.simulate.model_dump(mode="json"),
            "code": self.code["simulate"],
        }
        steps = {"simulate": self._step("simulate", origin, ())}
        for verb in _STEPS:
            if verb not in needed:
                continue
            before = tuple(steps[v] for v in ("simulate", *_NEEDS.get(verb, ())))
            content = {
                "parameters": getattr(parameters, verb).model_dump(mode="json"),
                "before": [step.key for step in before],
                "code": self.code[verb],
                "orientation": self.study.orientation,
                "thin": thinning(self.study, cell),
            }
            steps[verb] = self._step(verb, content, tuple(step.folder for step in before))
        return list(steps.values())

    def _step(self, verb: str, content: Mapping[str, Any], before: tuple[Path, ...]) -> _Step:
        key = f"{verb}-{_hash(content)}"
        # Steps are shared between studies, so that "quick" and "full" do not render twice.
        return _Step(verb, key, self.root / "data" / "studies" / "steps" / key, before)

    def _compute(self, verb: str, jobs: Mapping[str, tuple[_Step, Cell]]) -> None:
        jobs = {key: job for key, job in jobs.items() if not self._is_lost(job[0])}
        started = time.monotonic()
        pending = list(jobs.items())
        done = 0
        for start in range(0, len(pending), self.workers):
            batch = pending[start : start + self.workers]
            tasks = [dask.delayed(_run_step)(step, self._job(cell, step)) for _, (step, cell) in batch]
            for (key, _), outcome in zip(batch, self._dask(tasks), strict=True):
                if outcome.pop("error", None):
                    self.failed[key] = outcome["message"]
                else:
                    self.spent.append({"step": key, **outcome})
            done += len(batch)
            left = (time.monotonic() - started) / done * (len(pending) - done)
            self.announce(f"{verb}: {done} of {len(pending)}, about {left / 60:.1f} minutes left here")

    def _dask(self, tasks: list[Any]) -> list[dict[str, Any]]:
        address = os.environ.get("DASK_SCHEDULER_ADDRESS")
        if address:
            from distributed import Client

            with Client(address) as client:
                return list(client.gather(client.compute(tasks)))
        if self.workers == 1:
            return list(dask.compute(*tasks, scheduler="synchronous"))
        return list(dask.compute(*tasks, scheduler="processes", num_workers=self.workers))

    def _job(self, cell: Cell, step: _Step) -> dict[str, Any]:
        return {
            "root": str(self.root),
            "scene": self.study.scene,
            "site": self.study.site,
            "flight": flight_overrides(self.study, cell),
            "parameters": parameters_of(self.study, cell, self.base).model_dump(mode="json"),
            "thin": thinning(self.study, cell),
            "orientation": self.study.orientation,
            "simulate": str(_origin(step)),
        }

    def _is_lost(self, step: _Step) -> bool:
        """Whether a step before this one failed; then this one has failed with it."""
        for folder in step.before:
            if folder.name in self.failed:
                self.failed[step.key] = self.failed[folder.name]
                return True
        return False

    def _result(self, plan: list[_Step]) -> Path:
        key = _hash([[step.key for step in plan], sorted(self.study.responses), _hash_of_code("studies")])
        return self.folder / "cells" / f"{key}.json"

    def _respond(self, cell: Cell, plan: list[_Step]) -> None:
        """Ask a finished chain for its responses, and keep them; a failure is not kept, but tried anew."""
        if any(self._is_lost(step) or step.key in self.failed for step in plan):
            return
        parameters = parameters_of(self.study, cell, self.base)
        site = _site_of(self._job(cell, plan[0]), plan[0].folder)
        rows = []
        try:
            for group in self.study.responses:
                for verb in GROUPS[group][1]:
                    run = replace(site, root=next(s.folder for s in plan if s.verb == verb))
                rows += [list(row) for row in GROUPS[group][0](run, site, parameters)]
        except (WorkbenchError, KeyError, ValueError) as error:
            self.failed[plan[-1].key] = f"{type(error).__name__}: {error}"
            return
        path = self._result(plan)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json({"levels": dict(cell.levels), "seed": cell.seed, "responses": rows}, path)

    def _read(self, plan: list[_Step]) -> dict[str, Any]:
        path = self._result(plan)
        if path.exists():
            return json.loads(path.read_text(encoding="utf-8"))
        reasons = [self.failed[step.key] for step in plan if step.key in self.failed]
        return {"error": reasons[0] if reasons else "not computed"}

    def costs(self) -> pd.DataFrame:
        """Seconds and memory of what this run computed."""
        return pd.DataFrame(self.spent, columns=["step", "seconds", "peak_memory_mb"])

    def write_costs(self) -> None:
        """Append to ``costs.csv``: kept out of the table, because it differs from run to run."""
        path = self.folder / "costs.csv"
        before = [pd.read_csv(path)] if path.exists() else []
        table = pd.concat([*before, self.costs()]) if before or self.spent else self.costs()
        table.to_csv(path, index=False, lineterminator="\n")


def _run_step(step: _Step, job: Mapping[str, Any]) -> dict[str, Any]:
    """Compute one step; errors of data and parameters are values, so that other steps go on."""
    started = time.perf_counter()
    parameters = Parameters.model_validate(job["parameters"])
    try:
        if step.verb == "simulate":
            _simulate(step, job, parameters)
        else:
            _run_stage(step, job, parameters)
    except (WorkbenchError, MemoryError) as error:
        return {"error": True, "message": f"{step.verb}: {type(error).__name__}: {error}"}
    write_json({"verb": step.verb}, step.folder / "done.json")
    return {"seconds": round(time.perf_counter() - started, 2), "peak_memory_mb": _peak(step)}


def _simulate(step: _Step, job: Mapping[str, Any], parameters: Parameters) -> None:
    step.folder.mkdir(parents=True, exist_ok=True)
    if job["scene"] is not None:
        simulate_scene(job["scene"], step.folder, parameters, flight_overrides=job["flight"])
    else:
        load_site(job["site"], job["root"])


def _run_stage(step: _Step, job: Mapping[str, Any], parameters: Parameters) -> None:
    site = _site_of(job, Path(job["simulate"]))
    run = replace(site, root=step.folder)
    run.products.mkdir(parents=True, exist_ok=True)
    for before in step.before:
        for done in (before / "data" / "products" / site.name).glob("*"):
            link = run.products / done.name
            if done.is_dir() and done.name in FOLDERS.values() and not link.exists():
                link.symlink_to(done.resolve(), target_is_directory=True)
    if step.verb == "orient" and job["orientation"] == "truth":
        from workbench.studies.known_poses import orient_by_truth

        # The truth lies beside the site; only the products go to the folder of the step.
        orient_by_truth(site, parameters, run.products / FOLDERS["orient"])
        return
    module, function = _STAGES[step.verb]
    getattr(importlib.import_module(module), function)(run, parameters)
    shutil.rmtree(run.products / FOLDERS[step.verb] / "work", ignore_errors=True)


def _site_of(job: Mapping[str, Any], simulated: Path) -> Site:
    """The site of a cell with the photographs that it uses."""
    if job["scene"] is not None:
        names = sorted((simulated / "data" / "sites").iterdir())
        site = load_site(names[0].name, simulated)
    else:
        site = load_site(job["site"], job["root"])
    return thinned(site, job["thin"])


def thinned(site: Site, every: int) -> Site:
    """A site with every n-th photograph of each strip.

    Raises
    ------
    StudyError
        If fewer than two photographs are left.
    """
    if every == 1:
        return site
    strips: dict[int, list[Any]] = defaultdict(list)
    for photograph in sorted(site.photographs, key=lambda p: (p.strip, p.order)):
        strips[photograph.strip].append(photograph)
    kept = [p for strip in strips.values() for p in strip[::every]]
    if len(kept) < 2:
        raise StudyError(f"Every {every}. photograph of site {site.name} leaves {len(kept)}: thin less.")
    return replace(site, photographs=tuple(sorted(kept, key=lambda p: p.name)))


def _origin(step: _Step) -> Path:
    return step.folder if step.verb == "simulate" else step.before[0]


def _is_done(step: _Step) -> bool:
    return (step.folder / "done.json").exists()


def _peak(step: _Step) -> float:
    """Peak memory that the stage noted, MB; NaN for a simulation, which notes none."""
    for path in sorted(step.folder.glob(f"data/products/*/{FOLDERS.get(step.verb, '-')}/run.json")):
        return float(json.loads(path.read_text(encoding="utf-8"))["peak_memory_mb"])
    return float("nan")


def _write_tables(
    study: Study,
    cells: Iterable[Cell],
    results: Mapping[Cell, Mapping[str, Any]],
    folder: Path,
    costs: pd.DataFrame,
) -> StudyResult:
    factors = list(study.factors)
    rows, failed = [], []
    for cell in cells:
        start = [*(_plain(level) for _, level in cell.levels), cell.seed]
        if "error" in results[cell]:
            failed.append([*start, results[cell]["error"]])
        for name, value, unit in results[cell].get("responses", ()):
            rows.append([*start, name, float("nan") if value is None else value, unit])
    table = pd.DataFrame(rows, columns=[*factors, "seed", "response", "value", "unit"])
    losses = pd.DataFrame(failed, columns=[*factors, "seed", "error"])
    table.to_csv(folder / "table.csv", index=False, lineterminator="\n", float_format="%.8g")
    table.to_parquet(folder / "table.parquet", index=False)
    losses.to_csv(folder / "failed.csv", index=False, lineterminator="\n")
    write_json(describe_environment(), folder / "environment.json")
    return StudyResult(folder, table, losses, costs)


def _write_design(study: Study, cells: Iterable[Cell], folder: Path) -> None:
    write_json(_design(study, cells), folder / "design.json")


def _design(study: Study, cells: Iterable[Cell]) -> dict[str, Any]:
    runs = [{**{name: _plain(v) for name, v in cell.levels}, "seed": cell.seed} for cell in cells]
    return {"study": study.model_dump(mode="json"), "cells": runs}


def _plain(level: Any) -> Any:
    """Lists (of downscales, say) become one text, so that a level is one entry of a table."""
    return " ".join(map(str, level)) if isinstance(level, list | tuple) else level


def _hash(content: Any) -> str:
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _hash_of_code(package: str) -> str:
    """Hash of the source of a package: results of other code are other results."""
    folder = Path(__file__).parents[1] / package
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def announce_to_console() -> Callable[[str], None]:
    """Messages to the terminal."""
    return Console(stderr=True, highlight=False).print
