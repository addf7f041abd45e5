"""Interactive looks at a surface: its layers and counts, and single pairs by angle and resolution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import panel as pn
import xarray as xr
from matplotlib.figure import Figure

from workbench.errors import SurfaceError
from workbench.figures.maps import draw_classes, draw_surface, draw_values, figure
from workbench.matching import match_pair
from workbench.matching.levels import ground_height, search_heights
from workbench.matching.pairs import StereoPair, intersection_angle_at
from workbench.matching.rectify import rectify_pair, resample
from workbench.matching.store import MatchedPair
from workbench.orientation import Block, OrientedPhotograph, read_block
from workbench.params import Parameters
from workbench.photographs import read_photograph
from workbench.rasters import Grid, new_raster, read_overview, read_raster
from workbench.site import Site
from workbench.stages import FOLDERS
from workbench.surface.gridding import grid_pair
from workbench.surface.statistics import NO_CLASS, RATIO_CLASSES, count_statistics, ratio_classes

_LAYERS = ("height", "height above terrain", "count", "possible count", "V", "spread", "provenance")
_COLOURS = ("#d7301f", "#fdae61", "#fee08b", "#d9ef8b", "#a6d96a", "#66bd63", "#1a9850")
_LONGEST = 900


@dataclass(frozen=True, eq=False)
class PairLook:
    """One pair, matched at one downscale, on the cells of the site's surface."""

    angle: float
    """Intersection angle on the ground, degrees."""
    ground_resolution: float
    """Of the reduced photographs, metres."""
    height: xr.DataArray
    """Heights of the pair (y, x), NaN where it measured nothing."""
    seen: np.ndarray
    """Cells that both photographs see, bool."""


def surface_panel(site: Site, *, trees: xr.DataArray | None = None) -> pn.Column:
    """Layers of a site's surface, filtered by the least count, with the statistics of the count layer.

    Parameters
    ----------
    site
        Its surface stage has run.
    trees
        Mask (1 = tree) on the grid of the surface, for statistics inside it.

    Raises
    ------
    RasterError
        If the surface is missing.
    """
    folder = site.products / FOLDERS["surface"]
    count, possible = (read_raster(folder / f"{name}.tif") for name in ("count", "possible_count"))
    layer = pn.widgets.Select(name="layer", options=list(_LAYERS))
    least = pn.widgets.IntSlider(name="least count", start=1, end=max(int(count.max()), 2), value=1)
    statistics = count_statistics(count, possible, trees).summary.round(2)

    def draw(chosen: str, least_count: int) -> Figure:
        return draw_layer(folder, chosen, least_count)

    def told(least_count: int) -> str:
        area = possible.values > 0
        share = float((count.values[area] < least_count).mean())
        return f"**{share:.1%}** of the area that pairs see is measured by fewer than {least_count} of them."

    return pn.Column(
        pn.Row(layer, least),
        pn.pane.Matplotlib(pn.bind(draw, layer, least.param.value_throttled), tight=True, width=620),
        pn.pane.Markdown(pn.bind(told, least.param.value_throttled)),
        pn.pane.DataFrame(statistics, index=False),
    )


def draw_layer(folder: Path, layer: str, least_count: int = 1) -> Figure:
    """One layer of a surface folder; cells of fewer pairs are left empty.

    Raises
    ------
    SurfaceError
        If the layer is unknown.
    """
    if layer not in _LAYERS:
        raise SurfaceError(f"Unknown layer {layer!r}: choose one of {', '.join(_LAYERS)}.")
    files = {"height": "dsm", "height above terrain": "ndsm", "possible count": "possible_count"}
    count = read_overview(folder / "count.tif", longest=_LONGEST)
    made, axes = figure(6.2, 5.2)
    if layer == "V":
        possible = read_overview(folder / "possible_count.tif", longest=_LONGEST)
        shares = count.copy(data=ratio_classes(count.values, possible.values))
        colours = _spread_colours(len(RATIO_CLASSES))
        classes = {k: (f"{name} %", colours[k]) for k, name in enumerate(RATIO_CLASSES)}
        draw_classes(axes, shares, classes | {NO_CLASS: ("not seen by a pair", "#ffffff")})
        return made
    raster = read_overview(folder / f"{files.get(layer, layer)}.tif", longest=_LONGEST)
    if layer == "provenance":
        codes = [int(v) for v in np.unique(raster.values) if v]
        colours = _spread_colours(len(codes))[::-1]
        names = {255: "interpolated"}
        classes = {v: (names.get(v, f"downscale {v}"), colours[k]) for k, v in enumerate(codes)}
        draw_classes(axes, raster, {0: ("no data", "#ffffff")} | classes)
        return made
    values = raster.astype(np.float32)
    if layer != "possible count":
        values = values.where(count.values >= least_count)
    if layer in ("height", "height above terrain"):
        draw_surface(axes, values, label=f"{layer} (m)")
    else:
        draw_values(axes, values, label=layer + (" (m)" if layer == "spread" else " (pairs)"))
    return made


def pair_panel(site: Site, parameters: Parameters | None = None) -> pn.Column:
    """Match two photographs of a strip at a chosen distance and downscale, and see what is left.

    The further apart, the larger the angle; the larger the downscale, the coarser the ground resolution:
    the two axes of thesis table 4.1, tried on single pairs. Where the site is virtual, errors against
    the truth are given as well.
    """
    options = parameters or Parameters()
    block = read_block(site.products / FOLDERS["orient"], site)
    strip = longest_strip(block)
    apart = pn.widgets.IntSlider(name="photographs apart", start=1, end=min(4, len(strip) - 1), value=1)
    downscale = pn.widgets.IntSlider(name="downscale", start=1, end=4, value=1)
    first = pn.widgets.IntSlider(name="first photograph", start=1, end=len(strip) - 1, value=len(strip) // 2)
    look = lru_cache(24)(lambda k, n, d: look_at_pair(site, block, strip, k, n, d, options))

    def chosen(place: int, distance: int, factor: int) -> PairLook:
        return look(min(place, len(strip) - distance) - 1, distance, factor)

    def draw(place: int, distance: int, factor: int) -> Figure:
        found = chosen(place, distance, factor)
        made, axes = figure(6.2, 5.0)
        draw_surface(axes, found.height, label="height of the pair (m)")
        axes.set_title(f"{found.angle:.1f} degrees, {100 * found.ground_resolution:.0f} cm", fontsize=10)
        return made

    def table(place: int, distance: int, factor: int) -> pd.DataFrame:
        return describe_pair(site, chosen(place, distance, factor))

    moved = [first.param.value_throttled, apart.param.value_throttled, downscale.param.value_throttled]
    return pn.Column(
        pn.Row(first, apart, downscale),
        pn.Row(
            pn.pane.Matplotlib(pn.bind(draw, *moved), tight=True, width=560),
            pn.pane.DataFrame(pn.bind(table, *moved), index=False),
        ),
    )


def longest_strip(block: Block) -> list[OrientedPhotograph]:
    """Photographs of the strip that has most of them, in the order of flight."""
    strips: dict[int, list[OrientedPhotograph]] = {}
    for photograph in block:
        strips.setdefault(photograph.strip, []).append(photograph)
    longest = max(strips.values(), key=lambda photographs: len(photographs))
    return sorted(longest, key=lambda p: (p.order, p.name))


def look_at_pair(
    site: Site,
    block: Block,
    strip: Sequence[OrientedPhotograph],
    first: int,
    apart: int,
    downscale: int,
    parameters: Parameters,
) -> PairLook:
    """Match two photographs of a strip without a guide, and grid the result on the site's surface."""
    ground = ground_height(block)
    pair = StereoPair(strip[first], strip[first + apart], "inflight")
    heights = search_heights(block, parameters.match)
    frame, swapped = rectify_pair(pair, heights, downscale=downscale)
    left, right = (pair.right, pair.left) if swapped else (pair.left, pair.right)
    images = [
        resample(_grey(photo.path, downscale), photo.camera, photo.pose, frame, right=is_right)
        for photo, is_right in ((left, False), (right, True))
    ]
    found = match_pair(
        images[0],
        images[1],
        (0, frame.disparities),
        parameters=parameters.match.sgm,
        check_rectified=False,
    )
    matched = MatchedPair(
        pair.name,
        downscale,
        frame,
        np.where(found.valid, found.disparity, np.nan).astype(np.float32),
        np.full(frame.shape, 255, np.uint8),
    )
    surface = read_raster(site.products / FOLDERS["surface"] / "dsm.tif")
    grid = Grid.of(surface)
    resolution = (pair.left.pose.centre[2] - ground) / pair.left.camera.focal_x * downscale
    # A pair is gridded on cells that hold its pixels, as the surface stage does.
    coarse = Grid.from_bounds(grid.crs, grid.bounds, max(1.25 * resolution, grid.resolution))
    gridded = grid_pair(matched, coarse, heights)
    values = np.full(coarse.shape, np.nan, np.float32) if gridded is None else gridded[0]
    x, y = np.meshgrid(coarse.x, coarse.y)
    level = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, ground)])
    seen = (left.sees(level) & right.sees(level)).reshape(coarse.shape)
    return PairLook(
        intersection_angle_at(pair, ground),
        resolution,
        new_raster(values, coarse, name="pair", units="m", vertical_datum=block.vertical_datum),
        seen,
    )


def describe_pair(site: Site, look: PairLook) -> pd.DataFrame:
    """Unmatched share of what both photographs see; by land cover, with errors, where there is truth."""
    found = np.isfinite(look.height.values)
    rows = [_row("all", look.seen, found, None)]
    if site.truth is not None:
        from workbench.rasters import match_grid
        from workbench.virtual.world import Cover

        grid = Grid.of(look.height)
        cover = match_grid(read_raster(site.truth / "cover.tif"), grid, resampling="nearest").values
        true = match_grid(read_raster(site.truth / "dsm_mean.tif"), grid).values
        error = look.height.values - true
        rows = [_row("all", look.seen & (cover > 0), found, error)]
        for code in Cover:
            cells = look.seen & (cover == code)
            if code != Cover.NOTHING and cells.sum() > 200:
                rows.append(_row(code.name.lower().replace("_", " "), cells, found, error))
    return pd.DataFrame(rows).round(3)


def _row(name: str, cells: np.ndarray, found: np.ndarray, error: np.ndarray | None) -> dict[str, object]:
    row: dict[str, object] = {
        "cover": name,
        "cells": int(cells.sum()),
        "unmatched %": 100 * float(1 - found[cells].mean()) if cells.any() else float("nan"),
    }
    if error is not None:
        known = error[cells & np.isfinite(error)]
        middle = float(np.median(known)) if known.size else float("nan")
        row |= {
            "bias m": middle,
            "NMAD m": 1.4826 * float(np.median(np.abs(known - middle))) if known.size else float("nan"),
        }
    return row


def _grey(path: Path, downscale: int) -> np.ndarray:
    image = read_photograph(path, downscale)
    if image.shape[-1] >= 3:
        return cv2.cvtColor(np.ascontiguousarray(image[..., :3]), cv2.COLOR_RGB2GRAY)
    return np.ascontiguousarray(image[..., 0])


def _spread_colours(number: int) -> list[str]:
    places = np.linspace(0, len(_COLOURS) - 1, number).round().astype(int)
    return [_COLOURS[place] for place in places]
