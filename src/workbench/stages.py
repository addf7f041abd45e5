"""The stages of the chain, and what each leaves beside its products: parameters, metrics, time, memory."""

from __future__ import annotations

import errno
import json
import resource
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from workbench.errors import SiteError
from workbench.params import Section

FOLDERS = {
    "orient": "orientation",
    "match": "matching",
    "surface": "surface",
    "mosaic": "mosaic",
    "reed": "reed",
    "trees": "trees",
    "assess": "assessment",
    "report": "report",
}
"""Verb of each stage, in the order of the chain, and its folder under ``data/products/<site>``."""


_NO_ROOM = frozenset(
    (
        errno.ENOSPC,
        errno.EDQUOT,
        errno.EFBIG,
        errno.EROFS,
        errno.EACCES,
        errno.EPERM,
        errno.EIO,
        errno.ENOTDIR,
    )
)
"""Errors of the system that a full or protected disk causes; any other is a mistake of ours."""


@dataclass
class Stage:
    """A stage at work: where it writes, and what it will report."""

    folder: Path
    """``data/products/<site>/<stage>``."""
    metrics: dict[str, Any] = field(default_factory=dict)
    """Written as ``metrics.json`` at the end; numbers, texts and lists of them only."""

    def path(self, name: str) -> Path:
        """Path of a product of this stage."""
        return self.folder / name


@contextmanager
def open_stage(folder: Path, parameters: Mapping[str, Section]) -> Iterator[Stage]:
    """Prepare the folder of a stage, and describe the run once it has succeeded.

    Writes ``parameters.yaml`` (the sections that the stage reads), ``metrics.json`` (facts that
    depend on data and parameters alone) and ``run.json`` (seconds and peak memory of this run); a copy
    of the metrics goes to ``metrics/<stage>.json`` beside the folder, where DVC and git follow it.
    ``metrics.json`` is taken away at the start, so that its presence means a completed stage.

    Raises
    ------
    SiteError
        If the folder cannot be written.
    """
    started, cpu = time.perf_counter(), time.process_time()
    _reset_peak_memory()
    stage = Stage(folder)
    try:
        _prepare(stage, parameters)
    except OSError as error:
        raise _unwritable(folder, error) from error
    try:
        yield stage
    except OSError as error:
        if error.errno not in _NO_ROOM:
            raise
        raise _unwritable(Path(error.filename or folder), error) from error
    run = {
        "seconds": round(time.perf_counter() - started, 2),
        "cpu_seconds": round(time.process_time() - cpu, 2),
        "peak_memory_mb": round(_peak_memory_mb(), 1),
    }
    write_json(run, stage.path("run.json"))
    try:
        (folder.parent / "metrics").mkdir(exist_ok=True)
    except OSError as error:
        raise _unwritable(folder.parent / "metrics", error) from error
    write_json(stage.metrics, folder.parent / "metrics" / f"{folder.name}.json")
    write_json(stage.metrics, stage.path("metrics.json"))


def _prepare(stage: Stage, parameters: Mapping[str, Section]) -> None:
    """Make the folder, take away what an interrupted run left half written, and write the parameters."""
    stage.folder.mkdir(parents=True, exist_ok=True)
    stage.path("metrics.json").unlink(missing_ok=True)
    for left in stage.folder.glob(".*"):
        if left.is_dir():
            shutil.rmtree(left)
        elif left.name.endswith(".part"):
            left.unlink()
    sections = {name: section.model_dump(mode="json") for name, section in parameters.items()}
    part = stage.path(".parameters.yaml.part")
    with part.open("w", encoding="utf-8") as file:
        YAML().dump(sections, file)
    part.replace(stage.path("parameters.yaml"))


def _unwritable(path: Path, error: OSError) -> SiteError:
    return SiteError(f"{path}: cannot be written ({error}). Free space or choose another root.")


def write_json(values: Mapping[str, Any], path: Path) -> None:
    """Write a mapping as JSON under a temporary name, then rename it; NaN becomes null.

    Raises
    ------
    SiteError
        If the folder cannot be written.
    """
    text = json.dumps(_plain(values), indent=2, allow_nan=False) + "\n"
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise _unwritable(path, error) from error


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file that a stage wrote.

    Raises
    ------
    SiteError
        If it is missing: the stage has not been run, or was interrupted.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        verbs = {folder: verb for verb, folder in FOLDERS.items()}
        verb = verbs.get(path.parent.name, "run")
        raise SiteError(
            f"{path}: missing. Run `workbench {verb} --site {path.parent.parent.name}` first."
        ) from error


def _reset_peak_memory() -> None:
    """Start the kernel's high-water mark anew, so that each stage reports its own (Linux only)."""
    reset = Path("/proc/self/clear_refs")
    if reset.exists():
        try:
            reset.write_text("5")
        except OSError:
            return  # Not allowed in some containers: the mark then covers the whole process.


def _peak_memory_mb() -> float:
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "item") and getattr(value, "ndim", 0) == 0:
        value = value.item()
    elif hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float):
        return None if value != value or value in (float("inf"), float("-inf")) else value
    return value
