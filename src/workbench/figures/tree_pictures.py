"""Pieces of the tree panel: pictures for the screen, borders of crowns, a profile."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from workbench.errors import TreesError
from workbench.figures.maps import hillshade
from workbench.rasters import Grid
from workbench.trees import TreeInputs

COLOURS = {"found": "#1fa03a", "false": "#e31a1c", "missed": "#ff8c00", "top": "#1f78b4"}
"""Of a top by how it was judged, and of a missed tree; ``top`` where there is no reference."""
_LONGEST = 1200  # Pixels of the longer edge of a picture.
Bounds = tuple[float, float, float, float]


def clipped(raster: xr.DataArray, bounds: Bounds) -> xr.DataArray:
    """Cells of a raster whose centres lie within bounds.

    Raises
    ------
    TreesError
        If there is none.
    """
    west, south, east, north = bounds
    x = np.flatnonzero(((raster.x >= west) & (raster.x <= east)).values)
    y = np.flatnonzero(((raster.y >= south) & (raster.y <= north)).values)
    if len(x) < 2 or len(y) < 2:
        raise TreesError(f"The part {bounds} holds nothing of {raster.name}: choose one within it.")
    part = raster.isel(x=x, y=y)
    # What belonged to the whole raster is worked out again from the coordinates.
    return part.rio.write_transform(part.rio.transform(recalc=True))


def clipped_inputs(inputs: TreeInputs, bounds: Bounds) -> TreeInputs:
    """The same for all rasters that trees are sought in."""
    return TreeInputs(
        clipped(inputs.height, bounds),
        {name: clipped(layer, bounds) for name, layer in inputs.layers.items()},
        inputs.normalised,
        None if inputs.provenance is None else clipped(inputs.provenance, bounds),
        None if inputs.spread is None else clipped(inputs.spread, bounds),
        inputs.stands,
        inputs.lake,
    )


def base_picture(height: xr.DataArray, ortho: xr.DataArray | None) -> dict[str, Any]:
    """What lies below the trees: the orthophoto, or the shaded surface."""
    if ortho is None:
        shade = (255 * np.nan_to_num(hillshade(height))).astype(np.uint8)
        return _image(_packed(shade, shade, shade), Grid.of(height).bounds)
    step = max(1, -(-max(ortho.sizes["x"], ortho.sizes["y"]) // _LONGEST))
    part = ortho.isel(x=slice(None, None, step), y=slice(None, None, step))
    bands = part.values[:3].astype(np.float32)
    white = 255.0 if ortho.dtype == np.uint8 else max(float(np.percentile(bands, 99)), 1.0)
    seen = (255 * np.clip(bands / white, 0, 1)).astype(np.uint8)
    return _image(_packed(*seen), ortho.rio.bounds(recalc=True))


def border_picture(labels: xr.DataArray, judged: np.ndarray) -> dict[str, Any]:
    """Border cells of the crowns, in the colour of their tops.

    Parameters
    ----------
    labels
        Raster of ``tree_id`` from 1 to n, 0 none.
    judged
        (n,) word of :data:`COLOURS` for each top.
    """
    ids = labels.values
    border = np.zeros(ids.shape, bool)
    border[:, 1:] |= ids[:, 1:] != ids[:, :-1]
    border[1:] |= ids[1:] != ids[:-1]
    # Of the two cells beside an edge only one is drawn; where it is empty, the other one.
    border[:, :-1] |= (ids[:, :-1] > 0) & (ids[:, 1:] == 0)
    border[:-1] |= (ids[:-1] > 0) & (ids[1:] == 0)
    border &= ids > 0
    colours = np.zeros(len(judged) + 1, np.uint32)
    for word, colour in COLOURS.items():
        red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
        colours[1:][judged == word] = red | green << 8 | blue << 16 | 230 << 24
    return _image(np.where(border, colours[ids], 0).astype(np.uint32), Grid.of(labels).bounds)


def profile(height: xr.DataArray, smooth: xr.DataArray, x: float, y: float, reach: float) -> dict[str, Any]:
    """Heights along the row and the column through a place, before and after the filter."""
    distance = np.arange(-reach, reach + 1e-9, Grid.of(smooth).resolution)
    lines: dict[str, Any] = {"distance": distance}
    for prefix, raster in (("", height), ("smooth_", smooth)):
        lines[f"{prefix}west_east"] = _along(raster, x + distance, np.full(len(distance), y))
        lines[f"{prefix}south_north"] = _along(raster, np.full(len(distance), x), y + distance)
    return lines


def _along(raster: xr.DataArray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    grid = Grid.of(raster)
    columns = np.floor((x - grid.west) / grid.resolution).astype(int)
    rows = np.floor((grid.north - y) / grid.resolution).astype(int)
    inside = (rows >= 0) & (rows < grid.height) & (columns >= 0) & (columns < grid.width)
    values = np.full(len(x), np.nan)
    values[inside] = raster.values[rows[inside], columns[inside]]
    return values


def _packed(red: np.ndarray, green: np.ndarray, blue: np.ndarray) -> np.ndarray:
    bands = [band.astype(np.uint32) for band in (red, green, blue)]
    return bands[0] | bands[1] << 8 | bands[2] << 16 | np.uint32(255 << 24)


def _image(values: np.ndarray, bounds: Bounds) -> dict[str, Any]:
    west, south, east, north = bounds
    return {
        "image": [np.ascontiguousarray(values[::-1])],
        "x": [west],
        "y": [south],
        "dw": [east - west],
        "dh": [north - south],
    }
