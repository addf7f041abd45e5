"""Repetitions of the chain: same seed same bytes, other seed other bytes, nothing computed twice."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from workbench.errors import StudyError
from workbench.params import Parameters
from workbench.rasters import read_raster
from workbench.studies import repeat_chain, repetitions
from workbench.virtual import simulate_scene

PARAMETERS = Parameters(simulate={"truth_resolution": 0.16})


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
    assert twice.errors["seed"].tolist() == [1, 2]
    assert (twice.errors["check_rms_xy_m"] < 1).all()


def test_layer_is_written_with_the_grid_of_the_mosaics(twice):
    layer = read_raster(twice.folder / "reproducibility_dsm.tif")
    assert np.array_equal(layer.values, twice.by_surface["dsm"].layer.values)


def test_other_seeds_differ_and_the_same_seed_gives_the_same_bytes(meadow, twice, tmp_path):
    def orthophoto(folder, seed):
        return (folder / f"seed_{seed:03d}/data/products/meadow/ortho_dsm.tif").read_bytes()

    assert orthophoto(twice.folder, 1) != orthophoto(twice.folder, 2)
    again = repetitions._repeat(meadow, PARAMETERS, 1, tmp_path, ["dsm"])
    assert again.root == tmp_path / "seed_001"
    assert orthophoto(tmp_path, 1) == orthophoto(twice.folder, 1)


def test_complete_repetitions_are_not_computed_again(meadow, twice, monkeypatch):
    def forbidden(*arguments):
        raise AssertionError("computed again")

    monkeypatch.setattr(repetitions, "orient_site", forbidden)
    again = repeat_chain(meadow, PARAMETERS, repetitions=2, announce=lambda text: None)
    assert again.table.equals(twice.table)
    # An interrupted one lacks its last file, and is.
    (twice.folder / "seed_002/repetition.json").unlink()
    with pytest.raises(AssertionError, match="computed again"):
        repeat_chain(meadow, PARAMETERS, repetitions=2, announce=lambda text: None)


def test_fewer_than_two_are_refused(meadow):
    with pytest.raises(StudyError, match="at least two"):
        repeat_chain(meadow, PARAMETERS, repetitions=1)


def test_mosaics_without_common_area_are_refused(twice):
    mosaic = read_raster(twice.folder / "seed_001/data/products/meadow/ortho_dsm.tif")
    away = mosaic.assign_coords(x=mosaic.x + 5000)
    with pytest.raises(StudyError, match="no common area"):
        repetitions._on_common_grid([mosaic, away])
    shutil.rmtree(twice.folder)
