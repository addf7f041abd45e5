"""The embedded example end to end: notebook 01 from photographs to report, and the report in a browser."""

import pytest

from workbench.rasters import read_raster
from workbench.stages import read_json


@pytest.fixture
def lake(lake_root):
    """Products of the embedded example."""
    return lake_root / "data/products/lake"


@pytest.mark.slow
def test_every_photograph_is_registered_and_nearly_everything_measured(lake):
    orientation = read_json(lake / "orientation/metrics.json")
    assert orientation["registered"] == orientation["photos"]
    assert orientation["reprojection_error_px"] < 1
    surface = read_json(lake / "surface/metrics.json")
    assert surface["coverage_ge1"] > 0.9
    dsm = read_raster(lake / "surface/dsm.tif")
    assert dsm.attrs["vertical_datum"] == "DHHN2016"


@pytest.mark.slow
def test_products_of_the_contract_are_there(lake):
    for product in (
        *("orientation/sparse/images.bin", "orientation/cameras.csv", "orientation/tie_points.laz"),
        *("surface/dsm_ds1.tif", "surface/possible_count.tif", "surface/dtm.tif", "surface/ndsm.tif"),
        *("mosaic/source.tif", "mosaic/seamlines.gpkg", "mosaic/crop.gpkg", "mosaic/gli.tif"),
        *("report/report.html", "report/parameters.yaml"),
    ):
        assert (lake / product).stat().st_size > 0, product


@pytest.mark.slow
@pytest.mark.browser
def test_the_report_needs_no_network_and_shows_every_picture(lake, browser):
    page = browser.new_page()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto((lake / "report/report.html").as_uri())
    widths = page.eval_on_selector_all("img", "images => images.map(image => image.naturalWidth)")
    headings = page.eval_on_selector_all("h2", "titles => titles.map(title => title.textContent)")
    page.close()
    assert len(widths) >= 24
    assert min(widths) > 100
    assert not [url for url in asked if url.startswith("http")]
    assert [heading.split(" ", 1)[1] for heading in headings] == [
        *("Site", "Orientation", "Matching", "Surface", "Orthomosaic"),
        *("Aquatic reed", "Single trees", "Assessment", "How it was made"),
    ]
