"""Reference trees: leaning stems, diameters, tables as people save them."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import pytest

from workbench.assessment import extrapolate_tops, read_reference_trees, thick_enough
from workbench.errors import AssessmentError, SiteError
from workbench.rasters import Grid, new_raster

CRS = "EPSG:32633"


def surface(height=130.0):
    grid = Grid.from_bounds(CRS, (0, 0, 100, 100), 0.5)
    return new_raster(np.full(grid.shape, height, np.float32), grid, name="dsm", units="m")


def stems(**columns):
    x, y = columns["x1"], columns["y1"]
    return gpd.GeoDataFrame(columns, geometry=gpd.points_from_xy(x, y), crs=CRS)


def test_a_leaning_stem_ends_where_its_line_meets_the_surface():
    trees = stems(x1=[50.0], y1=[50.0], z1=[101.0], x2=[50.2], y2=[49.9], z2=[105.0])
    top = extrapolate_tops(trees, surface())
    a = (130 - 101) / (105 - 101)
    assert top.geometry.x[0] == pytest.approx(50 + a * 0.2)
    assert top.geometry.y[0] == pytest.approx(50 - a * 0.1)


def test_the_height_is_that_at_the_end_of_the_stem():
    heights = surface()
    # The stem stands under a cell of 120 m and leans under one of 130 m.
    heights[:, :102] = 120.0
    trees = stems(x1=[50.0], y1=[50.0], z1=[100.0], x2=[50.5], y2=[50.0], z2=[105.0])
    assert extrapolate_tops(trees, heights).geometry.x[0] == pytest.approx(50 + 30 / 5 * 0.5)


def test_stems_without_a_surface_or_a_second_point_stay():
    trees = stems(
        x1=[50.0, 20.0, 500.0],
        y1=[50.0] * 3,
        z1=[100.0] * 3,
        x2=[np.nan, 20.5, 501.0],
        y2=[50.0] * 3,
        z2=[105.0] * 3,
    )
    heights = surface()
    heights[:, :60] = np.nan
    top = extrapolate_tops(trees, heights)
    assert top.geometry.x.tolist() == [50.0, 20.0, 500.0]
    assert extrapolate_tops(trees[["geometry"]], heights).geometry.equals(trees.geometry)


def test_thin_stems_are_no_reference():
    trees = stems(x1=[0.0] * 5, y1=[0.0] * 5)
    trees["species_group"] = ["broadleaf", "broadleaf", "conifer", "conifer", "other"]
    trees["dbh_m"] = [0.24, 0.25, 0.19, 0.20, np.nan]
    assert thick_enough(trees)["dbh_m"].tolist()[:2] == [0.25, 0.20]
    assert len(thick_enough(trees)) == 3


@pytest.mark.parametrize(
    "text", ["x,y,species\n10.5,20.25,Picea\n11,21,Fagus\n", "x;y;species\n10,5;20,25;Picea\n11;21;Fagus\n"]
)
def test_tables_with_point_or_comma(tmp_path, text):
    path = tmp_path / "trees.csv"
    path.write_text(text, encoding="utf-8-sig")
    trees = read_reference_trees(path, CRS)
    assert [(p.x, p.y) for p in trees.geometry] == [(10.5, 20.25), (11, 21)]
    assert trees.species.tolist() == ["Picea", "Fagus"]


def test_bad_tables_are_named(tmp_path):
    path = tmp_path / "trees.csv"
    path.write_text("east,north\n1,2\n")
    with pytest.raises(AssessmentError, match="x and y"):
        read_reference_trees(path, CRS)
    path.write_text("x,y\n1,2\n,3\n")
    with pytest.raises(SiteError, match="line 3"):
        read_reference_trees(path, CRS)
    with pytest.raises(SiteError, match="no such file"):
        read_reference_trees(tmp_path / "absent.csv", CRS)
