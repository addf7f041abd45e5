"""Lists of inputs: a changed file or statement changes the lists of those stages that read it."""

import pytest

from workbench.errors import SiteError
from workbench.site import load_site, write_inputs

SITE_YAML = """crs: EPSG:32633
vertical_datum: DHHN2016
photographs: photographs
water_level: 517.93
shoreline: shore.shp
plots: plots.csv
dtm: lidar.tif
reference_trees: stems.csv
cameras:
  camera1: {width: 6000, height: 4000, focal_length_px: 8000}
"""
FILES = {
    "site.yaml": SITE_YAML,
    "photographs.csv": "name,camera,strip\na.jpg,camera1,0\nb.jpg,camera1,0\n",
    "photographs/a.jpg": "pixels",
    "photographs/b.jpg": "pixels",
    "control.csv": "name,x,y,z,sd_xy,sd_z,role\n",
    "observations.csv": "name,photo,column,row\n",
    "shore.shp": "shapes",
    "shore.dbf": "columns",
    "plots.csv": "aoi\n",
    "lidar.tif": "heights",
    "stems.csv": "x,y\n",
    "stands.gpkg": "stands",
    "truth/cover.csv": "code,cover\n",
    "truth/reed.gpkg": "read by nothing",
}
CHAIN = {"orient", "match", "surface", "mosaic"}


@pytest.fixture
def site(tmp_path):
    """Root with a site, and its lists."""
    for name, content in FILES.items():
        path = tmp_path / "data/sites/mine" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return tmp_path


def lists(root) -> dict[str, str]:
    folder = write_inputs(load_site("mine", root))
    return {path.stem: path.read_text() for path in folder.glob("*.json")}


@pytest.mark.parametrize(
    ("file", "old", "new", "verbs"),
    [
        ("truth/reed.gpkg", "read", "still read", set()),
        ("site.yaml", "DHHN2016", "ellipsoid", CHAIN | {"report"}),
        ("site.yaml", "32633", "32632", CHAIN | {"report"}),
        ("site.yaml", "8000", "8010", {"orient", "report"}),
        ("site.yaml", "517.93", "518.10", {"reed", "report"}),
        ("photographs.csv", "b.jpg,camera1,0", "b.jpg,camera1,1", CHAIN | {"report"}),
        ("photographs/b.jpg", "pixels", "other pixels", {"orient", "match", "mosaic"}),
        ("control.csv", "role\n", "role\nP1,1,2,3,0.1,0.1,check\n", {"orient", "report"}),
        ("observations.csv", "row\n", "row\nP1,a.jpg,5,6\n", {"orient", "report"}),
        ("plots.csv", "aoi", "aoi,stems", {"reed"}),
        ("shore.shp", "shapes", "other", {"reed", "trees"}),
        ("shore.dbf", "columns", "other", {"reed", "trees"}),
        ("lidar.tif", "heights", "other", {"surface"}),
        ("stands.gpkg", "stands", "other", {"trees"}),
        ("stems.csv", "x,y", "x,y,dbh_m", {"assess"}),
        ("truth/cover.csv", "cover\n", "cover\n1,water\n", {"assess"}),
    ],
)
def test_a_change_is_seen_where_it_is_read(site, file, old, new, verbs):
    before = lists(site)
    path = site / "data/sites/mine" / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    after = lists(site)
    assert {verb for verb in after if after[verb] != before[verb]} == verbs


def test_a_photograph_that_is_gone_is_named(site):
    (site / "data/sites/mine/photographs/b.jpg").unlink()
    with pytest.raises(SiteError, match=r"b\.jpg: cannot be read"):
        lists(site)
