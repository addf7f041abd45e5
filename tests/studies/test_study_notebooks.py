"""Notebooks 09 and 10 run on the tables that come with the repository."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("root")
    shutil.copytree(REPOSITORY / "data" / "published", folder / "data" / "published")
    wanted = shutil.ignore_patterns("steps", "cells", "*.parquet")
    shutil.copytree(REPOSITORY / "data" / "studies", folder / "data" / "studies", ignore=wanted)
    return folder


def outputs(notebook):
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


@pytest.mark.slow
def test_sweeps_are_drawn_from_the_tables(root, execute_notebook):
    shown = outputs(execute_notebook("09_sweeps", root))
    assert sum("image/png" in output.get("data", {}) for output in shown) >= 5
    assert not any(output.output_type == "error" for output in shown)


@pytest.mark.slow
def test_findings_are_led_through_paper_by_paper(root, execute_notebook):
    shown = outputs(execute_notebook("10_findings", root))
    text = "".join(str(output.get("data", {}).get("text/html", "")) for output in shown)
    assert all(number in text for number in ("R01", "T25", "O10"))
    assert "not confirmed" in text
