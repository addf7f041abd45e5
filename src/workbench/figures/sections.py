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
    title: str = ""
    """What the table shows."""


@dataclass(frozen=True)
class Picture:
    """A figure with its caption."""

    png: str
    """PNG, base64."""
    caption: str
    """One or two sentences: what is shown and how to read it."""
    wide: bool = False
    """Whether it takes the whole width of the page."""

    @classmethod
    def of(cls, figure: Figure, caption: str, *, wide: bool = False) -> Picture:
        """Render a figure."""
        data = io.BytesIO()
        # Without metadata the same figure gives the same bytes.
        figure.savefig(data, format="png", dpi=_DPI, bbox_inches="tight", metadata={"Software": None})
        return cls(base64.b64encode(data.getvalue()).decode(), caption, wide)


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


def facts(values: Mapping[str, Any], labels: Mapping[str, str], *, title: str = "") -> Table:
    """Table of the labelled values that are there, in the order of the labels."""
    rows = [(label, written(values[key])) for key, label in labels.items() if values.get(key) is not None]
    return Table(rows, title=title)


def matrix_table(scores: Mapping[str, Any], title: str, *, classes: Sequence[str] = ()) -> Table:
    """Error matrix as the papers print it: rows classified, columns reference, accuracies at the borders.

    Parameters
    ----------
    scores
        ``counts``, ``producer_accuracy``, ``user_accuracy``, ``overall_accuracy``, ``kappa`` and, unless
        given apart, ``classes``.
    """
    names = list(classes or scores["classes"])
    user, producer = scores["user_accuracy"], scores["producer_accuracy"]
    rows = [
        [name, *(f"{count:.0f}" for count in row), percent(user[name])]
        for name, row in zip(names, scores["counts"], strict=True)
    ]
    rows.append(["producer accuracy", *(percent(producer[name]) for name in names), ""])
    total = f"overall accuracy {percent(scores['overall_accuracy'])}, kappa {written(scores['kappa'])}"
    return Table(rows, ["classified / reference", *names, "user accuracy"], f"{title}: {total}.")


def percent(share: float | None) -> str:
    """A share 0..1 in per cent."""
    return "-" if share is None or math.isnan(share) else f"{100 * share:.1f} %"


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
