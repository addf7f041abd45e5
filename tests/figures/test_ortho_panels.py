"""Panels of georeferencing and reproducibility on small made-up inputs, without a browser."""

from pathlib import Path

import numpy as np
import pytest
from rasterio.crs import CRS
from scipy import ndimage

from workbench.errors import StudyError
from workbench.figures.georeferencing_panel import GeoreferencingPanel, residual_arrows
from workbench.figures.reproducibility_panel import ReproducibilityPanel
from workbench.orientation.control import PointResidual
from workbench.orientation.optimise import Optimisation, Trial
from workbench.points import write_points
from workbench.rasters import Grid, new_raster, write_raster
from workbench.site import ControlPoint, Site

UTM = CRS.from_epsg(32633)


def residual(name, role, size):
    return PointResidual(name, role, 5, size, 0.0, 2 * size, 0.3)


@pytest.fixture
def oriented(tmp_path):
    """A site with tie points of known attributes and residuals of three points."""
    control = tuple(
        ControlPoint(f"P{k}", 5e5 + 10 * k, 5e6 + 5 * k, 0, 0.01, 0.01, "check") for k in range(3)
    )
    site = Site("s", tmp_path, UTM, "test", (), control=control)
    folder = site.products / "orientation"
    random = np.random.default_rng(3)
    xyz = np.c_[5e5 + random.uniform(0, 50, 200), 5e6 + random.uniform(0, 40, 200), random.uniform(0, 2, 200)]
    attributes = {
        "reprojection_error": np.linspace(0, 4, 200).astype(np.float32),
        "reconstruction_uncertainty": np.full(200, 5, np.float32),
        "projection_accuracy": np.full(200, 2, np.float32),
        "image_count": np.full(200, 4, np.uint16),
    }
    folder.mkdir(parents=True)
    write_points(xyz, folder / "tie_points.laz", crs=UTM.to_wkt(), attributes=attributes)
    (folder / "control.csv").write_text(
        "name,role,photographs,dx,dy,dz,reprojection_px\nP0,check,4,0.01,0.02,-0.04,0.3\nP1,check,1,,,,\n"
    )
    return site


def test_georeferencing_panel_looks_up_what_was_computed(oriented, tmp_path):
    trials = tuple(
        Trial(threshold, 100, tuple(residual(f"P{k}", "check", size) for k in range(3)))
        for threshold, size in ((4.0, 0.05), (1.0, 0.01), (0.5, 0.03))
    )
    optimisation = Optimisation(None, trials, 1, 0.02, "")
    tool = GeoreferencingPanel(oriented, optimisation, params=tmp_path / "params.yaml")
    assert tool.threshold.value == 1.0
    assert tool.kept(1.0, 50, 10).sum() == 50
    text = tool.summary(0.5, 50, 10).object
    assert "25 of 200 tie points" in text
    assert "check 3.0 cm in plan, 6.0 cm in height" in text
    assert "Chosen: 1 px" in text
    assert tool.values()["orient.max_reprojection_error"] == 1.0
    assert len(tool.map(1.0, 50, 10, "reprojection_error").traverse(specs=["Points"])) == 2
    assert len(tool.panel()) == 4


def test_residuals_become_arrows_of_points_that_have_them(oriented):
    segments = residual_arrows(oriented, magnify=100).traverse(lambda element: element, ["Segments"])
    horizontal = segments[0].array()
    assert horizontal.tolist() == [pytest.approx([5e5, 5e6, 5e5 + 1.0, 5e6 + 2.0])]


@pytest.fixture
def repeated(tmp_path):
    """Three mosaics of 40 x 30 m: alike in the west, different in the east."""
    grid = Grid.from_bounds(UTM, (5e5, 5e6, 5e5 + 40, 5e6 + 30), 0.25)
    random = np.random.default_rng(1)
    base = 128 + 300 * ndimage.gaussian_filter(random.normal(size=(3, *grid.shape)), (0, 1.5, 1.5))
    for seed in range(3):
        values = base.copy()
        values[:, :, 100:] = 128 + 40 * random.normal(size=(3, grid.height, grid.width - 100))
        mosaic = new_raster(np.clip(values, 1, 255).astype(np.uint8), grid, name="o", units="1", nodata=0)
        write_raster(mosaic, tmp_path / f"seed_{seed:03d}/data/products/s/ortho_dsm.tif")
    return tmp_path


def test_reproducibility_panel_follows_its_limits(repeated):
    tool = ReproducibilityPanel(Site("s", repeated, UTM, "test", ()), repeated)
    assert tool.surface.options == ["dsm"]
    strict = tool.result("dsm", 0.95, 5, "pearson")
    loose = tool.result("dsm", 0.5, 5, "pearson")
    assert strict.share == pytest.approx(100 / 160, abs=0.03)
    assert loose.share > strict.share
    assert tool.result("dsm", 0.95, 5, "pearson") is strict
    picture = tool.map("dsm", 0.95, 5, "pearson")
    assert float(picture.dimension_values("z", flat=False).max()) == 3
    assert "total" in tool.shares("dsm", 0.95, 5, "pearson").object["cover"].to_list()
    assert len(tool.histogram("dsm", 0.95, 5, "pearson")) == 4
    assert len(tool.panel()) == 3


def test_without_repetitions_it_says_how_to_make_them(tmp_path):
    with pytest.raises(StudyError, match="workbench study reproducibility --site s"):
        ReproducibilityPanel(Site("s", Path(), UTM, "test", ()), tmp_path)


@pytest.mark.slow
def test_notebook_05_optimises_and_shows_both_panels(execute_notebook, lake_root):
    notebook = execute_notebook("05_georeferencing", lake_root)
    text = "\n".join(
        output.get("data", {}).get("text/plain", "") + output.get("text", "")
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
    )
    assert "cross-validated (m)" in text
    assert "Save observations.csv" in text
    assert "visibility tested: True; hidden from all photographs" in text


@pytest.mark.slow
def test_notebook_06_repeats_and_follows_crowns(execute_notebook, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))  # nothing is taken over from an earlier run
    notebook = execute_notebook("06_reproducibility", tmp_path)
    text = "\n".join(
        output.get("data", {}).get("text/plain", "") + output.get("text", "")
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
    )
    assert "forest" in text
    assert "crowns:" in text
    assert "overlap_most" in text
