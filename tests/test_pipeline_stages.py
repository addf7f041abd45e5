"""dvc.yaml: a change reruns what depends on it, and nothing else."""

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[1]
PACKAGES = (
    *("virtual", "site", "orientation", "matching", "surface", "mosaic"),
    *("reed", "trees", "assessment", "figures"),
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
# Stands in for every verb but `inputs`: what it writes depends on its parameters, on its list of inputs and
# on those products of earlier stages that the verb really reads.
verb = sys.argv[1]
name = sys.argv[sys.argv.index("--site") + 1] if "--site" in sys.argv else sys.argv[2]
site, products = pathlib.Path("data/sites") / name, pathlib.Path("data/products") / name
POSES = ("orientation/sparse/images.bin", "orientation/metrics.json")
VERBS = {
    "orient": ("orientation", ("sparse/images.bin",), ()),
    "match": ("matching", ("pairs.zip",), POSES),
    "surface": (
        "surface",
        ("dsm.tif", "dtm.tif", "ndsm.tif", "provenance.tif", "spread.tif"),
        (*POSES, "matching/pairs.zip"),
    ),
    "mosaic": ("mosaic", ("ortho.tif", "gli.tif"), (*POSES, "surface/dsm.tif", "surface/dtm.tif")),
    "reed": ("reed", ("reed.gpkg",), ("surface/dsm.tif", "surface/spread.tif")),
    "trees": (
        "trees",
        ("mask.tif", "trees.gpkg"),
        ("surface/ndsm.tif", "surface/provenance.tif", "surface/spread.tif", "mosaic/gli.tif"),
    ),
    "assess": ("assessment", ("scores.csv",), ("surface/dsm.tif", "trees/mask.tif", "trees/trees.gpkg")),
    "report": (
        "report",
        ("report.html",),
        tuple(f"{f}/metrics.json" for f in (
            "orientation", "matching", "surface", "mosaic", "reed", "trees", "assessment"
        )),
    ),
}
def put(path, text="same"):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
if verb == "simulate":
    put(site / "photographs.csv", "name,camera\\n")
    put(site / "site.yaml", "crs: EPSG:32633\\nvertical_datum: a\\n")
else:
    parameters = pathlib.Path("params.yaml").read_text()
    text = re.search(rf"^{verb}:.*?(?=^\\S|\\Z)", parameters, re.M | re.S).group()
    if verb == "surface":  # The surface counts the pairs that could have been matched.
        text += re.search(r"^  inflight:.*$", parameters, re.M).group()
    folder, files, reads = VERBS[verb]
    text += (products / "inputs" / f"{verb}.json").read_text()
    text += "".join((products / path).read_text() for path in reads)
    for product in (*files, "metrics.json"):
        put(products / folder / product, text)
    put(products / "metrics" / f"{folder}.json", json.dumps({"length": len(text)}))
"""

SITE_YAML = """crs: EPSG:32633
vertical_datum: DHHN2016
photographs: photographs
water_level: 517.93
shoreline: shoreline.geojson
plots: plots.csv
reference_trees: stems.csv
cameras:
  camera1: {width: 6000, height: 4000, focal_length_px: 8000}
"""
FILES = {
    "site.yaml": SITE_YAML,
    "photographs.csv": "name,camera,strip\na.jpg,camera1,0\nb.jpg,camera1,0\n",
    "photographs/a.jpg": "pixels",
    "photographs/b.jpg": "pixels",
    "control.csv": "name,x,y,z,sd_xy,sd_z,role\n",
    "observations.csv": "name,photo,column,row\n",
    "shoreline.geojson": "{}",
    "plots.csv": "aoi\n",
    "stems.csv": "x,y\n",
    "truth/cover.csv": "code,cover\n",
    "notes.txt": "read by nothing",
}


@pytest.fixture(scope="module")
def pipeline(tmp_path_factory):
    """The repository's dvc.yaml with stand-ins for the verbs, run once on a real site beside a scene."""
    folder = tmp_path_factory.mktemp("pipeline")
    text = (ROOT / "dvc.yaml").read_text()
    text = text.replace("cmd: workbench inputs", f"cmd: {sys.executable} -m workbench.cli inputs")
    (folder / "dvc.yaml").write_text(text.replace("cmd: workbench ", f"cmd: {sys.executable} fake.py "))
    (folder / "fake.py").write_text(FAKE)
    parameters = (ROOT / "params.yaml").read_text().replace("\nsites: [lake]\n", "\nsites: [mine]\n")
    assert "sites: [mine]" in parameters
    (folder / "params.yaml").write_text(parameters)
    for package in PACKAGES:
        (folder / "src/workbench" / package).mkdir(parents=True)
        (folder / "src/workbench" / package / "code.py").write_text("")
    for name, content in FILES.items():
        path = folder / "data/sites/mine" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
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


def test_every_verb_of_the_chain_is_a_stage():
    from workbench.stages import FOLDERS

    stages = YAML(typ="safe").load((ROOT / "dvc.yaml").read_text())["stages"]
    assert list(stages) == ["simulate", "inputs", *FOLDERS]
    # A scene is written where the chain looks for the site of its name.
    assert list(stages["simulate"]["outs"][0]) == ["data/sites/${item.scene}"]
    assert "data/sites/${item.site}" in stages["inputs"]["deps"]
    for verb, folder in FOLDERS.items():
        metrics = [name for entry in stages[verb]["metrics"] for name in entry]
        assert metrics == [f"data/products/${{item.site}}/metrics/{folder}.json"]


def test_nothing_changed_reruns_nothing_at_once(pipeline):
    started = time.monotonic()
    assert rerun(pipeline) == []
    # 1-2 s alone; the limit leaves room for a busy machine.
    assert time.monotonic() - started < 12


@pytest.mark.parametrize(
    ("path", "value", "first"),
    [
        ("simulate.seed", 77, "simulate"),
        ("orient.neighbours", 13, "orient"),
        ("match.guide_below", 13.0, "match"),
        ("match.inflight", 2, "match"),
        ("surface.min_patch", 2.0, "surface"),
        ("mosaic.seam_band", 0.2, "mosaic"),
        ("reed.min_height", 0.7, "reed"),
        ("trees.min_height", 4.0, "trees"),
        ("assess.gross_error", 0.7, "assess"),
        ("study.repetitions", 6, None),
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
        # No listed site is that of the scene: the chain is spared.
        assert ran == ["simulate"]
    else:
        assert sorted(ran) == sorted(AFTER.get(first, ()))


def test_a_changed_file_reruns_only_what_reads_it(pipeline):
    # Which files each stage reads is tested with the lists themselves (tests/site/test_inputs.py).
    site = pipeline / "data/sites/mine"
    (site / "notes.txt").write_text("still read by nothing")
    assert rerun(pipeline) == ["inputs"]
    (site / "plots.csv").write_text("aoi,stems\n")
    assert sorted(rerun(pipeline)) == ["inputs", "reed", "report"]


def test_lists_of_inputs_name_what_the_stages_declare():
    from workbench.site.inputs import BESIDE, NAMED, STATED

    assert {*NAMED, *BESIDE} <= set(STATED)
    text = (ROOT / "dvc.yaml").read_text()
    listed = re.findall(r"inputs/(\w+)\.json", text)
    assert sorted(listed) == sorted(STATED)
