"""What dvc.yaml declares for a stage is all that it reads: without anything else it makes the same bytes."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from workbench.site.inputs import BESIDE, NAMED

ROOT = Path(__file__).parents[2]
SITE_FILES = ("site.yaml", "photographs.csv", "control.csv", "observations.csv")
pytestmark = pytest.mark.slow


def declared(verb: str) -> list[str]:
    """Products of the small site that a stage declares."""
    stage = YAML(typ="safe").load((ROOT / "dvc.yaml").read_text())["stages"][verb]
    paths = [path.replace("${item.site}", "pond") for path in stage["deps"]]
    own = [path for path in paths if path.startswith("data/products/pond/") and "/inputs/" not in path]
    # The index is computed from the orthophoto alone, by the same stage: it changes only with it.
    return own + [path.replace("ortho.tif", "gli.tif") for path in own if path.endswith("ortho.tif")]


@pytest.mark.parametrize(
    ("verb", "folder"),
    [
        ("mosaic", "mosaic"),
        ("reed", "reed"),
        ("trees", "trees"),
        ("assess", "assessment"),
        ("report", "report"),
    ],
)
def test_nothing_else_is_read(verb, folder, pond, run_verb, tmp_path):
    for path in declared(verb):
        target = tmp_path / path
        target.parent.mkdir(parents=True, exist_ok=True)
        copy = shutil.copytree if (pond / path).is_dir() else shutil.copy
        copy(pond / path, target)
    for metrics in (pond / "data/products/pond").glob("*/metrics.json"):
        # Every stage leaves it at its end; its presence says that the products beside it are complete.
        if metrics.parent.name != folder and (target := tmp_path / metrics.relative_to(pond)).parent.is_dir():
            shutil.copy(metrics, target)
    site = tmp_path / "data/sites/pond"
    site.mkdir(parents=True)
    original = pond / "data/sites/pond"
    (site / "photographs").symlink_to(original / "photographs")
    for name in SITE_FILES:
        shutil.copy(original / name, site)
    for name in BESIDE.get(verb, ()):
        if (original / name).exists() and not (site / name).exists():
            (site / name).parent.mkdir(exist_ok=True)
            shutil.copy(original / name, site / name)
    description = YAML(typ="safe").load((original / "site.yaml").read_text())
    named = {key: description[key] for keys in NAMED.values() for key in keys if description.get(key)}
    for key, name in named.items():
        if key in NAMED.get(verb, ()):
            shutil.copy(original / name, site / name)
        else:  # The site names it, and no stage but its own may look into it.
            (site / name).write_text("not for this stage")
    (site / "truth").mkdir(exist_ok=True)
    run_verb(verb, tmp_path)
    made, expected = (root / "data/products/pond" / folder for root in (tmp_path, pond))
    names = {path.name for path in expected.iterdir()} - {"run.json"}
    assert {path.name for path in made.iterdir()} - {"run.json"} == names
    different = [
        name for name in sorted(names) if (made / name).read_bytes() != (expected / name).read_bytes()
    ]
    assert not different
