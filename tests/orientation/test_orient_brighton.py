"""Six real photographs: registered, the same bytes with one and two threads, and resumed after a kill."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from workbench.orientation import orient_site, read_block
from workbench.orientation.features import match_features
from workbench.params import OrientParameters, Parameters
from workbench.site import load_site, new_site

DATA = Path(os.environ.get("WORKBENCH_DATA", Path(__file__).parents[3] / "shared" / "data"))
PHOTOGRAPHS = DATA / "brighton_beach" / "images"
pytestmark = pytest.mark.skipif(not PHOTOGRAPHS.is_dir(), reason=f"{PHOTOGRAPHS} is not here")

OPTIONS = OrientParameters(threads=1, max_image_size=1000)
# Two strips over the park and the beach; the forest hardly matches at this size.
CHOSEN = (24, 25, 26, 32, 33, 34)
KILLED = """
import sys
from pathlib import Path
from workbench.orientation.features import match_features
from workbench.params import OrientParameters
from workbench.site import load_site
options = OrientParameters(threads=1, max_image_size=1000)
match_features(load_site("beach", Path(sys.argv[1])), options, Path(sys.argv[2]))
"""


@pytest.fixture(scope="module")
def beach(tmp_path_factory):
    root = tmp_path_factory.mktemp("beach")
    photographs = root / "six"
    photographs.mkdir()
    for number in CHOSEN:
        name = f"DJI_{number:04d}.JPG"
        (photographs / name).symlink_to(PHOTOGRAPHS / name)
    new_site("beach", photos=photographs, root=root, vertical_datum="barometric")
    return load_site("beach", root)


def orient(site, options):
    return orient_site(site, Parameters().model_copy(update={"orient": options}))


def products(site):
    folder = site.products / "orientation"
    names = ("cameras.csv", "tie_points.laz", "sparse/images.bin", "sparse/points3D.bin", "metrics.json")
    return {name: (folder / name).read_bytes() for name in names}


def test_registered_resumed_and_the_same_with_two_threads(beach, tmp_path):
    metrics = orient(beach, OPTIONS)
    assert metrics["registered"] == metrics["photos"] == 6
    # Key points are found at a quarter of the width: a quarter of the precision of the full photograph.
    assert metrics["reprojection_error_px"] < 4 * 0.85
    assert metrics["focal_length_px"]["1"] == pytest.approx(2340, abs=2)
    assert any("focal length" in warning for warning in metrics["warnings"])
    assert len(read_block(beach.products / "orientation", beach)) == 6
    first = products(beach)

    # Killed while features are being found; the second run goes on and ends with the same bytes.
    again = replace(beach, name="again")
    work = again.products / "orientation" / "work"
    run = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(beach.root), str(work)], stderr=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 60
    while not list(work.glob("features-*.db")) and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(1.0)
    run.kill()
    run.wait()
    orient(again, OPTIONS.model_copy(update={"threads": 2}))
    assert products(again) == first


def test_changed_photograph_starts_anew(beach, tmp_path):
    two = tuple(beach.photographs[:2])
    site = replace(beach, photographs=two)
    database = match_features(site, OPTIONS, tmp_path)
    before = database.stat().st_ino, database.stat().st_mtime_ns
    match_features(site, OPTIONS, tmp_path)
    assert database.stat().st_ino == before[0]
    record = database.with_suffix(".json")
    record.write_text(record.read_text().replace('": "', '": "0'), encoding="utf-8")
    match_features(site, OPTIONS, tmp_path)
    assert database.stat().st_ino != before[0] or database.stat().st_mtime_ns != before[1]
