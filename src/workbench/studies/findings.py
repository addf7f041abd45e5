"""The findings of the three papers, each with the rule that decides whether our studies confirm it.

The rules (what is measured, and the threshold) stand in ``findings_reed``, ``findings_trees`` and
``findings_ortho``. They were written, and committed, before any study had been run.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats

from workbench.errors import StudyError

PAPERS = {"reed": "Aquatic reed", "tree": "Single trees", "ortho": "Orthomosaics"}
"""Short name of a paper in the table of findings -> title."""
TABLE = Path("data") / "studies" / "findings.csv"
"""Verdicts below a root, as `workbench study findings` writes them."""

Verdict = Literal["confirmed", "not confirmed", "not testable"]
Relation = Literal[">", ">=", "<", "<="]
CONFIDENCE = 0.95
"""Of the intervals over seeds."""


class NotTestable(StudyError):
    """The evidence that a rule needs is not there."""


@dataclass(frozen=True, eq=False)
class Criterion:
    """One number of a rule, and where its threshold lies."""

    what: str
    """In words."""
    values: ArrayLike
    """One per seed."""
    relation: Relation
    """How the mean must lie to the threshold."""
    threshold: float
    """Fixed before the studies ran."""
    unit: str = ""
    """Of values and threshold."""

    @property
    def mean(self) -> float:
        """Over the seeds that have a value; NaN without any."""
        known = self._known
        return float(known.mean()) if known.size else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Student's interval of the mean over seeds; NaN with fewer than two."""
        known = self._known
        if known.size < 2:
            return float("nan"), float("nan")
        reach = stats.t.ppf((1 + CONFIDENCE) / 2, known.size - 1) * stats.sem(known)
        return self.mean - float(reach), self.mean + float(reach)

    @property
    def holds(self) -> bool:
        """Whether the mean lies as it must; a mean that is unknown does not."""
        mean = self.mean
        return {
            ">": mean > self.threshold,
            ">=": mean >= self.threshold,
            "<": mean < self.threshold,
            "<=": mean <= self.threshold,
        }[self.relation]

    @property
    def is_sure(self) -> bool:
        """Whether the interval does not hold the threshold."""
        low, high = self.interval
        return bool(low > self.threshold or high < self.threshold)

    def __str__(self) -> str:
        low, high = self.interval
        around = "" if np.isnan(low) else f" [{low:.3g}, {high:.3g}]"
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.what}: {self.mean:.3g}{around}{unit} (rule {self.relation} {self.threshold:g})"

    @property
    def _known(self) -> np.ndarray:
        values = np.asarray(self.values, dtype=float)
        return values[np.isfinite(values)]


@dataclass(frozen=True)
class Rule:
    """How one finding is decided."""

    number: str
    """As in ``data/published/findings.csv``."""
    text: str
    """The rule in words, with its threshold."""
    published: str
    """The published numbers that it is about."""
    decide: Callable[[Evidence], Iterable[Criterion]]
    """The criteria; the finding is confirmed if all of them hold."""


@dataclass(frozen=True, eq=False)
class Finding:
    """A finding with our verdict."""

    number: str
    """R01 .. O10."""
    source: str
    """reed, tree or ortho."""
    finding: str
    """What the paper found."""
    rule: Rule
    """What decides."""
    criteria: tuple[Criterion, ...]
    """Our numbers; empty where nothing could be measured."""
    verdict: Verdict
    """Confirmed if every criterion holds."""
    why: str
    """Why it could not be tested, or which criteria do not hold; empty if confirmed."""

    @property
    def is_sure(self) -> bool:
        """Whether no interval holds its threshold."""
        return bool(self.criteria) and all(criterion.is_sure for criterion in self.criteria)


class Evidence:
    """Tables of the studies below a root, and the published ones.

    Of a study the full table goes before that of its quick preset.

    Parameters
    ----------
    root
        Folder that holds ``data/``.
    """

    def __init__(self, root: Path = Path()) -> None:
        self.root = Path(root)
        self.used: list[str] = []
        """Folders of the studies that were asked, in order."""
        self.table = cache(self._table)

    def values(self, study: str, response: str, **levels: Any) -> pd.Series:
        """Values of a response by seed, in the cell of the given levels.

        Levels are compared as text, with ``__`` for a dot in the name of a factor
        (``match__across=True``); lists are written ``"1 2 3"``, null is None.

        Raises
        ------
        NotTestable
            If the study has not been run, or has no such cell or response.
        """
        table = self.table(study)
        chosen = table[table["response"] == response]
        for factor, level in levels.items():
            column = chosen[factor.replace("__", ".")]
            if level is None:
                chosen = chosen[column.isna()]
            else:
                chosen = chosen[column.map(_text) == _text(level)]
        if chosen.empty:
            raise NotTestable(f"study {study} has no {response} at {levels}: the cell failed or was left out")
        return chosen.groupby("seed")["value"].mean()

    def levels(self, study: str, factor: str) -> list[Any]:
        """Levels of a factor that a study has run."""
        return list(self.table(study)[factor].dropna().unique())

    def published(self, name: str) -> pd.DataFrame:
        """A published table, ``data/published/<name>.csv``."""
        return pd.read_csv(self.root / "data" / "published" / f"{name}.csv")

    def design(self, study: str) -> dict[str, Any]:
        """``design.json`` of a study."""
        return json.loads((self._folder(study) / "design.json").read_text(encoding="utf-8"))

    def _table(self, study: str) -> pd.DataFrame:
        return pd.read_csv(self._folder(study) / "table.csv", low_memory=False)

    def _folder(self, study: str) -> Path:
        for name in (study, f"{study}-quick"):
            folder = self.root / "data" / "studies" / name
            if (folder / "table.csv").exists():
                if name not in self.used:
                    self.used.append(name)
                return folder
        raise NotTestable(f"study {study} has not been run: `workbench study {study} --quick`")


def judge_findings(root: Path = Path()) -> tuple[Finding, ...]:
    """Judge every finding of ``data/published/findings.csv`` by the studies that have been run.

    Raises
    ------
    StudyError
        If a row has no rule.
    """
    rules = all_rules()
    evidence = Evidence(root)
    rows = evidence.published("findings")
    without = sorted(set(rows["id"]) - set(rules))
    if without:
        raise StudyError(
            f"Findings {', '.join(without)} have no rule: add one to workbench.studies.findings_*."
        )
    return tuple(_judge(row, rules[str(row.id)], evidence) for row in rows.itertuples())


def all_rules() -> dict[str, Rule]:
    """Rule of every finding, by its number."""
    from workbench.studies import findings_ortho, findings_reed, findings_trees

    rules = [*findings_reed.RULES, *findings_trees.RULES, *findings_ortho.RULES]
    return {rule.number: rule for rule in rules}


def findings_table(findings: Iterable[Finding]) -> pd.DataFrame:
    """One row a finding: id, source, finding, published, rule, ours, verdict, sure, why."""
    rows = [
        {
            "id": f.number,
            "source": f.source,
            "finding": f.finding,
            "published": f.rule.published,
            "rule": f.rule.text,
            "ours": "; ".join(map(str, f.criteria)),
            "verdict": f.verdict,
            "sure": f.is_sure,
            "why": f.why,
        }
        for f in findings
    ]
    return pd.DataFrame(rows)


def rule(
    number: str, text: str, published: str
) -> Callable[[Callable[[Evidence], Iterable[Criterion]]], Rule]:
    """Make a rule of a function that yields its criteria."""

    def of(decide: Callable[[Evidence], Iterable[Criterion]]) -> Rule:
        return Rule(number, text, published, decide)

    return of


def _judge(row: Any, own: Rule, evidence: Evidence) -> Finding:
    try:
        criteria = tuple(own.decide(evidence))
    except NotTestable as reason:
        return Finding(str(row.id), row.source, row.finding, own, (), "not testable", str(reason))
    unknown = [c.what for c in criteria if np.isnan(c.mean)]
    if unknown:
        why = "no value for " + "; ".join(unknown)
        return Finding(str(row.id), row.source, row.finding, own, criteria, "not testable", why)
    failing = [c.what for c in criteria if not c.holds]
    verdict: Verdict = "not confirmed" if failing else "confirmed"
    return Finding(str(row.id), row.source, row.finding, own, criteria, verdict, "; ".join(failing))


def _text(level: Any) -> str:
    """A level as text: 60 and 60.0 are one, and so are True and "True"."""
    if isinstance(level, bool | np.bool_):
        return str(bool(level))
    try:
        return f"{float(level):g}"
    except (TypeError, ValueError):
        return str(level)
