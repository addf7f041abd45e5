"""Running a study: cell by cell, each step once, continued where it stopped."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import dask
import pandas as pd
from distributed import Client, Future, LocalCluster, as_completed

from workbench.environment import describe_environment
from workbench.errors import StudyError, WorkbenchError
from workbench.params import Parameters
from workbench.site import Site, load_site
from workbench.stages import FOLDERS, read_json, write_json
from workbench.studies.design import (
    Cell,
    Study,
    cells_of,
    changed_sources,
    flight_overrides,
    parameters_of,
    scene_of,
    scenes_of,
    thinning,
)
from workbench.studies.keys import hash_of, hash_of_code
from workbench.studies.known_frames import with_cut_photographs
from workbench.studies.responses import GROUPS, require_groups
from workbench.virtual import simulate_scene
from workbench.virtual.scene import load_scene

_FAILURES = (WorkbenchError, MemoryError, ArithmeticError, LookupError, OSError, RuntimeError, ValueError)
"""What a cell may fail with; the rest of the study goes on."""
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
    """Seconds and peak memory (MB) of the steps that this run computed."""

    def _repr_html_(self) -> str:
        return str(self.table.head(50).to_html(index=False))


@dataclass(frozen=True)
class _Step:
    """One stage of one or more cells that share everything it depends on."""

    verb: str
    key: str
    folder: Path
    before: tuple[Path, ...]


def run_studies(
    studies: Iterable[Study],
    root: Path = Path(),
    parameters: Parameters | None = None,
    *,
    workers: int | None = None,
    memory_gb: float = 16.0,
    announce: Callable[[str], None] = print,
) -> Iterator[StudyResult]:
    """Run studies one after the other with the same workers; yields the result of each when it is there.

    Parameters and errors are those of :func:`run_study`. ``workers`` None stands for one per processor.
    """
    with _hands(workers or os.cpu_count() or 1, memory_gb) as client:
        for study in studies:
            yield _run(study, root, parameters or Parameters(), client, announce)


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
    ``costs.csv``, ``design.json``, ``environment.json``, and ``maps/`` where the study asks for it.

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
        Budget of all workers together; there are no more of them than it has room for, at 3 GB each.
    announce
        Told what is done, with the time that is left.

    Raises
    ------
    StudyError
        If factors, levels or responses are unknown, or the study was changed while it ran.
    """
    with _hands(workers, memory_gb) as client:
        return _run(study, root, parameters or Parameters(), client, announce)


def _run(
    study: Study,
    root: Path,
    parameters: Parameters,
    client: Client | None,
    announce: Callable[[str], None],
) -> StudyResult:
    require_groups(study.responses)
    cells = cells_of(study)
    root = Path(root).resolve()
    folder = root / "data" / "studies" / study.name
    folder.mkdir(parents=True, exist_ok=True)
    write_json(_design(study, cells), folder / "design.json")
    runner = _Runner(study, parameters, root, announce)
    try:
        results = runner.run(cells, client)
    finally:
        runner.write_costs()
    _require_unchanged(study, cells, folder)
    runner.keep_maps(cells)
    return _write_tables(study, cells, results, folder, runner.costs())


def estimate_study(study: Study, root: Path = Path(), parameters: Parameters | None = None) -> pd.DataFrame:
    """What a study would cost: steps, how many of them are done, and the seconds that the rest will take.

    Seconds are the mean of the steps of the same kind that were computed below ``root``, of this study or
    others, on whatever machine and beside whatever else; NaN for a kind that never was. Processor seconds
    depend less on what else the machine did.

    Returns
    -------
    DataFrame
        step, steps, done, seconds_each, cpu_seconds_each, seconds_left.
    """
    runner = _Runner(study, parameters or Parameters(), Path(root).resolve(), print)
    steps = {step.key: step for cell in cells_of(study) for step in runner.plan(cell)}
    rows = []
    for verb in ("simulate", *_STEPS):
        mine = [step for step in steps.values() if step.verb == verb]
        if mine:
            done = sum(_is_done(step) for step in mine)
            each = runner.seconds_each(verb)
            cpu = runner.seconds_each(verb, "cpu_seconds")
            rows.append((verb, len(mine), done, each, cpu, each * (len(mine) - done)))
    columns = ["step", "steps", "done", "seconds_each", "cpu_seconds_each", "seconds_left"]
    return pd.DataFrame(rows, columns=columns)


def cell_folder(
    study: Study, root: Path, cell: Cell, verb: str, parameters: Parameters | None = None
) -> Path:
    """Products of one step of one cell, ``.../data/products/<site>/<folder>``.

    Raises
    ------
    StudyError
        If the step has not been computed, or the study does not need it.
    """
    runner = _Runner(study, parameters or Parameters(), Path(root).resolve(), print)
    for step in runner.plan(cell):
        if step.verb == verb:
            for folder in sorted(step.folder.glob(f"data/products/*/{FOLDERS[verb]}")):
                return folder
            raise StudyError(
                f"{step.folder}: {verb} has not been computed. Run `workbench study {study.name}`."
            )
    raise StudyError(f"Study {study.name} does not need {verb}: add a response that does.")


@contextmanager
def _hands(workers: int, memory_gb: float) -> Iterator[Client | None]:
    """Who computes: this process (None), worker processes here, or the cluster that the environment names."""
    address = os.environ.get("DASK_SCHEDULER_ADDRESS")
    workers = min(workers, max(int(memory_gb // 3), 1))
    if address:
        with Client(address) as client:
            yield client
    elif workers == 1:
        yield None
    else:
        with (
            LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                memory_limit=f"{memory_gb / workers:.3f}GB",
                dashboard_address=None,
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client


def _require_unchanged(study: Study, cells: Iterable[Cell], folder: Path) -> None:
    changed = [str(path) for path in changed_sources(study)]
    if json.loads((folder / "design.json").read_text(encoding="utf-8")) != _design(study, cells):
        changed.append(str(folder / "design.json"))
    if changed:
        raise StudyError(
            f"{', '.join(changed)} was changed while study {study.name} ran. No table is written, because it "
            "would belong to neither. Run it again: what is done and still the same is kept."
        )


class _Runner:
    """State of one run: which steps are there, what failed, how long it takes."""

    def __init__(self, study: Study, base: Parameters, root: Path, announce: Callable[[str], None]) -> None:
        self.study, self.base, self.root, self.announce = study, base, root, announce
        self.folder = root / "data" / "studies" / study.name
        self.failed: dict[str, str] = {}
        self.spent: list[dict[str, Any]] = []
        self.code = {verb: hash_of_code(package) for verb, package in _CODE.items()}
        self.code["truth"] = hash_of_code("studies", "known_*.py")
        self.code["responses"] = hash_of_code("studies", "*responses*.py")
        self.started = time.monotonic()
        self.done_now = 0.0
        self.to_do = 0.0

    def run(self, cells: Iterable[Cell], client: Client | None) -> dict[Cell, dict[str, Any]]:
        """Results of all cells, those of earlier runs included."""
        plans = {cell: self.plan(cell) for cell in cells}
        todo = [cell for cell in plans if not self._result(plans[cell]).exists()]
        self.announce(f"{len(plans)} cells, {len(plans) - len(todo)} of them done before")
        stages: list[dict[str, tuple[_Step, Cell]]] = []
        for verb in ("simulate", *_STEPS):
            steps = ((step, cell) for cell in todo for step in plans[cell] if step.verb == verb)
            stages.append({step.key: (step, cell) for step, cell in steps if not _is_done(step)})
        self.to_do = sum(self._expected(step) for jobs in stages for step, _ in jobs.values())
        for jobs in stages:
            wanted = {key: job for key, job in jobs.items() if not self._is_lost(job[0])}
            tasks = {key: (step, self._job(cell)) for key, (step, cell) in wanted.items()}
            for key, outcome in _each(_run_step, tasks, client):
                self._note(wanted[key][0], outcome)
        self._respond(todo, plans, client)
        return {cell: self._read(plans[cell]) for cell in plans}

    def plan(self, cell: Cell) -> list[_Step]:
        """Steps of a cell; the key of each holds all that it depends on."""
        parameters = parameters_of(self.study, cell, self.base)
        needed = {verb for group in self.study.responses for verb in GROUPS[group][1]}
        needs = _NEEDS
        if parameters.trees.mask_index == "none":
            needs = _NEEDS | {"trees": ("surface",)}  # A mask by height alone asks for no orthophoto.
        for verb in reversed(_STEPS):
            if verb in needed:
                needed |= set(needs.get(verb, ()))
        scene = scene_of(self.study, cell)
        origin = {
            # A copied scene is the same scene; another scene of the same name is not.
            "scene": None if scene is None else load_scene(scene).model_dump(mode="json"),
            "site": self.study.site,
            "flight": flight_overrides(self.study, cell),
            "simulate": parameters.simulate.model_dump(mode="json"),
            "code": self.code["simulate"],
        }
        steps = {"simulate": self._step("simulate", origin, ())}
        for verb in _STEPS:
            if verb not in needed:
                continue
            before = tuple(steps[v] for v in ("simulate", *needs.get(verb, ())))
            by_truth = verb == "orient" and self.study.orientation == "truth"
            content = {
                "parameters": getattr(parameters, verb).model_dump(mode="json"),
                "before": [step.key for step in before],
                "code": self.code["truth" if by_truth else verb],
                "orientation": self.study.orientation,
                "used": self._used(cell),
            }
            steps[verb] = self._step(verb, content, tuple(step.folder for step in before))
        return list(steps.values())

    def _used(self, cell: Cell) -> list[int]:
        """Every n-th photograph and strip, and which of the n is the first: another one for every seed."""
        photograph, strip = thinning(self.study, cell)
        return [photograph, cell.seed % photograph, strip, cell.seed % strip]

    def _step(self, verb: str, content: Mapping[str, Any], before: tuple[Path, ...]) -> _Step:
        key = f"{verb}-{hash_of(content)}"
        # Steps are shared between studies, so that "quick" and "full" do not render twice.
        return _Step(verb, key, self.root / "data" / "studies" / "steps" / key, before)

    def _job(self, cell: Cell) -> dict[str, Any]:
        return {
            "root": str(self.root),
            "scene": scene_of(self.study, cell),
            "site": self.study.site,
            "flight": flight_overrides(self.study, cell),
            "parameters": parameters_of(self.study, cell, self.base).model_dump(mode="json"),
            "used": self._used(cell),
            "orientation": self.study.orientation,
        }

    def _note(self, step: _Step, outcome: dict[str, Any] | str) -> None:
        """Remember what a step cost or why it failed, and say how long the rest will take."""
        self.done_now += self._expected(step)
        if isinstance(outcome, str):
            self.failed[step.key] = f"{step.verb}: {outcome}"
            self.announce(f"{step.verb} failed: {outcome}")
            return
        self.spent.append({"step": step.key, **outcome})
        passed = time.monotonic() - self.started
        left = passed / self.done_now * max(self.to_do - self.done_now, 0.0)
        self.announce(f"{step.verb} done in {outcome['seconds']:.1f} s; about {left / 60:.1f} minutes left")

    def _expected(self, step: _Step) -> float:
        each = self.seconds_each(step.verb)
        return each if each == each else 5.0

    def seconds_each(self, verb: str, kind: str = "seconds") -> float:
        """Mean seconds of the steps of a kind that were computed before; NaN without any."""
        known = [noted[kind] for noted in self._measured.get(verb, ()) if kind in noted]
        return sum(known) / len(known) if known else float("nan")

    @cached_property
    def _measured(self) -> dict[str, list[dict[str, Any]]]:
        measured: dict[str, list[dict[str, Any]]] = defaultdict(list)
        for path in sorted((self.root / "data" / "studies" / "steps").glob("*/done.json")):
            noted = read_json(path)
            measured[noted["verb"]].append(noted)
        return measured

    def _respond(
        self, todo: Iterable[Cell], plans: Mapping[Cell, list[_Step]], client: Client | None
    ) -> None:
        """Ask finished chains for their responses and keep them; failures are tried anew next time."""
        whole = [cell for cell in todo if not self._is_incomplete(plans[cell])]
        tasks = {str(i): (plans[cell], self._job(cell), self.study.responses) for i, cell in enumerate(whole)}
        for place, outcome in _each(_responses, tasks, client):
            cell = whole[int(place)]
            if isinstance(outcome, str):
                self.failed[plans[cell][-1].key] = outcome
                self.announce(outcome)
                continue
            path = self._result(plans[cell])
            path.parent.mkdir(parents=True, exist_ok=True)
            write_json({"levels": dict(cell.levels), "seed": cell.seed, "responses": outcome}, path)

    def _is_lost(self, step: _Step) -> bool:
        """Whether a step before this one failed; then this one has failed with it."""
        for folder in step.before:
            if folder.name in self.failed:
                self.failed[step.key] = self.failed[folder.name]
                return True
        return False

    def _is_incomplete(self, plan: list[_Step]) -> bool:
        for step in plan:
            self._is_lost(step)
        return any(step.key in self.failed for step in plan)

    def _result(self, plan: list[_Step]) -> Path:
        groups = sorted(self.study.responses)
        key = hash_of([[step.key for step in plan], groups, self.code["responses"]])
        return self.folder / "cells" / f"{key}.json"

    def _read(self, plan: list[_Step]) -> dict[str, Any]:
        path = self._result(plan)
        if path.exists():
            return json.loads(path.read_text(encoding="utf-8"))
        reasons = [self.failed[step.key] for step in plan if step.key in self.failed]
        return {"error": reasons[0] if reasons else "not computed"}

    def keep_maps(self, cells: Iterable[Cell]) -> None:
        """Copy the count layers of the first seed, named after their levels, to ``maps/``."""
        for cell in cells if self.study.maps else ():
            folders = [s.folder for s in self.plan(cell) if s.verb == "surface" and _is_done(s)]
            if cell.seed == self.study.seeds[0] and folders:
                target = self.folder / "maps" / f"{map_name(cell.levels)}.tif"
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(next(folders[0].glob("data/products/*/surface/count.tif")), target)

    def costs(self) -> pd.DataFrame:
        """Seconds and memory of what this run computed."""
        return pd.DataFrame(self.spent, columns=["step", "seconds", "cpu_seconds", "peak_memory_mb"])

    def write_costs(self) -> None:
        """Append to ``costs.csv``: kept out of the table, because it differs from run to run."""
        path = self.folder / "costs.csv"
        known = path.exists()
        if self.spent or not known:
            self.costs().to_csv(path, mode="a", header=not known, index=False, lineterminator="\n")


def map_name(levels: Iterable[tuple[str, Any]]) -> str:
    """File name (without suffix) of the map of a cell: its levels, in the order of the factors."""
    return "_".join(f"{name.rpartition('.')[2]}-{_plain(level)}".replace(" ", "-") for name, level in levels)


def _each(
    function: Callable[..., Any], tasks: Mapping[str, tuple[Any, ...]], client: Client | None
) -> Iterator[tuple[str, Any]]:
    """Key and outcome of every task as it is done; the outcome of one that failed is what was wrong."""
    if client is None:
        for key, arguments in tasks.items():
            yield key, function(*arguments)
        return
    futures: dict[Future, str] = {
        client.submit(function, *arguments, pure=False): key for key, arguments in tasks.items()
    }
    for future in as_completed(futures):
        # A worker that ran out of its memory has no outcome, but an error.
        lost = future.exception()
        yield futures[future], future.result() if lost is None else f"{type(lost).__name__}: {lost}"


def _run_step(step: _Step, job: Mapping[str, Any]) -> dict[str, Any] | str:
    """Compute one step; what it failed with is a value, so that other steps go on."""
    started, cpu = time.perf_counter(), time.process_time()
    parameters = Parameters.model_validate(job["parameters"])
    try:
        # Within a worker of a cluster the stage has its own threads, not the cluster's.
        with dask.config.set(scheduler="threads"):
            if step.verb == "simulate":
                _simulate(step, job, parameters)
            else:
                _run_stage(step, job, parameters)
    except _FAILURES as error:
        return f"{type(error).__name__}: {error}"
    cost = {
        "seconds": round(time.perf_counter() - started, 2),
        "cpu_seconds": round(time.process_time() - cpu, 2),
        "peak_memory_mb": _peak(step),
    }
    write_json({"verb": step.verb, **cost}, step.folder / "done.json")
    return cost


def _responses(plan: list[_Step], job: Mapping[str, Any], groups: list[str]) -> list[list[Any]] | str:
    """Ask a finished chain for its responses."""
    parameters = Parameters.model_validate(job["parameters"])
    rows: list[list[Any]] = []
    try:
        site = _site_of(job, plan[0].folder)
        with dask.config.set(scheduler="threads"):
            for group in groups:
                function, verbs = GROUPS[group]
                run = replace(site, root=next(s.folder for s in plan if s.verb == verbs[-1]))
                rows += [list(row) for row in function(run, site, parameters)]
    except _FAILURES as error:
        return f"responses: {type(error).__name__}: {error}"
    return rows


def _simulate(step: _Step, job: Mapping[str, Any], parameters: Parameters) -> None:
    step.folder.mkdir(parents=True, exist_ok=True)
    if job["scene"] is not None:
        simulate_scene(job["scene"], step.folder, parameters, flight_overrides=job["flight"])
    else:
        load_site(job["site"], job["root"])


def _run_stage(step: _Step, job: Mapping[str, Any], parameters: Parameters) -> None:
    site = _site_of(job, step.before[0])
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
        orient_by_truth(site, parameters, run.products / FOLDERS["orient"], cut=True)
        return
    if job["orientation"] == "truth":
        run = with_cut_photographs(run)
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
    return thinned(site, *job["used"])


def thinned(site: Site, every: int, first: int = 0, every_strip: int = 1, first_strip: int = 0) -> Site:
    """A site with every n-th photograph of every m-th strip.

    Parameters
    ----------
    site
        Strips and order of the photographs are those that the site states.
    every, first
        Of each strip the photographs first, first + every, ...
    every_strip, first_strip
        The same for strips.

    Raises
    ------
    StudyError
        If fewer than two photographs are left.
    """
    strips: dict[int, list[Any]] = defaultdict(list)
    for photograph in sorted(site.photographs, key=lambda p: (p.strip, p.order)):
        strips[photograph.strip].append(photograph)
    chosen = sorted(strips)[first_strip::every_strip]
    kept = [photograph for strip in chosen for photograph in strips[strip][first::every]]
    if len(kept) < 2:
        raise StudyError(
            f"Every {every}. photograph of every {every_strip}. strip of site {site.name} leaves "
            f"{len(kept)}: thin less."
        )
    return replace(site, photographs=tuple(sorted(kept, key=lambda p: p.name)))


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


def _design(study: Study, cells: Iterable[Cell]) -> dict[str, Any]:
    runs = [{**{name: _plain(v) for name, v in cell.levels}, "seed": cell.seed} for cell in cells]
    described = _without_places(study.model_dump(mode="json"))
    described["scenes"] = {Path(s).stem: load_scene(s).model_dump(mode="json") for s in scenes_of(study)}
    return {"study": described, "cells": runs}


def _without_places(value: Any) -> Any:
    """Scenes by name: where the package lies is no part of the design."""
    if isinstance(value, dict):
        return {
            key: Path(entry).stem if key == "scene" and isinstance(entry, str) else _without_places(entry)
            for key, entry in value.items()
        }
    return value


def _plain(level: Any) -> Any:
    """Lists (of downscales, say) become one text, so that a level is one entry of a table."""
    return " ".join(map(str, level)) if isinstance(level, list | tuple) else level
