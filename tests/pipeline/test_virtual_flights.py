"""Notebook 02: a scene, two flights over it, sliders."""

import pytest


@pytest.mark.slow
def test_notebook_of_virtual_flights_runs_and_shows_pictures(tmp_path, execute_notebook):
    notebook = execute_notebook("02_virtual_flights", tmp_path)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 2
    assert not [output for output in outputs if output.output_type == "error"]
