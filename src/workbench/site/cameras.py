"""The cameras of ``site.yaml``: inner orientations, or the questions that are still open."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from workbench.cameras import Camera
from workbench.errors import CameraError, SiteError


def read_cameras(entries: Mapping[str, Any], path: Path) -> tuple[dict[str, Camera], list[str]]:
    """Cameras by identifier, and a question for each one that lacks a number.

    Raises
    ------
    SiteError
        Naming the entry that is not a number or impossible.
    """
    if not isinstance(entries, Mapping):
        raise SiteError(f"{path}: cameras must hold one entry a camera.")
    cameras: dict[str, Camera] = {}
    questions: list[str] = []
    for identifier, entry in entries.items():
        where = f"{path}: cameras.{identifier}"
        if not isinstance(entry, Mapping):
            raise SiteError(f"{where} must hold width, height, focal_length_mm and sensor_width_mm.")
        lacking = _lacking(entry)
        if lacking:
            questions.append(f"{where}.{lacking} is open for {_label(entry)}: {_HELP[lacking]}")
        else:
            cameras[str(identifier)] = _camera(entry, str(identifier), where)
    return cameras, questions


_HELP = {
    "focal_length_mm": "look up the real focal length of the lens in its data sheet "
    "(not the 35 mm equivalent).",
    "sensor_width_mm": "look up the sensor size in the maker's data sheet and give the width that the "
    "photograph's columns cover.",
}


def _lacking(entry: Mapping[str, Any]) -> str:
    if entry.get("focal_length_px"):
        return ""
    return next((key for key in _HELP if not entry.get(key)), "")


def _label(entry: Mapping[str, Any]) -> str:
    name = _make_and_model(entry) or "a camera without EXIF"
    return f"'{name}' ({entry.get('width')} x {entry.get('height')} px)"


def _make_and_model(entry: Mapping[str, Any]) -> str:
    """Make and model; some makers write their name into both."""
    make, model = str(entry.get("make") or "").strip(), str(entry.get("model") or "").strip()
    return model if model.lower().startswith(make.lower()) else f"{make} {model}".strip()


def _camera(entry: Mapping[str, Any], identifier: str, where: str) -> Camera:
    name = _make_and_model(entry) or identifier
    try:
        width, height = int(entry["width"]), int(entry["height"])
        distortion = tuple(float(value) for value in entry.get("distortion") or ())
        sensor = entry.get("sensor_width_mm")
        pixel = float(sensor) / 1000 / width if sensor else None
        if entry.get("focal_length_px"):
            focal = float(entry["focal_length_px"])
            return Camera(name, width, height, focal, focal, width / 2, height / 2, distortion, pixel)
        focal_length = float(entry["focal_length_mm"]) / 1000
        return Camera.from_focal_length(
            name,
            width,
            height,
            focal_length=focal_length,
            pixel_size=float(entry["sensor_width_mm"]) / 1000 / width,
            distortion=distortion,
        )
    except (KeyError, TypeError, ValueError, ZeroDivisionError, CameraError) as error:
        raise SiteError(f"{where} is not a camera ({error}). Mend its numbers.") from error
