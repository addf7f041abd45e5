"""A study: which chains to run. A small YAML file becomes a list of cells."""

from __future__ import annotations

import hashlib
import io
import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError, model_validator
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from workbench.errors import ParameterError, SceneError, StudyError
from workbench.params import Parameters
from workbench.params.file import parse_parameters
from workbench.virtual.stage import flight_of

_FLIGHT = "flight."
_OWN = ("scene", "thin", "strips")
_Factor = list[Any] | dict[str | int | float, dict[str, Any]]


class Fractional(BaseModel):
    """A random part of the full design in which every level occurs as evenly as possible."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    runs: int = Field(ge=1, description="Number of combinations.")
    seed: int = Field(1, ge=0, description="Of the choice.")


class Quick(BaseModel):
    """What a study is reduced to for a first look."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    factors: dict[str, _Factor] = Field({}, description="Fewer levels of some factors.")
    fixed: dict[str, Any] = Field({}, description="Other fixed values.")
    seeds: list[int] | None = Field(None, description="Fewer seeds.")
    scene: str | None = Field(None, description="A smaller scene.")
    design: Literal["full"] | Fractional | None = Field(None, description="Another part of the design.")


class Study(BaseModel):
    """The file of a study. Frozen, and closed to unknown keys.

    Factors and fixed values are named by their path: ``flight.<field>`` for the flight of a virtual scene,
    ``thin`` to use every n-th photograph of each strip (the overlap falls as when the authors left
    photographs out), ``strips`` to use every n-th strip (so falls the side overlap), ``scene``, or any path
    of ``params.yaml``. Which of n photographs is the first follows from the seed. A factor whose levels
    change several values at once has any name, and a mapping from level to values:
    ``camera: {long: {flight.camera: ..., flight.frame: ...}, short: {...}}``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(description="Name of the study and its folder.", pattern=r"^[a-z0-9][a-z0-9_-]*$")
    title: str = Field(description="One line.")
    published: str | None = Field(None, description="Table of data/published that it repeats.")
    scene: str | None = Field(None, description="Virtual scene, or path of its YAML file.")
    site: str | None = Field(None, description="A site instead of a scene.")
    orientation: Literal["photographs", "truth"] = Field(
        "photographs", description="Structure from motion, or the true poses of a virtual scene."
    )
    factors: dict[str, _Factor] = Field(description="Levels of each factor.", min_length=1)
    fixed: dict[str, Any] = Field({}, description="Values that are the same in all cells.")
    seeds: list[int] = Field([1], description="Repetitions with other disturbances.", min_length=1)
    design: Literal["full"] | Fractional = Field("full", description="All combinations, or a part.")
    responses: list[str] = Field(description="Groups of responses.", min_length=1)
    maps: bool = Field(False, description="Keep the count layers of the first seed beside the table.")
    quick: Quick = Field(default_factory=Quick, description="Reduced preset.")
    _source: tuple[tuple[Path, str], ...] = PrivateAttr(())

    @model_validator(mode="after")
    def _one_origin(self) -> Study:
        if (self.scene is None) == (self.site is None):
            raise ValueError("give either scene or site")
        if self.site is not None and self.orientation == "truth":
            raise ValueError("only a virtual scene has true poses")
        if any(not levels for levels in self.factors.values()):
            raise ValueError("every factor needs at least one level")
        return self


@dataclass(frozen=True)
class Cell:
    """One run of the chain."""

    levels: tuple[tuple[str, Any], ...]
    """Factor and level, in the order of the study."""
    seed: int
    """Seed of flight, noise and orientation, and of which photographs are left out."""


def load_study(name: str | Path, root: Path = Path(), *, quick: bool = False) -> Study:
    """Read a study: a path, one in ``data/studies/NAME.yaml``, or one that is shipped.

    Raises
    ------
    StudyError
        If there is none of that name, or with everything that is wrong with it at once.
    """
    path = _find(str(name), root)
    try:
        values = YAML(typ="safe").load(io.StringIO(path.read_text(encoding="utf-8")))
        study = Study(**values)
    except (YAMLError, TypeError, UnicodeDecodeError) as error:
        raise StudyError(f"{path}: no study ({error}).") from error
    except ValidationError as error:
        problems = "; ".join(f"{'.'.join(map(str, p['loc']))}: {p['msg']}" for p in error.errors())
        raise StudyError(f"{path}: {problems}.") from error
    study = _with_scenes(study, path.parent / "scenes")
    chosen = reduced(study) if quick else study
    sources = {path, *(Path(scene) for scene in scenes_of(chosen) if Path(scene).is_file())}
    chosen._source = tuple((source, content_hash(source)) for source in sorted(sources))
    return chosen


def changed_sources(study: Study) -> tuple[Path, ...]:
    """Files of a study (its own and those of its scenes) that are not what they were when it was read."""
    return tuple(p for p, noted in study._source if not p.is_file() or content_hash(p) != noted)


def content_hash(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def scenes_of(study: Study) -> tuple[str, ...]:
    """All scenes that the cells of a study are flown over."""
    named = [study.scene, study.fixed.get("scene")]
    for factor, levels in study.factors.items():
        if isinstance(levels, dict):
            named += [values.get("scene") for values in levels.values()]
        elif factor == "scene":
            named += levels
    return tuple(sorted({scene for scene in named if scene is not None}))


def load_studies(name: str, root: Path = Path(), *, quick: bool = False) -> tuple[Study, ...]:
    """One study, or every shipped one for the name ``all``.

    Raises
    ------
    StudyError
        As :func:`load_study`.
    """
    names = shipped_studies() if name == "all" else (name,)
    return tuple(load_study(each, root, quick=quick) for each in names)


def list_studies() -> pd.DataFrame:
    """The shipped studies: name, title, cells of the full design and of the quick preset."""
    rows = []
    for name in shipped_studies():
        study = load_study(name)
        rows.append((name, study.title, len(cells_of(study)), len(cells_of(reduced(study)))))
    return pd.DataFrame(rows, columns=["study", "title", "cells", "quick_cells"])


def _with_scenes(study: Study, folder: Path) -> Study:
    """A scene in ``scenes/`` beside the study goes before one of the package."""

    def own(name: str) -> str:
        path = folder / f"{name}.yaml"
        return str(path) if path.is_file() else name

    def resolve(value: Any) -> Any:
        if isinstance(value, dict):
            return {
                k: own(v) if k == "scene" and isinstance(v, str) else resolve(v) for k, v in value.items()
            }
        return value

    values = resolve(study.model_dump())
    for part in (values, values["quick"]):
        if isinstance(part["factors"].get("scene"), list):
            part["factors"]["scene"] = [own(name) for name in part["factors"]["scene"]]
    return Study(**values)


def shipped_studies() -> tuple[str, ...]:
    """Names of the studies of the package."""
    folder = files("workbench.studies").joinpath("shipped")
    return tuple(sorted(f.name.removesuffix(".yaml") for f in folder.iterdir() if f.name.endswith(".yaml")))


def reduced(study: Study) -> Study:
    """The quick preset of a study, under the name ``<name>-quick``.

    Raises
    ------
    StudyError
        If the preset names a factor that the study does not have.
    """
    unknown = set(study.quick.factors) - set(study.factors)
    if unknown:
        raise StudyError(f"Study {study.name}: quick names unknown factors {sorted(unknown)}.")
    return study.model_copy(
        update={
            "name": f"{study.name}-quick",
            "factors": {name: _fewer(study, name) for name in study.factors},
            "fixed": study.fixed | study.quick.fixed,
            "seeds": study.quick.seeds or study.seeds,
            "scene": study.quick.scene or study.scene,
            "design": study.quick.design or study.design,
        }
    )


def _fewer(study: Study, factor: str) -> _Factor:
    """Levels of a factor in the quick preset; of a mapping its levels may be listed by name alone."""
    whole, part = study.factors[factor], study.quick.factors.get(factor)
    if isinstance(whole, dict) and isinstance(part, list):
        unknown = [level for level in part if level not in whole]
        if unknown:
            raise StudyError(f"Study {study.name}: quick names unknown levels {unknown} of {factor}.")
        return {level: whole[level] for level in part}
    return whole if part is None else part


def cells_of(study: Study) -> tuple[Cell, ...]:
    """All runs of a study, in the order of its factors, then seeds.

    Raises
    ------
    StudyError
        If a factor or level is unknown or out of range.
    """
    combinations = list(itertools.product(*study.factors.values()))
    if isinstance(study.design, Fractional):
        combinations = _part(combinations, study.design)
    cells = tuple(
        Cell(tuple(zip(study.factors, map(_frozen, levels), strict=True)), seed)
        for levels in combinations
        for seed in study.seeds
    )
    problems = sorted({problem for cell in cells for problem in _problems(study, cell)})
    if problems:
        raise StudyError(f"Study {study.name}:\n  " + "\n  ".join(problems))
    return cells


def settings_of(study: Study, cell: Cell) -> dict[str, Any]:
    """Path and value of everything that a cell sets; levels go before fixed values."""
    values = dict(study.fixed)
    for factor, level in cell.levels:
        levels = study.factors[factor]
        values |= levels[level] if isinstance(levels, dict) else {factor: level}
    return values


def flight_overrides(study: Study, cell: Cell) -> dict[str, Any]:
    """Fields of the flight that a cell sets."""
    values = settings_of(study, cell)
    return {path.removeprefix(_FLIGHT): v for path, v in values.items() if path.startswith(_FLIGHT)}


def scene_of(study: Study, cell: Cell) -> str | None:
    """The scene that a cell is flown over; None for a real site."""
    return settings_of(study, cell).get("scene", study.scene)


def thinning(study: Study, cell: Cell) -> tuple[int, int]:
    """Every how manyth photograph of a strip, and every how manyth strip a cell uses."""
    values = settings_of(study, cell)
    return values.get("thin", 1), values.get("strips", 1)


def parameters_of(study: Study, cell: Cell, base: Parameters) -> Parameters:
    """Parameters of a cell: the base, the fixed values, the levels, and the seed of the cell.

    Raises
    ------
    StudyError
        If a path is unknown or a value out of range.
    """
    values = base.model_dump(mode="json")
    changes = settings_of(study, cell) | {"simulate.seed": cell.seed, "orient.seed": cell.seed}
    for path, value in changes.items():
        if not path.startswith(_FLIGHT) and path not in _OWN:
            _set(values, path, value, study)
    try:
        return parse_parameters(values, f"study {study.name}")
    except ParameterError as error:
        raise StudyError(str(error)) from error


def _set(values: dict[str, Any], path: str, value: Any, study: Study) -> None:
    *parents, key = path.split(".")
    node: Any = values
    for parent in parents:
        node = node.get(parent) if isinstance(node, Mapping) else None
    if not isinstance(node, dict) or key not in node or not parents:
        raise StudyError(
            f"Study {study.name}: no factor {path!r}. Give flight.<field>, {', '.join(_OWN)}, "
            "or a path of params.yaml."
        )
    node[key] = value


def _problems(study: Study, cell: Cell) -> list[str]:
    problems = []
    try:
        parameters = parameters_of(study, cell, Parameters())
        scene = scene_of(study, cell)
        if scene is not None:
            from workbench.virtual.scene import load_scene

            flight_of(load_scene(scene).flight, parameters.simulate, flight_overrides(study, cell))
        elif flight_overrides(study, cell):
            problems.append("flight factors need a virtual scene: a real site was flown as it was.")
    except (StudyError, SceneError) as error:
        problems.append(str(error))
    for name, every in zip(("thin", "strips"), thinning(study, cell), strict=True):
        if not isinstance(every, int) or every < 1:
            problems.append(f"{name} is {every!r}: give a whole number from 1.")
    return problems


def _frozen(level: Any) -> Any:
    """A list of downscales, say, as a tuple: a cell is a value that can be looked up."""
    return tuple(level) if isinstance(level, list) else level


def _part(combinations: list[tuple[Any, ...]], design: Fractional) -> list[tuple[Any, ...]]:
    """A balanced random part: each step takes the combination whose levels were used least."""
    if design.runs >= len(combinations):
        return combinations
    order = np.random.default_rng(design.seed).permutation(len(combinations))
    used: dict[tuple[int, str], int] = {}
    chosen: list[int] = []
    left = [int(i) for i in order]
    for _ in range(design.runs):
        cost = [
            sum(used.get((place, repr(level)), 0) for place, level in enumerate(combinations[i]))
            for i in left
        ]
        taken = left.pop(int(np.argmin(cost)))
        for place, level in enumerate(combinations[taken]):
            used[place, repr(level)] = used.get((place, repr(level)), 0) + 1
        chosen.append(taken)
    return [combinations[i] for i in sorted(chosen)]


def _find(name: str, root: Path) -> Path:
    shipped = Path(str(files("workbench.studies").joinpath("shipped", f"{name}.yaml")))
    for path in (Path(name), root / "data" / "studies" / f"{name}.yaml", shipped):
        if path.suffix in (".yaml", ".yml") and path.is_file():
            return path
    raise StudyError(
        f"No study {name!r}. Shipped are {', '.join(shipped_studies())}; your own goes to "
        f"{root / 'data' / 'studies' / (name + '.yaml')}."
    )
