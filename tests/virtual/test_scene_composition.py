"""Compositions of virtual scenes: what is shipped, what is refused, what is built."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from workbench.errors import SceneError
from workbench.rasters import Grid
from workbench.virtual.composition import SceneSpec
from workbench.virtual.scene import build_scene, load_scene, scene_names
from workbench.virtual.trees3d import grow_tree
from workbench.virtual.truth import scene_truth
from workbench.virtual.world import Cover

_SMALL = {
    "name": "small",
    "seed": 1,
    "crs": "EPSG:25832",
    "vertical_datum": "DHHN2016",
    "origin": (600000.0, 5300000.0),
    "size": (40.0, 30.0),
    "terrain": {"base": 101.0, "relief": 0.2},
}
_LAKE = {"level": 100.0, "outline": [(-20, 15), (70, 15), (70, 80), (-20, 80)]}


def test_six_scenes_are_shipped_and_valid():
    assert scene_names() == ["baruth", "chiemsee14", "habichtswald", "lake", "meadow", "park"]
    for name in scene_names():
        assert load_scene(name).name == name
    reed = load_scene("chiemsee14").reed
    lengths = [belt.along[1] - belt.along[0] for belt in reed]
    assert len(reed) == 14 and sorted(lengths) == [70] + [100] * 13
    assert reed[6].aoi == "7" and lengths[6] == 70


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: a\nsize: [1, 2]\n", "terrain"),
        ("[1, 2", "not a scene"),
        ("just text", "not a scene"),
        ("name: a\nunknown_key: 1\n", "unknown_key"),
    ],
)
def test_wrong_compositions_name_file_and_field(tmp_path, text, message):
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    with pytest.raises(SceneError, match=message) as error:
        load_scene(path)
    assert "wrong.yaml" in str(error.value)


def test_unknown_scene_lists_the_known_ones():
    with pytest.raises(SceneError, match="habichtswald"):
        load_scene("atlantis")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stands": [{"area": [(0, 0), (9, 0), (9, 9)], "species_group": "palm"}]}, "palm"),
        ({"single_trees": [{"number": 2, "species_group": "palm"}]}, "palm"),
        (
            {"stands": [{"area": [(0, 0), (9, 9), (9, 0), (0, 9)], "species_group": "conifer"}]},
            "crosses itself",
        ),
        ({"reed": [{"along": (0, 10)}]}, "no lake"),
        ({"lake": _LAKE, "reed": [{"along": (20, 40)}, {"along": (30, 50)}]}, "overlap"),
        ({"lake": _LAKE, "reed": [{"along": (900, 950)}]}, "not in the scene"),
        ({"crs": "EPSG:4326"}, "not projected"),
        ({"size": (90000.0, 90000.0)}, "nodes"),
        ({"size": (3.0, 3.0)}, "too small"),
        ({"targets": [{"name": "A", "x": 99, "y": 2}]}, "outside"),
        ({"targets": [{"name": "A", "x": 9, "y": 2}, {"name": "A", "x": 5, "y": 2}]}, "name of its own"),
        ({"buildings": [{"x": 9, "y": 9, "eaves": 5.0, "ridge": 4.0}]}, "ridge"),
        ({"lake": {**_LAKE, "outline": [(0, 0), (9, 9), (9, 0), (0, 9)]}}, "crosses itself"),
        ({"lake": {**_LAKE, "level": 130.0}}, "lake level is 130 m, the land along its outline 101"),
        ({"lake": {**_LAKE, "level": 60.0}}, "choose a level from 96.* to 102"),
    ],
)
def test_impossible_scenes_are_refused(change, message):
    with pytest.raises(SceneError, match=message):
        build_scene(SceneSpec(**{**_SMALL, **change}))


@pytest.mark.parametrize(
    "change",
    [
        {"lake": {**_LAKE, "deepest": -2.0}},
        {"lake": _LAKE, "reed": [{"along": (0, 9), "deepest": -1.0}]},
        {"lake": _LAKE, "reed": [{"along": (0, 9), "fray": 1.5}]},
        {"terrain": {"base": 100.0, "relief": -1.0}},
        {"seed": -1},
    ],
)
def test_values_out_of_range_are_refused(change):
    with pytest.raises(ValueError, match=r"greater than|less than"):
        SceneSpec(**{**_SMALL, **change})


def test_impossible_trees_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(SceneError, match="unknown"):
        grow_tree("fern", 5, 2, rng)
    with pytest.raises(SceneError, match="positive"):
        grow_tree("conifer", 0, 2, rng)


@pytest.fixture(scope="module")
def shore():
    stand = {"area": [(2, 1), (38, 1), (38, 9), (2, 9)], "species_group": "broadleaf", "age": "middle"}
    reed = {"along": (24, 56), "width": 7.0, "fray": 0.6, "islets": 2, "holes": 2}
    return build_scene(
        SceneSpec(**{**_SMALL, "lake": _LAKE, "reed": [reed], "stands": [{**stand, "understorey": 900}]})
    )


def test_scene_is_a_value(shore):
    again = build_scene(shore.spec)
    every = np.arange(len(shore.trees))
    np.testing.assert_array_equal(again.grove.plants(every).clumps, shore.grove.plants(every).clumps)
    np.testing.assert_array_equal(again.reed.fields.density, shore.reed.fields.density)
    other = build_scene(shore.spec.model_copy(update={"seed": 2}))
    assert not np.array_equal(other.world.terrain.height, shore.world.terrain.height)


def test_trees_stand_on_land_and_know_whether_they_are_seen(shore):
    trees = shore.trees
    assert list(trees.tree_id) == list(range(1, len(trees) + 1))
    assert np.allclose(trees.ground_z, shore.ground_z(trees.x, trees.y), atol=1e-3)
    assert (trees.ground_z > shore.water_level).all()
    assert np.allclose(trees.top_z - trees.ground_z, trees.height_m)
    canopy = trees[~trees.understorey]
    assert canopy.visible.mean() > 0.8
    assert trees[trees.understorey].visible.mean() < canopy.visible.mean()
    assert trees.dbh_m.between(0.005, 1.2).all()
    assert trees.geometry.is_valid.all()


def test_truth_of_trees_and_reed_agrees_with_tables(shore):
    grid = Grid.from_bounds(shore.crs, shore.extent, 0.5)
    truth = scene_truth(shore, grid)
    wet = (truth.dtm.values < shore.water_level) & (truth.cover.values == Cover.WATER)
    assert np.abs(truth.dsm.values[wet & (truth.stem_density.values == 0)] - shore.water_level).min() < 1e-3
    reed = shore.reed.extent.geometry.union_all()
    x, y = np.meshgrid(grid.x, grid.y)
    inside = shapely.contains_xy(reed.buffer(-1.0), x, y)
    assert (truth.cover.values[inside] == Cover.REED).mean() > 0.9
    height = truth.dsm.values[inside] - np.maximum(truth.dtm.values[inside], shore.water_level)
    # A cell shows the tallest of its stems, whose spread is 9 %; their mean is lower, and leaves lower still.
    ratio = height / truth.stem_height.values[inside]
    assert 1.0 < np.median(ratio) < 1.3
    mean = truth.dsm_mean.values[inside] - np.maximum(truth.dtm.values[inside], shore.water_level)
    assert 0.6 < np.median(mean / truth.stem_height.values[inside]) < np.median(ratio)
    seen = shore.trees[shore.trees.visible & ~shore.trees.dead & ~shore.trees.understorey].set_index(
        "tree_id"
    )
    misses = [
        truth.dsm.values[truth.tree_id.values == tree_id].max() - row.top_z
        for tree_id, row in seen.iterrows()
    ]
    # A top may hide below the branch of a neighbour, but never stands above its height.
    assert np.median(np.abs(misses)) < 0.3
    assert max(misses) < 0.05


def test_front_runs_along_the_water_side(shore):
    front = shore.reed.front.geometry.iloc[0]
    assert 20 < front.length < 90
    beyond = shore.shoreline.buffer(0.6)
    assert front.intersection(beyond).length > 0.9 * front.length
    assert len(shore.reed.islets) >= 1 and len(shore.reed.holes) >= 1
    for islet in shore.reed.islets.geometry:
        assert not islet.intersects(front.buffer(0.1)) or islet.area < 30
