"""Repetitions of the chain: same seed same bytes, other seed other bytes, nothing computed twice."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from workbench.errors import RasterError, StudyError
from workbench.params import Parameters
from workbench.rasters import Grid, new_raster, read_raster, write_raster
from workbench.studies import repeat_chain, repetitions, reproducibility
from workbench.studies.repetitions import repeat_step
from workbench.studies.reproducibility import NOT_COMPARED
from workbench.virtual import simulate_scene

# In clean photographs of open land every sample of matches leads to the same poses; coarse JPEG leaves
# doubtful matches for chance to decide.
PARAMETERS = Parameters(simulate={"truth_resolution": 0.16, "jpeg_quality": 40}, orient={"seed": 2})


@pytest.fixture(scope="module")
def meadow(tmp_path_factory):
    return simulate_scene(
        "meadow",
        tmp_path_factory.mktemp("root"),
        PARAMETERS,
        flight_overrides={"reduction": 12, "gsd": 0.16},
    )


@pytest.fixture(scope="module")
def twice(meadow):
    return repeat_chain(meadow, PARAMETERS, repetitions=2, announce=lambda text: None)


def test_table_holds_both_surfaces_and_the_covers_of_the_site(twice):
    assert set(twice.table["surface"]) == {"dsm", "mesh"}
    for surface, result in twice.by_surface.items():
        assert result.pairs == 1
        rows = twice.table[twice.table["surface"] == surface].set_index("cover")
        assert rows.share["total"] == pytest.approx(result.share)
        assert 0.5 < rows.share["meadow"] <= 1
    assert twice.errors["seed"].tolist() == [2, 3]
    assert (twice.errors["check_rms_xy_m"] < 1).all()


def test_layer_is_written_with_the_grid_of_the_mosaics(twice):
    layer = read_raster(twice.folder / "reproducibility_dsm.tif")
    assert np.array_equal(layer.values, twice.by_surface["dsm"].layer.values)


@pytest.mark.slow
def test_other_seeds_differ_and_the_same_seed_gives_the_same_bytes(meadow, twice, tmp_path):
    def orthophoto(folder, seed):
        return (folder / f"seed_{seed:03d}/data/products/meadow/ortho_dsm.tif").read_bytes()

    assert orthophoto(twice.folder, 2) != orthophoto(twice.folder, 3)
    repeat_step(meadow, PARAMETERS, "2/mosaic_dsm", repetitions=2, surfaces=["dsm"], folder=tmp_path)
    assert orthophoto(tmp_path, 2) == orthophoto(twice.folder, 2)


@pytest.fixture
def computed(monkeypatch):
    """Steps that are computed from here on, by name; nothing is."""
    names = []

    def note(name, run, parameters):
        names.append((parameters.orient.seed, name))

    monkeypatch.setattr(repetitions, "_compute", note)
    return names


def changed(section, **values):
    return PARAMETERS.model_copy(update={section: getattr(PARAMETERS, section).model_copy(update=values)})


def test_steps_that_are_done_are_not_computed_again(meadow, twice, computed):
    again = repeat_chain(meadow, PARAMETERS, repetitions=2, announce=lambda text: None)
    assert computed == []
    assert again.table.equals(twice.table)


@pytest.mark.parametrize(
    ("section", "values", "steps"),
    [
        ("mosaic", {"balance": False}, ["mosaic_dsm", "mosaic_mesh"]),
        ("surface", {"min_count": 2}, ["surface", "mosaic_dsm", "mosaic_mesh"]),
        ("study", {"identical_from": 0.9}, []),
        ("reed", {"min_height": 1.0}, []),
    ],
)
def test_a_changed_parameter_repeats_what_depends_on_it(meadow, twice, computed, section, values, steps):
    copy = twice.folder.with_name("changed")
    shutil.copytree(twice.folder, copy, dirs_exist_ok=True)
    repeat_chain(meadow, changed(section, **values), repetitions=2, folder=copy, announce=lambda text: None)
    shutil.rmtree(copy)
    assert computed == [(seed, step) for seed in (2, 3) for step in steps]


def test_an_interrupted_or_longer_study_computes_only_what_is_missing(meadow, twice, computed):
    copy = twice.folder.with_name("longer")
    shutil.copytree(twice.folder, copy)
    (copy / "seed_003/steps/mosaic_mesh.json").unlink()
    with pytest.raises(RasterError, match="ortho_dsm"):  # the third repetition was not really computed
        repeat_chain(meadow, PARAMETERS, repetitions=3, folder=copy, announce=lambda text: None)
    shutil.rmtree(copy)
    assert computed == [
        (3, "mosaic_mesh"),
        *((4, s) for s in ("orient", "surface", "mosaic_dsm", "mosaic_mesh")),
    ]


@pytest.mark.slow
def test_dvc_records_each_step_and_repeats_none(meadow, twice):
    """The pipeline beside the study agrees with the study on what is done."""
    dvc = [sys.executable, "-m", "dvc"]
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}

    def run(*words):
        return subprocess.run(
            [*dvc, *words], cwd=meadow.root, capture_output=True, text=True, env=environment, check=True
        ).stdout

    run("init", "--no-scm", "--quiet")
    orthophoto = twice.folder / "seed_002/data/products/meadow/ortho_dsm.tif"
    before = orthophoto.read_bytes()
    pipeline = (twice.folder / "dvc.yaml").relative_to(meadow.root)
    stages = YAML(typ="safe").load(twice.folder / "dvc.yaml")["stages"]
    assert len(stages) == 2 * 4 + 1
    assert "Running stage" in run("repro", f"{pipeline}:mosaic-dsm-2")
    lock = YAML(typ="safe").load(twice.folder / "dvc.lock")["stages"]
    assert set(lock) == {"orient-2", "surface-2", "mosaic-dsm-2"}
    assert orthophoto.read_bytes() == before
    orthophoto.unlink()
    run("checkout", f"{pipeline}:mosaic-dsm-2")
    assert orthophoto.read_bytes() == before
    assert "up to date" in run("repro", f"{pipeline}:mosaic-dsm-2")


def test_unknown_steps_and_surfaces_are_named(meadow):
    with pytest.raises(StudyError, match="2/orient, 2/surface, 2/mosaic_dsm"):
        repeat_step(meadow, PARAMETERS, "7/orient", repetitions=2)
    with pytest.raises(StudyError, match="dsm, mesh"):
        repeat_chain(meadow, PARAMETERS, repetitions=2, surfaces=["lidar"])


def test_fewer_than_two_are_refused(meadow):
    with pytest.raises(StudyError, match="at least two"):
        repeat_chain(meadow, PARAMETERS, repetitions=1)


def test_cells_without_data_are_not_compared(tmp_path):
    grid = Grid.from_bounds("EPSG:32633", (0, 0, 20, 20), 1.0)
    values = np.random.default_rng(0).integers(1, 255, (3, 20, 20), dtype=np.uint8)
    values[:, :5] = 0
    paths = [tmp_path / f"{k}.tif" for k in range(2)]
    for path in paths:
        write_raster(new_raster(values, grid, name="o", units="1", nodata=0), path)
    layer = reproducibility(repetitions.common_area([read_raster(path) for path in paths])).layer
    np.testing.assert_array_equal(layer.values == NOT_COMPARED, (values == 0).all(axis=0))


def test_mosaics_without_common_area_are_refused(twice):
    mosaic = read_raster(twice.folder / "seed_002/data/products/meadow/ortho_dsm.tif")
    away = mosaic.assign_coords(x=mosaic.x + 5000)
    with pytest.raises(StudyError, match="no common area"):
        repetitions.common_area([mosaic, away])
    shutil.rmtree(twice.folder)
