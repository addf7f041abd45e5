"""Findings: every row has a rule, rules are decided by numbers alone, missing evidence is no verdict."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from workbench.errors import StudyError
from workbench.figures.findings_section import findings_section
from workbench.studies.findings import (
    Criterion,
    Evidence,
    NotTestable,
    all_rules,
    findings_table,
    judge_findings,
)
from workbench.studies.findings_page import write_findings

PUBLISHED = Path(__file__).parents[2] / "data" / "published"


@pytest.fixture
def root(tmp_path):
    shutil.copytree(PUBLISHED, tmp_path / "data" / "published")
    return tmp_path


def put(root, study, rows, columns):
    folder = root / "data" / "studies" / study
    folder.mkdir(parents=True)
    table = pd.DataFrame(rows, columns=[*columns, "seed", "response", "value"]).assign(unit="%")
    table.to_csv(folder / "table.csv", index=False)


def table_4_01(root, factor=1.0):
    """A study that gives the published table, times a factor, at both seeds."""
    published = pd.read_csv(PUBLISHED / "tree_table4_01_unmatched_gsd.csv")
    angles = {90: 2.65, 80: 5.3, 70: 7.9, 60: 10.5}
    thin = {90: 1, 80: 2, 70: 3, 60: 4}
    rows = []
    for row in published.to_dict("records"):
        for seed in (1, 2):
            start = [row["gsd_cm"], thin[row["overlap_pct"]], seed]
            rows.append([*start, "count_0_area", factor * row["count_zero_pct"]])
            rows.append([*start, "angle", angles[row["overlap_pct"]]])
    put(root, "angle-gsd-quick", rows, ["gsd_cm", "thin"])


def test_every_published_finding_has_a_rule():
    rows = pd.read_csv(PUBLISHED / "findings.csv")
    assert len(rows) == 45
    assert set(rows["id"]) == set(all_rules())
    assert all(rule.text and rule.published for rule in all_rules().values())


def test_without_studies_only_the_formula_is_judged(root):
    verdicts = {f.number: f for f in judge_findings(root)}
    assert verdicts["T01"].verdict == "confirmed"
    others = [f for number, f in verdicts.items() if number != "T01"]
    assert {f.verdict for f in others} == {"not testable"}
    assert "workbench study angle-gsd --quick" in verdicts["T02"].why


def test_the_published_table_confirms_what_was_found_in_it(root):
    table_4_01(root)
    verdicts = {f.number: f.verdict for f in judge_findings(root)}
    assert [verdicts[number] for number in ("T02", "T03", "T04")] == ["confirmed"] * 3


def test_a_reversed_table_confirms_nothing(root):
    table_4_01(root, factor=-1.0)
    verdicts = {f.number: f for f in judge_findings(root)}
    assert [verdicts[number].verdict for number in ("T02", "T03", "T04")] == ["not confirmed"] * 3
    assert "60 %, 9 minus 15 cm" in verdicts["T03"].why


def test_criteria_are_decided_by_the_mean_and_sure_by_the_interval():
    values = np.array([1.0, 3.0])
    criterion = Criterion("x", values, ">", 1.5)
    assert criterion.holds
    # Two values 2 apart: standard error 1, t(0.975, 1) = 12.706.
    assert criterion.interval == pytest.approx((2 - 12.706, 2 + 12.706), abs=1e-3)
    assert not criterion.is_sure
    assert Criterion("x", np.array([2.0, 2.001]), ">", 1.5).is_sure
    assert not Criterion("x", np.array([2.0]), ">", 1.5).is_sure
    assert not Criterion("x", np.array([np.nan]), "<", 1.5).holds


def test_levels_are_found_whatever_they_are_written_as(root):
    rows = [
        ["1 2 3", "", True, 1, "y", 1.0],
        ["1", 60.0, False, 1, "y", 2.0],
    ]
    put(root, "s", rows, ["match.downscales", "trees.max_slope", "match.across"])
    evidence = Evidence(root)
    assert evidence.values("s", "y", match__downscales="1 2 3").tolist() == [1.0]
    assert evidence.values("s", "y", trees__max_slope=None).tolist() == [1.0]
    assert evidence.values("s", "y", trees__max_slope=60, match__across=False).tolist() == [2.0]
    with pytest.raises(NotTestable, match="left out"):
        evidence.values("s", "y", match__downscales="2")


def test_the_full_study_goes_before_its_quick_preset(root):
    put(root, "s-quick", [[1, 1, "y", 1.0]], ["thin"])
    put(root, "s", [[1, 1, "y", 2.0]], ["thin"])
    assert Evidence(root).values("s", "y", thin=1).tolist() == [2.0]


def test_a_finding_without_rule_is_an_error(root):
    path = root / "data" / "published" / "findings.csv"
    path.write_text(path.read_text() + "X01,reed,something new,look\n")
    with pytest.raises(StudyError, match="X01 have no rule"):
        judge_findings(root)


def test_the_table_holds_rule_numbers_and_reason(root):
    table_4_01(root)
    (root / "docs").mkdir()
    table = pd.read_csv(write_findings(root)).set_index("id")
    page = (root / "docs" / "findings.md").read_text()
    assert "### T02: confirmed" in page
    assert "| thesis 4.1 | angle-gsd | 12 | 1.00 |" in page
    assert len(table) == 45
    assert "rule > 0.8" in table["ours"]["T02"]
    assert table["published"]["T05"].startswith("Table 4.2")
    assert table.reset_index().equals(findings_table(judge_findings(root)).replace("", np.nan))


def test_the_report_shows_every_finding_with_its_verdict_or_its_reason(root):
    assert findings_section(root) is None
    table_4_01(root)
    write_findings(root)
    section = findings_section(root)
    rows = [row for table in section.tables for row in table.rows]
    assert len(rows) == 45 and len(section.pictures) == 1
    shown = {row[0]: row for row in rows}
    assert shown["T01"][-1].startswith("confirmed")
    assert shown["R01"][-1] == "not testable" and "has not been run" in shown["R01"][3]
    cells = pd.read_csv(root / "data" / "studies" / "side_by_side.csv")
    assert set(cells["table"]) == {"thesis 4.1"} and len(cells) == 12
    np.testing.assert_allclose(cells["published"], cells["simulated"], rtol=1e-4)


def test_lights_are_compared_within_one_preset(root):
    def repetitions(site, forest):
        folder = root / "data" / "studies" / "reproducibility" / site
        folder.mkdir(parents=True)
        errors = "seed,check_rms_xy_m,check_rms_z_m\n1,0.01,0.02\n"
        (folder / "errors.csv").write_text(errors)
        (folder / "reproducibility.csv").write_text(f"surface,cover,pixels,share\ndsm,forest,9,{forest}\n")

    for site, forest in (("low_sun", 0.9), ("low_sun-quick", 0.2), ("cloudy-quick", 0.3)):
        repetitions(site, forest)
    (criterion,) = all_rules()["O10"].decide(Evidence(root))
    assert criterion.mean == pytest.approx(10.0)
    repetitions("cloudy", 0.8)
    (criterion,) = all_rules()["O10"].decide(Evidence(root))
    assert criterion.mean == pytest.approx(-10.0)
