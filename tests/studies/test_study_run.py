"""A study on a small virtual flight: continued, extended, failed cells, the same bytes for two workers."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pandas as pd
import pytest
from distributed import LocalCluster

from workbench.errors import StudyError
from workbench.rasters import Grid, read_raster
from workbench.studies import responses, runner
from workbench.studies.design import Study, load_study
from workbench.studies.runner import estimate_study, run_study


def quiet(text):
    pass


SCENE = """
name: patch
seed: 3
crs: EPSG:25832
vertical_datum: DHHN2016
origin: [660000.0, 5300000.0]
size: [24.0, 16.0]
terrain: {base: 60.0, relief: 0.5, longest: 15.0}
boulders: 6
flight: {camera: 3K nadir, reduction: 16, gsd: 0.15, forward_overlap: 0.8, strips: 1, run_in: 0.2, wind: 0.0}
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "patch.yaml"
    path.write_text(SCENE)
    return path


def small_study(scene, **values):
    small = {"simulate.truth_resolution": 0.25, "simulate.supersampling": 1, "match.downscales": [1]}
    base = {
        "name": "open-land",
        "title": "Counts on open land",
        "scene": str(scene),
        "orientation": "truth",
        "factors": {"thin": [1, 2]},
        "fixed": small,
        "responses": ["geometry", "counts", "heights"],
    }
    return Study(**(base | values))


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return tmp_path_factory.mktemp("root")


@pytest.fixture(scope="module")
def result(root, scene):
    return run_study(small_study(scene), root, announce=quiet)


def test_leaving_photographs_out_opens_the_angle(result):
    value = result.table.set_index(["thin", "response"])["value"]
    assert value[1, "angle"] < value[2, "angle"]
    assert value[1, "photographs"] > value[2, "photographs"]
    assert value[1, "nmad_meadow"] < 0.22
    assert result.failed.empty
    assert (result.costs["seconds"] > 0).all()


def test_counts_are_those_of_the_scene_and_not_of_the_land_around_it(root, result):
    (truth,) = (root / "data" / "studies" / "steps").glob("simulate-*/data/sites/*/truth")
    counts = (root / "data" / "studies" / "steps").glob("surface-*/data/products/*/surface/count.tif")
    site = SimpleNamespace(truth=truth, name="patch")
    for path in counts:
        grid = Grid.of(read_raster(path))
        inside = responses._known(site, grid)
        assert inside.sum() * grid.resolution**2 == pytest.approx(24 * 16, rel=0.05)
        assert inside.size > 2 * inside.sum()


def test_files_say_what_was_done(result):
    table = pd.read_parquet(result.folder / "table.parquet")
    assert table.equals(result.table)
    design = json.loads((result.folder / "design.json").read_text())
    assert [cell["thin"] for cell in design["cells"]] == [1, 2]
    assert (result.folder / "environment.json").exists()


def test_a_finished_study_computes_nothing_and_an_added_level_only_what_is_new(
    root, scene, result, monkeypatch
):
    before = (result.folder / "table.csv").read_bytes()
    ran = []
    original = runner._run_step

    def counted(step, job):
        ran.append(step.verb)
        return original(step, job)

    monkeypatch.setattr(runner, "_run_step", counted)
    run_study(small_study(scene), root, announce=quiet)
    assert ran == []
    assert (result.folder / "table.csv").read_bytes() == before
    extended = run_study(small_study(scene, factors={"thin": [1, 2, 3]}), root, announce=quiet)
    assert ran == ["orient", "match", "surface"]
    assert extended.table["thin"].unique().tolist() == [1, 2, 3]


def test_an_interrupted_study_continues_to_the_same_table(root, scene, result, tmp_path, monkeypatch):
    original = runner._run_step

    def stops(step, job):
        if step.verb == "surface":
            raise KeyboardInterrupt
        return original(step, job)

    monkeypatch.setattr(runner, "_run_step", stops)
    with pytest.raises(KeyboardInterrupt):
        run_study(small_study(scene), tmp_path, announce=quiet)
    monkeypatch.setattr(runner, "_run_step", original)
    # Two workers in processes of their own, on top of what one had done.
    again = run_study(small_study(scene), tmp_path, announce=quiet, workers=2)
    assert again.table.equals(run_study(small_study(scene), root, announce=quiet).table)


def test_the_cluster_that_the_environment_names_gives_the_same_table(scene, result, tmp_path, monkeypatch):
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        monkeypatch.setenv("DASK_SCHEDULER_ADDRESS", cluster.scheduler_address)
        seen = []
        monkeypatch.setattr(runner, "LocalCluster", lambda **_: seen.append("local"))
        one = {"thin": [2]}
        again = run_study(small_study(scene, factors=one), tmp_path, announce=quiet, workers=2)
    assert seen == []
    mine = result.table[result.table["thin"] == 2].reset_index(drop=True)
    assert again.failed.empty
    pd.testing.assert_frame_equal(again.table, mine)


@pytest.mark.slow
def test_a_study_killed_at_work_continues_to_the_same_table(scene, result, tmp_path):
    path = tmp_path / "open-land.yaml"
    study = small_study(scene).model_dump(mode="json", exclude_defaults=True)
    path.write_text(json.dumps(study))
    command = [sys.executable, "-m", "workbench.cli", "study", str(path), "--root", str(tmp_path)]
    steps = tmp_path / "data" / "studies" / "steps"
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as running:
        while running.poll() is None and not list(steps.glob("match-*/done.json")):
            time.sleep(0.05)
        running.send_signal(signal.SIGKILL)
    assert not (tmp_path / "data" / "studies" / "open-land" / "table.csv").exists()
    subprocess.run(command, check=True, capture_output=True)
    continued = tmp_path / "data" / "studies" / "open-land" / "table.csv"
    assert continued.read_bytes() == (result.folder / "table.csv").read_bytes()


def test_a_study_file_changed_while_it_runs_is_noticed(root, scene, result, tmp_path, monkeypatch):
    path = tmp_path / "open-land.yaml"
    path.write_text(json.dumps(small_study(scene).model_dump(mode="json", exclude_defaults=True)))
    original = runner._Runner.run

    def edited(self, cells, client):
        path.write_text(path.read_text() + "\n")
        return original(self, cells, client)

    monkeypatch.setattr(runner._Runner, "run", edited)
    with pytest.raises(StudyError, match=r"open-land.yaml was changed while"):
        run_study(load_study(path), root, announce=quiet)


def test_levels_that_set_several_values_and_strips_left_out(root, scene, result):
    both = small_study(
        scene,
        name="strips",
        factors={"flown": {"one": {"thin": 2}, "all": {}}, "strips": [1]},
    )
    table = run_study(both, root, announce=quiet).table
    known = result.table[result.table["response"] == "angle"].set_index("thin")["value"]
    ours = table[table["response"] == "angle"].set_index("flown")["value"]
    assert ours["one"] == known[2]
    assert ours["all"] == known[1]


def test_what_a_study_would_cost_is_estimated_from_what_was_measured(root, scene, result):
    costs = estimate_study(small_study(scene, factors={"thin": [1, 2, 4]}), root).set_index("step")
    assert costs["steps"].to_dict() == {"simulate": 1, "orient": 3, "match": 3, "surface": 3}
    assert costs["done"].to_dict() == {"simulate": 1, "orient": 2, "match": 2, "surface": 2}
    assert costs["seconds_left"]["match"] == pytest.approx(costs["seconds_each"]["match"])


def test_a_cell_that_fails_is_recorded_and_the_rest_goes_on(root, scene, result):
    failing = run_study(small_study(scene, factors={"thin": [1, 500]}), root, announce=quiet)
    assert failing.failed["thin"].tolist() == [500]
    assert "thin less" in failing.failed["error"][0]
    assert failing.table["thin"].unique().tolist() == [1]


def test_a_study_changed_while_it_runs_is_noticed(root, scene, result, monkeypatch):
    original = runner._Runner.run

    def changed(self, cells, client):
        outcome = original(self, cells, client)
        (self.folder / "design.json").write_text("{}")
        return outcome

    monkeypatch.setattr(runner._Runner, "run", changed)
    with pytest.raises(StudyError, match="changed while"):
        run_study(small_study(scene), root, announce=quiet)
