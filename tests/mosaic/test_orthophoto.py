from dataclasses import replace

import cv2
import numpy as np
import pytest
import rasterio
from box_scene import ORIGIN, ROOF, UTM, box_surface, texture
from rasterio.crs import CRS

from workbench.cameras.view import view_table
from workbench.errors import MosaicError, SurfaceError
from workbench.mosaic import blending, colours, crop_area, make_orthophoto, orthophoto
from workbench.mosaic import sources as passes
from workbench.mosaic.rectify import rectify
from workbench.mosaic.sources import HIDDEN, NOT_SEEN, UNCOVERED
from workbench.mosaic.views import best_views
from workbench.orientation import Block
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
    result = make_orthophoto(box_site.block, box_site.surface, tmp_path)
    ortho = read_raster(tmp_path / "ortho.tif")
    truth, near_edge = truth_at(ortho)
    truth = truth * result.gains[0].mean()  # the brightness of the whole block is free
    shown = (ortho.values > 0).all(axis=0) & ~near_edge
    error = np.abs(ortho.values.astype(float) - truth).max(axis=0)[shown]
    assert shown.mean() > 0.95
    # A wall is blue (20, 20, 250): any double image or smear is off by more than 50.
    assert (error > 25).mean() < 0.002
    assert np.median(error) < 4
    source = read_raster(tmp_path / "source.tif").values
    assert set(np.unique(source)) - {0} == {index + 1 for index in result.used} <= set(range(1, 10))
    validity = read_raster(tmp_path / "validity.tif").values
    assert np.array_equal(np.bincount(validity.ravel(), minlength=5), result.cells)
    assert np.array_equal((validity == HIDDEN) | (validity == NOT_SEEN), source == 0)


def test_without_the_visibility_test_the_box_appears_twice(box_site, truth_at, tmp_path):
    parameters = MosaicParameters(visibility=False, seams="best-view")
    make_orthophoto(box_site.block, box_site.surface, tmp_path, parameters)
    ortho = read_raster(tmp_path / "ortho.tif")
    truth, near_edge = truth_at(ortho)
    shown = (ortho.values > 0).all(axis=0) & ~near_edge
    error = np.abs(ortho.values.astype(float) - truth).max(axis=0)[shown]
    assert (error > 50).mean() > 0.004


def test_balance_finds_the_darker_photograph(box_site, tmp_path):
    result = make_orthophoto(box_site.block, box_site.surface, tmp_path)
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


def test_a_reduced_photograph_keeps_its_scale_where_a_remainder_is_cut_off(box_site):
    photo = box_site.block.photographs[0]
    camera = photo.camera
    factor = next(n for n in (3, 4, 5, 7) if camera.width % n > 1)
    rows, columns = camera.height // factor, camera.width // factor
    # A ramp of columns: the grey value is the column of the full photograph, whatever the factor.
    ramp = np.tile((np.arange(columns) + 0.5) * factor, (rows, 1)).astype(np.float32)[..., None]
    grid = Grid.from_bounds(UTM, (*(ORIGIN + 8), *(ORIGIN + 28)), 1.0)
    view = view_table((photo,), grid)[0]
    found = rectify(ramp, view, np.zeros(grid.shape, np.float32), resolution=1.0)[..., 0]
    x, y = np.meshgrid(grid.x, grid.y)
    places = photo.project(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3))[:, 0].reshape(x.shape)
    inside = np.isfinite(found) & (places > factor) & (places < (columns - 1) * factor)
    assert inside.any()
    assert found[inside] == pytest.approx(places[inside], abs=1e-2)


def test_seamlines_and_crop(box_site, tmp_path):
    result = make_orthophoto(box_site.block, box_site.surface, tmp_path)
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
        make_orthophoto(box_site.block, wrong, tmp_path)


def test_surface_without_heights_is_refused(box_site, tmp_path):
    empty = box_surface() * np.nan
    empty = empty.rio.write_crs(box_site.surface.rio.crs)
    with pytest.raises(SurfaceError, match="no height"):
        make_orthophoto(box_site.block, empty, tmp_path)


def test_tiles_do_not_matter(box_site, tmp_path, monkeypatch):
    parameters = MosaicParameters(blending="multi-band", balance=False)
    make_orthophoto(box_site.block, box_site.surface, tmp_path / "whole", parameters)
    for module in (passes, colours, blending, orthophoto):
        monkeypatch.setattr(module, "_TILE", 128)
    make_orthophoto(box_site.block, box_site.surface, tmp_path / "tiled", parameters)
    for name in ("source.tif", "validity.tif"):
        whole, tiled = (read_raster(tmp_path / folder / name).values for folder in ("whole", "tiled"))
        np.testing.assert_array_equal(whole, tiled)
    whole, tiled = (
        read_raster(tmp_path / folder / "ortho.tif").values.astype(int) for folder in ("whole", "tiled")
    )
    # Single precision sums of the pyramid differ in the last digit where a tile begins elsewhere.
    assert np.abs(whole - tiled).max() <= 1


def test_pits_of_a_rough_surface_are_shown_and_flagged(box_site, truth_at, tmp_path):
    rough = box_site.surface.copy(deep=True)
    x, y = np.meshgrid(rough.x - ORIGIN[0], rough.y - ORIGIN[1])
    pits = (np.arange(rough.sizes["y"])[:, None] % 12 < 2) & (np.arange(rough.sizes["x"]) % 12 < 2)
    far = (x < 20) & (y < 20)
    rough.values[pits & far] -= 8.0
    without = make_orthophoto(box_site.block, rough, tmp_path / "without", MosaicParameters(hidden_specks=0))
    result = make_orthophoto(box_site.block, rough, tmp_path / "with")
    assert without.cells[UNCOVERED] == 0
    assert result.cells[UNCOVERED] > 0.5 * (without.cells[HIDDEN] - result.cells[HIDDEN]) > 100
    # The wide shadow of sight beside the box stays empty: nothing is shown twice.
    ortho = read_raster(tmp_path / "with/ortho.tif")
    truth, near_edge = truth_at(ortho)
    x, y = np.meshgrid(ortho.x - ORIGIN[0], ortho.y - ORIGIN[1])
    shown = (ortho.values > 0).all(axis=0) & ~near_edge & ((x > 22) | (y > 22))
    error = np.abs(ortho.values.astype(float) - truth * result.gains[0].mean()).max(axis=0)[shown]
    assert (error > 25).mean() < 0.002


def test_on_a_terrain_model_the_ground_is_right_and_the_roof_leans(box_site, truth_at, tmp_path):
    """What a user DTM does as the surface of the photographs, and why it is not the default."""
    plane = box_site.surface.copy(data=np.zeros_like(box_site.surface.values))
    make_orthophoto(box_site.block, plane, tmp_path, MosaicParameters(balance=False, seams="best-view"))
    ortho = read_raster(tmp_path / "ortho.tif")
    truth, _ = truth_at(ortho)
    x, y = np.meshgrid(ortho.x - ORIGIN[0], ortho.y - ORIGIN[1])
    west, east, south, north, top = ROOF
    shown = (ortho.values > 0).all(axis=0)
    lean = top * 1.2  # no view is steeper than 50 degrees
    around = (x > west - lean) & (x < east + lean) & (y > south - lean) & (y < north + lean)
    dark = read_raster(tmp_path / "source.tif").values == 5  # taken a third darker
    error = np.abs(ortho.values.astype(float) - truth).max(axis=0)
    assert np.percentile(error[shown & ~around & ~dark], 99) < 10
    inside = (x > west + 1) & (x < east - 1) & (y > south + 1) & (y < north - 1)
    assert (error[inside & shown] > 50).mean() > 0.05


@pytest.fixture(scope="module")
def deep_site(box_site, tmp_path_factory):
    """The same photographs with four bands of 16 bit; near infrared is 40 times blue plus 7."""
    folder = tmp_path_factory.mktemp("deep")
    photographs = []
    for photograph in box_site.block:
        image = cv2.imread(str(photograph.path))[..., ::-1].astype(np.uint16)
        deep = np.concatenate([image * 200, image[..., 2:] * 40 + 7], axis=-1)
        path = folder / f"{photograph.path.stem}.tif"
        with rasterio.open(path, "w", driver="GTiff", width=600, height=450, count=4, dtype="uint16") as file:
            file.write(np.moveaxis(deep, -1, 0))
        photographs.append(replace(photograph, path=path))
    return Block(tuple(photographs), UTM, "test")


def test_four_bands_of_16_bit_pass_through(deep_site, box_site, tmp_path):
    parameters = MosaicParameters(balance=False)
    make_orthophoto(deep_site, box_site.surface, tmp_path, parameters)
    ortho = read_raster(tmp_path / "ortho.tif").values
    assert ortho.shape[0] == 4
    assert ortho.dtype == np.uint16
    shown = (ortho > 0).all(axis=0)
    assert ortho[0][shown].max() > 30_000
    blue, infrared = ortho[2][shown].astype(float), ortho[3][shown].astype(float)
    # Interpolation is linear, so the relation of the bands holds in every cell, up to rounding.
    assert np.abs(infrared - (blue / 5 + 7)).max() <= 1


def test_photographs_of_different_kinds_are_refused(deep_site, box_site, tmp_path):
    mixed = Block((*deep_site.photographs[:4], *box_site.block.photographs[4:]), UTM, "test")
    with pytest.raises(MosaicError, match="one site for each kind of camera"):
        make_orthophoto(mixed, box_site.surface, tmp_path)


def test_blending_hides_a_seam_and_shows_nothing_that_is_hidden(box_site, truth_at, tmp_path):
    """One photograph is a third darker, and nothing balances it: its seam is a step of 40 and more."""
    hard = MosaicParameters(balance=False, seams="best-view")
    soft = hard.model_copy(update={"blending": "multi-band"})
    make_orthophoto(box_site.block, box_site.surface, tmp_path / "hard", hard)
    make_orthophoto(box_site.block, box_site.surface, tmp_path / "soft", soft)
    source = read_raster(tmp_path / "hard/source.tif").values
    before, after = (
        read_raster(tmp_path / name / "ortho.tif").values.astype(float) for name in ("hard", "soft")
    )
    seam = (source[:, 1:] == 5) != (source[:, :-1] == 5)
    seam &= (source[:, 1:] > 0) & (source[:, :-1] > 0)
    steps = [np.abs(np.diff(mosaic[1], axis=1))[seam] for mosaic in (before, after)]
    assert np.median(steps[1]) < 0.4 * np.median(steps[0])
    np.testing.assert_array_equal(after == 0, before == 0)
    # The blue of the walls is hidden in the mosaic; blending must not let it shine through.
    assert (after[2] > 200).mean() <= (before[2] > 200).mean() + 1e-4
    far = cv2.erode((source == 1).astype(np.uint8), np.ones((140, 140), np.uint8)) > 0
    np.testing.assert_array_equal(before[:, far], after[:, far])
