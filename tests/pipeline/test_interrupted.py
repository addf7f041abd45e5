"""Every stage killed at a random moment and started again, and every stage on a full or protected disk."""

from __future__ import annotations

import hashlib
import os
import random
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from workbench.stages import FOLDERS, read_json

pytestmark = pytest.mark.slow


def before(verb: str, pond: Path, root: Path) -> Path:
    """A root in which everything before a stage is done; the folder of the stage, which is not there."""
    (root / "data").mkdir(parents=True)
    shutil.copy(pond / "params.yaml", root)
    (root / "data/sites").symlink_to(pond / "data/sites")
    products = root / "data/products/pond"
    done = list(FOLDERS)[: list(FOLDERS).index(verb)]
    for earlier in done:
        shutil.copytree(pond / "data/products/pond" / FOLDERS[earlier], products / FOLDERS[earlier])
    products.mkdir(parents=True, exist_ok=True)
    return products / FOLDERS[verb]


def digests(folder: Path) -> dict[str, str]:
    """Digest of every file of a stage but for what a run takes, and features that continue to grow."""
    return {
        path.relative_to(folder).as_posix(): hashlib.blake2b(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "run.json" and "work" not in path.relative_to(folder).parts
    }


def command(verb: str, root: Path, **options) -> subprocess.Popen:
    words = [sys.executable, "-m", "workbench.cli", verb, "--site", "pond", "--root", str(root)]
    return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, **options)


@pytest.mark.parametrize("verb", list(FOLDERS))
def test_a_stage_that_was_killed_ends_with_the_same_bytes(verb, pond, run_verb, tmp_path):
    folder = before(verb, pond, tmp_path / "root")
    original = pond / "data/products/pond" / FOLDERS[verb]
    moment = random.Random(verb).uniform(0.1, 0.9) * read_json(original / "run.json")["seconds"]
    process = command(verb, tmp_path / "root")
    while not (folder / "parameters.yaml").exists() and process.poll() is None:
        time.sleep(0.01)
    time.sleep(moment)
    process.kill()
    process.communicate()
    if process.returncode == 0:
        # It was done earlier than the first time: what is left is the state just before its last write.
        (folder / "metrics.json").unlink()
    assert not (folder / "metrics.json").exists()
    run_verb(verb, tmp_path / "root")
    assert digests(folder) == digests(original)
    assert not [path.name for path in folder.glob(".*")]


@pytest.mark.parametrize("verb", list(FOLDERS))
def test_a_disk_without_room_is_named_with_a_remedy(verb, pond, tmp_path):
    before(verb, pond, tmp_path / "root")

    def no_large_files() -> None:
        # The system refuses to let any file grow beyond this, as a full disk would.
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))

    process = command(verb, tmp_path / "root", preexec_fn=no_large_files)
    _, message = process.communicate()
    assert process.returncode == 1, message
    assert "Traceback" not in message
    assert str(tmp_path / "root") in message.replace("\n", "")
    assert "room" in message or "space" in message


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write everywhere")
@pytest.mark.parametrize("verb", list(FOLDERS))
def test_a_protected_folder_is_named_with_a_remedy(verb, pond, tmp_path):
    folder = before(verb, pond, tmp_path / "root")
    folder.parent.chmod(0o500)
    process = command(verb, tmp_path / "root")
    _, message = process.communicate()
    folder.parent.chmod(0o700)
    assert process.returncode == 1
    assert str(folder) in message.replace("\n", "")
    assert "choose another root" in message
