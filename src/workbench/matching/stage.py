"""The match stage: disparities of all pairs at all downscales, from coarse to fine."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from rich.progress import track

from workbench.errors import MatchingError
from workbench.matching.engine import match_pair
from workbench.matching.guide import guide_disparity
from workbench.matching.levels import (
    choose_downscales,
    common_extent,
    ground_height,
    search_heights,
)
from workbench.matching.pairs import StereoPair, intersection_angle_at, select_pairs
from workbench.matching.rectify import RowOffsets, rectify_pair, resample
from workbench.matching.rows import measure_row_offsets
from workbench.matching.store import MatchedPair, load_pair, pack, save_pair, stored_pair
from workbench.orientation import Block, read_block
from workbench.params import MatchParameters, Parameters
from workbench.photographs import read_photograph
from workbench.rasters import Grid, RasterWriter, read_raster
from workbench.site import Site
from workbench.stages import FOLDERS, open_stage
from workbench.surface.filling import FilledHeights, fill_heights
from workbench.surface.levels import fuse_levels, grid_level, level_grid

_CACHED_PHOTOGRAPHS = 8
_ROOM = 0.1
_STEP = 0.5  # Coarser heights are refined smoothly between neighbours that differ by no more, metres.
_CHUNK = 1024
_END = 2.0  # Pixels at both ends of the range, one of them beyond the heights that are searched.


@dataclass(frozen=True, eq=False)
class Guide:
    """What the coarser levels found."""

    surface: FilledHeights
    """Their surface."""
    lowest: float
    """Lowest measured height, metres."""
    highest: float
    """Highest measured height, metres."""


def match_site(site: Site, parameters: Parameters) -> dict:
    """Match all pairs of a site; writes ``pairs.zip`` and ``pairs.json``.

    A pair that an interrupted run finished is not matched again.

    Returns
    -------
    dict
        The metrics: pairs, downscales, intersection angles, matched share.

    Raises
    ------
    MatchingError
        If no photographs overlap.
    """
    options = parameters.match
    with open_stage(site.products / FOLDERS["match"], {"match": options}) as stage:
        orientation = site.products / FOLDERS["orient"]
        block = read_block(orientation, site)
        ground = ground_height(block)
        pairs = select_pairs(block, inflight=options.inflight, across=options.across, ground=ground)
        resolution = median_resolution(block, ground)
        downscales = tuple(sorted(options.downscales or choose_downscales(resolution)))
        work = stage.path("work") / _key(orientation, options)
        files: dict[int, list[Path]] = {}
        guide: Guide | None = None
        rows: list[RowOffsets | None] = [None] * len(pairs)
        shares = {}
        for downscale in reversed(downscales):
            files[downscale], shares[downscale] = _match_level(
                pairs,
                downscale,
                search_heights(block, options),
                guide,
                rows,
                options,
                affordable_disparities(downscale, downscales[0], options),
                work,
            )
            rows = [stored_pair(path).rectification.rows for path in files[downscale]]
            if downscale != downscales[0]:
                guide = _surface(files, block, resolution, search_heights(block, options), work)
        entries = [(f"ds{d}/{path.name}", path) for d in downscales for path in files[d]]
        pack(entries, stage.path("pairs.zip"))
        shutil.rmtree(stage.path("work"))
        angles = [intersection_angle_at(pair, ground) for pair in pairs]
        stage.metrics.update(
            {
                "pairs": len(pairs),
                "pairs_across": sum(pair.kind == "across" for pair in pairs),
                "downscales": list(downscales),
                "ground_resolution_m": round(resolution, 5),
                "angle_median_deg": round(float(np.median(angles)), 3),
                "angle_min_deg": round(min(angles), 3),
                "angle_max_deg": round(max(angles), 3),
                "matched_share": {f"ds{d}": round(shares[d], 4) for d in downscales},
                "pair_angles_deg": {p.name: round(a, 3) for p, a in zip(pairs, angles, strict=True)},
            }
        )
    return stage.metrics


def median_resolution(block: Block, ground: float) -> float:
    """Median ground resolution of the photographs of a block, metres."""
    return float(np.median([(p.pose.centre[2] - ground) / p.camera.focal_x for p in block]))


def affordable_disparities(downscale: int, finest: int, options: MatchParameters) -> float:
    """Disparities that cost at a downscale what the guided search costs at the finest one.

    Reduced photographs have fewer pixels, so that wide ranges are cheap there; a guide would only cut
    off trees that the still coarser level missed.
    """
    return (downscale / finest) ** 2 * (options.guide_below + options.guide_above + 1)


def _match_level(
    pairs: Sequence[StereoPair],
    downscale: int,
    heights: tuple[float, float],
    guide: Guide | None,
    rows: Sequence[RowOffsets | None],
    options: MatchParameters,
    affordable: float,
    work: Path,
) -> tuple[list[Path], float]:
    folder = work / f"ds{downscale}"
    folder.mkdir(parents=True, exist_ok=True)
    grey = lru_cache(_CACHED_PHOTOGRAPHS)(lambda path: _grey(path, downscale))
    files, matched, known = [], 0, 0
    known_rows = dict(zip((pair.name for pair in pairs), rows, strict=True))
    for pair in track(pairs, f"matching at 1/{downscale}", transient=True):
        path = folder / f"{pair.name}.zip"
        files.append(path)
        if not path.exists():
            found = _match(pair, downscale, heights, guide, known_rows[pair.name], options, affordable, grey)
            save_pair(found, path)
        disparity = load_pair(path).disparity
        matched += int(np.isfinite(disparity).sum())
        known += disparity.size
    return files, matched / max(known, 1)


def _match(
    pair: StereoPair,
    downscale: int,
    heights: tuple[float, float],
    guide: Guide | None,
    rows: RowOffsets | None,
    options: MatchParameters,
    affordable: float,
    grey: Callable[[Path], np.ndarray],
) -> MatchedPair:
    """Match one pair; a range of up to ``affordable`` disparities is searched wholly, without a guide.

    ``rows`` is what the coarser level found of vertical parallax; the result holds what this one found.
    """
    rectification, swapped = rectify_pair(pair, heights, downscale=downscale)
    if guide is not None and rectification.disparities > affordable:
        # What the coarser levels found bounds the range, with room for what they missed.
        margin = _ROOM * (heights[1] - heights[0])
        heights = (
            max(heights[0], guide.lowest - margin),
            min(heights[1], guide.highest + margin),
        )
        rectification, swapped = rectify_pair(pair, heights, downscale=downscale)
    else:
        guide = None
    rectification = replace(rectification, rows=rows)
    left, right = (pair.right, pair.left) if swapped else (pair.left, pair.right)
    images = [
        resample(grey(photo.path), photo.camera, photo.pose, rectification, right=is_right)
        for photo, is_right in ((left, False), (right, True))
    ]
    expected = None
    if guide is not None:
        expected = guide_disparity(rectification, guide.surface, heights[1], heights[0])
        if not np.isfinite(expected).any():
            expected = None
    result = match_pair(
        images[0],
        images[1],
        disparity_range=(0, rectification.disparities),
        guide=expected,
        guide_radius=(options.guide_below, options.guide_above),
        parameters=options.sgm,
        check_rectified=False,
        threads=options.threads,
    )
    disparity = np.where(result.valid, result.disparity, np.nan).astype(np.float32)
    # A best match at the end of the range need not be a minimum: a better one may lie beyond.
    at_end = (disparity < _END) | (disparity > rectification.disparities - _END)
    disparity[at_end] = np.nan
    confidence = np.clip(np.rint(result.confidence.values * 255), 0, 255).astype(np.uint8)
    rectification = replace(
        rectification, rows=measure_row_offsets(images[0], images[1], disparity, rectification)
    )
    return MatchedPair(pair.name, downscale, rectification, disparity, confidence)


def _surface(
    files: dict[int, list[Path]],
    block: Block,
    resolution: float,
    heights: tuple[float, float],
    work: Path,
) -> Guide:
    """What the levels matched so far say together: the guide of the next level."""
    finest = min(files)
    pairs = {downscale: [stored_pair(path) for path in files[downscale]] for downscale in sorted(files)}
    extent = common_extent([pair.rectification for pair in pairs[finest]], ground_height(block))
    cell = 1.25 * resolution * finest
    grid = Grid.from_bounds(block.crs, extent, cell)
    path = work / f"guide_ds{finest}.tif"
    with ExitStack() as stack:
        levels = [
            stack.enter_context(grid_level(pairs[d], d, level_grid(grid, d, finest), heights, work))
            for d in pairs
        ]
        writer = stack.enter_context(
            RasterWriter(path, grid, dtype="float32", attributes={"units": "m", "long_name": "guide"})
        )
        limits = []
        for tile in grid.tiles():
            height = fuse_levels(levels, grid, tile.core, _STEP).height
            writer.write(height, tile.core)
            if np.isfinite(height).any():
                limits += [float(np.nanmin(height)), float(np.nanmax(height))]
    if not limits:
        raise MatchingError(
            f"Nothing was matched at downscales {', '.join(map(str, sorted(files)))}: look at the residuals "
            "of the orientation and at the sharpness of the photographs."
        )
    return Guide(fill_heights(read_raster(path, chunks=_CHUNK)), min(limits), max(limits))


def _grey(path: Path, downscale: int) -> np.ndarray:
    image = read_photograph(path, downscale)
    if image.shape[-1] >= 3:
        return cv2.cvtColor(np.ascontiguousarray(image[..., :3]), cv2.COLOR_RGB2GRAY)
    return np.ascontiguousarray(image[..., 0])


def _key(orientation: Path, options: MatchParameters) -> str:
    """Names everything that a matched pair depends on: unfinished work of other settings is not used."""
    digest = hashlib.blake2b(digest_size=8)
    for file in sorted((orientation / "sparse").iterdir()):
        digest.update(file.read_bytes())
    digest.update(json.dumps(options.model_dump(mode="json"), sort_keys=True).encode())
    return digest.hexdigest()
