"""The findings as a page: verdicts paper by paper, and published tables beside ours."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pandas as pd

from workbench.site.files import write_text
from workbench.studies.advice import unmatched_lines
from workbench.studies.findings import PAPERS, TABLE, Finding, findings_table, judge_findings
from workbench.studies.findings_notes import NOTES
from workbench.studies.side_by_side import SideBySide, side_by_side, side_by_side_table

_HEAD = """# Findings of the three papers, tested again

Made by `workbench study findings`; do not edit. Each finding has a rule, written and committed before any
study had run (`src/workbench/studies/findings_*.py`). It is confirmed if every criterion holds for the mean
over seeds. In brackets: 95 % intervals over seeds (Student); *sure* means that none holds its threshold. The
studies are the quick presets unless a full one has been run: see [studies](studies.md).
"""


def write_findings(root: Path = Path()) -> Path:
    """Judge all findings; write ``data/studies/findings.csv``, and ``docs/findings.md`` where there are docs.

    Beside the findings, ``side_by_side.csv`` holds every cell of a published table with our mean.

    Returns
    -------
    Path
        Of the table.
    """
    root = Path(root)
    findings = judge_findings(root)
    path = root / TABLE
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(findings_table(findings).to_csv(index=False, lineterminator="\n"), path)
    tables = side_by_side(root)
    cells = side_by_side_table(tables).to_csv(index=False, lineterminator="\n", float_format="%.5g")
    write_text(cells, path.with_name("side_by_side.csv"))
    if (root / "docs").is_dir():
        write_text(findings_page(findings, tables, root), root / "docs" / "findings.md")
    return path


def findings_page(findings: Iterable[Finding], tables: Iterable[SideBySide], root: Path) -> str:
    """The page as Markdown."""
    findings = tuple(findings)
    parts = [_HEAD, _summary(findings)]
    for source, title in PAPERS.items():
        parts.append(f"## {title}\n")
        parts += [_entry(finding) for finding in findings if finding.source == source]
    parts += ["## Published tables beside ours\n", _tables(tables), _collapse(root)]
    return "\n".join(parts)


def _summary(findings: tuple[Finding, ...]) -> str:
    table = findings_table(findings)
    counts = table.groupby(["source", "verdict"]).size().unstack(fill_value=0)
    lines = ["| paper | " + " | ".join(counts.columns) + " |", "|---" * (len(counts.columns) + 1) + "|"]
    lines += [
        f"| {PAPERS[source]} | " + " | ".join(map(str, row)) + " |" for source, *row in counts.itertuples()
    ]
    return "\n".join(lines) + "\n"


def _entry(finding: Finding) -> str:
    sure = " (sure)" if finding.is_sure else ""
    lines = [
        f"### {finding.number}: {finding.verdict}{sure}",
        "",
        finding.finding + ".",
        "",
        f"- Rule: {finding.rule.text}.",
        f"- Published: {finding.rule.published}.",
    ]
    lines += [
        f"- Ours: {criterion}{'' if criterion.holds else ' **fails**'}" for criterion in finding.criteria
    ]
    if finding.verdict == "not testable":
        lines.append(f"- Why: {finding.why}.")
    if finding.number in NOTES:
        lines.append(f"- {NOTES[finding.number]}")
    return "\n".join(lines) + "\n"


def _tables(tables: Iterable[SideBySide]) -> str:
    rows = [(t.table, t.study, len(t.cells), f"{t.rho:.2f}", f"{t.p:.2g}") for t in tables]
    frame = pd.DataFrame(rows, columns=["table", "study", "cells", "rank correlation", "p"])
    lines = ["| " + " | ".join(frame.columns) + " |", "|---" * len(frame.columns) + "|"]
    lines += ["| " + " | ".join(map(str, row)) + " |" for row in frame.itertuples(index=False)]
    lines += ["", "Every cell of them: `data/studies/side_by_side.csv`."]
    return "\n".join(lines) + "\n"


def _collapse(root: Path) -> str:
    lines = [
        "## One variable for angle and resolution\n",
        "Our own finding: the logit of the unmatched share over the logarithm of the disparity in pixels per",
        "metre of height. It holds if the line explains 90 % of the variance and no ground resolution lies",
        "farther than half a logit from it on average.\n",
        "| flights | slope | R2 | offset by ground resolution (logits) | holds |",
        "|---|---|---|---|---|",
    ]
    for name, line in unmatched_lines(root).items():
        offsets = ", ".join(f"{gsd:g} cm {value:+.2f}" for gsd, value in line.offsets.items())
        lines.append(
            f"| {name} | {line.slope:.2f} | {line.r2:.3f} | {offsets} | {'yes' if line.holds else 'no'} |"
        )
    if "collapse" in NOTES:
        lines += ["", NOTES["collapse"]]
    return "\n".join(lines) + "\n"
