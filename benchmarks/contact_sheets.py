"""A contact sheet of each virtual scene, to be judged by eye beside real photographs.

    python benchmarks/contact_sheets.py --out docs/scenes lake baruth

Four panels: a photograph of the scene's own flight, its most varied part pixel by pixel, the same part in
colour infrared, and the same exposure under an overcast sky.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from workbench.params import SimulateParameters
from workbench.virtual import build_scene, load_scene, scene_names
from workbench.virtual.photograph import take_photograph
from workbench.virtual.stage import conditions_of, flight_of, fly_scene

PANEL = (600, 400)


def main() -> None:
    """Render the sheets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", help="names; all scenes of the package by default")
    parser.add_argument("--out", type=Path, default=Path("docs/scenes"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.scenes or scene_names():
        started = time.process_time()
        sheet(name).save(options.out / f"{name}.jpg", quality=80)
        print(f"{name:14s} {time.process_time() - started:6.1f} CPU-s")


def sheet(name: str) -> Image.Image:
    """Four panels of one scene."""
    spec = load_scene(name)
    settings = SimulateParameters(near_infrared=True)
    plan = flight_of(spec.flight, settings)
    scene = build_scene(spec)
    flight = fly_scene(scene, plan, settings)
    west, south, east, north = scene.extent
    middle = np.array([(west + east) / 2, (south + north) / 2])
    exposure = min(flight.exposures, key=lambda e: float(np.hypot(*(e.pose.centre[:2] - middle))))
    conditions = conditions_of(plan, settings)
    clear = take_photograph(scene, flight, exposure, conditions).pixels
    dull = take_photograph(scene, flight, exposure, replace(conditions, cloudiness=1.0)).pixels
    part = most_varied(clear)
    panels = [
        (whole(wide(clear)[..., :3]), f"{name}: {plan.camera}, GSD {100 * flight.gsd:.0f} cm"),
        (whole(clear[part][..., :3]), "pixel by pixel"),
        (whole(clear[part][..., [3, 0, 1]]), "near infrared, red, green"),
        (whole(wide(dull)[..., :3]), "overcast"),
    ]
    image = Image.new("RGB", (2 * PANEL[0], 2 * PANEL[1]))
    draw = ImageDraw.Draw(image)
    for index, (panel, text) in enumerate(panels):
        corner = (index % 2 * PANEL[0], index // 2 * PANEL[1])
        image.paste(panel, corner)
        draw.rectangle((corner[0], corner[1], corner[0] + 8 * len(text), corner[1] + 18), fill=(0, 0, 0))
        draw.text((corner[0] + 5, corner[1] + 3), text, fill=(255, 255, 255))
    return image


def most_varied(pixels: np.ndarray) -> tuple[slice, slice]:
    """The window of a panel's size with the largest variance of coarse brightness."""
    rows, columns = min(PANEL[1], pixels.shape[0]), min(PANEL[0], pixels.shape[1])
    grey = pixels[..., :3].mean(axis=2)
    starts = [
        (r, c)
        for r in np.linspace(0, pixels.shape[0] - rows, 5).astype(int)
        for c in np.linspace(0, pixels.shape[1] - columns, 5).astype(int)
    ]
    row, column = max(
        starts, key=lambda at: grey[at[0] : at[0] + rows : 8, at[1] : at[1] + columns : 8].var()
    )
    return slice(row, row + rows), slice(column, column + columns)


def wide(pixels: np.ndarray) -> np.ndarray:
    """Of a frame much longer than wide, the most varied part in the shape of a panel."""
    rows, columns = pixels.shape[:2]
    height = columns * PANEL[1] // PANEL[0]
    if rows <= 1.5 * columns:
        return pixels
    grey = pixels[::8, ::8, :3].mean(axis=2)
    starts = np.linspace(0, rows - height, 40).astype(int)
    start = max(starts, key=lambda row: grey[row // 8 : (row + height) // 8].var())
    return pixels[start : start + height]


def whole(pixels: np.ndarray) -> Image.Image:
    """Fitted into a panel with its shape kept, never enlarged."""
    image = Image.fromarray(np.ascontiguousarray(pixels))
    image.thumbnail(PANEL, Image.Resampling.BOX)
    return image


if __name__ == "__main__":
    main()
