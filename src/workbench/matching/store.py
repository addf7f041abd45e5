"""Disparities of all pairs in one packed file."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np

from workbench.errors import MatchingError
from workbench.matching.rectify import Rectification, RowOffsets

_FRACTION = 64  # Steps per pixel: finer than any matcher is accurate.
_INVALID = 65535
_DATE = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, eq=False)
class MatchedPair:
    """The result of matching one pair at one downscale."""

    name: str
    """Name of the pair."""
    downscale: int
    """How much the photographs were reduced."""
    rectification: Rectification
    """Geometry of the rectified pair."""
    disparity: np.ndarray
    """(rows, columns) float32, px, NaN where nothing was matched."""
    confidence: np.ndarray
    """(rows, columns) uint8, 0..255."""


@dataclass(frozen=True, eq=False)
class StoredPair:
    """A pair on disk: its geometry at once, its disparities when they are needed."""

    rectification: Rectification
    """Geometry of the rectified pair."""
    load: Callable[[], MatchedPair]
    """Reads the whole pair."""


def save_pair(pair: MatchedPair, path: Path) -> None:
    """Write one pair under a temporary name, then rename it; the same pair gives the same bytes."""
    scaled = np.rint(pair.disparity * _FRACTION)
    steps = np.where(np.isfinite(scaled) & (scaled >= 0) & (scaled < _INVALID), scaled, _INVALID)
    r = pair.rectification
    facts = {
        "name": pair.name,
        "downscale": pair.downscale,
        "rotation": r.rotation.tolist(),
        "centre": r.centre.tolist(),
        "focal": r.focal,
        "principal": list(r.principal),
        "base": r.base,
        "shift": r.shift,
        "disparities": r.disparities,
        "shape": list(r.shape),
        "rows": None if r.rows is None else [list(r.rows.coefficients), r.rows.lowest, r.rows.highest],
    }
    part = path.with_name(f".{path.name}.part")
    with zipfile.ZipFile(part, "w") as file:
        _write(file, "pair.json", json.dumps(facts).encode())
        _write(file, "disparity", _delta(steps.astype(np.uint16)).tobytes())
        _write(file, "confidence", pair.confidence.astype(np.uint8).tobytes())
    part.replace(path)


def load_pair(path: Path | IO[bytes]) -> MatchedPair:
    """Read one pair.

    Raises
    ------
    MatchingError
        If the file is damaged.
    """
    try:
        with zipfile.ZipFile(path) as file:
            facts = json.loads(file.read("pair.json"))
            rectification = _rectification(facts)
            shape = rectification.shape
            steps = np.frombuffer(file.read("disparity"), np.uint16).reshape(shape)
            confidence = np.frombuffer(file.read("confidence"), np.uint8).reshape(shape)
    except (zipfile.BadZipFile, KeyError, ValueError, OSError) as error:
        raise MatchingError(f"{path}: damaged ({error}). Run `workbench match` again.") from error
    steps = np.cumsum(steps, axis=1, dtype=np.uint16)
    disparity = np.where(steps == _INVALID, np.nan, steps.astype(np.float32) / _FRACTION)
    return MatchedPair(
        facts["name"], facts["downscale"], rectification, disparity.astype(np.float32), confidence
    )


def stored_pair(path: Path) -> StoredPair:
    """A pair in a file of its own.

    Raises
    ------
    MatchingError
        If the file is damaged.
    """
    return StoredPair(_load_rectification(path, path), partial(load_pair, path))


class PairStore:
    """Reads single pairs from the packed file of a site.

    Raises
    ------
    MatchingError
        If the file is missing.
    """

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise MatchingError(f"{path}: missing. Run `workbench match` first.")
        self.path = path
        with zipfile.ZipFile(path) as file:
            self.names = tuple(file.namelist())

    @property
    def downscales(self) -> tuple[int, ...]:
        """Downscales that were matched, finest first."""
        return tuple(sorted({int(name.split("/")[0].removeprefix("ds")) for name in self.names}))

    def pairs(self, downscale: int) -> tuple[str, ...]:
        """Entries of a downscale."""
        return tuple(name for name in self.names if name.startswith(f"ds{downscale}/"))

    def load(self, entry: str) -> MatchedPair:
        """One pair."""
        with zipfile.ZipFile(self.path) as file, file.open(entry) as packed:
            return load_pair(packed)

    def stored(self, downscale: int) -> list[StoredPair]:
        """All pairs of a downscale, with their geometry."""
        with zipfile.ZipFile(self.path) as file:
            pairs = []
            for entry in self.pairs(downscale):
                with file.open(entry) as packed:
                    geometry = _load_rectification(packed, f"{self.path}: {entry}")
                pairs.append(StoredPair(geometry, partial(self.load, entry)))
        return pairs


def pack(files: Iterable[tuple[str, Path]], path: Path) -> None:
    """Put the files of single pairs into one, under a temporary name first."""
    part = path.with_name(f".{path.name}.part")
    with zipfile.ZipFile(part, "w", zipfile.ZIP_STORED) as packed:
        for name, source in files:
            packed.writestr(zipfile.ZipInfo(name, _DATE), source.read_bytes())
    part.replace(path)


def _load_rectification(source: Path | IO[bytes], name: Path | str) -> Rectification:
    try:
        with zipfile.ZipFile(source) as file:
            return _rectification(json.loads(file.read("pair.json")))
    except (zipfile.BadZipFile, KeyError, ValueError, OSError) as error:
        raise MatchingError(f"{name}: damaged ({error}). Run `workbench match` again.") from error


def _rectification(facts: Mapping[str, Any]) -> Rectification:
    rows, columns = facts["shape"]
    offsets = facts["rows"]
    return Rectification(
        np.array(facts["rotation"]),
        np.array(facts["centre"]),
        facts["focal"],
        (facts["principal"][0], facts["principal"][1]),
        facts["base"],
        facts["shift"],
        facts["disparities"],
        (rows, columns),
        None if offsets is None else RowOffsets(tuple(offsets[0]), offsets[1], offsets[2]),
    )


def _write(file: zipfile.ZipFile, name: str, data: bytes) -> None:
    entry = zipfile.ZipInfo(name, _DATE)
    entry.compress_type = zipfile.ZIP_DEFLATED
    file.writestr(entry, data, compresslevel=1)


def _delta(steps: np.ndarray) -> np.ndarray:
    """Differences along the rows, modulo 2^16: neighbours differ little, so that they pack well."""
    return np.diff(steps, axis=1, prepend=np.zeros((len(steps), 1), np.uint16))
