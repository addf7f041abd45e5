"""Notebooks 03 and 04 and their panels, on the embedded example."""

import numpy as np
import pytest

from workbench.errors import SurfaceError
from workbench.figures.smoothing_panel import draw_smoothing, highest_row, smoothing_panel
from workbench.figures.surface_panel import draw_layer
from workbench.rasters import Grid, new_raster
from workbench.surface import bilateral


@pytest.mark.slow
@pytest.mark.parametrize(("name", "tables"), [("03_surface_quality", 4), ("04_smoothing", 1)])
def test_the_notebook_runs_on_the_example(execute_notebook, lake_root, name, tables):
    notebook = execute_notebook(name, lake_root)
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    shown = [output.get("data", {}).get("text/html", "") for output in outputs]
    assert sum("<table" in text for text in shown) >= tables


def crown():
    """A round crown of 12 m on level ground, with noise and a hole."""
    grid = Grid.from_bounds("EPSG:32633", (0, 0, 40, 30), 0.25)
    x, y = np.meshgrid(grid.x - 20, grid.y - 15)
    noise = np.random.default_rng(1).normal(size=grid.shape) * 0.4
    heights = np.where(np.hypot(x, y) < 4, 12 - 0.2 * np.hypot(x, y) ** 2 + noise, 0.0).astype(np.float32)
    heights[5:9, 5:9] = np.nan
    return new_raster(heights, grid, name="ndsm", units="m", vertical_datum="height above terrain")


def test_the_profile_runs_through_the_top_and_edges_stay():
    surface = crown()
    row = highest_row(surface)
    assert abs(row - 60) < 12
    smooth = bilateral(surface, 13, 2.0)
    drawn = draw_smoothing(surface, smooth, row)
    before, after = (line.get_ydata() for line in drawn.axes[1].lines)
    assert np.std(np.diff(after[74:86])) < 0.5 * np.std(np.diff(before[74:86]))
    assert np.nanmax(np.abs(after[:60])) < 0.05  # the ground beside the crown does not rise
    assert smoothing_panel(surface) is not None


def test_a_surface_without_heights_cannot_be_smoothed():
    surface = crown()
    with pytest.raises(SurfaceError, match="nothing to smooth"):
        highest_row(surface.copy(data=np.full(surface.shape, np.nan, np.float32)))


def test_an_unknown_layer_is_refused(tmp_path):
    with pytest.raises(SurfaceError, match="choose one of"):
        draw_layer(tmp_path, "colour")
