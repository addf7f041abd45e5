"""The panel: what a slider changes, what the button writes, and how fast a browser shows it."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import panel as pn
import pytest
from scipy.ndimage import gaussian_filter
from tree_shapes import cones, raster, tops_at

from workbench.errors import TreesError
from workbench.figures.tree_pictures import COLOURS
from workbench.figures.trees import _TreePanel, tree_panel
from workbench.params import AssessParameters, Parameters, TreesParameters, load_parameters, render_parameters
from workbench.trees import TreeInputs


def hectare(size=100.0, cell=0.15, count=260, seed=0):
    """A stand with rough crowns, its indices, its orthophoto and its trees."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(3, size - 3, (count, 2))
    trees = [(x, y, rng.uniform(10, 25), rng.uniform(1.5, 3.0)) for x, y in places]
    smooth = cones(trees, size, cell)
    rough = gaussian_filter(rng.normal(size=smooth.shape).astype(np.float32), 2) * 6
    height = raster(np.maximum(smooth.values + np.where(smooth.values > 0, rough, 0), 0), cell)
    green = smooth.values > 0
    gli = raster(np.where(green, 0.15, -0.05).astype(np.float32) + rough / 10, cell)
    bands = np.stack([np.where(green, 60, 140), np.where(green, 110, 130), np.where(green, 40, 120)])
    ortho = (
        raster(np.zeros(green.shape), cell)
        .expand_dims(band=3)
        .copy(data=(bands + 5 * rough).astype(np.uint8))
    )
    layers = {"gli": gli, "brightness": raster(bands.mean(axis=0).astype(np.float32) + 10 * rough, cell)}
    return TreeInputs(height, layers), ortho.rio.write_crs(height.rio.crs), tops_at(trees)


@pytest.fixture(scope="module")
def stand():
    return hectare(40.0, 0.2, 60)


def panel_of(stand, **options):
    inputs, ortho, trees = stand
    return _TreePanel(inputs, ortho, {"mapped": trees}, TreesParameters(**options), AssessParameters(), None)


def test_map_scores_and_profile_say_the_same(stand):
    panel = panel_of(stand)
    words = panel.sources["points"].data["judged"].tolist()
    assert set(words) <= set(COLOURS)
    assert (
        f"<td>{words.count('found')}</td><td>{words.count('missed')}</td><td>{words.count('false')}</td>"
        in (panel.scores.object)
    )
    assert words.count("found") + words.count("missed") == len(stand[2])
    assert f"<b>{words.count('found') + words.count('false')} tops</b>" in panel.scores.object
    lines = panel.sources["lines"].data
    middle = len(lines["distance"]) // 2
    assert lines["west_east"][middle] == pytest.approx(
        np.nanmax(panel.sources["points"].data["height"]), abs=0.5
    )
    assert lines["smooth_west_east"][middle] < lines["west_east"][middle]


def test_a_slider_changes_the_tops_and_only_what_depends_on_it(stand):
    panel = panel_of(stand, max_slope=60.0)
    tops = panel.model.search(TreesParameters(max_slope=60.0))
    before = len(panel.sources["points"].data["x"])
    panel.sliders["max_slope"].value = 30.0
    panel.update()
    assert panel.model.search(TreesParameters()) is tops
    panel.sliders["min_height"].value = 18.0
    panel.update()
    assert "false" not in panel.sources["points"].data["judged"] or before
    heights = panel.sources["points"].data["height"][panel.sources["points"].data["judged"] != "missed"]
    assert heights.min() >= 18.0


def test_a_click_shows_the_nearest_tree(stand):
    panel = panel_of(stand)
    points = panel.sources["points"].data
    event = type("Tap", (), {"x": points["x"][3] + 0.1, "y": points["y"][3]})()
    panel._tapped(event)
    assert panel.sources["place"].data["x"] == [points["x"][3]]


def test_impossible_values_are_told_and_the_last_picture_stays(stand):
    panel = panel_of(stand, radius=1.0)
    before = panel.sources["points"].data
    panel.sliders["working_resolution"].value = 1.0
    panel.sliders["radius"].value = 0.2
    panel.update()
    assert panel.message.visible
    assert "less than one cell" in panel.message.object
    assert panel.sources["points"].data is before


def test_values_go_to_the_parameters_file(stand, tmp_path):
    file = tmp_path / "params.yaml"
    file.write_text(render_parameters(Parameters()), encoding="utf-8")
    panel = panel_of(stand)
    panel.window.value = "constant"
    panel.sliders["radius"].value = 1.8
    panel.switches["max_slope"].value = True
    inputs, ortho, trees = stand
    view = tree_panel(inputs, ortho=ortho, references={"mapped": trees}, parameters_file=file)
    button = next(iter(view.select(pn.widgets.Button)))
    button.clicks += 1
    assert load_parameters(file).trees == TreesParameters()
    chosen = TreesParameters(**panel.chosen_options())
    assert (chosen.radius, chosen.max_slope, chosen.spacing) == (1.8, 60.0, None)
    assert set(panel.values()) == {f"trees.{name}" for name in panel.chosen_options()}


def test_a_part_of_the_area_and_no_references(stand):
    inputs, ortho, _ = stand
    view = tree_panel(inputs, area=(5.0, 5.0, 25.0, 25.0), ortho=ortho)
    assert any("No reference trees" in str(pane.object) for pane in view.select(pn.pane.HTML))
    with pytest.raises(TreesError, match="holds nothing"):
        tree_panel(inputs, area=(500.0, 5.0, 525.0, 25.0))


def test_a_stand_without_trees_is_a_picture_too(stand):
    inputs, _, trees = stand
    bare = TreeInputs(inputs.height * 0 + 1.0)
    bare = TreeInputs(bare.height.rio.write_crs(inputs.height.rio.crs))
    panel = _TreePanel(bare, None, {"mapped": trees}, TreesParameters(), AssessParameters(), None)
    assert set(panel.sources["points"].data["judged"]) == {"missed"}
    empty = gpd.GeoDataFrame({"height_m": []}, geometry=[], crs=trees.crs)
    panel = _TreePanel(bare, None, {"mapped": empty}, TreesParameters(), AssessParameters(), None)
    assert len(panel.sources["points"].data["x"]) == 0


# Slider, canvas that it changes, and the key (see tests/conftest.py).
RIGHT = ("ArrowRight",)
MOVES = {
    "growth": (3, 0, RIGHT),
    "minimum height": (4, 0, RIGHT),
    "filter size": (10, 2, RIGHT),
    "slope": (12, 0, RIGHT),
    "GLI": (15, 0, RIGHT),
}


@pytest.mark.slow
@pytest.mark.browser
def test_a_change_is_on_the_screen_within_0_3_seconds(screen_times):
    inputs, ortho, trees = hectare()
    options = TreesParameters(max_slope=70.0, min_gli=0.1)
    times = screen_times(
        lambda: tree_panel(inputs, ortho=ortho, references={"mapped": trees}, options=options),
        MOVES,
        (1150, 1450),
    )
    assert {name: seconds for name, seconds in times.items() if seconds > 0.3} == {}
