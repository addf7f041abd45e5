"""The camera table: sensor widths of known models. EXIF does not tell them, or tells them wrong."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from importlib.resources import files


@dataclass(frozen=True)
class SensorModel:
    """A known camera."""

    make: str
    """Maker as in EXIF."""
    model: str
    """Model as in EXIF."""
    sensor_width: float
    """Width of the whole sensor, metres."""
    pixels_wide: int
    """Columns of a full-width photograph."""
    focal_length: float | None
    """Metres, where the lens is fixed or usual."""


def find_sensor(make: str, model: str) -> SensorModel | None:
    """The table's entry of a make and model as EXIF gives them, or None if it is not known.

    Capitals, spaces and punctuation do not matter, nor a make that the model repeats.
    """
    return _table().get(_key(make, model))


@cache
def _table() -> dict[str, SensorModel]:
    text = files("workbench.cameras").joinpath("sensors.csv").read_text(encoding="utf-8")
    entries = {}
    for row in csv.DictReader(text.splitlines()):
        focal = float(row["focal_mm"]) / 1000 if row["focal_mm"] else None
        entries[_key(row["make"], row["model"])] = SensorModel(
            row["make"], row["model"], float(row["sensor_width_mm"]) / 1000, int(row["pixels_wide"]), focal
        )
    return entries


def _key(make: str, model: str) -> str:
    def plain(text: str) -> str:
        return "".join(sign for sign in text.lower() if sign.isalnum())

    maker = plain(make.split()[0]) if make.split() else ""
    return f"{maker} {plain(model).removeprefix(maker)}"
