import cv2
import numpy as np
import pytest
from box_scene import ORIGIN, ROOF, box_surface, texture
from rasterio.crs import CRS

from workbench.cameras.view import view_table
from workbench.errors import MosaicError, SurfaceError
from workbench.mosaic import crop_area, make_orthophoto
from workbench.mosaic.rectify import rectify
from workbench.mosaic.views import best_views
from workbench.params import MosaicParameters
from workbench.rasters import Grid, read_raster


@pytest.fixture(scope="module")
def truth_at():
    def colours(raster):
        x, y = np.meshgrid(raster.x.values - ORIGIN[0], raster.y.values - ORIGIN[1])
        west, east, south, north, _ = ROOF
        roof = (x > west) & (x < east) & (y > south) & (y < north)
        inside = np.minimum.reduce([x - west, east - x, y - south, north - y])
        return np.moveaxis(texture(x, y, roof), -1, 0), np.abs(inside) < 0.5

    return colours


def test_true_orthophoto_shows_roof_and_ground_where_they_are(box_site, truth_at, tmp_path):
    result = make_orthophoto(box_site.block, box_site.surface, tmp_path / "o.tif")
    ortho = read_raster(tmp_path / "o.tif")
    truth, near_edge = truth_at(ortho)
    truth = truth * result.gains[0].mean()  # the brightness of the whole block is free
    shown = (ortho.values > 0).all(axis=0) & ~near_edge
    error = np.abs(ortho.values.astype(float) - truth).max(axis=0)[shown]
    assert shown.mean() > 0.95
    # A wall is blue (20, 20, 250): any double image or smear is off by more than 50.
    assert (error > 25).mean() < 0.002
    assert np.median(error) < 4
    assert set(np.unique(result.source)) - {0} <= set(range(1, 10))


def test_without_the_visibility_test_the_box_appears_twice(box_site, truth_at, tmp_path):
    parameters = MosaicParameters(visibility=False, seams="best-view")
    make_orthophoto(box_site.block, box_site.surface, tmp_path / "o.tif", parameters)
    ortho = read_raster(tmp_path / "o.tif")
    truth, near_edge = truth_at(ortho)
    shown = (ortho.values > 0).all(axis=0) & ~near_edge
    error = np.abs(ortho.values.astype(float) - truth).max(axis=0)[shown]
    assert (error > 50).mean() > 0.004


def test_balance_finds_the_darker_photograph(box_site, tmp_path):
    result = make_orthophoto(box_site.block, box_site.surface, tmp_path / "o.tif")
    dark = [p.name for p in box_site.block].index("photo_11.png")
    ratio = result.gains[dark] / np.delete(result.gains, dark, axis=0).mean(axis=0)
    assert ratio == pytest.approx(1 / 0.7, rel=0.05)


def test_sight_agrees_with_ray_casting_and_does_not_depend_on_the_window(box_site):
    surface = box_site.surface
    grid = Grid.of(surface)
    table = view_table(box_site.block.photographs[:1], grid)
    seen = best_views(surface.values, table, resolution=grid.resolution, tolerance=1.0) > 0
    # Independent: a cell on the ground is hidden where the segment to the camera meets the box.
    x, y = np.meshgrid(grid.x - ORIGIN[0], grid.y - ORIGIN[1])
    start = box_site.block.photographs[0].pose.centre - (*ORIGIN, 0)
    points = np.stack([x, y, surface.values], -1).reshape(-1, 3)
    rays = points - start
    west, east, south, north, top = ROOF
    t1 = (np.array([west, south, 0]) - start) / rays
    t2 = (np.array([east, north, top - 1e-3]) - start) / rays
    enter, leave = np.minimum(t1, t2).max(1), np.maximum(t1, t2).min(1)
    hidden = ((enter < leave) & (enter < 1 - 1e-6)).reshape(seen.shape) & (surface.values == 0)
    frame = box_site.block.photographs[0].sees(points + (*ORIGIN, 0)).reshape(seen.shape)
    disagree = seen != (frame & ~hidden)
    assert hidden[frame].sum() > 100
    assert disagree.mean() < 0.01  # one row of cells along the outline of the shadow of sight
    half = slice(0, 130)
    part = best_views(surface.values[half], table, resolution=grid.resolution, tolerance=1.0) > 0
    inner = slice(0, 20)  # far enough from the cut that no obstacle beyond it matters
    assert np.array_equal(part[inner], seen[inner])


def test_rectification_is_exact_on_the_plane(box_site):
    surface = box_site.surface
    grid = Grid.of(surface)
    photograph = box_site.block.photographs[0]
    image = cv2.imread(str(photograph.path))[..., ::-1]
    view = view_table([photograph], grid)[0]
    colours = rectify(image, view, np.zeros(grid.shape, np.float32), resolution=grid.resolution)
    x, y = np.meshgrid(grid.x - ORIGIN[0], grid.y - ORIGIN[1])
    truth = texture(x, y, np.zeros(x.shape, bool))
    far = np.isfinite(colours[..., 0]) & (x < 20)
    assert np.abs(colours[far] - truth[far]).max() < 3


def test_seamlines_and_crop(box_site, tmp_path):
    result = make_orthophoto(box_site.block, box_site.surface, tmp_path / "o.tif")
    seams = result.seamlines
    assert set(seams.photograph) <= {p.name for p in box_site.block}
    overlap = sum(
        a.intersection(b).area for i, a in enumerate(seams.geometry) for b in seams.geometry[i + 1 :]
    )
    assert overlap < 1e-6
    crop = crop_area(seams)
    assert crop.geometry[0].area < seams.area.sum()
    assert crop.cropped[0]
    assert crop.photographs[0] == 1  # of three by three, only the middle one is not outermost


def test_another_crs_is_refused(box_site, tmp_path):
    wrong = box_site.surface.rio.write_crs(CRS.from_epsg(25832))
    with pytest.raises(MosaicError, match="reproject"):
        make_orthophoto(box_site.block, wrong, tmp_path / "o.tif")


def test_surface_without_heights_is_refused(box_site, tmp_path):
    empty = box_surface() * np.nan
    empty = empty.rio.write_crs(box_site.surface.rio.crs)
    with pytest.raises(SurfaceError, match="no height"):
        make_orthophoto(box_site.block, empty, tmp_path / "o.tif")
