"""Scenes larger than memory: trees grown where they are needed, truth in strips, bounded photographs."""

from __future__ import annotations

import subprocess
import sys
from datetime import UTC, datetime

import numpy as np
import pytest

from workbench.cameras import Camera, Pose
from workbench.rasters import Grid
from workbench.virtual import forest, grove, truth
from workbench.virtual.composition import SceneSpec
from workbench.virtual.particles import CLUMPS
from workbench.virtual.render import render
from workbench.virtual.scene import build_scene

NOON = datetime(2020, 6, 21, 11, tzinfo=UTC)
SPEC = SceneSpec(
    name="wood",
    seed=3,
    crs="EPSG:25832",
    vertical_datum="DHHN2016",
    origin=(600000.0, 5300000.0),
    size=(40.0, 40.0),
    terrain={"base": 100.0},
    stands=[{"area": [(1, 1), (39, 1), (39, 39), (1, 39)], "species_group": "conifer", "age": "middle"}],
)


@pytest.fixture(scope="module")
def whole():
    return build_scene(SPEC)


@pytest.fixture(scope="module")
def parts(whole):
    """The same scene with memory for a tenth of its foliage."""
    everything = whole.grove.plants(np.arange(len(whole.trees))).clumps.nbytes
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forest, "fits", lambda clumps: False)
        patch.setitem(grove.Grove.__init__.__kwdefaults__, "most_bytes", everything // 10)
        yield build_scene(SPEC)


def _photograph(scene):
    camera = Camera("plain", 160, 160, 400.0, 400.0, 80.0, 80.0)
    return render(scene, camera, Pose.from_omega_phi_kappa((600020.0, 5300020.0, 200.0), 2, 1, 5), time=NOON)


def test_forgotten_trees_grow_again_as_they_were(whole, parts):
    first, second = _photograph(whole), _photograph(parts)
    np.testing.assert_array_equal(first.radiance, second.radiance)
    np.testing.assert_array_equal(first.tree_id, second.tree_id)
    np.testing.assert_array_equal(whole.trees.visible, parts.trees.visible)


def test_foliage_stays_within_its_memory(whole, parts):
    every = np.arange(len(parts.trees))
    everything = whole.grove.plants(every).clumps
    limit = everything.nbytes // 10
    for index in every[:: len(every) // 8]:
        plants = parts.grove.plants(np.array([index]))
        rows = slice(plants.row[index], plants.row[index] + int(plants.trees[index, CLUMPS]))
        number = int(plants.first[index])
        np.testing.assert_array_equal(
            plants.clumps[rows], everything[number : number + rows.stop - rows.start]
        )
        kept = [block.nbytes for block in parts.grove._blocks.values()]
        assert sum(kept) <= limit or len(kept) == 1  # One block of land is always held.


def test_truth_does_not_depend_on_its_strips(whole, monkeypatch):
    grid = Grid.from_bounds(whole.crs, whole.extent, 0.25)
    once = truth.scene_truth(whole, grid)
    monkeypatch.setattr(truth, "_MOST_SAMPLES", 60_000)
    strips = truth.scene_truth(whole, grid)
    for name in ("dsm", "dsm_mean", "dtm", "cover", "tree_id"):
        # Rounding of a coordinate may put one leaf of a hundred thousand into the neighbouring cell.
        assert np.mean(once[name].values != strips[name].values) < 1e-3, name
        assert np.median(np.abs(once[name].values - strips[name].values)) == 0, name


_LARGE = """
from pathlib import Path
from workbench.params import SimulateParameters
from workbench.virtual import build_scene, load_scene
from workbench.virtual.photograph import encode_photograph, take_photograph
from workbench.virtual.stage import conditions_of, flight_of, fly_scene
scene, settings = build_scene(load_scene("lake")), SimulateParameters()
change = {"camera": "MACS MAR", "frame": (4000, 3000), "gsd": 0.08, "strips": 1}
plan = flight_of(scene.spec.flight, settings, change)
flight = fly_scene(scene, plan, settings)
middle = flight.exposures[len(flight.exposures) // 2]
taken = take_photograph(scene, flight, middle, conditions_of(plan, settings))
encode_photograph(taken.pixels, b"", 93)
# Not ru_maxrss: that of a child begins with the peak of the process that started it.
status = Path("/proc/self/status").read_text()
print(int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e9)
"""


@pytest.mark.slow
def test_a_photograph_of_12_megapixels_needs_no_more_than_one_and_a_half_gigabytes():
    run = subprocess.run([sys.executable, "-c", _LARGE], capture_output=True, text=True, check=True)
    assert float(run.stdout) < 1.5
