"""Photographs of a virtual site cut to its scene: same rays, same counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from workbench.cameras import Camera, Pose
from workbench.errors import StudyError
from workbench.matching import match_site
from workbench.params import Parameters
from workbench.photographs import read_photograph
from workbench.rasters import Grid, match_grid, read_raster
from workbench.studies.known_frames import cut_photographs, window_of, with_cut_photographs
from workbench.studies.known_poses import orient_by_truth, true_poses
from workbench.surface import surface_site
from workbench.virtual import simulate_scene

LENS = Camera("lens", 1000, 3000, 2000.0, 2000.0, 510.0, 1480.0, (-0.02, 0.01, 0.001, 0.0))


@pytest.mark.parametrize("tilt", [0.0, 12.0])
def test_everything_of_the_scene_is_in_the_window(tilt):
    pose = Pose.from_omega_phi_kappa((20.0, 60.0, 250.0), tilt, 2.0, 5.0)
    bounds = 0.0, 0.0, 40.0, 30.0
    rows, columns = window_of(LENS, pose, bounds, (0.0, 30.0))
    x, y, z = (
        v.ravel() for v in np.meshgrid(np.linspace(0, 40, 9), np.linspace(0, 30, 9), [0.0, 15.0, 30.0])
    )
    places = LENS.project(pose.to_camera(np.stack([x, y, z], axis=1)))
    seen = places[LENS.contains(places)]
    assert len(seen) > 50
    assert (seen[:, 0] > columns.start).all() and (seen[:, 0] < columns.stop).all()
    assert (seen[:, 1] > rows.start).all() and (seen[:, 1] < rows.stop).all()
    assert rows.stop - rows.start < 1200
    assert rows.start % 12 == columns.start % 12 == 0
    # A frame that shows a corner alone keeps enough to be matched with its neighbours at any downscale.
    away = Pose.from_omega_phi_kappa((82.0, 60.0, 250.0), 0.0, 0.0, 0.0)
    corner = window_of(LENS, away, bounds, (0.0, 30.0))
    assert min(part.stop - part.start for part in corner) >= 240
    assert window_of(LENS, pose, (900.0, 0.0, 940.0, 30.0), (0.0, 30.0)) is None


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    root = tmp_path_factory.mktemp("patch")
    scene = root / "patch.yaml"
    scene.write_text(
        "{name: patch, seed: 3, crs: 'EPSG:25832', vertical_datum: DHHN2016, origin: [660000.0, 5300000.0], "
        "size: [24.0, 16.0], terrain: {base: 60.0, relief: 0.5, longest: 15.0}, boulders: 6, "
        "flight: {camera: 3K nadir, reduction: 8, gsd: 0.15, forward_overlap: 0.8, strips: 1, run_in: 0.5, "
        "wind: 0.0}}"
    )
    small = {"simulate": {"truth_resolution": 0.25, "supersampling": 1}}
    return simulate_scene(scene, root, Parameters.model_validate(small))


def test_cut_photographs_are_parts_of_the_whole_ones_with_the_same_rays(site, tmp_path):
    poses = true_poses(site)
    lenses = cut_photographs(site, poses, tmp_path)
    assert 2 <= len(lenses) <= len(site.photographs)
    photograph = next(p for p in site.photographs if p.name in lenses)
    whole, lens = site.cameras[photograph.camera], lenses[photograph.name]
    column, row = round(whole.principal_x - lens.principal_x), round(whole.principal_y - lens.principal_y)
    part = read_photograph(tmp_path / "photographs" / f"{photograph.name}.tif")
    window = read_photograph(photograph.path)[row : row + lens.height, column : column + lens.width]
    np.testing.assert_array_equal(part, window)
    places = np.array([[3.0, 4.0], [lens.width - 2.0, lens.height - 5.0]])
    np.testing.assert_allclose(lens.rays(places), whole.rays(places + (column, row)), atol=1e-12)
    assert sum(lens.width * lens.height for lens in lenses.values()) < 0.6 * len(site.photographs) * (
        whole.width * whole.height
    )
    with pytest.raises(StudyError, match="photographs show the scene"):
        cut_photographs(replace(site, photographs=(photograph,)), poses, tmp_path / "few")


@pytest.mark.slow
def test_counts_of_the_scene_are_those_of_whole_photographs(site, tmp_path):
    parameters = Parameters.model_validate({"match": {"downscales": [1]}})
    layers = []
    for cut in (False, True):
        run = replace(site, root=tmp_path / str(cut))
        orient_by_truth(site, parameters, run.products / "orientation", cut=cut)
        run = with_cut_photographs(run) if cut else run
        match_site(run, parameters)
        surface_site(run, parameters)
        grid = Grid.of(read_raster(site.truth / "dsm_mean.tif"))
        folder = run.products / "surface"
        names = "count.tif", "possible_count.tif", "dsm.tif"
        layers.append([match_grid(read_raster(folder / n), grid, resampling="nearest").values for n in names])
    (count, possible, heights), (cut_count, cut_possible, cut_heights) = layers
    assert (possible == cut_possible).mean() > 0.97
    assert cut_count.mean() == pytest.approx(count.mean(), rel=0.02)
    assert np.nanmedian(np.abs(heights - cut_heights)) < 0.02
