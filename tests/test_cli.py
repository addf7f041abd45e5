"""The command line: exit codes and messages."""

import subprocess
import sys

import pytest


def workbench(*words, cwd=None):
    return subprocess.run(
        [sys.executable, "-m", "workbench.cli", *map(str, words)], capture_output=True, text=True, cwd=cwd
    )


def test_environment_names_every_library():
    result = workbench("environment")
    assert result.returncode == 0
    for library in ("numpy", "pycolmap", "opencv-python-headless", "processor", "cores"):
        assert f"{library}: " in result.stdout


def test_wrong_usage_is_two(tmp_path):
    assert workbench("orient", cwd=tmp_path).returncode == 2
    assert workbench("unknown", cwd=tmp_path).returncode == 2


@pytest.mark.parametrize(
    "verb", ["orient", "match", "surface", "mosaic", "reed", "trees", "assess", "report", "run", "check"]
)
def test_a_site_that_does_not_exist_is_one_and_says_what_to_do(verb, tmp_path):
    result = workbench(verb, "--site", "nowhere", cwd=tmp_path)
    assert result.returncode == 1
    assert "new-site nowhere" in result.stderr
    assert "Traceback" not in result.stderr


def test_wrong_parameters_are_all_named(tmp_path):
    (tmp_path / "params.yaml").write_text("orient:\n  seed: -1\n  sead: 2\nsurface:\n  min_count: many\n")
    result = workbench("where", "--root", tmp_path)
    assert result.returncode == 1
    for field in ("orient.seed", "orient.sead", "surface.min_count"):
        assert field in result.stderr


def test_a_folder_without_photographs_is_named(tmp_path):
    result = workbench("new-site", "empty", "--photos", tmp_path, "--root", tmp_path)
    assert result.returncode == 1
    assert str(tmp_path) in result.stderr
