"""The chain on open land whose surface, poses and targets are known."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from workbench.matching import match_site
from workbench.orientation import orient_site
from workbench.params import Parameters
from workbench.rasters import Grid, match_grid, read_raster
from workbench.surface import surface_site
from workbench.virtual import simulate_scene

GSD = 0.12
PARAMETERS = Parameters(simulate={"truth_resolution": 0.12})


@pytest.fixture(scope="module")
def meadow(tmp_path_factory):
    site = simulate_scene(
        "meadow",
        tmp_path_factory.mktemp("root"),
        PARAMETERS,
        flight_overrides={"reduction": 8, "gsd": GSD},
    )
    for stage in (orient_site, match_site, surface_site):
        stage(site, PARAMETERS)
    return site


def test_oriented_poses_are_as_good_as_their_priors_allow(meadow):
    def places(path, columns=("x", "y", "z")):
        with path.open(encoding="utf-8") as file:
            return {
                row["photo"].removesuffix(".jpg"): [float(row[c]) for c in columns]
                for row in csv.DictReader(file)
            }

    found, true = places(meadow.products / "orientation" / "cameras.csv"), places(meadow.truth / "poses.csv")
    assert found.keys() == true.keys()
    off = np.array([np.subtract(found[name], true[name]) for name in true])
    sd = np.array([0.05, 0.05, 0.08])
    # Bias and drift (60 % of the variance) are common to all photographs of a strip and stay.
    assert np.all(np.abs(off.mean(axis=0)) < 0.01 + 2 * np.sqrt(0.6) * sd)
    assert np.all(off.std(axis=0) < 0.01 + sd)


def test_surface_is_right_to_half_a_pixel(meadow):
    measured = read_raster(meadow.products / "surface" / "dsm.tif")
    truth = match_grid(read_raster(meadow.truth / "dsm_mean.tif"), Grid.of(measured))
    off = measured.values - truth.values
    inside = np.isfinite(truth.values)
    assert np.isfinite(off).sum() > 0.9 * inside.sum()
    off = off[np.isfinite(off)]
    centred = off - np.median(off)
    assert 1.4826 * np.median(np.abs(centred)) <= 0.5 * GSD
    # The whole surface hangs on the heights of the receiver and of the control points.
    assert abs(np.median(off)) < 0.01 + 2 * 0.08
