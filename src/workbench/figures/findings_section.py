"""Findings of the papers in the report: what the studies below the same root say of each."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from workbench.figures.sections import Picture, Section, Table
from workbench.figures.study_figures import draw_verdicts
from workbench.studies.findings import PAPERS, TABLE


def findings_section(root: Path) -> Section | None:
    """Verdicts of all findings, paper by paper; None where no findings have been judged.

    Parameters
    ----------
    root
        Folder that holds ``data/``.
    """
    path = root / TABLE
    if not path.exists():
        return None
    findings = pd.read_csv(path, keep_default_na=False)
    findings["sure"] = findings["sure"].astype(str) == "True"
    counts = findings["verdict"].value_counts()
    text = (
        "The findings of the three papers, tested with virtual flights; they do not depend on this site. Of "
        f"{len(findings)} findings {counts.get('confirmed', 0)} are confirmed, "
        f"{counts.get('not confirmed', 0)} are not, {counts.get('not testable', 0)} could not be tested. "
        "Each rule was written before the first study had run. In brackets: 95 % intervals over seeds. What "
        "the differences are likely to be stands in docs/findings.md."
    )
    tables = [
        Table(
            [_row(row) for row in findings[findings["source"] == source].to_dict("records")],
            ["", "finding", "published", "ours", "verdict"],
            title,
        )
        for source, title in PAPERS.items()
    ]
    caption = "Verdicts; pale where an interval over seeds holds the threshold of the rule."
    return Section("Findings", text, tables, [Picture.of(draw_verdicts(findings), caption, wide=True)])


def _row(row: dict) -> list[str]:
    verdict = row["verdict"] + (" (sure)" if row["sure"] else "")
    ours = row["ours"] if row["verdict"] != "not testable" else row["why"]
    return [row["id"], row["finding"], row["published"], ours, verdict]
