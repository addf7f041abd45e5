"""The surface stage: fused DSM, count, spread, provenance, terrain and height above it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any

import numpy as np
import xarray as xr

from workbench.matching.levels import common_extent, ground_height, search_heights
from workbench.matching.pairs import StereoPair
from workbench.matching.stage import median_resolution
from workbench.matching.store import PairStore
from workbench.orientation import Block, read_block
from workbench.params import Parameters, SurfaceParameters
from workbench.rasters import Grid, RasterWriter, ScratchArrays, read_raster
from workbench.site import Site
from workbench.stages import FOLDERS, Stage, open_stage
from workbench.surface.canopy import CanopyHeights, crown_warnings, view_of_crowns
from workbench.surface.filling import FilledHeights, fill_heights
from workbench.surface.fusion import INTERPOLATED, NO_DATA
from workbench.surface.levels import Level, fuse_levels, grid_level, level_grid
from workbench.surface.possible_count import PossibleCount, possible_pairs
from workbench.surface.refine import refine_window
from workbench.surface.terrain import UserTerrain, ground_filter

_KINDS = {"count": "uint8", "spread": "float32", "provenance": "uint8"}
_TEXTS = {
    "dsm": ("m", "surface"),
    "count": ("pairs", "pairs that measured the cell and were used"),
    "possible_count": ("pairs", "pairs that see the cell"),
    "spread": ("m", "robust standard deviation of the heights of the pairs"),
    "provenance": ("1", "0 no data, n downscale measured at, 255 interpolated"),
    "dtm": ("m", "terrain"),
    "ground_seen": ("1", "1 where ground was measured or given, 0 where the terrain is interpolated"),
    "ndsm": ("m", "height above terrain"),
}
_CROWN_NAMES = {
    "crown_height": "crown_height_m",
    "overlap": "crown_overlap",
    "overlap_ground": "ground_overlap",
    "angle": "crown_angle_deg",
    "overlap_needed": "crown_overlap_needed",
    "overlap_ground_needed": "ground_overlap_needed",
}
_SPREAD_STEP, _SPREAD_STEPS = 1e-4, 100_000  # Spreads are counted in tenths of a millimetre, up to 10 m.


def surface_site(site: Site, parameters: Parameters) -> dict:
    """Make the surfaces of a site from its matched pairs.

    Writes ``dsm_ds1.tif`` ..., ``dsm.tif``, ``count.tif``, ``possible_count.tif``, ``spread.tif``,
    ``provenance.tif``, ``dtm.tif``, ``ground_seen.tif`` and ``ndsm.tif``. Everything goes tile by tile; only
    what has a 64th of the cells (the closed surface) or cells of ``ground_cell`` (the cloth, which is
    one for the whole area) is held in memory.

    Returns
    -------
    dict
        The metrics: coverage by one and two pairs, shares of each downscale, spread.

    Raises
    ------
    MatchingError
        If the pairs are missing.
    SurfaceError
        If nothing was measured, or a user terrain does not fit.
    """
    options = parameters.surface
    with open_stage(site.products / FOLDERS["surface"], {"surface": options}) as stage, ExitStack() as stack:
        block = read_block(site.products / FOLDERS["orient"], site)
        store = PairStore(site.products / FOLDERS["match"] / "pairs.zip")
        heights = search_heights(block, parameters.match)
        grid = _grid(block, store, options)
        levels = [
            stack.enter_context(
                grid_level(
                    store.stored(downscale),
                    downscale,
                    level_grid(grid, downscale, store.downscales[0]),
                    heights,
                    stage.folder,
                    options,
                )
            )
            for downscale in store.downscales
        ]
        layers = stack.enter_context(ScratchArrays(stage.folder, grid.shape, _KINDS))
        _write_fused(levels, grid, layers, options, stage, block.vertical_datum)
        surface = _filled(stage, options)
        if options.interpolate == "linear":
            _interpolate(surface, layers, options, stage)
        _write_layers(layers, grid, options, stage)
        pairs = possible_pairs(block, parameters.match)
        counted = _count(PossibleCount(pairs, surface), levels, layers, grid, options, stage)
        stage.metrics.update(counted)
        canopy = CanopyHeights()
        surface = _filled(stage, options)
        finest = store.downscales[0]
        stage.metrics.update(_terrain(site, surface.surface, layers, finest, canopy, options, stage))
        stage.metrics.update(_crowns(pairs, canopy, ground_height(block), counted["no_data_share"]))
    return stage.metrics


def _grid(block: Block, store: PairStore, options: SurfaceParameters) -> Grid:
    """Cells that any pair can fill; resolution of two significant digits, so that dates fall together."""
    finest = store.downscales[0]
    rectifications = [pair.rectification for pair in store.stored(finest)]
    ground = ground_height(block)
    resolution = options.resolution
    if resolution is None:
        wanted = 1.25 * median_resolution(block, ground) * finest
        digits = 1 - int(np.floor(np.log10(wanted)))
        resolution = float(np.ceil(wanted * 10**digits - 1e-6) / 10**digits)
    return Grid.from_bounds(block.crs, common_extent(rectifications, ground), resolution)


def _write_fused(
    levels: Sequence[Level],
    grid: Grid,
    layers: ScratchArrays,
    options: SurfaceParameters,
    stage: Stage,
    datum: str,
) -> None:
    """Write the surface of each downscale and all of them fused; note what belongs to the fused one."""
    with ExitStack() as stack:
        alone = {
            level.downscale: stack.enter_context(
                _writer(stage, grid, f"dsm_ds{level.downscale}", long_name="surface", vertical_datum=datum)
            )
            for level in levels
        }
        dsm = stack.enter_context(_writer(stage, grid, "dsm", vertical_datum=datum))
        for tile in grid.tiles(options.tile_size):
            fused = fuse_levels(levels, grid, tile.core, options.patch_step)
            dsm.write(fused.height, tile.core)
            for downscale, height in fused.levels.items():
                alone[downscale].write(height, tile.core)
            for name in _KINDS:
                layers.write(name, getattr(fused, name), tile.core)


def _filled(stage: Stage, options: SurfaceParameters) -> FilledHeights:
    """The fused surface as it is on disk."""
    return fill_heights(read_raster(stage.path("dsm.tif"), chunks=max(options.tile_size, 512)))


def _interpolate(
    surface: FilledHeights, layers: ScratchArrays, options: SurfaceParameters, stage: Stage
) -> None:
    """Replace ``dsm.tif`` by the surface without holes; filled cells are flagged."""
    grid = surface.grid
    with _writer(stage, grid, "dsm", vertical_datum=surface.surface.attrs["vertical_datum"]) as dsm:
        for tile in grid.tiles(options.tile_size):
            height, measured = surface.window(*tile.core)
            dsm.write(height.astype(np.float32), tile.core)
            provenance = layers.read("provenance", tile.core)
            provenance[~measured] = INTERPOLATED
            layers.write("provenance", provenance, tile.core)


def _write_layers(layers: ScratchArrays, grid: Grid, options: SurfaceParameters, stage: Stage) -> None:
    for name, kind in _KINDS.items():
        with _writer(stage, grid, name, kind) as writer:
            for tile in grid.tiles(options.tile_size):
                writer.write(layers.read(name, tile.core), tile.core)


def _count(
    possible: PossibleCount,
    levels: Sequence[Level],
    layers: ScratchArrays,
    grid: Grid,
    options: SurfaceParameters,
    stage: Stage,
) -> dict:
    """Write the possible count; metrics of what was measured of it."""
    sums: dict[str, int] = dict.fromkeys(("area", "ge1", "ge2", "zero", "count", "possible"), 0)
    unmatched = {level.downscale: 0 for level in levels}
    sources = np.zeros(256, np.int64)
    spreads = np.zeros(_SPREAD_STEPS, np.int64)
    with _writer(stage, grid, "possible_count", "uint8") as writer:
        for tile in grid.tiles(options.tile_size):
            limit = possible.window(*tile.core)
            writer.write(limit, tile.core)
            area = limit > 0
            count, spread, provenance = (layers.read(name, tile.core) for name in _KINDS)
            sums["area"] += int(area.sum())
            sums["ge1"] += int((area & (count >= 1)).sum())
            sums["ge2"] += int((area & (count >= 2)).sum())
            sums["zero"] += int((area & (count == 0)).sum())
            sums["count"] += int(count[area].sum(dtype=np.int64))
            sums["possible"] += int(limit[area].sum(dtype=np.int64))
            for level in levels:
                missing = level.window("count", grid, tile.core) == 0
                unmatched[level.downscale] += int((area & missing).sum())
            sources += np.bincount(provenance[area], minlength=256)
            known = spread[np.isfinite(spread)]
            steps = np.minimum(known / _SPREAD_STEP, _SPREAD_STEPS - 1).astype(np.int64)
            spreads += np.bincount(steps, minlength=_SPREAD_STEPS)
    cells = max(sums["area"], 1)
    return {
        "cells_m": grid.resolution,
        "coverage_ge1": round(sums["ge1"] / cells, 5),
        "coverage_ge2": round(sums["ge2"] / cells, 5),
        "count_zero_share": round(sums["zero"] / cells, 5),
        "count_mean": round(sums["count"] / cells, 4),
        "possible_count_mean": round(sums["possible"] / cells, 4),
        "spread_median_m": _median(spreads),
        "unmatched_share": {f"ds{d}": round(n / cells, 5) for d, n in unmatched.items()},
        "provenance_share": {
            f"ds{level.downscale}": round(sources[level.downscale] / cells, 5) for level in levels
        },
        "interpolated_share": round(sources[INTERPOLATED] / cells, 5),
        "no_data_share": round(sources[NO_DATA] / cells, 5),
    }


def _median(counts: np.ndarray) -> float | None:
    """Median spread, metres, of counts of spreads."""
    total = int(counts.sum())
    if not total:
        return None
    return round((int(np.searchsorted(counts.cumsum(), (total + 1) // 2)) + 0.5) * _SPREAD_STEP, 5)


def _terrain(
    site: Site,
    surface: xr.DataArray,
    layers: ScratchArrays,
    finest: int,
    canopy: CanopyHeights,
    options: SurfaceParameters,
    stage: Stage,
) -> dict:
    """Write terrain and height above it; share of the terrain that was seen."""
    grid = Grid.of(surface)
    datum = str(surface.attrs["vertical_datum"])
    given = None if site.dtm is None else UserTerrain(read_raster(site.dtm, chunks=1024), surface)
    if given is None:
        possible = read_raster(stage.path("possible_count.tif"), chunks=max(options.tile_size, 512))

        def confirmed(window: tuple[slice, slice]) -> np.ndarray:
            """Cells that two pairs agree on, or that the one pair that sees them measured in detail."""
            alone = (possible[window].values < 2) & (layers.read("provenance", window) == finest)
            return alone | (layers.read("count", window) >= 2)

        coarse, seen = ground_filter(
            surface,
            cell=options.ground_cell,
            rigidness=options.ground_rigidness,
            threshold=options.ground_threshold,
            trusted=confirmed,
        )
        base = Grid.of(coarse)
    ground = 0
    with (
        _writer(stage, grid, "dtm", vertical_datum=datum) as dtm,
        _writer(stage, grid, "ground_seen", "uint8") as flags,
        _writer(stage, grid, "ndsm", vertical_datum="height above terrain") as ndsm,
    ):
        for tile in grid.tiles(options.tile_size):
            heights = surface.isel(y=tile.core[0], x=tile.core[1]).values
            if given is not None:
                terrain = given.window(*tile.core)
                given.check(heights, terrain)
                flag = np.isfinite(terrain).astype(np.uint8)
            else:
                terrain = refine_window(coarse.values.__getitem__, base, grid, tile.core, step=np.inf)
                flag = refine_window(seen.values.__getitem__, base, grid, tile.core)
            dtm.write(terrain, tile.core)
            flags.write(flag, tile.core)
            above = (heights - terrain).astype(np.float32)
            ndsm.write(above, tile.core)
            canopy.add(above)
            ground += int(flag.sum())
        if given is not None:
            given.require_cover()
    return {"ground_seen_share": round(ground / (grid.width * grid.height), 5)}


def _crowns(pairs: Sequence[StereoPair], canopy: CanopyHeights, ground: float, no_data: float) -> dict:
    """How the photographs see the crowns, and what they could not measure."""
    if canopy.crown_height is None:
        return {"tree_share": 0.0, "warnings": []}
    view = view_of_crowns(pairs, ground, canopy.crown_height)
    seen = (
        {} if view is None else {_CROWN_NAMES[name]: round(value, 4) for name, value in asdict(view).items()}
    )
    return {
        "tree_share": round(canopy.share, 5),
        **seen,
        "warnings": crown_warnings(view, canopy.share, no_data),
    }


def _writer(stage: Stage, grid: Grid, name: str, kind: str = "float32", **attributes: Any) -> RasterWriter:
    units, text = _TEXTS.get(name, _TEXTS["dsm"])
    attributes = {"units": units, "long_name": text} | attributes
    return RasterWriter(stage.path(f"{name}.tif"), grid, dtype=kind, attributes=attributes)
