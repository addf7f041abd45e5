from dataclasses import replace

import numpy as np
import pytest
from box_scene import ORIGIN, ROOF, UTM

from workbench.errors import WorkbenchError
from workbench.mosaic import mosaic_site, stage
from workbench.params import MosaicParameters, Parameters
from workbench.rasters import Grid, read_raster, write_raster
from workbench.site import Site
from workbench.vectors import read_vector


@pytest.fixture
def site(box_site, tmp_path, monkeypatch):
    """A site with a surface, a terrain model, and the block that the orientation would have left."""
    site = Site("box", tmp_path, UTM, "test", (), {})
    folder = site.products / "surface"
    folder.mkdir(parents=True)
    surface = box_site.surface
    write_raster(surface, folder / "dsm.tif")
    write_raster(surface.copy(data=np.zeros_like(surface.values)), folder / "dtm.tif")
    points = np.array([(*(ORIGIN + place), 0.0) for place in ((5, 5), (60, 5), (60, 60), (5, 60), (30, 8))])
    block = replace(box_site.block, tie_points=points)
    monkeypatch.setattr(stage, "read_block", lambda folder, site: block)
    return site


def made(site, **values):
    metrics = mosaic_site(site, Parameters(mosaic=MosaicParameters(balance=False, **values)))
    return metrics, read_raster(site.products / "mosaic" / "ortho.tif").load()


def test_each_surface_gives_a_mosaic_of_its_own(site):
    mosaics = {surface: made(site, surface=surface)[1] for surface in ("dsm", "dtm", "mesh")}
    west, east, south, north, top = ROOF
    around = {
        "x": slice(ORIGIN[0] + west - top, ORIGIN[0] + east + top),
        "y": slice(ORIGIN[1] + north + top, ORIGIN[1] + south - top),
    }
    leans = np.abs(mosaics["dsm"].sel(around).astype(float) - mosaics["dtm"].sel(around)).max("band")
    assert float((leans > 50).mean()) > 0.03  # on the terrain the roof and its walls lie beside their place
    # Far from the box all three are the same ground.
    away = {"x": slice(ORIGIN[0] + 8, ORIGIN[0] + 16), "y": slice(ORIGIN[1] + 24, ORIGIN[1] + 10)}
    for other in ("dtm", "mesh"):
        difference = np.abs(mosaics["dsm"].sel(away).astype(float) - mosaics[other].sel(away))
        assert float(difference.mean()) < 3


def test_a_missing_terrain_model_is_said(site):
    (site.products / "surface" / "dtm.tif").unlink()
    with pytest.raises(WorkbenchError, match=r"dtm\.tif"):
        made(site, surface="dtm")


def test_clipped_to_the_crop_area(site):
    whole, ortho = made(site)
    clipped, inner = made(site, clip=True)
    (area,) = read_vector(site.products / "mosaic" / "crop.gpkg").geometry
    assert clipped["area_m2"] == pytest.approx(area.area, rel=0.05)
    assert clipped["area_m2"] < 0.5 * whole["area_m2"]
    assert clipped["photographs_used"] <= whole["photographs_used"]
    shown = (inner.values > 0).any(axis=0)
    np.testing.assert_array_equal(inner.values[:, shown], ortho.values[:, shown])
    validity = read_raster(site.products / "mosaic" / "validity.tif").values
    assert set(np.unique(validity[~shown])) <= {0, 3}
    assert Grid.of(inner) == Grid.of(ortho)
