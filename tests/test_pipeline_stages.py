"""dvc.yaml: a changed parameter reruns what depends on it, and nothing before it."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[1]
PACKAGES = (
    "virtual",
    "orientation",
    "matching",
    "surface",
    "mosaic",
    "reed",
    "trees",
    "assessment",
    "figures",
)
AFTER = {
    "orient": {"orient", "match", "surface", "mosaic", "reed", "trees", "assess", "report"},
    "match": {"match", "surface", "mosaic", "reed", "trees", "assess", "report"},
    "surface": {"surface", "mosaic", "reed", "trees", "assess", "report"},
    "mosaic": {"mosaic", "trees", "assess", "report"},
    "reed": {"reed", "report"},
    "trees": {"trees", "assess", "report"},
    "assess": {"assess", "report"},
    "report": {"report"},
}
"""Stages that a change of each stage's parameters reruns."""

FAKE = """
import json, pathlib, re, sys
# Stands in for every verb: writes what dvc.yaml expects, from its parameters and what came before.
verb = sys.argv[1]
name = sys.argv[sys.argv.index("--site") + 1] if "--site" in sys.argv else sys.argv[2]
site, products = pathlib.Path("data/sites") / name, pathlib.Path("data/products") / name
folders = {
    "orient": ("orientation", "sparse/images.bin", None),
    "match": ("matching", "pairs.zip", "orient"),
    "surface": ("surface", "dsm.tif", "match"),
    "mosaic": ("mosaic", "ortho.tif", "surface"),
    "reed": ("reed", "reed.gpkg", "surface"),
    "trees": ("trees", "trees.gpkg", "mosaic"),
    "assess": ("assessment", "scores.csv", "trees"),
    "report": ("report", "report.html", "assess"),
}
def put(path, text="same"):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
if verb == "simulate":
    for file in ("photographs.csv", "control.csv", "observations.csv"):
        put(site / file)
    put(site / "site.yaml", "crs: 1\\nvertical_datum: a\\nphotographs: p\\ncameras: {c: 1}\\ndtm: null\\n")
else:
    parameters = pathlib.Path("params.yaml").read_text()
    text = re.search(rf"^{verb}:.*?(?=^\\S|\\Z)", parameters, re.M | re.S).group()
    folder, file, before = folders[verb]
    if before:
        text += (products / folders[before][0] / folders[before][1]).read_text()
    for product in (file, "dtm.tif", "metrics.json"):
        put(products / folder / product, text)
    put(products / "metrics" / f"{folder}.json", json.dumps({"length": len(text)}))
"""


@pytest.fixture(scope="module")
def pipeline(tmp_path_factory):
    """The repository's dvc.yaml with stand-ins for the verbs, run once."""
    folder = tmp_path_factory.mktemp("pipeline")
    text = (ROOT / "dvc.yaml").read_text().replace("cmd: workbench ", f"cmd: {sys.executable} fake.py ")
    (folder / "dvc.yaml").write_text(text)
    (folder / "fake.py").write_text(FAKE)
    shutil.copy(ROOT / "params.yaml", folder)
    for package in PACKAGES:
        (folder / "src/workbench" / package).mkdir(parents=True)
        (folder / "src/workbench" / package / "code.py").write_text("")
    run(folder, "git", "init", "-q")
    dvc(folder, "init", "-q")
    dvc(folder, "config", "core.analytics", "false")
    dvc(folder, "config", "core.check_update", "false")
    dvc(folder, "repro", "-q")
    return folder


def run(folder, *words):
    return subprocess.run(words, cwd=folder, check=True, capture_output=True, text=True).stdout


def dvc(folder, *words):
    return run(folder, sys.executable, "-m", "dvc", *words)


def rerun(folder) -> list[str]:
    out = dvc(folder, "repro")
    return [line.split("'")[1].split("@")[0] for line in out.splitlines() if line.startswith("Running stage")]


def test_nothing_changed_reruns_nothing(pipeline):
    assert rerun(pipeline) == []


@pytest.mark.parametrize(
    ("path", "value", "first"),
    [
        ("simulate.seed", 77, "simulate"),
        ("orient.neighbours", 13, "orient"),
        ("match.guide_below", 13.0, "match"),
        ("surface.min_patch", 2.0, "surface"),
        ("mosaic.seam_band", 0.2, "mosaic"),
        ("reed.min_height", 0.7, "reed"),
        ("trees.min_height", 4.0, "trees"),
        ("assess.gross_error", 0.7, "assess"),
    ],
)
def test_a_changed_parameter_reruns_its_stage_and_what_follows(pipeline, path, value, first):
    section, key = path.split(".")
    yaml = YAML()
    file = pipeline / "params.yaml"
    document = yaml.load(file.read_text())
    document[section][key] = value
    with file.open("w") as out:
        yaml.dump(document, out)
    ran = rerun(pipeline)
    if first == "simulate":
        # The stand-in simulates the same site for every seed: what follows is spared.
        assert ran == ["simulate"]
    else:
        assert sorted(ran) == sorted(AFTER[first])


def test_a_changed_site_reruns_only_what_reads_it(pipeline):
    site = pipeline / "data/sites/lake/site.yaml"
    site.write_text(site.read_text().replace("dtm: null", "dtm: lidar.tif"))
    status = dvc(pipeline, "status")
    assert "surface@lake" in status
    assert "orient@lake" not in status
    assert "match@lake" not in status
