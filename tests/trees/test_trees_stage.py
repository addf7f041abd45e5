"""The trees and assess stages on a site whose trees are known: with all layers, with few, without trees."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from rasterio.crs import CRS as RasterCRS
from shapely.geometry import Polygon, box
from tree_shapes import CRS, cones

from workbench.assessment import assess_site
from workbench.errors import TreesError
from workbench.params import Parameters
from workbench.rasters import Grid, new_raster, read_raster, write_raster
from workbench.site import Site
from workbench.trees import TreeModel, read_tree_inputs, trees_site
from workbench.vectors import read_vector

TREES = [
    (x + 0.3 * (i % 2), y, 8.0 + (7 * i + j) % 13, 2.2)
    for i, x in enumerate(np.arange(5, 40, 6.0))
    for j, y in enumerate(np.arange(5, 40, 6.0))
]
SIZE, CELL = 42.0, 0.2
PARAMETERS = Parameters()


def layer(values, name, units="1"):
    like = cones([], SIZE, CELL)
    return new_raster(values, Grid.of(like), name=name, units=units)


@pytest.fixture
def site(tmp_path):
    """A surface with cones on a slope, an orthophoto that is green where they stand."""
    made = Site("plot", tmp_path, RasterCRS.from_user_input(CRS), "local", ())
    made.folder.mkdir(parents=True)
    height = cones(TREES, SIZE, CELL)
    green = height.values > 0
    bands = np.stack([np.where(green, 40, 120), np.where(green, 90, 120), np.where(green, 30, 120)])
    rasters = {
        "surface/ndsm.tif": layer(height.values, "ndsm", "m"),
        "surface/spread.tif": layer(np.full(green.shape, 0.2, np.float32), "spread", "m"),
        "surface/provenance.tif": layer(np.ones(green.shape, np.uint8), "provenance"),
        "mosaic/ortho.tif": layer(bands.astype(np.uint8), "ortho"),
        "mosaic/gli.tif": layer(np.where(green, 0.4, 0.0).astype(np.float32), "gli"),
    }
    for name, values in rasters.items():
        path = made.products / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_raster(values, path)
    return made


def site_with(site, shoreline):
    return Site(site.name, site.root, site.crs, "local", (), shoreline=shoreline)


def test_the_stage_finds_every_tree_and_writes_the_products_of_the_contract(site):
    metrics = trees_site(site, PARAMETERS)
    assert metrics["trees"] == len(TREES) == metrics["crowns"]
    assert metrics["indices"] == ["gli"]
    tops = read_vector(site.products / "trees/trees.gpkg", layer="tops")
    crowns = read_vector(site.products / "trees/trees.gpkg", layer="crowns")
    assert {"tree_id", "height_m", "height_sd_m", "stand_type"} <= set(tops.columns)
    assert {"tree_id", "area_m2", "diameter_m", "gli_mean", "brightness_mean"} <= set(crowns.columns)
    # Spread of the pairs and deviation of the terrain together.
    np.testing.assert_allclose(tops["height_sd_m"], np.hypot(0.2, PARAMETERS.trees.height_sd), rtol=1e-6)
    assert crowns["gli_mean"].min() > 0.35
    # A crown ends where the cone falls below 3 m, or a fifth of its height.
    height = crowns.merge(tops, on="tree_id")["height_m"]
    expected = 2 * 2.2 * np.minimum((1 - 3 / height) / 0.8, 1)
    np.testing.assert_allclose(crowns["diameter_m"], expected, atol=0.3)
    assert read_raster(site.products / "trees/mask.tif").dtype == np.uint8
    assert len(pd.read_csv(site.products / "trees/stands.csv")) == 1
    first = (site.products / "trees/mask.tif").read_bytes()
    trees_site(site, PARAMETERS)
    assert (site.products / "trees/mask.tif").read_bytes() == first


def test_stands_give_their_trees_parameters_and_rows_of_their_own(site):
    stands = gpd.GeoDataFrame(
        {"stand_type": ["conifer", "broadleaf"]},
        geometry=[box(0, 0, 20, SIZE), box(20, 0, SIZE, SIZE)],
        crs=CRS,
    )
    stands.to_file(site.folder / "stands.gpkg")
    trees_site(site, Parameters(trees={"conifer_diameter": 2.0}))
    tops = read_vector(site.products / "trees/trees.gpkg", layer="tops")
    crowns = read_vector(site.products / "trees/trees.gpkg", layer="crowns").merge(tops, on="tree_id")
    assert set(tops["stand_type"]) == {"conifer", "broadleaf"}
    assert crowns[crowns["stand_type"] == "conifer"]["diameter_m"].max() < 2.3
    assert crowns[crowns["stand_type"] == "broadleaf"]["diameter_m"].min() > 3.3
    table = pd.read_csv(site.products / "trees/stands.csv").set_index("stand")
    assert table["stems"].sum() == len(TREES)


def test_what_stands_in_the_lake_is_no_tree(site):
    lake = site.folder / "shoreline.gpkg"
    gpd.GeoDataFrame(geometry=[box(-1, -1, 20, SIZE + 1)], crs=CRS).to_file(lake)
    metrics = trees_site(site_with(site, lake), PARAMETERS)
    tops = read_vector(site.products / "trees/trees.gpkg", layer="tops")
    assert tops.geometry.x.min() > 20
    assert metrics["trees"] == sum(x > 20 for x, *_ in TREES)
    assert metrics["warnings"] == []


def test_low_tops_on_the_shore_may_be_reed(site):
    lake = site.folder / "shoreline.gpkg"
    gpd.GeoDataFrame(geometry=[box(-1, -1, 8, SIZE + 1)], crs=CRS).to_file(lake)
    height = read_raster(site.products / "surface/ndsm.tif")
    # The eastern trees are as low as reed; some of them stand too far from the lake to be it.
    low = height.copy(data=np.where(height.x.values > 14, 0.25, 1.0).astype(np.float32) * height.values)
    write_raster(low, site.products / "surface/ndsm.tif")
    metrics = trees_site(site_with(site, lake), PARAMETERS)
    tops = read_vector(site.products / "trees/trees.gpkg", layer="tops")
    near = (tops["height_m"] <= 6.0) & (tops.geometry.x <= 8 + 25)
    assert 0 < near.sum() < len(tops)
    assert [int(warning.split()[0]) for warning in metrics["warnings"]] == [near.sum()]


def test_an_index_that_is_not_there_is_asked_for(site):
    with pytest.raises(TreesError, match="ndvi"):
        trees_site(site, Parameters(trees={"mask_index": "ndvi"}))
    assert trees_site(site, Parameters(trees={"mask_index": "none"}))["trees"] == len(TREES)


def test_without_terrain_the_surroundings_are_the_ground(site):
    ndsm = site.products / "surface/ndsm.tif"
    height = read_raster(ndsm)
    ndsm.unlink()
    write_raster(layer(height.values + 300, "dsm", "m"), site.products / "surface/dsm.tif")
    metrics = trees_site(site, PARAMETERS)
    assert metrics["ground"] == "lowest surroundings"
    assert metrics["trees"] == len(TREES)
    (site.products / "surface/dsm.tif").unlink()
    with pytest.raises(TreesError, match="workbench surface"):
        trees_site(site, PARAMETERS)


def test_a_site_without_trees_has_empty_layers(site):
    write_raster(layer(np.zeros((210, 210), np.float32), "ndsm", "m"), site.products / "surface/ndsm.tif")
    metrics = trees_site(site, PARAMETERS)
    assert metrics["trees"] == 0
    assert metrics["height_mean_m"] is None
    assert len(read_vector(site.products / "trees/trees.gpkg", layer="tops")) == 0


def truth_of(site, missing=3):
    """True trees of a virtual site; the last ones are not on the surface."""
    folder = site.folder / "truth"
    folder.mkdir()
    rows = [*TREES, *[(3.0 + 6 * k, 8.0, 9.0, 2.0) for k in range(missing)]]
    x, y, height, radius = np.array(rows).T
    corners = np.linspace(0, 2 * np.pi, 33)
    shapes = [
        Polygon(np.c_[a + r * np.cos(corners), b + r * np.sin(corners)])
        for a, b, r in zip(x, y, radius, strict=True)
    ]
    gpd.GeoDataFrame(
        {
            "tree_id": np.arange(len(rows)) + 1,
            "top_x": x,
            "top_y": y,
            "height_m": height,
            "visible": np.arange(len(rows)) < len(TREES) + 1,
        },
        geometry=shapes,
        crs=CRS,
    ).to_file(folder / "trees.gpkg")
    green = read_raster(site.products / "surface/ndsm.tif").values > 0
    write_raster(layer(np.where(green, 2, 1).astype(np.uint8), "cover"), folder / "cover.tif")
    (folder / "cover.csv").write_text("code,cover\n1,meadow\n2,conifer\n", encoding="utf-8")


def test_the_assess_stage_counts_found_missed_and_false(site):
    trees_site(site, PARAMETERS)
    truth_of(site)
    metrics = assess_site(site, PARAMETERS)
    assert metrics["compared"] == ["tree_mask", "tops", "crowns"]
    assert metrics["tops"]["true"]["missed"] == 3
    assert metrics["tops"]["visible"]["missed"] == 1
    assert metrics["tops"]["visible"]["false"] == 0
    assert metrics["crowns"]["completeness"] == pytest.approx(len(TREES) / (len(TREES) + 1))
    # The mask leaves out the rim of the crowns below 3 m, and nothing else.
    matrix = np.array(metrics["tree_mask"]["counts"])
    assert matrix[0, 1] == 0
    assert metrics["tree_mask"]["kappa"] > 0.7
    layers = read_vector(site.products / "assessment/trees.gpkg", layer="missed")
    assert len(layers) == 3
    scores = pd.read_csv(site.products / "assessment/scores.csv")
    assert set(scores["product"]) == {"tree_mask", "tops", "crowns"}


def test_a_site_without_references_says_so(site):
    trees_site(site, PARAMETERS)
    assert assess_site(site, PARAMETERS)["compared"] == []


def test_surveyed_trees_outside_or_twice_are_set_aside(site):
    trees_site(site, PARAMETERS)
    table = site.folder / "stems.csv"
    lines = ["x,y,dbh_m,species_group", *[f"{x},{y},0.3,conifer" for x, y, *_ in TREES]]
    lines += [lines[1], "38,2,0.05,conifer"]
    table.write_text("\n".join(lines), encoding="utf-8")
    surveyed = Site(site.name, site.root, site.crs, "local", (), reference_trees=table)
    scores = assess_site(surveyed, PARAMETERS)["tops"]["surveyed"]
    assert (scores["found"], scores["missed"], scores["false"]) == (len(TREES), 0, 0)


def test_a_moved_limit_computes_only_what_depends_on_it(site):
    options = PARAMETERS.trees
    model = TreeModel(read_tree_inputs(site, options))
    search, labels = model.search(options), model.labels(options)
    assert model.search(options.model_copy(update={"max_slope": 50.0})) is search
    assert model.labels(options) is labels
    assert model.search(options.model_copy(update={"radius": 1.0})) is not search
