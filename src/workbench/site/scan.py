"""Looking through a folder of photographs: which can be used, and which camera took each."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from workbench.cameras.exif import PhotographFacts, read_facts
from workbench.errors import SiteError
from workbench.photographs import count_bands, photograph_size, require_complete

SUFFIXES = frozenset({".jpg", ".jpeg", ".tif", ".tiff"})


class CameraKind(NamedTuple):
    """What tells one camera (with its lens and image format) from another."""

    make: str
    model: str
    serial: str
    focal_length: float
    width: int
    height: int
    bands: int
    folder: str


@dataclass(frozen=True)
class Found:
    """A file that may be a photograph."""

    name: str
    """Path below the folder of photographs, with forward slashes."""
    path: Path
    """The file."""
    facts: PhotographFacts
    """EXIF and XMP."""
    size: tuple[int, int]
    """Columns and rows; 0, 0 if unreadable."""
    bands: int
    """Bands of the image."""
    problem: str = ""
    """Why it cannot be used; empty if it can."""

    @property
    def folder(self) -> str:
        """Subfolder, empty for the folder of photographs itself."""
        return self.name.rpartition("/")[0]


def scan_photographs(folder: Path) -> list[Found]:
    """All JPEG and TIFF files below a folder, by name; damaged and repeated ones with their problem.

    Raises
    ------
    SiteError
        If the folder is missing or holds no such file.
    """
    if not folder.is_dir():
        raise SiteError(f"{folder}: no such folder of photographs.")
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    if not paths:
        raise SiteError(f"{folder}: holds no photograph ({', '.join(sorted(SUFFIXES))}).")
    found: list[Found] = []
    seen: dict[bytes, str] = {}
    for path in paths:
        item = _scan(path, path.relative_to(folder).as_posix())
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "blake2b").digest()
        if digest in seen and not item.problem:
            problem = f"the same file as {seen[digest]}: delete one of them"
            item = Found(item.name, path, item.facts, item.size, item.bands, problem)
        seen.setdefault(digest, item.name)
        found.append(item)
    return found


def number_cameras(found: Sequence[Found]) -> dict[str, tuple[str, CameraKind]]:
    """Identifier and kind of the camera of each readable photograph, by the photograph's name.

    Photographs of one make, model, serial number, focal length and size are of one camera. Where no
    serial number tells and they lie in several folders, folders that were filled one after the other
    are one camera (memory cards begin a new folder now and then); folders filled at the same time, or
    at unknown times, are the cameras of a rig.
    """
    readable = [item for item in found if item.size != (0, 0)]
    by_kind: dict[CameraKind, list[Found]] = defaultdict(list)
    for item in readable:
        by_kind[_kind(item, "")].append(item)
    kinds = {}
    for kind, items in by_kind.items():
        rig = not kind.serial and _at_once(items)
        for item in items:
            kinds[item.name] = kind._replace(folder=item.folder) if rig else kind
    identifiers = {kind: f"camera{n}" for n, kind in enumerate(sorted(set(kinds.values())), start=1)}
    return {name: (identifiers[kind], kind) for name, kind in kinds.items()}


def _scan(path: Path, name: str) -> Found:
    try:
        size, bands = photograph_size(path), count_bands(path)
    except SiteError:
        return Found(name, path, PhotographFacts(), (0, 0), 0, "not a readable image: copy it again")
    facts = read_facts(path)
    try:
        require_complete(path)
    except SiteError:
        return Found(name, path, facts, size, bands, "truncated or damaged: copy it again")
    return Found(name, path, facts, size, bands)


def _kind(item: Found, folder: str) -> CameraKind:
    facts = item.facts
    # 0 for unknown keeps kinds sortable; tenths of a millimetre absorb the rounding of zoom lenses.
    focal = 0.0 if facts.focal_length is None else round(facts.focal_length, 5)
    return CameraKind(facts.make, facts.model, facts.serial, focal, *item.size, item.bands, folder)


def _at_once(items: Sequence[Found]) -> bool:
    """Whether several folders were filled at overlapping times, or at times that are unknown."""
    times = defaultdict(list)
    for item in items:
        times[item.folder].append(item.facts.time)
    if len(times) == 1:
        return False
    spans = []
    for stamps in times.values():
        known = [
            stamp.astimezone(UTC) if stamp.tzinfo else stamp.replace(tzinfo=UTC) for stamp in stamps if stamp
        ]
        if len(known) < len(stamps):
            return True
        spans.append((min(known), max(known)))
    spans.sort()
    return any(later[0] <= earlier[1] for earlier, later in pairwise(spans))
