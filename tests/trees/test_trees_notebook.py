"""Notebook 08 on a root without any products."""

import pytest


@pytest.mark.slow
def test_the_notebook_runs_from_a_clean_clone(execute_notebook, tmp_path):
    notebook = execute_notebook("08_trees", tmp_path)
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 2
    assert any("has no surface yet" in output.get("text", "") for output in outputs)
