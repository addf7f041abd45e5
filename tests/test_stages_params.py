"""Stages and parameters: what a run leaves beside its products, and what params.yaml accepts."""

import json
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from workbench.errors import ParameterError, SiteError
from workbench.params import (
    Parameters,
    ReedParameters,
    load_parameters,
    render_parameters,
    update_parameters,
)
from workbench.stages import FOLDERS, open_stage, read_json, write_json

ROOT = Path(__file__).parents[1]


# ---------------------------------------------------------------------------- stages


def test_a_stage_describes_its_run(tmp_path):
    folder = tmp_path / "lake" / "reed"
    with open_stage(folder, {"reed": ReedParameters()}) as stage:
        assert not stage.path("metrics.json").exists()
        stage.metrics["area_m2"] = np.float64(12.5)
        stage.metrics["missing"] = float("nan")
        stage.metrics["list"] = np.arange(3)
    assert read_json(folder / "metrics.json") == {"area_m2": 12.5, "missing": None, "list": [0, 1, 2]}
    assert read_json(folder.parent / "metrics" / "reed.json")["area_m2"] == 12.5
    run = read_json(folder / "run.json")
    assert run["seconds"] >= 0 and run["peak_memory_mb"] > 10
    resolved = YAML(typ="safe").load((folder / "parameters.yaml").read_text())
    assert resolved == {"reed": ReedParameters().model_dump(mode="json")}


def test_an_interrupted_stage_has_no_metrics(tmp_path):
    folder = tmp_path / "lake" / "reed"
    with open_stage(folder, {}) as stage:
        stage.metrics["n"] = 1
    with pytest.raises(KeyboardInterrupt), open_stage(folder, {}):
        raise KeyboardInterrupt
    assert not (folder / "metrics.json").exists()
    with pytest.raises(SiteError, match="workbench reed --site lake"):
        read_json(folder / "metrics.json")


def test_folder_of_a_stage_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(SiteError, match="cannot be written"), open_stage(tmp_path / "file" / "reed", {}):
        pass
    with pytest.raises(SiteError, match="cannot be written"):
        write_json({}, tmp_path / "file" / "a.json")


def test_metrics_are_plain_json(tmp_path):
    write_json({"path": {1: (1, 2)}, "flag": np.bool_(True), "inf": np.inf}, tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_text()) == {"path": {"1": [1, 2]}, "flag": True, "inf": None}


# ---------------------------------------------------------------------------- parameters


def test_params_yaml_of_the_repository_is_complete():
    # Every value stands in the file with its comment: writing it anew changes nothing.
    path = ROOT / "params.yaml"
    assert path.read_text(encoding="utf-8") == render_parameters(load_parameters(path))


def test_every_parameter_has_unit_and_source():
    def check(section, where):
        for name, field in section.model_fields.items():
            if hasattr(field.annotation, "model_fields"):
                check(field.annotation, f"{where}.{name}")
                continue
            extra = field.json_schema_extra or {}
            assert field.description and extra.get("unit") and extra.get("source"), f"{where}.{name}"

    for stage in FOLDERS:
        check(Parameters.model_fields[stage].annotation, stage)


def test_written_defaults_are_read_as_defaults(tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text(render_parameters(Parameters()))
    assert load_parameters(path) == Parameters()
    path.write_text("")
    assert load_parameters(path) == Parameters()


def test_all_problems_at_once_with_their_paths(tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text("orient:\n  seed: -1\n  sead: 3\n  threads: many\nnonsense: 1\n")
    with pytest.raises(ParameterError) as caught:
        load_parameters(path)
    text = str(caught.value)
    assert "4 problem(s)" in text
    for field in ("orient.seed", "orient.sead", "orient.threads", "nonsense"):
        assert field in text
    assert "params.yaml" in text and "-1" in text


@pytest.mark.parametrize("content", ["a: [1, 2", "- a list", "orient: 3"])
def test_files_that_are_no_parameters(tmp_path, content):
    path = tmp_path / "params.yaml"
    path.write_text(content)
    with pytest.raises(ParameterError, match=r"params\.yaml"):
        load_parameters(path)
    with pytest.raises(ParameterError, match="no such file"):
        load_parameters(tmp_path / "none.yaml")


def test_changing_a_value_keeps_comments_and_names_the_stage(tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text(render_parameters(Parameters()))
    before = path.read_text().splitlines()
    assert update_parameters(path, {"orient.seed": 7}) == ("orient",)
    assert load_parameters(path).orient.seed == 7
    after = path.read_text().splitlines()
    assert [line for line in after if line not in before] == ["  seed: 7"]
    assert len(after) == len(before)
    assert update_parameters(path, {"orient.seed": 7}) == ()


def test_a_wrong_change_leaves_the_file(tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text(render_parameters(Parameters()))
    before = path.read_text()
    for change in ({"orient.seed": -1}, {"orient.sead": 1}, {"nothing.at_all": 1}):
        with pytest.raises(ParameterError):
            update_parameters(path, change)
        assert path.read_text() == before
