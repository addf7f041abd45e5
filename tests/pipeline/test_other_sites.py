"""Sites unlike the embedded example: oriented from what they have, all from one small virtual flight."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rasterio

from workbench.cameras import Camera
from workbench.matching.pairs import select_pairs
from workbench.orientation import orient_site, read_block
from workbench.photographs import read_photograph
from workbench.site import find_strips, load_site, new_site
from workbench.site.files import render_photographs

pytestmark = pytest.mark.slow


def errors_of_poses(site, truth: Path) -> np.ndarray:
    """Adjusted minus true projection centres (n, 3), metres, of the photographs by their stems."""
    found = pd.read_csv(site.products / "orientation" / "cameras.csv")
    true = pd.read_csv(truth / "poses.csv").set_index("photo")
    assert found["registered"].all()
    names = [Path(name).stem for name in found["photo"]]
    return found[["x", "y", "z"]].to_numpy() - true.loc[names, ["x", "y", "z"]].to_numpy()


@pytest.fixture
def copy(pond, tmp_path):
    """The small site in a root of its own, nothing processed."""
    shutil.copytree(pond / "data/sites/pond", tmp_path / "data/sites/pond")
    return load_site("pond", tmp_path)


def test_control_alone_places_photographs_without_positions(copy, pond_parameters):
    blind = tuple(replace(p, position=None, position_sd=None, attitude=None) for p in copy.photographs)
    site = replace(copy, photographs=blind)
    metrics = orient_site(site, pond_parameters)
    assert metrics["registered"] == len(blind)
    # Targets are pointed at to a sixth of a pixel of 6 cm, and surveyed to 1.5 cm. They fill a part of
    # this small block: poses beyond them bend, which no check point there can see.
    assert metrics["check_rms_xy_m"] < 0.1
    assert metrics["check_rms_z_m"] < 0.5
    assert metrics["gnss_rms_m"] is None


def test_names_with_spaces_in_folders(copy, pond_parameters, tmp_path):
    listing = []
    for p in copy.photographs:
        name = f"first flight/{p.name.replace('_', ' ')}"
        (tmp_path / "moved/first flight").mkdir(parents=True, exist_ok=True)
        shutil.copy(p.path, tmp_path / "moved" / name)
        listing.append(replace(p, name=name, path=tmp_path / "moved" / name))
    site = replace(copy, photographs=tuple(listing), observations=(), control=())
    metrics = orient_site(site, pond_parameters)
    assert metrics["registered"] == len(listing)
    assert [p.name for p in read_block(site.products / "orientation", site)] == sorted(
        p.name for p in listing
    )


def test_two_cameras_in_one_block(copy, pond_parameters, tmp_path):
    """Every second photograph is enlarged by a half: another sensor behind the same lens."""
    (tmp_path / "mixed").mkdir()
    old = copy.cameras[copy.photographs[0].camera]
    width, height = round(old.width * 1.5), round(old.height * 1.5)
    large = Camera(
        "large",
        *(width, height),
        *(old.focal_x * width / old.width, old.focal_y * height / old.height),
        *(old.principal_x * width / old.width, old.principal_y * height / old.height),
        old.distortion,
    )
    photographs = []
    for place, p in enumerate(copy.photographs):
        path = tmp_path / "mixed" / p.name
        if place % 2:
            import cv2

            image = cv2.imread(str(p.path))
            cv2.imwrite(str(path), cv2.resize(image, (width, height), interpolation=cv2.INTER_CUBIC))
        else:
            shutil.copy(p.path, path)
        photographs.append(replace(p, path=path, camera="large" if place % 2 else p.camera))
    site = replace(
        copy,
        photographs=tuple(photographs),
        cameras=copy.cameras | {"large": large},
        observations=(),
        control=(),
    )
    metrics = orient_site(site, pond_parameters)
    assert metrics["registered"] == len(photographs)
    assert len(metrics["focal_length_px"]) == 2
    assert np.abs(errors_of_poses(site, copy.truth)).max() < 0.5


def test_near_infrared_of_16_bit(copy, pond_parameters, tmp_path):
    """Four bands, 16 bit, as mapping cameras deliver them: oriented like the JPEG they were made from."""
    folder = tmp_path / "cir"
    folder.mkdir()
    rows = []
    for p in copy.photographs:
        bands = np.moveaxis(read_photograph(p.path), -1, 0).astype(np.uint16) * 64
        four = np.concatenate([bands, bands[1:2]])
        path = folder / f"{p.path.stem}.tif"
        profile = {"width": four.shape[2], "height": four.shape[1], "count": 4, "dtype": "uint16"}
        with rasterio.open(path, "w", driver="GTiff", **profile) as target:
            target.write(four)
        rows.append(replace(p, name=path.name, path=path, bands=4))
    site = replace(copy, photographs=tuple(rows), observations=(), control=())
    metrics = orient_site(site, pond_parameters)
    assert metrics["registered"] == len(rows)
    assert np.abs(errors_of_poses(site, copy.truth)).max() < 0.5


def test_photographs_in_any_order_have_pairs(copy, pond, pond_parameters):
    """A kite: neighbours in time do not neighbour each other, so that strips mean nothing."""
    shuffled = [copy.photographs[k] for k in np.random.default_rng(5).permutation(len(copy.photographs))]
    strips, orders = find_strips([p.position[:2] for p in shuffled])
    anywhere = [replace(p, strip=s, order=o) for p, s, o in zip(shuffled, strips, orders, strict=True)]
    table = render_photographs(sorted(anywhere, key=lambda p: p.name))
    (copy.folder / "photographs.csv").write_text(table, encoding="utf-8")
    kite = load_site("pond", copy.root)
    block = read_block(pond / "data/products/pond/orientation", kite)
    ground = float(np.median(block.tie_points[:, 2]))
    pairs = select_pairs(block, inflight=1, across=False, ground=ground)
    assert {name for pair in pairs for name in (pair.left.name, pair.right.name)} == {p.name for p in block}
    seen = sum(pair.left.sees(block.tie_points) & pair.right.sees(block.tie_points) for pair in pairs)
    assert (np.asarray(seen) >= 1).mean() > 0.95


def test_photographs_without_exif_and_with_control_as_a_user_gives_them(copy, pond_parameters, tmp_path):
    """From files alone: no EXIF, no navigation; the camera is answered in site.yaml."""
    photos = tmp_path / "plain"
    photos.mkdir()
    for p in copy.photographs:
        from PIL import Image

        with Image.open(p.path) as image:
            image.save(photos / p.name, quality=97)
    root = tmp_path / "user"
    site = new_site(
        "mine",
        photos=photos,
        root=root,
        crs="EPSG:25832",
        vertical_datum="DHHN2016",
        control=copy.folder / "control.csv",
        observations=copy.folder / "observations.csv",
    )
    assert any("focal_length_mm is open" in question for question in site.unanswered)
    description = site.folder / "site.yaml"
    camera = copy.cameras[copy.photographs[0].camera]
    terms = json.dumps([round(value, 6) for value in camera.distortion])
    text = description.read_text(encoding="utf-8")
    answers = f"    focal_length_px: {camera.focal_x}\n    distortion: {terms}\n"
    head, _, tail = text.partition("  camera1:\n")
    kept = [line for line in tail.splitlines() if "focal_length_px" not in line and "distortion:" not in line]
    description.write_text(head + "  camera1:\n" + answers + "\n".join(kept) + "\n", encoding="utf-8")
    site = load_site("mine", root)
    assert not site.unanswered
    metrics = orient_site(site, pond_parameters)
    assert metrics["registered"] == len(copy.photographs)
    assert metrics["check_rms_xy_m"] < 0.1
