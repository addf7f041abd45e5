"""Thresholds found again where they are known, and findings on tables whose numbers are known."""

from types import SimpleNamespace

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from rasterio.crs import CRS

from workbench.errors import ReedError
from workbench.params import ReedParameters
from workbench.rasters import Grid, new_raster
from workbench.reed import ReedModel, References, agreements, of_areas, tune_thresholds
from workbench.reed.findings import (
    coverage_finding,
    depth_findings,
    front_finding,
    height_findings,
    matrix_findings,
    motion_finding,
)

CRS_ = CRS.from_epsg(32633)
WEST, SOUTH = 400000.0, 5300000.0


TRIED = {"min_heights": (0.3, 0.5, 0.7, 0.9, 1.2), "variance_cuts": (0.05, 0.1, 0.3), "mean_cuts": (1.0, 2.5)}


@pytest.fixture(scope="module")
def lake():
    """Reed of 2 m (x < 50) and rough reed of 1.5 m on average (x > 50); 0.8 m of weed in front of it."""
    grid = Grid(CRS_, WEST, SOUTH + 50, 0.2, 500, 250)
    x, y = np.meshgrid(grid.x - WEST, grid.y - SOUTH)
    rough = 1.5 + 0.4 * np.where((np.floor(x / 0.4) + np.floor(y / 0.4)) % 2 == 0, 1, -1)
    frayed = (x > 50) & (np.abs(x % 4 - 2) < 1) & (y > 16)
    reed = (y < 20) & ~frayed
    heights = np.where(reed, np.where(x < 50, 2.0, rough), np.where(y < 25, 0.8, 0.0))
    dsm = new_raster(heights.astype(np.float32), grid, name="dsm", units="m", vertical_datum="gauge")
    water = gpd.GeoSeries([shapely.box(WEST, SOUTH + 5, WEST + 100, SOUTH + 50)], crs=CRS_)
    lines = [shapely.LineString([(WEST + u, SOUTH + 32), (WEST + u, SOUTH + 5)]) for u in range(5, 96, 10)]
    transects = gpd.GeoDataFrame(
        {"aoi": ["A"] * 5 + ["B"] * 5, "transect": [*range(1, 6)] * 2}, geometry=lines, crs=CRS_
    )
    model = ReedModel(dsm, 0.0, water, transects=transects)
    px, py = (c.ravel() for c in np.meshgrid(np.arange(7.5, 97, 10.0), np.arange(38, 5, -2.0)))
    points = pd.DataFrame(
        {"aoi": np.where(px < 50, "A", "B"), "transect": (px // 10).astype(int).astype(str)}
    )
    stands = (py < 16) | ((py < 20) & ((px < 50) | (np.abs(px % 4 - 2) > 1)))
    points = points.assign(
        point="1",
        x=px + WEST,
        y=py + SOUTH,
        stem_height_m=np.where(stands, 3.0, np.nan),
        water_depth_m=py / 20,
    )
    plots = pd.DataFrame({"aoi": ["A"] * 4 + ["B"] * 4, "transect": "1", "plot": [str(i) for i in range(8)]})
    px = np.array([10.5, 20.5, 30.5, 40.5, 60.5, 70.5, 80.5, 90.5])
    plots = plots.assign(
        x=WEST + px, y=SOUTH + 10.5, stems_per_m2=np.nan, density=["dense"] * 4 + ["sparse"] * 4
    )
    status = pd.DataFrame(
        {
            "aoi": ["A"] * 4 + ["B"] * 4,
            "section": [1, 2, 3, 4] * 2,
            "status": ["healthy"] * 4 + ["stressed"] * 4,
        }
    )
    return model, References(points, plots, status)


def test_thresholds_are_found_and_hold(lake):
    model, references = lake
    untuned = agreements(model.measure(ReedParameters(arsi_cut=30)), references)
    found = tune_thresholds(model, references, ReedParameters(arsi_cut=30), **TRIED)
    assert found.min_height == 0.9
    assert found.variance_cut < 0.16
    tuned = agreements(model.measure(found), references)
    for name in ("extent", "density", "status"):
        assert tuned[name].matrix.overall_accuracy == 1.0, name
    assert untuned["extent"].matrix.overall_accuracy < 0.9
    assert untuned["status"].matrix.overall_accuracy == 0.5


def test_what_is_right_already_stays(lake):
    model, references = lake
    good = tune_thresholds(model, references, **TRIED)
    assert tune_thresholds(model, References(references.points, references.plots), good, **TRIED) == good
    only = tune_thresholds(model, References(status=references.status), ReedParameters(min_height=0.9))
    assert only.min_height == 0.9
    assert only.variance_cut == ReedParameters().variance_cut
    with pytest.raises(ReedError, match="no reference"):
        tune_thresholds(model, References())


def test_few_stressed_sections_weigh_as_much_as_many_healthy_ones():
    """Healthy at 4 to 6, 8 and 9, stressed at 7 and 12: 10.5 is right more often, 6.5 finds both."""
    index = [4.0, 4.2, 4.5, 5.0, 5.5, 5.8, 6.0, 8.0, 9.0, 7.0, 12.0]
    said = ["healthy"] * 9 + ["stressed"] * 2
    sections = pd.DataFrame({"aoi": "A", "section": range(11), "arsi": index})
    model = SimpleNamespace(measure=lambda options: SimpleNamespace(sections=sections))
    found = tune_thresholds(model, References(status=sections.assign(status=said)))
    assert found.arsi_cut == pytest.approx(6.5)


def test_areas_are_kept_apart(lake):
    _, references = lake
    part = of_areas(references, ["B"])
    assert {*part.points.aoi, *part.plots.aoi, *part.status.aoi} == {"B"}
    assert of_areas(References(), ["B"]).points is None


def test_findings_on_numbers_that_are_known(lake):
    model, references = lake
    field = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 3.5])
    table = pd.DataFrame({"aoi": ["A", "B"] * 3, "field_m": field, "surface_m": 0.5 * field + 1.0})
    table["water_depth_m"] = 2 - field / 2
    heights = height_findings(table)
    assert (heights["slope"], heights["intercept_m"]) == pytest.approx((0.5, 1.0))
    assert heights["bias_of_lower_half_m"] == pytest.approx(0.25)
    assert heights["bias_of_taller_half_m"] == pytest.approx(-0.5)
    assert heights["rmse_of_best_area_m"] <= heights["rmse_m"] <= heights["rmse_of_worst_area_m"]
    metrics = model.measure()
    depth = depth_findings(table, metrics, references)
    assert (depth["depth_to_height_field"], depth["depth_to_height_surface"]) == pytest.approx((-1, -1))
    matrix = matrix_findings(agreements(metrics, references))
    assert matrix["extent_producer_aquatic reed"] == 1.0
    assert motion_finding({"A": 0.4, "B": 0.6, "C": 0.9}, {"A": 1, "B": 2, "C": 3}) == pytest.approx(1)
    # Two areas have no rank correlation.
    assert np.isnan(front_finding(metrics, {"A": 0.1, "B": 0.9}))
    covered = coverage_finding(metrics, table)
    assert (covered["lake_known"], covered["points_known"]) == (1, 1)
