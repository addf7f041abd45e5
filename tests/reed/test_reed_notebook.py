"""The notebook runs on the products of the embedded example."""

import pytest


@pytest.mark.slow
def test_notebook_07_shows_scores_and_the_panel(execute_notebook, lake_root):
    notebook = execute_notebook("07_reed", lake_root)
    shown = [
        output.get("data", {}).get("text/plain", "")
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
    ]
    text = "\n".join(shown)
    assert "declining" in text
    assert "kappa" in text
    assert "FloatSlider" in text
