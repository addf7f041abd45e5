"""The surface stage: fused DSM, count, spread, provenance, terrain and height above it."""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np
import xarray as xr

from workbench.matching.levels import common_extent, ground_height, search_heights
from workbench.matching.stage import median_resolution
from workbench.matching.store import PairStore
from workbench.orientation import Block, read_block
from workbench.params import Parameters, SurfaceParameters
from workbench.rasters import Grid, new_raster, read_raster, write_raster
from workbench.site import Site
from workbench.stages import FOLDERS, Stage, open_stage
from workbench.surface.filling import fill_heights
from workbench.surface.fusion import INTERPOLATED, NO_DATA, fuse_downscales
from workbench.surface.levels import Level, grid_level
from workbench.surface.possible_count import count_possible, possible_pairs
from workbench.surface.refine import refine
from workbench.surface.terrain import ground_filter, height_above, user_terrain

_CACHED_PAIRS = 12


def surface_site(site: Site, parameters: Parameters) -> dict:
    """Make the surfaces of a site from its matched pairs.

    Writes ``dsm_ds1.tif`` ..., ``dsm.tif``, ``count.tif``, ``possible_count.tif``, ``spread.tif``,
    ``provenance.tif``, ``dtm.tif``, ``ground_seen.tif`` and ``ndsm.tif``.

    Returns
    -------
    dict
        The metrics: coverage by one and two pairs, shares of each downscale, spread.

    Raises
    ------
    MatchingError
        If the pairs are missing.
    SurfaceError
        If a user terrain does not fit.
    """
    options = parameters.surface
    with open_stage(site.products / FOLDERS["surface"], {"surface": options}) as stage:
        block = read_block(site.products / FOLDERS["orient"], site)
        store = PairStore(site.products / FOLDERS["match"] / "pairs.zip")
        heights = search_heights(block, parameters.match)
        grid = _grid(block, store, options)
        levels = {d: _level(store, d, grid, heights, options) for d in store.downscales}
        datum = block.vertical_datum
        rasters = [
            new_raster(level.height, grid, name=f"dsm_ds{d}", units="m", vertical_datum=datum)
            for d, level in levels.items()
        ]
        for raster in rasters:
            write_raster(raster, stage.path(f"{raster.name}.tif"))
        fused = fuse_downscales(rasters, list(levels))
        dsm, provenance = fused.height.values, fused.provenance.values
        count, spread = _of_source(levels, provenance)
        surface = new_raster(dsm, grid, name="dsm", units="m", long_name="surface", vertical_datum=datum)
        if options.interpolate == "linear":
            filled, measured = fill_heights(surface).window(slice(0, grid.height), slice(0, grid.width))
            surface.values[~measured] = filled[~measured]
            provenance[~measured] = INTERPOLATED
        write_raster(surface, stage.path("dsm.tif"))
        _write_layers(stage, grid, count, spread, provenance)
        possible = count_possible(possible_pairs(block, parameters.match), surface)
        write_raster(possible, stage.path("possible_count.tif"))
        ground = _terrain(site, surface, options, stage)
        stage.metrics.update(_metrics(levels, provenance, count, spread, possible, ground))
    return stage.metrics


def _grid(block: Block, store: PairStore, options: SurfaceParameters) -> Grid:
    """Cells that any pair can fill; resolution of two significant digits, so that dates fall together."""
    finest = store.downscales[0]
    rectifications = [store.load(entry).rectification for entry in store.pairs(finest)]
    ground = ground_height(block)
    resolution = options.resolution
    if resolution is None:
        wanted = 1.25 * median_resolution(block, ground) * finest
        digits = 1 - int(np.floor(np.log10(wanted)))
        resolution = float(np.ceil(wanted * 10**digits - 1e-6) / 10**digits)
    return Grid.from_bounds(block.crs, common_extent(rectifications, ground), resolution)


def _level(
    store: PairStore,
    downscale: int,
    grid: Grid,
    heights: tuple[float, float],
    options: SurfaceParameters,
) -> Level:
    """A coarser downscale is gridded on cells as much coarser, then refined to the common grid."""
    load = lru_cache(_CACHED_PAIRS)(store.load)
    pairs = [partial(load, entry) for entry in store.pairs(downscale)]
    factor = max(round(downscale / store.downscales[0]), 1)
    if factor == 1:
        return grid_level(pairs, grid, heights, options)
    coarse = Grid.from_bounds(grid.crs, grid.bounds, grid.resolution * factor)
    level = grid_level(pairs, coarse, heights, options)
    return Level(
        refine(level.height, coarse, grid, step=options.patch_step),
        refine(level.count, coarse, grid),
        refine(level.spread, coarse, grid),
    )


def _of_source(levels: dict[int, Level], provenance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Count and spread of the downscale that gave each cell."""
    count = np.zeros(provenance.shape, np.uint8)
    spread = np.full(provenance.shape, np.nan, np.float32)
    for downscale, level in levels.items():
        mine = provenance == downscale
        count[mine], spread[mine] = level.count[mine], level.spread[mine]
    return count, spread


def _write_layers(
    stage: Stage, grid: Grid, count: np.ndarray, spread: np.ndarray, provenance: np.ndarray
) -> None:
    texts = {
        "count": (count, "pairs", "pairs that measured the cell and were used"),
        "spread": (spread, "m", "robust standard deviation of the heights of the pairs"),
        "provenance": (provenance, "1", "0 no data, n downscale measured at, 255 interpolated"),
    }
    for name, (values, units, text) in texts.items():
        write_raster(
            new_raster(values, grid, name=name, units=units, long_name=text), stage.path(f"{name}.tif")
        )


def _terrain(site: Site, surface: xr.DataArray, options: SurfaceParameters, stage: Stage) -> float:
    """Write terrain and height above it; share of the terrain that was seen."""
    grid = Grid.of(surface)
    if site.dtm is not None:
        terrain = user_terrain(read_raster(site.dtm), surface)
        seen = np.isfinite(terrain.values).astype(np.uint8)
        ground_seen = new_raster(seen, grid, name="ground_seen", units="1", long_name="given by the user")
    else:
        coarse, coarse_seen = ground_filter(
            surface,
            cell=options.ground_cell,
            rigidness=options.ground_rigidness,
            threshold=options.ground_threshold,
        )
        base = Grid.of(coarse)
        terrain = new_raster(
            refine(coarse.values, base, grid, step=np.inf),
            grid,
            name="dtm",
            units="m",
            long_name="terrain",
            vertical_datum=surface.attrs["vertical_datum"],
        )
        ground_seen = new_raster(
            refine(coarse_seen.values, base, grid),
            grid,
            name="ground_seen",
            units="1",
            long_name="1 where ground was measured, 0 where the terrain is interpolated",
        )
    write_raster(terrain, stage.path("dtm.tif"))
    write_raster(ground_seen, stage.path("ground_seen.tif"))
    write_raster(height_above(surface, terrain), stage.path("ndsm.tif"))
    return float(ground_seen.values.mean())


def _metrics(
    levels: dict[int, Level],
    provenance: np.ndarray,
    count: np.ndarray,
    spread: np.ndarray,
    possible: xr.DataArray,
    ground: float,
) -> dict:
    area = possible.values > 0
    cells = max(int(area.sum()), 1)
    known = spread[np.isfinite(spread)]
    return {
        "cells_m": float(abs(possible.x[1] - possible.x[0])),
        "coverage_ge1": round(float((area & (count >= 1)).sum() / cells), 5),
        "coverage_ge2": round(float((area & (count >= 2)).sum() / cells), 5),
        "count_zero_share": round(float((area & (count == 0)).sum() / cells), 5),
        "count_mean": round(float(count[area].mean()) if area.any() else 0.0, 4),
        "possible_count_mean": round(float(possible.values[area].mean()) if area.any() else 0.0, 4),
        "spread_median_m": round(float(np.median(known)), 5) if known.size else None,
        "unmatched_share": {
            f"ds{d}": round(float((area & (level.count == 0)).sum() / cells), 5)
            for d, level in levels.items()
        },
        "provenance_share": {f"ds{d}": round(float((provenance == d).sum() / cells), 5) for d in levels},
        "interpolated_share": round(float((area & (provenance == INTERPOLATED)).sum() / cells), 5),
        "no_data_share": round(float((area & (provenance == NO_DATA)).sum() / cells), 5),
        "ground_seen_share": round(ground, 5),
    }
