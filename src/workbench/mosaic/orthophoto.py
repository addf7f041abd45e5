"""The true orthophoto of a block on a surface, in bounded memory.

Two passes: first, tile by tile and from geometry alone, which photograph gives each cell; then,
photograph by photograph (each is decoded once), its colours. What is in the making lies on disk.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numpy as np
import xarray as xr

from workbench.cameras.view import view_table
from workbench.errors import MosaicError
from workbench.mosaic.balance import balance_gains
from workbench.mosaic.blending import blend
from workbench.mosaic.colours import fill_colours, heights_at
from workbench.mosaic.crop import crop_area
from workbench.mosaic.scratch import Scratch
from workbench.mosaic.seams import Preview, find_seams, preview, seamline_polygons
from workbench.mosaic.sources import (
    HIDDEN,
    INTERPOLATED,
    MEASURED,
    UNCOVERED,
    Sight,
    Sources,
    clip_sources,
    find_sources,
)
from workbench.orientation import Block
from workbench.params import MosaicParameters
from workbench.photographs import read_photograph
from workbench.rasters import Grid, RasterWriter
from workbench.surface.filling import FilledHeights, fill_heights

_TILE = 1024
_SAME_STATION = 0.01


@dataclass(frozen=True, eq=False)
class Orthophoto:
    """What a mosaic is made of, beside the files of its colours, sources and validity."""

    grid: Grid
    """Its cells."""
    seamlines: gpd.GeoDataFrame
    """A polygon a photograph before occlusions are filled: source, photograph, geometry."""
    gains: np.ndarray
    """(photographs, bands): the balance that was applied."""
    cells: np.ndarray
    """(5,) cells of each validity, see :mod:`workbench.mosaic.sources`."""
    used: tuple[int, ...]
    """Photographs that give any cell, from 0 in the order of the block."""

    @property
    def shown(self) -> int:
        """Cells that show something."""
        return int(self.cells[[MEASURED, INTERPOLATED, UNCOVERED]].sum())

    def share(self, validity: int) -> float:
        """Cells of a validity over all cells that a photograph holds; NaN if there are none."""
        inside = self.shown + int(self.cells[HIDDEN])
        return float(self.cells[validity]) / inside if inside else math.nan


def make_orthophoto(
    block: Block, surface: xr.DataArray, folder: Path | str, parameters: MosaicParameters | None = None
) -> Orthophoto:
    """Write the true orthophoto of a block [thesis 2.3.1.2].

    Written into the folder: ``ortho.tif`` with the bands and type of the photographs (0 is no data,
    measured zeros are 1), ``source.tif`` (uint16: number of the photograph from 1 in the order of the
    block, 0 none) and ``validity.tif`` (uint8, see :mod:`workbench.mosaic.sources`).

    Parameters
    ----------
    block
        Oriented photographs; all with the same bands and type.
    surface
        Heights (rows, columns) with CRS; holes are closed smoothly and flagged in ``validity``.
    folder
        Where to write.
    parameters
        Defaults if not given; ``surface`` of them is not used here.

    Raises
    ------
    MosaicError
        If the block and the surface lie in different CRS or do not overlap, or photographs differ in
        bands or type.
    """
    parameters = parameters or MosaicParameters()
    if Grid.of(surface).crs != block.crs:
        raise MosaicError(
            f"The surface is in {Grid.of(surface).crs}, the photographs in {block.crs}: reproject it."
        )
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    heights = fill_heights(surface)
    grid = _orthophoto_grid(block, heights, parameters)
    previews, coarse = _previews(block, heights, grid, parameters)
    labels = find_seams(
        previews,
        coarse.shape,
        base_ratio=base_height_ratio(block, float(np.median(heights.coarse))),
        method=parameters.seams,
        band=parameters.seam_band,
    )
    seamlines = seamline_polygons(labels, coarse, block.photographs)
    sample = read_photograph(block.photographs[0].path, downscale=8)
    gains = np.ones((len(block), sample.shape[-1]))
    if parameters.balance:
        gains = balance_gains(previews, len(block), white=float(np.iinfo(sample.dtype).max))
    del previews
    sight = Sight(block, heights, grid, parameters)
    sources = Sources(Scratch(folder, grid.shape, np.uint16), Scratch(folder, grid.shape, np.uint8))
    find_sources(sight, labels, coarse, sources)
    if parameters.clip:
        sources = clip_sources(sources, crop_area(seamlines, ratio=parameters.crop_ratio), grid)
    colours = Scratch(folder, (sample.shape[-1], *grid.shape), sample.dtype)
    fill_colours(block, heights, grid, sources, gains, colours)
    if parameters.blending == "multi-band":
        colours = blend(block, sight, sources, gains, colours, Scratch(folder, colours.shape, colours.dtype))
    _write(colours, folder / "ortho.tif", grid, "digital number", "average")
    _write(sources.source, folder / "source.tif", grid, "photograph", "nearest")
    _write(sources.validity, folder / "validity.tif", grid, "validity", "nearest")
    return Orthophoto(grid, seamlines, gains, sources.cells, tuple(sorted(sources.windows)))


def ground_sampling_distances(block: Block, height: float) -> np.ndarray:
    """Ground sampling distance (n,), metres, of each photograph along its axis at a ground height."""
    return np.array(
        [
            (photograph.pose.centre[2] - height)
            / max(-photograph.pose.view_direction[2], 0.1)
            / photograph.camera.focal_x
            for photograph in block
        ]
    )


def base_height_ratio(block: Block, height: float) -> float:
    """Median distance to the nearest other station over the height above ground; 1 without another.

    Cameras of one rig share a station: what lies within a hundredth of the height is the same one.
    """
    stations = np.array([photograph.pose.centre for photograph in block])
    above = max(float(np.median(stations[:, 2])) - height, 1e-6)
    apart = np.hypot(*(stations[:, None, :2] - stations[None, :, :2]).transpose(2, 0, 1)) / above
    apart[apart < _SAME_STATION] = np.inf
    nearest = apart.min(axis=1)
    return float(np.median(nearest[np.isfinite(nearest)])) if np.isfinite(nearest).any() else 1.0


def _orthophoto_grid(block: Block, heights: FilledHeights, parameters: MosaicParameters) -> Grid:
    grid = heights.grid
    resolution = parameters.resolution
    if resolution is None:
        gsd = float(np.median(ground_sampling_distances(block, float(np.median(heights.coarse)))))
        if gsd <= 0:
            raise MosaicError("The photographs lie below the surface: check the vertical datum of both.")
        # Two significant digits, so that grids of repeated runs and dates fall together.
        digits = 1 - math.floor(math.log10(gsd))
        resolution = math.ceil(gsd * 10**digits) / 10**digits
    return Grid.from_bounds(grid.crs, grid.bounds, resolution)


def _previews(
    block: Block, heights: FilledHeights, grid: Grid, parameters: MosaicParameters
) -> tuple[list[Preview], Grid]:
    coarse = Grid.from_bounds(grid.crs, grid.bounds, grid.resolution * parameters.seam_cell)
    table = view_table(block.photographs, coarse)
    elevation = np.empty(coarse.shape, np.float32)
    for tile in coarse.tiles(_TILE):
        elevation[tile.core], _ = heights_at(heights, coarse, *tile.core)
    gsd = ground_sampling_distances(block, float(np.median(elevation)))
    found = []
    for index, photograph in enumerate(block):
        downscale = max(round(coarse.resolution / gsd[index]), 1)
        image = read_photograph(photograph.path, downscale=downscale)
        view = preview(index, image, table[index], elevation, coarse)
        if view is not None:
            found.append(view)
    if not found:
        raise MosaicError(
            "No photograph shows the surface: check that poses and surface share CRS and datum."
        )
    bands = {view.colours.shape[-1] for view in found}
    if len(bands) > 1:
        raise MosaicError(f"Photographs have {sorted(bands)} bands: make one site for each kind of camera.")
    return found, coarse


def _write(values: Scratch, path: Path, grid: Grid, long_name: str, resampling: str) -> None:
    bands = values.shape[0] if len(values.shape) == 3 else 1
    names = ["red", "green", "blue", "nir"][:bands] if bands in (3, 4) else None
    with RasterWriter(
        path,
        grid,
        dtype=str(values.dtype),
        bands=bands,
        nodata=0,
        attributes={"units": "1", "long_name": long_name, "band_names": names},
        resampling=resampling,
    ) as writer:
        for tile in grid.tiles(_TILE):
            writer.write(values.read(tile.core), tile.core)
