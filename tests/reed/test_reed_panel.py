"""The panel: what a slider computes and shows, what the button writes, and how fast a browser shows it."""

from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
import yaml
from rasterio.crs import CRS
from scipy.ndimage import gaussian_filter

from workbench.errors import ReedError
from workbench.figures.controls import stages_to_rerun, write_button
from workbench.figures.reed import _ReedPanel, reed_panel
from workbench.params import Parameters, ReedParameters, load_parameters, render_parameters
from workbench.rasters import Grid, new_raster
from workbench.reed import ReedModel, References
from workbench.stages import FOLDERS

CRS_ = CRS.from_epsg(32633)
LEVEL, SHORE = 517.93, 25.0
ROOT = Path(__file__).parents[2]


def shore_line(length, width=80.0, resolution=0.136):
    """A belt of reed along a shore of this length (m), with islets, gaps in the surface, and references."""
    rng = np.random.default_rng(1)
    grid = Grid(CRS_, 316000.0, 5303000.0, resolution, round(length / resolution), round(width / resolution))
    from_shore = (np.arange(grid.height) * resolution - SHORE)[:, None]
    front = 14 + gaussian_filter(rng.normal(size=grid.width), 20) * 20
    texture = gaussian_filter(rng.standard_normal(grid.shape, dtype=np.float32), 1.5) * 2
    reed = (from_shore > -2) & (from_shore < front)
    for x in np.arange(15, length, 30):
        reed |= np.hypot(np.arange(grid.width) * resolution - x, from_shore - 20) < 1.5
    heights = LEVEL + np.where(reed, 2.5 - 0.06 * from_shore + texture, 0.1 * texture)
    heights[texture > 0.95] = np.nan
    dsm = new_raster(heights.astype(np.float32), grid, name="dsm", units="m", vertical_datum="DHHN2016")
    bands = np.stack([np.where(reed, *pair) + 10 * texture for pair in ((90, 60), (120, 80), (60, 110))])
    ortho = new_raster(bands.clip(1, 255).astype(np.uint8), grid, name="ortho", units="1")
    west, south, east, north = grid.bounds
    lake = gpd.GeoSeries([shapely.box(west, south, east, north - SHORE)], crs=CRS_)
    half = (west + east) / 2
    areas = gpd.GeoDataFrame(
        {"aoi": ["A", "B"]},
        geometry=[shapely.box(west, south, half, north), shapely.box(half, south, east, north)],
        crs=CRS_,
    )
    x, y = (c.ravel() for c in np.meshgrid(np.arange(west + 5, east, 10), north - SHORE - np.arange(1.0, 25)))
    stands = (north - SHORE - y) < 14
    points = pd.DataFrame(
        {
            "aoi": np.where(x < half, "A", "B"),
            "transect": ((x - west) // 10).astype(int).astype(str),
            "point": "1",
            "x": x,
            "y": y,
            "stem_height_m": np.where(stands, 3.0, np.nan),
            "water_depth_m": 0.6,
        }
    )
    model = ReedModel(dsm, LEVEL, lake, areas=areas)
    return model, ortho, References(points=points)


@pytest.fixture(scope="module")
def hundred():
    return shore_line(100.0)


@pytest.fixture
def panel(hundred):
    model, ortho, references = hundred
    return _ReedPanel(ReedModel(model.dsm, LEVEL, model.shoreline), ortho, references, ReedParameters(), None)


def move(panel, name, value):
    before = {key: source.data for key, source in panel.sources.items()}
    panel.sliders[name].value = value
    panel.update()
    return {key for key, source in panel.sources.items() if source.data is not before[key]}


@pytest.mark.parametrize(
    ("slider", "value", "changed"),
    [
        ("arsi_cut", 6.0, {"boxes"}),
        ("variance_cut", 0.3, {"density", "boxes"}),
        ("mean_cut", 2.0, {"density", "boxes"}),
        ("cell_size", 2.0, {"density", "boxes"}),
        ("min_height", 1.0, {"extent", "density", "lines", "closed", "boxes"}),
        ("max_height", 3.0, {"extent", "density", "lines", "closed", "boxes"}),
        ("water_level", LEVEL + 0.2, {"extent", "density", "lines", "closed", "boxes"}),
    ],
)
def test_a_slider_sends_only_the_layers_that_depend_on_it(panel, slider, value, changed):
    assert move(panel, slider, value) == changed


def test_scores_follow_the_sliders(panel):
    before = panel.scores.object
    assert "extent</b>" in before
    assert "RMSE" in before
    move(panel, "min_height", 2.2)
    assert panel.scores.object != before
    move(panel, "min_height", 0.5)
    assert panel.scores.object == before


def test_heights_shift_their_colours_with_the_water(panel):
    move(panel, "water_level", LEVEL + 0.25)
    assert (panel.mapper.low, panel.mapper.high) == pytest.approx((0.25, 5.25))


def test_impossible_values_are_said_and_the_pictures_stay(panel):
    assert move(panel, "max_height", 0.3) == set()
    assert panel.message.visible
    assert "min_height" in panel.message.object
    assert move(panel, "max_height", 6.0) == set()
    assert not panel.message.visible


def test_one_area_is_cut_out_and_an_unknown_one_refused(hundred):
    model, ortho, references = hundred
    view = reed_panel(model, area="A", ortho=ortho, references=references)
    assert len(view) == 2
    with pytest.raises(ReedError, match="the areas are A, B"):
        reed_panel(model, area="C")


def test_the_button_writes_the_values_and_names_the_stages(hundred, tmp_path):
    file = tmp_path / "params.yaml"
    file.write_text(render_parameters(Parameters()), encoding="utf-8")
    model, ortho, references = hundred
    made = _ReedPanel(model, ortho, references, ReedParameters(), file)
    button = write_button(file, made.values)
    made.sliders["arsi_cut"].value = 6.5
    button[0].clicks += 1
    assert load_parameters(file).reed == ReedParameters(arsi_cut=6.5)
    assert "**reed, report**" in button[1].object
    button[0].clicks += 1
    assert button[1].object == "Nothing changed."
    made.sliders["water_level"].value = 518.0
    button[0].clicks += 1
    assert load_parameters(file).reed.water_level == 518.0
    file.unlink()
    button[0].clicks += 1
    assert "Not written" in button[1].object


def test_the_stages_named_are_those_that_dvc_would_run():
    """The graph of dvc.yaml, followed from every stage whose parameters changed."""
    stages = yaml.safe_load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]
    made = {
        name: [str(out) if isinstance(out, str) else next(iter(out)) for out in stage.get("outs", [])]
        for name, stage in stages.items()
    }
    made = {
        name: [out.replace("${item.scene}", "${item.site}") for out in outs] for name, outs in made.items()
    }

    def uses(stage, other):
        needed = [str(dep) for dep in stages[stage].get("deps", [])]
        needed += [next(iter(p)) for p in stages[stage].get("params", []) if isinstance(p, dict)]
        return any(dep == out or dep.startswith(f"{out}/") for dep in needed for out in made[other])

    for section in set(stages) & set(FOLDERS):
        again = {
            name
            for name, stage in stages.items()
            if any(str(p).split(".")[0] == section for p in stage.get("params", []) if isinstance(p, str))
        }
        while more := {s for s in stages if s not in again and any(uses(s, other) for other in again)}:
            again |= more
        assert set(stages_to_rerun((section,))) == again & set(FOLDERS), section


# Slider, canvas that it changes, and keys in turn (see tests/conftest.py).
MOVES = {
    "water level": (0, 4, ("ArrowRight",)),
    "minimum height": (1, 4, ("ArrowRight",)),
    "variance": (3, 6, ("ArrowRight",)),
    "aRSI cut": (5, 8, ("Home", "End")),
    "cell": (6, 6, ("ArrowRight",)),
}


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize(("length", "limit"), [(100.0, 0.3), (1000.0, 1.0)])
def test_a_change_is_on_the_screen_in_time(length, limit, screen_times):
    model, ortho, references = shore_line(length)
    times = screen_times(lambda: reed_panel(model, ortho=ortho, references=references), MOVES, (1640, 1250))
    assert {name: seconds for name, seconds in times.items() if seconds > limit} == {}
