"""Reading, writing and changing ``params.yaml``."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.representer import RoundTripRepresenter

from workbench.errors import ParameterError
from workbench.params.assess import AssessParameters
from workbench.params.base import Section
from workbench.params.match import MatchParameters
from workbench.params.mosaic import MosaicParameters
from workbench.params.orient import OrientParameters
from workbench.params.reed import ReedParameters
from workbench.params.report import ReportParameters
from workbench.params.simulate import SimulateParameters
from workbench.params.study import StudyParameters
from workbench.params.surface import SurfaceParameters
from workbench.params.trees import TreesParameters


class Parameters(Section):
    """The whole of ``params.yaml``: the sites to work on and one section a stage."""

    scenes: tuple[str, ...] = Field(("lake",), description="Virtual scenes to simulate as sites.")
    sites: tuple[str, ...] = Field(("lake",), description="Sites to run the chain on.")
    simulate: SimulateParameters = SimulateParameters()
    orient: OrientParameters = OrientParameters()
    match: MatchParameters = MatchParameters()
    surface: SurfaceParameters = SurfaceParameters()
    mosaic: MosaicParameters = MosaicParameters()
    reed: ReedParameters = ReedParameters()
    trees: TreesParameters = TreesParameters()
    assess: AssessParameters = AssessParameters()
    report: ReportParameters = ReportParameters()
    study: StudyParameters = StudyParameters()


def load_parameters(path: Path | str) -> Parameters:
    """Read and check ``params.yaml``; what it leaves out has its default.

    Raises
    ------
    ParameterError
        If the file is missing or not YAML, or with all unknown keys, wrong types and values out of
        range at once, each with the path of its field.
    """
    path = Path(path)
    return parse_parameters(_read_yaml(path), str(path))


def parse_parameters(values: Mapping[str, Any], origin: str = "parameters") -> Parameters:
    """Check a mapping of sections; ``origin`` names it in errors."""
    try:
        return Parameters.model_validate(dict(values))
    except ValidationError as error:
        lines = [
            f"  {'.'.join(str(part) for part in problem['loc'])}: {problem['msg']} "
            f"(given: {problem['input']!r})"
            for problem in error.errors()
        ]
        raise ParameterError(f"{origin}: {len(lines)} problem(s):\n" + "\n".join(lines)) from error


def update_parameters(path: Path | str, changes: Mapping[str, Any]) -> tuple[str, ...]:
    """Change values of ``params.yaml`` in place, keeping its comments.

    Parameters
    ----------
    path
        The file.
    changes
        New values by dotted path, as ``{"reed.arsi_cut": 7.5}``.

    Returns
    -------
    tuple of str
        The sections (= stages) whose values really changed.

    Raises
    ------
    ParameterError
        If a key is unknown or a value out of range; the file is then left as it was.
    """
    path = Path(path)
    document = _read_yaml(path)
    before = parse_parameters(document, str(path))
    for dotted, value in changes.items():
        *parents, key = dotted.split(".")
        node = document
        for parent in parents:
            node = node.setdefault(parent, {})
        node[key] = list(value) if isinstance(value, tuple) else value
    after = parse_parameters(document, str(path))
    text = io.StringIO()
    _yaml().dump(document, text)
    part = path.with_name(path.name + ".part")
    part.write_text(text.getvalue(), encoding="utf-8")
    part.replace(path)
    return tuple(name for name in Parameters.model_fields if getattr(before, name) != getattr(after, name))


def render_parameters(parameters: Parameters) -> str:
    """``params.yaml`` as text, with unit, range and source of each value in a comment."""
    lines = [
        "# Every parameter of the chain. One section a stage; a comment gives",
        "# meaning [unit; range] (source). `dvc repro` reruns what depends on a changed value.",
    ]
    for name, field in Parameters.model_fields.items():
        value = getattr(parameters, name)
        lines.append("")
        if isinstance(value, BaseModel):
            fields = _render_section(value, indent=2)
            lines += [
                f"# {_first_line(type(value).__doc__)}",
                f"{name}:" if fields else f"{name}: {{}}",
                *fields,
            ]
        else:
            lines += [f"# {field.description}", f"{name}: {_scalar(value)}"]
    return "\n".join(lines) + "\n"


def _render_section(section: BaseModel, indent: int) -> list[str]:
    lines: list[str] = []
    pad = " " * indent
    for name, field in type(section).model_fields.items():
        value = getattr(section, name)
        if isinstance(value, BaseModel):
            lines += [f"{pad}# {_first_line(type(value).__doc__)}", f"{pad}{name}:"]
            lines += _render_section(value, indent + 2)
            continue
        extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        facts = "; ".join(part for part in (str(extra.get("unit", "-")), _range(field)) if part)
        lines.append(f"{pad}# {field.description} [{facts}] ({extra.get('source', '-')})")
        lines.append(f"{pad}{name}: {_scalar(value)}")
    return lines


def _range(field: Any) -> str:
    signs = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}
    found = [
        f"{sign} {getattr(item, key)}"
        for item in field.metadata
        for key, sign in signs.items()
        if getattr(item, key, None) is not None
    ]
    choices = re.findall(r"'([^']+)'", str(field.annotation)) if "Literal" in str(field.annotation) else []
    return ", ".join(found + ([" | ".join(choices)] if choices else []))


def _scalar(value: Any) -> str:
    text = io.StringIO()
    plain = list(value) if isinstance(value, tuple) else value
    yaml = YAML()
    yaml.default_flow_style = True
    yaml.width = 10_000
    yaml.dump({"v": plain}, text)
    return text.getvalue().strip()[len("{v: ") : -1]


def _first_line(text: str | None) -> str:
    return (text or "").strip().splitlines()[0]


def _read_yaml(path: Path) -> Any:
    try:
        document = _yaml().load(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ParameterError(f"{path}: no such file. Write one with `python -m workbench.params`.") from error
    except (YAMLError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: not valid YAML ({error}).") from error
    if document is None:
        return {}
    if not isinstance(document, dict):
        raise ParameterError(f"{path}: must hold sections of parameters, not {type(document).__name__}.")
    return document


class _Representer(RoundTripRepresenter):
    """Writes null as null, as :func:`render_parameters` does; ruamel leaves the place empty."""


_Representer.add_representer(
    type(None), lambda representer, _: representer.represent_scalar("tag:yaml.org,2002:null", "null")
)


def _yaml() -> YAML:
    yaml = YAML()
    yaml.Representer = _Representer
    yaml.preserve_quotes = True
    yaml.width = 10_000
    return yaml
