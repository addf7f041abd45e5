"""The parts of a report: what each is made of, and how numbers are written."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from matplotlib.figure import Figure

_DPI = 110


@dataclass(frozen=True)
class Table:
    """A small table of text; the first column names the row."""

    rows: Sequence[Sequence[str]]
    """Cells, already written as text."""
    header: Sequence[str] = ()
    """Names of the columns; none for a list of facts."""


@dataclass(frozen=True)
class Picture:
    """A figure with its caption."""

    png: str
    """PNG, base64."""
    caption: str
    """One or two sentences: what is shown and how to read it."""

    @classmethod
    def of(cls, figure: Figure, caption: str) -> Picture:
        """Render a figure."""
        data = io.BytesIO()
        # Without metadata the same figure gives the same bytes.
        figure.savefig(data, format="png", dpi=_DPI, metadata={"Software": None})
        return cls(base64.b64encode(data.getvalue()).decode(), caption)


@dataclass(frozen=True)
class Block:
    """A foldable text, such as a parameter file."""

    title: str
    """What unfolds."""
    text: str
    """Monospaced text."""


@dataclass(frozen=True)
class Section:
    """A chapter of the report."""

    title: str
    """Heading."""
    text: str = ""
    """A paragraph in front."""
    tables: Sequence[Table] = ()
    """Tables, first."""
    pictures: Sequence[Picture] = ()
    """Figures, after the tables."""
    blocks: Sequence[Block] = field(default_factory=tuple)
    """Foldable texts, at the end."""


def facts(values: Mapping[str, Any], labels: Mapping[str, str]) -> Table:
    """Table of the labelled values that are there, in the order of the labels."""
    return Table([(label, written(values[key])) for key, label in labels.items() if key in values])


def written(value: Any) -> str:
    """A value as a reader wants it: four significant digits, lists joined, None as a dash."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e5 else f"{value:,.0f}"
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {written(item)}" for key, item in value.items())
    if isinstance(value, Iterable):
        return ", ".join(written(item) for item in value)
    return str(value)
