"""Heights at points, agreement with the field, and tables as people write them."""

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from rasterio.crs import CRS
from scipy import stats

from workbench.errors import ReedError, SiteError
from workbench.rasters import Grid, new_raster
from workbench.reed import (
    HeightAgreement,
    agreement_by_area,
    compare_heights,
    density_agreement,
    density_cells,
    extent_agreement,
    height_at_points,
    map_extent,
    read_field_points,
    read_plots,
    status_agreement,
)

CRS_ = CRS.from_epsg(32633)
ENGLISH = """aoi,transect,point,x,y,stem_height_m,water_depth_m,n_stems
A,1,1,2.5,17.5,,1.10,0
A,1,2,2.5,12.5,3.20,0.70,3
A,1,3,2.5,7.5,3.00,,2
B,1,1,12.5,17.5,,1.20,0
B,1,2,12.5,12.5,2.10,0.60,1
"""
GERMAN = ENGLISH.replace(",", ";").replace(".", ",")


def raster(values, resolution=1.0):
    values = np.asarray(values, dtype=np.float32)
    grid = Grid(CRS_, 0.0, 20.0, resolution, values.shape[1], values.shape[0])
    return new_raster(values, grid, name="ohm", units="m", vertical_datum="x")


@pytest.mark.parametrize("text", [ENGLISH, GERMAN, GERMAN.replace(";", "\t")])
def test_tables_with_points_and_commas_are_the_same(tmp_path, text):
    path = tmp_path / "field_points.csv"
    path.write_text(text, encoding="utf-8")
    table = read_field_points(path)
    assert table.stem_height_m.tolist()[1:3] == [3.2, 3.0]
    assert np.isnan(table.stem_height_m[0])
    assert np.isnan(table.water_depth_m[2])
    assert table.x.tolist() == [2.5, 2.5, 2.5, 12.5, 12.5]


def test_a_point_without_depth_is_left_out_and_counted(tmp_path):
    path = tmp_path / "field_points.csv"
    path.write_text(ENGLISH, encoding="utf-8")
    compared = compare_heights(raster(np.full((20, 20), 2.0)), read_field_points(path))
    table = agreement_by_area(compared).set_index("aoi")
    assert len(compared) == 3
    assert table.n.to_dict() == {"A": 1, "B": 1, "total": 2}
    assert table.bias["total"] == pytest.approx(((2 - 2.5) + (2 - 1.5)) / 2)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        (ENGLISH.replace("water_depth_m", "depth"), SiteError, "water_depth_m"),
        (ENGLISH.replace("3.20", "tall"), SiteError, "line 3"),
        (ENGLISH.replace("3.20", "-3.20"), ReedError, "point 2 in transect 1 of A"),
        (ENGLISH.replace("3.20", "").replace("3.00", "").replace("2.10", ""), ReedError, "no point has"),
    ],
)
def test_bad_field_tables_are_refused(tmp_path, text, error, message):
    path = tmp_path / "field_points.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(error, match=message):
        read_field_points(path)


def test_plots_need_stems_or_a_judgement(tmp_path):
    path = tmp_path / "plots.csv"
    path.write_text(
        "aoi;transect;plot;x;y;density\nA;1;1;2,5;3;sparse\nA;1;2;2,5;8;Dense\n", encoding="utf-8"
    )
    assert read_plots(path).density.tolist() == ["sparse", "dense"]
    path.write_text("aoi,transect,plot,x,y,density\nA,1,1,2.5,3,thin\n", encoding="utf-8")
    with pytest.raises(ReedError, match="'thin'"):
        read_plots(path)
    path.write_text("aoi,transect,plot,x,y\nA,1,1,2.5,3\n", encoding="utf-8")
    with pytest.raises(ReedError, match="neither"):
        read_plots(path)


def test_the_disc_is_exact_on_the_grid():
    values = np.zeros((20, 20))
    values[9, 9] = 5.0  # Centre at (9.5, 10.5).
    ohm = raster(values)
    assert height_at_points(ohm, 9.5, 10.5, radius=0.5)[0] == 5
    assert height_at_points(ohm, 10.0, 10.5, radius=0.5)[0] == 5  # On the border.
    assert height_at_points(ohm, 10.01, 10.5, radius=0.5)[0] == 0
    rng = np.random.default_rng(1)
    ohm = raster(rng.normal(size=(150, 150)), resolution=0.13)
    x, y = rng.uniform(1, 18, 40), rng.uniform(2, 19, 40)
    cells_x, cells_y = np.meshgrid(ohm.x, ohm.y)
    expected = [
        ohm.values[np.hypot(cells_x - a, cells_y - b) <= 0.5].max() for a, b in zip(x, y, strict=True)
    ]
    assert height_at_points(ohm, x, y) == pytest.approx(expected)


def test_points_on_unknown_ground_or_outside_have_no_height():
    values = np.full((20, 20), 2.0)
    values[:, 10:] = np.nan
    found = height_at_points(raster(values), [5.5, 15.5, 100.5], [5.5, 5.5, 5.5])
    assert found[0] == 2
    assert np.isnan(found[1:]).all()


def test_agreement_equals_scipy_and_the_formulas():
    rng = np.random.default_rng(2)
    field = rng.uniform(0.5, 3.5, 200)
    surface = 0.7 * field + 0.6 + rng.normal(0, 0.3, 200)
    found = HeightAgreement.of(field, surface)
    line = stats.linregress(field, surface)
    assert found.r2 == pytest.approx(line.rvalue**2)
    assert (found.slope, found.intercept) == pytest.approx((line.slope, line.intercept))
    assert found.rmse == pytest.approx(np.sqrt(((surface - field) ** 2).mean()))
    assert found.bias == pytest.approx((surface - field).mean())
    perfect = HeightAgreement.of(field, field)
    assert (perfect.rmse, perfect.r2, perfect.efficiency) == pytest.approx((0, 1, 1))
    assert HeightAgreement.of([], []).n == 0
    assert np.isnan(HeightAgreement.of([2.0, 2.0], [1.0, 3.0]).r2)


@pytest.fixture
def campaign(tmp_path):
    """Reed in the west (x < 10), water in the east, a hole in the surface at x > 15, y > 15."""
    values = np.zeros((20, 20))
    values[:, :10] = 3.0
    values[5:10, :10] = np.where(np.indices((5, 10)).sum(axis=0) % 2, 2.0, 0.8)
    values[:5, 15:] = np.nan
    ohm = raster(values)
    path = tmp_path / "points.csv"
    rows = ["A,1,1,12,18,,1.1", "A,1,2,2.5,17.5,3.2,0.5", "A,1,3,12.5,12.5,2.0,0.5", "A,1,4,17,17,,1.0"]
    rows += ["A,2,1,5.5,5.5,,0.4"]
    path.write_text(
        "aoi,transect,point,x,y,stem_height_m,water_depth_m\n" + "\n".join(rows), encoding="utf-8"
    )
    return ohm, map_extent(ohm, min_area=0, min_hole=0), read_field_points(path)


def test_extent_matrix_by_hand(campaign):
    _, mapped, points = campaign
    found = extent_agreement(points, mapped)
    assert found.matrix.counts.tolist() == [[1, 1], [1, 1]]
    assert found.left_out == 1
    assert found.samples.classified.tolist() == [
        "aquatic reed" if i in (1, 4) else "unknown" if i == 3 else "water" for i in range(5)
    ]


def test_density_matrix_by_hand(campaign):
    ohm, mapped, points = campaign
    cells = density_cells(ohm, mapped.reed, cell_size=2.0)
    plots = pd.DataFrame(
        {
            "aoi": "A",
            "transect": "1",
            "plot": ["1", "2", "3", "4"],
            "x": [3.0, 5.0, 3.0, 13.0],
            "y": [3.0, 12.9, 12.9, 7.0],
            "stems_per_m2": [60.0, 20.0, np.nan, 10.0],
            "density": ["", "", "dense", ""],
        }
    )
    found = density_agreement(plots, points, cells, mapped)
    # Plots: dense as dense, sparse as sparse, dense as sparse, sparse as water; two transects of water.
    assert found.matrix.counts.tolist() == [[1, 1, 0], [0, 1, 1], [1, 0, 1]]
    assert density_agreement(plots, None, cells, mapped).matrix.total == 4


def test_status_matrix_leaves_excluded_sections_out():
    box = shapely.box(0, 0, 1, 1)
    sections = gpd.GeoDataFrame(
        {"aoi": "1", "section": [1, 2, 3], "status": ["stressed", "healthy", "excluded"]},
        geometry=[box] * 3,
        crs=CRS_,
    )
    reference = pd.DataFrame(
        {"aoi": 1, "section": ["1", "2", "3"], "status": ["stressed", "stressed", "healthy"]}
    )
    found = status_agreement(sections, reference)
    assert found.matrix.counts.tolist() == [[1, 0], [1, 0]]
    assert found.left_out == 1
    with pytest.raises(ReedError, match="No section"):
        status_agreement(sections, reference.assign(aoi="9"))
    with pytest.raises(ReedError, match="dying"):
        status_agreement(sections, reference.assign(status="dying"))
    with pytest.raises(ReedError, match="column status"):
        status_agreement(sections, reference.drop(columns="status"))
