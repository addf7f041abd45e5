"""The mosaic stage: orthophoto, source, validity, seamlines, crop mask and indices of a site."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from workbench.errors import MosaicError
from workbench.mosaic.crop import crop_area
from workbench.mosaic.mesh import mesh_surface
from workbench.mosaic.orthophoto import Orthophoto, make_orthophoto
from workbench.mosaic.sources import HIDDEN, INTERPOLATED, UNCOVERED
from workbench.orientation import Block, read_block
from workbench.params import Parameters
from workbench.rasters import Grid, RasterWriter, read_raster
from workbench.site import Site
from workbench.stages import FOLDERS, Stage, open_stage
from workbench.trees.indices import green_leaf_index, vegetation_index
from workbench.vectors import write_layers

_TILE = 1024


def mosaic_site(site: Site, parameters: Parameters) -> dict:
    """Make the true orthophoto of a site and what belongs to it.

    Writes ``ortho.tif``, ``source.tif``, ``validity.tif``, ``seamlines.gpkg``, ``crop.gpkg``,
    ``gli.tif`` and, where the photographs have near infrared, ``ndvi.tif``.

    Returns
    -------
    dict
        The metrics: resolution, share of cells shown, shown on interpolated heights, hidden.

    Raises
    ------
    MosaicError
        If surface and photographs do not fit together.
    SiteError
        If the surface or the orientation is missing.
    """
    with open_stage(site.products / FOLDERS["mosaic"], {"mosaic": parameters.mosaic}) as stage:
        block = read_block(site.products / FOLDERS["orient"], site)
        surface = _surface(site, block, parameters)
        ortho = make_orthophoto(block, surface, stage.folder, parameters.mosaic)
        write_layers({"seamlines": ortho.seamlines}, stage.path("seamlines.gpkg"))
        if parameters.mosaic.crop:
            area = crop_area(ortho.seamlines, ratio=parameters.mosaic.crop_ratio)
            write_layers({"crop": area}, stage.path("crop.gpkg"))
        _write_indices(stage)
        stage.metrics.update(_metrics(ortho))
    return stage.metrics


def _surface(site: Site, block: Block, parameters: Parameters) -> xr.DataArray:
    dsm = read_raster(site.products / FOLDERS["surface"] / "dsm.tif", chunks=_TILE)
    if parameters.mosaic.surface == "dsm":
        return dsm
    if parameters.mosaic.surface == "dtm":
        return read_raster(site.products / FOLDERS["surface"] / "dtm.tif", chunks=_TILE)
    return mesh_surface(
        block.tie_points,
        Grid.of(dsm),
        vertical_datum=block.vertical_datum,
        smoothing=parameters.mosaic.mesh_smoothing,
    )


def _write_indices(stage: Stage) -> None:
    ortho = read_raster(stage.path("ortho.tif"), chunks=_TILE)
    bands = ortho.sizes.get("band", 1)
    if bands >= 3:
        _write_index(ortho, stage.path("gli.tif"), "green leaf index", green_leaf_index, (0, 1, 2))
    if bands >= 4:
        _write_index(ortho, stage.path("ndvi.tif"), "NDVI", vegetation_index, (3, 0))


def _write_index(ortho: xr.DataArray, path: Path, name: str, index, bands: tuple[int, ...]) -> None:
    grid = Grid.of(ortho)
    with RasterWriter(path, grid, dtype="float32", attributes={"units": "1", "long_name": name}) as writer:
        for tile in grid.tiles(_TILE):
            rows, columns = tile.core
            colours = ortho.isel(y=rows, x=columns).values
            values = index(*(colours[band].astype(np.float32) for band in bands))
            writer.write(np.where((colours > 0).any(axis=0), values, np.nan).astype(np.float32), tile.core)


def _metrics(ortho: Orthophoto) -> dict:
    if not ortho.shown:
        raise MosaicError("The mosaic is empty: no photograph sees any cell of the surface.")
    # Nine decimals: the noise of float coordinates would shift the cells of a run that takes this size.
    resolution = round(ortho.grid.resolution, 9)
    return {
        "resolution_m": resolution,
        "area_m2": ortho.shown * resolution**2,
        "photographs_used": len(ortho.used),
        "interpolated_height_share": float(ortho.cells[INTERPOLATED]) / ortho.shown,
        "hidden_share": ortho.share(HIDDEN),
        "uncovered_share": ortho.share(UNCOVERED),
        "largest_gain": float(np.max(ortho.gains)),
        "smallest_gain": float(np.min(ortho.gains)),
    }
