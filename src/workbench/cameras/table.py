"""The camera table: sensor sizes of known models. EXIF does not tell them, or tells them wrong."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

_SAME_SHAPE = 0.01  # Relative difference of two aspect ratios that still are one: rounding of a resize.


@dataclass(frozen=True)
class SensorModel:
    """A known camera."""

    make: str
    """Maker as in EXIF."""
    model: str
    """Model as in EXIF."""
    sensor_width: float
    """Width of the whole sensor, metres."""
    sensor_height: float
    """Height of the whole sensor, metres."""
    pixels_wide: int
    """Columns of a photograph that uses the whole sensor."""
    pixels_high: int
    """Rows of a photograph that uses the whole sensor."""
    focal_length: float | None
    """Metres, where the lens is fixed or usual."""

    def pixel_size(self, width: int, height: int) -> float | None:
        """Edge of a pixel on the sensor for a photograph of ``width`` x ``height``, metres.

        Whole frames, frames cropped to another shape (16:9 of a 3:2 sensor), frames reduced as a
        whole, and each of them turned upright are recognised. Any other size gives None: whether it
        was cropped or resampled cannot be told, and the two differ in the focal length.
        """
        long, short = max(width, height), min(width, height)
        wide, high = max(self.pixels_wide, self.pixels_high), min(self.pixels_wide, self.pixels_high)
        pixel = self.sensor_width / self.pixels_wide
        if (long == wide and short <= high) or (short == high and long <= wide):
            return pixel
        shape = (long / short) / (wide / high)
        if long < wide and abs(shape - 1) < _SAME_SHAPE:
            return pixel * wide / long
        return None


def find_sensor(make: str, model: str) -> SensorModel | None:
    """The table's entry of a make and model as EXIF gives them, or None if it is not known.

    Capitals, spaces and punctuation do not matter, nor a make that the model repeats.
    """
    return _table().get(_key(make, model))


def known_sensors() -> tuple[SensorModel, ...]:
    """All entries of the camera table."""
    return tuple(_table().values())


@cache
def _table() -> dict[str, SensorModel]:
    text = files("workbench.cameras").joinpath("sensors.csv").read_text(encoding="utf-8")
    entries = {}
    for row in csv.DictReader(text.splitlines()):
        entries[_key(row["make"], row["model"])] = SensorModel(
            row["make"],
            row["model"],
            float(row["sensor_width_mm"]) / 1000,
            float(row["sensor_height_mm"]) / 1000,
            int(row["pixels_wide"]),
            int(row["pixels_high"]),
            float(row["focal_mm"]) / 1000 if row["focal_mm"] else None,
        )
    return entries


def _key(make: str, model: str) -> str:
    def plain(text: str) -> str:
        return "".join(sign for sign in text.lower() if sign.isalnum())

    maker = plain(make.split()[0]) if make.split() else ""
    return f"{maker} {plain(model).removeprefix(maker)}"
