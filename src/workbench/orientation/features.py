"""Features and matches, kept in a database so that an interrupted run goes on where it stopped."""

from __future__ import annotations

import hashlib
import shutil
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

import cv2
import numpy as np
import pycolmap

from workbench.cameras import Camera
from workbench.errors import OrientationError
from workbench.params import OrientParameters
from workbench.photographs import is_8_bit, read_photograph
from workbench.site import Photograph, Site
from workbench.stages import read_json, write_json

# Its own log repeats what metrics and errors say, hundreds of lines long.
pycolmap.logging.minloglevel = 2

_STAND_INS = "images"
_BYTES_PER_FEATURE = 160  # 128 of the descriptor, position and shape, and the pages of the database.
_BYTES_PER_MATCH = 4  # Eight, twice (raw and verified), for a quarter of the features.
# Matches are verified at random and depend on which pairs there are, so seed and neighbours count.
_DECISIVE = {"max_image_size", "first_octave", "max_features", "max_matches", "neighbours", "seed"}


def match_features(site: Site, parameters: OrientParameters, work: Path) -> Path:
    """Find features in all photographs and match the pairs that may overlap.

    What a database of the same options and the same photographs (by content) already holds is not
    computed again, wherever an earlier run was interrupted. Photographs may be added; a photograph
    that changed under its old name starts the database anew.

    Returns
    -------
    Path
        The COLMAP database.

    Raises
    ------
    OrientationError
        If a photograph has a camera whose questions are open, or the database cannot be written.
    """
    work.mkdir(parents=True, exist_ok=True)
    database = work / f"features-{_options_key(site, parameters)}.db"
    _require_room(site, parameters, work)
    folder = image_folder(site, work)
    _forget_changed(site, database)
    pycolmap.set_random_seed(parameters.seed)
    with _naming(database):
        _fill(site, database, folder, parameters)
    shutil.rmtree(work / _STAND_INS, ignore_errors=True)
    return database


def _fill(site: Site, database: Path, folder: Path, parameters: OrientParameters) -> None:
    """Photographs, features and verified matches, as far as the database does not hold them yet."""
    names = [photograph.name for photograph in site.photographs]
    pycolmap.Database.open(database).close()
    _rename(database, {quote(name): name for name in names})  # As an interruption may have left them.
    _import(site, database, folder)
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size = parameters.max_image_size
    options.num_threads = parameters.threads
    options.sift.max_num_features = parameters.max_features
    options.sift.first_octave = parameters.first_octave
    pycolmap.extract_features(database, folder, names, extraction_options=options, device=pycolmap.Device.cpu)
    pairs = database.with_name("pairs.txt")
    candidates = candidate_pairs(site.photographs, parameters.neighbours)
    pairs.write_text("\n".join(f"{quote(names[i])} {quote(names[j])}" for i, j in candidates))
    matching = pycolmap.FeatureMatchingOptions()
    # The random samples of the verification depend on which thread takes which pair: one thread only.
    matching.num_threads = 1
    matching.max_num_matches = parameters.max_matches
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = parameters.seed
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = str(pairs)
    # A list of pairs is divided at spaces, which names of photographs may hold.
    _rename(database, {name: quote(name) for name in names})
    pycolmap.match_image_pairs(database, matching, pairing, verification, pycolmap.Device.cpu)
    _rename(database, {quote(name): name for name in names})


def _require_room(site: Site, parameters: OrientParameters, work: Path) -> None:
    """COLMAP ends the whole process when the disk is full, so that room is asked for before."""
    count = len(site.photographs)
    pairs = count * min(parameters.neighbours, count - 1)
    needed = parameters.max_features * (count * _BYTES_PER_FEATURE + pairs * _BYTES_PER_MATCH)
    free = shutil.disk_usage(work).free
    if free < needed:
        raise OrientationError(
            f"{work}: {free / 1e6:.0f} MB are free, features and matches of {count} photographs take up to "
            f"{needed / 1e6:.0f} MB. Free space, choose another root, or lower orient.max_features."
        )


@contextmanager
def _naming(database: Path) -> Iterator[None]:
    """Say which file failed: COLMAP tells neither a full disk nor a damaged file apart."""
    try:
        yield
    except RuntimeError as error:
        raise OrientationError(
            f"{database}: cannot be written or read ({error}). Free space or choose another root; if there "
            "is room, delete the file: features are then sought anew."
        ) from error


def candidate_pairs(photographs: tuple[Photograph, ...], neighbours: int) -> list[tuple[int, int]]:
    """Index pairs worth matching: the nearest ones by position, and everything with a photograph without.

    In a rig, photographs of one exposure stand at one place; each of them keeps its own neighbours.
    """
    pairs: set[tuple[int, int]] = set()
    placed = [k for k, p in enumerate(photographs) if p.position is not None]
    for k, p in enumerate(photographs):
        if p.position is None:
            pairs |= {(min(k, m), max(k, m)) for m in range(len(photographs)) if m != k}
    if len(placed) > 1:
        xy = np.array([p.position[:2] for p in photographs if p.position is not None])
        cameras = np.array([photographs[k].camera for k in placed])
        for place, k in enumerate(placed):
            distance = np.hypot(*(xy - xy[place]).T)
            distance[place] = np.inf
            for camera in np.unique(cameras):
                near = np.flatnonzero(cameras == camera)
                near = near[np.argsort(distance[near], kind="stable")][:neighbours]
                others = [placed[m] for m in near if np.isfinite(distance[m])]
                pairs |= {(min(k, m), max(k, m)) for m in others}
    return sorted(pairs)


def image_folder(site: Site, work: Path) -> Path:
    """Folder that all photographs lie below; their names are relative to it.

    COLMAP takes 16 bit by their upper half, which leaves a sensor of 12 or 14 bit dark, and not every
    number of bands: where there are such photographs, a folder of stand-ins takes the place, with links
    to those that need none.
    """
    first = site.photographs[0]
    own = Path(str(first.path)[: -len(first.name)]) if first.name else first.path.parent
    if all(_is_plain(photograph) for photograph in site.photographs):
        return own
    folder = work / _STAND_INS
    for photograph in site.photographs:
        target = folder / photograph.name
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.is_symlink() or target.exists():
            target.unlink()
        if _is_plain(photograph):
            target.symlink_to(photograph.path.resolve())
        else:
            cv2.imwrite(str(target), _grey(photograph.path))
    return folder


def _is_plain(photograph: Photograph) -> bool:
    if photograph.path.suffix.lower() in (".jpg", ".jpeg"):
        return True
    return photograph.bands <= 3 and is_8_bit(photograph.path)


def _grey(path: Path) -> np.ndarray:
    """Mean of the first three bands, 8 bit, from the 0.5th to the 99.5th percentile."""
    image = read_photograph(path)[..., :3].astype(np.float32).mean(axis=-1)
    low, high = np.percentile(image, (0.5, 99.5))
    return np.clip((image - low) * (255 / max(high - low, 1.0)) + 0.5, 0, 255).astype(np.uint8)


def colmap_camera(camera: Camera) -> list[float]:
    """Parameters of COLMAP's OPENCV model: fx, fy, cx, cy, k1, k2, p1, p2.

    The tangential terms stand in for the principal point, which the adjustment holds: without them
    the block of a drone camera that corrects its own lens bends by several centimetres.
    """
    return [
        *(camera.focal_x, camera.focal_y, camera.principal_x, camera.principal_y),
        *camera.distortion[:4],
    ]


def _import(site: Site, database: Path, folder: Path) -> None:
    """Cameras and photographs in a fixed order: their numbers, and so the result, depend on it."""
    by_camera: dict[str, list[str]] = defaultdict(list)
    for photograph in site.photographs:
        by_camera[photograph.camera].append(photograph.name)
    for identifier in sorted(by_camera):
        if identifier not in site.cameras:
            raise OrientationError(
                f"{site.folder / 'site.yaml'}: camera '{identifier}' has open questions; answer them first."
            )
        options = pycolmap.ImageReaderOptions()
        options.camera_model = "OPENCV"
        options.camera_params = ",".join(f"{v:.10g}" for v in colmap_camera(site.cameras[identifier]))
        pycolmap.import_images(
            database, folder, pycolmap.CameraMode.SINGLE, sorted(by_camera[identifier]), options
        )
    handle = pycolmap.Database.open(database)
    for camera in handle.read_all_cameras():
        camera.has_prior_focal_length = True
        handle.update_camera(camera)
    handle.close()


def _rename(database: Path, names: Mapping[str, str]) -> None:
    """Give photographs of the database other names; those that keep theirs are not touched."""
    changed = {old: new for old, new in names.items() if old != new}
    if not changed:
        return
    handle = pycolmap.Database.open(database)
    for image in handle.read_all_images():
        if image.name in changed:
            image.name = changed[image.name]
            handle.update_image(image)
    handle.close()


def _forget_changed(site: Site, database: Path) -> None:
    """Delete a database that was made from other pixels; note what this one is made from."""
    record = database.with_suffix(".json")
    known = read_json(record) if record.exists() else {}
    now = {photograph.name: _digest(photograph.path) for photograph in site.photographs}
    if any(known.get(name, digest) != digest for name, digest in now.items()):
        database.unlink(missing_ok=True)
        known = {}
    write_json(known | now, record)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "blake2b").hexdigest()[:32]


def _options_key(site: Site, parameters: OrientParameters) -> str:
    """Names what the content of a database depends on, beside the photographs that it lists itself."""
    cameras = {name: colmap_camera(camera) for name, camera in sorted(site.cameras.items())}
    options = parameters.model_dump(include=_DECISIVE)
    text = f"{sorted(options.items())} {cameras}"
    return hashlib.blake2b(text.encode(), digest_size=6).hexdigest()
