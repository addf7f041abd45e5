"""The true orthophoto of a block on a surface, in bounded memory.

Two passes: first, tile by tile and from geometry alone, which photograph gives each cell; then,
photograph by photograph (each is decoded once), its colours.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numba
import numpy as np
import xarray as xr

from workbench.cameras.view import view_table
from workbench.errors import MosaicError
from workbench.mosaic.balance import balance_gains
from workbench.mosaic.rectify import rectify
from workbench.mosaic.seams import Preview, find_seams, preview, seamline_polygons
from workbench.mosaic.views import best_views, steepest_tangent
from workbench.orientation import Block
from workbench.params import MosaicParameters
from workbench.photographs import read_photograph
from workbench.rasters import Grid, RasterWriter, Tile, new_raster
from workbench.surface.filling import FilledHeights, fill_heights

_TILE = 1024
_STRIP = 1024
_THREADS = 2
_WALL = 2.0  # Neighbouring cells that differ by more than this many cells are steeper than 63 degrees.

NOT_SEEN, MEASURED, INTERPOLATED, HIDDEN = 0, 1, 2, 3
"""Values of ``validity.tif``: outside all photographs; shown on a measured height; shown on an
interpolated height; inside a photograph, but hidden from all."""


@dataclass(frozen=True, eq=False)
class Orthophoto:
    """What a mosaic is made of, beside the file of its colours."""

    source: xr.DataArray
    """uint16: number of the photograph that gives each cell, from 1 in the order of the block; 0 none."""
    validity: xr.DataArray
    """uint8: 0 not seen, 1 on a measured height, 2 on an interpolated height, 3 hidden from all."""
    seamlines: gpd.GeoDataFrame
    """A polygon a photograph before occlusions are filled: source, photograph, geometry."""
    gains: np.ndarray
    """(photographs, bands): the balance that was applied."""


def make_orthophoto(
    block: Block, surface: xr.DataArray, path: Path | str, parameters: MosaicParameters | None = None
) -> Orthophoto:
    """Write the true orthophoto of a block [thesis 2.3.1.2].

    Parameters
    ----------
    block
        Oriented photographs; all with the same bands and type.
    surface
        Heights (rows, columns) with CRS; holes are closed smoothly and flagged in ``validity``.
    path
        GeoTIFF to write: the bands and type of the photographs, 0 = no data (measured zeros are 1).
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
    heights = fill_heights(surface)
    grid = _orthophoto_grid(block, heights, parameters)
    previews, coarse = _previews(block, heights, grid, parameters)
    labels = find_seams(previews, coarse.shape, method=parameters.seams, band=parameters.seam_band)
    seamlines = seamline_polygons(labels, coarse, block.photographs)
    sample = read_photograph(block.photographs[0].path, downscale=8)
    white = float(np.iinfo(sample.dtype).max)
    gains = np.ones((len(block), sample.shape[-1]))
    if parameters.balance:
        gains = balance_gains(previews, len(block), white=white)
    del previews
    source, validity = _sources(block, heights, grid, labels, coarse, parameters)
    _write_colours(block, heights, grid, source, gains, sample, Path(path))
    raster = new_raster(source, grid, name="source", units="1", long_name="photograph", nodata=0)
    flags = new_raster(validity, grid, name="validity", units="1", long_name="validity", nodata=0)
    return Orthophoto(raster, flags, seamlines, gains)


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
        elevation[tile.core], _ = _heights_at(heights, coarse, *tile.core)
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


def _sources(
    block: Block,
    heights: FilledHeights,
    grid: Grid,
    labels: np.ndarray,
    coarse: Grid,
    parameters: MosaicParameters,
) -> tuple[np.ndarray, np.ndarray]:
    """Photograph and validity of every cell; sight is tested on the cells of the surface."""
    surface_grid = heights.grid
    table = view_table(block.photographs, surface_grid)
    relief = float(heights.coarse.max() - heights.coarse.min()) + 5.0
    margin = math.ceil(relief * steepest_tangent(table) / surface_grid.resolution)
    source = np.zeros(grid.shape, np.uint16)
    validity = np.zeros(grid.shape, np.uint8)
    tolerance = parameters.visibility_tolerance if parameters.visibility else None

    def decide(tile: Tile) -> tuple[np.ndarray, np.ndarray]:
        rows, columns = tile.padded
        z, measured = heights.window(rows, columns)
        wish = labels[_lookup(surface_grid, coarse, rows, columns)]
        wanted = np.zeros(z.shape, bool)
        wanted[tile.inner] = True
        chosen = best_views(
            z,
            table,
            resolution=surface_grid.resolution,
            first_row=rows.start,
            first_column=columns.start,
            preferred=wish,
            tolerance=tolerance,
            wanted=wanted,
        )
        flags = np.where(chosen > 0, np.where(measured, MEASURED, INTERPOLATED), 0).astype(np.uint8)
        flags[(chosen == 0) & (wish > 0)] = HIDDEN
        return chosen[tile.inner], flags[tile.inner]

    tiles = list(surface_grid.tiles(max(_TILE, margin), margin if parameters.visibility else 0))
    with ThreadPoolExecutor(_THREADS) as pool:
        for tile, (chosen, flags) in zip(tiles, pool.map(decide, tiles), strict=True):
            _spread(tile.core, surface_grid, grid, chosen, source)
            _spread(tile.core, surface_grid, grid, flags, validity)
    return source, validity


def _spread(core: tuple[slice, slice], fine: Grid, target: Grid, values: np.ndarray, out: np.ndarray) -> None:
    """Copy values of a window of one grid to the cells of another whose centres fall into it."""
    rows = np.floor((fine.north - target.y) / fine.resolution).astype(int)
    columns = np.floor((target.x - fine.west) / fine.resolution).astype(int)
    i = np.flatnonzero((rows >= core[0].start) & (rows < core[0].stop))
    j = np.flatnonzero((columns >= core[1].start) & (columns < core[1].stop))
    if len(i) and len(j):
        picked = values[rows[i] - core[0].start][:, columns[j] - core[1].start]
        out[i[0] : i[-1] + 1, j[0] : j[-1] + 1] = picked


def _lookup(fine: Grid, coarse: Grid, rows: slice, columns: slice) -> tuple[np.ndarray, ...]:
    """Index arrays of the coarse cells that hold the centres of a window of the fine grid."""
    window = fine.window(rows, columns)
    i = np.clip(np.floor((coarse.north - window.y) / coarse.resolution), 0, coarse.height - 1)
    j = np.clip(np.floor((window.x - coarse.west) / coarse.resolution), 0, coarse.width - 1)
    return np.ix_(i.astype(int), j.astype(int))


def _heights_at(
    heights: FilledHeights, grid: Grid, rows: slice, columns: slice
) -> tuple[np.ndarray, np.ndarray]:
    """Heights at the cells of a window of another grid (bilinear), and whether they were measured."""
    base = heights.grid
    window = grid.window(rows, columns)
    y = np.clip((base.north - window.y) / base.resolution - 0.5, 0, base.height - 1)
    x = np.clip((window.x - base.west) / base.resolution - 0.5, 0, base.width - 1)
    top, left = int(y.min()), int(x.min())
    bottom, right = min(int(y.max()) + 2, base.height), min(int(x.max()) + 2, base.width)
    z, measured = heights.window(slice(top, bottom), slice(left, right))
    return _between(z, measured, y - top, x - left, _WALL * base.resolution)


@numba.njit(cache=True, nogil=True)
def _between(
    z: np.ndarray, measured: np.ndarray, y: np.ndarray, x: np.ndarray, wall: float
) -> tuple[np.ndarray, np.ndarray]:
    """Bilinear heights at rows y and columns x (cells, from the first centre).

    Between the top and the foot of a wall there is no height: a cell there belongs to one of them.
    """
    rows, columns = z.shape
    heights = np.empty((len(y), len(x)), np.float32)
    known = np.empty((len(y), len(x)), np.bool_)
    for i in range(len(y)):
        top = int(y[i])
        bottom, down = min(top + 1, rows - 1), np.float32(y[i] - top)
        near_row = top if down < 0.5 else bottom
        for j in range(len(x)):
            left = int(x[j])
            right, across = min(left + 1, columns - 1), np.float32(x[j] - left)
            near_column = left if across < 0.5 else right
            a, b, c, d = z[top, left], z[top, right], z[bottom, left], z[bottom, right]
            known[i, j] = measured[near_row, near_column]
            if max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) > wall:
                heights[i, j] = z[near_row, near_column]
            else:
                upper, lower = a * (1 - across) + b * across, c * (1 - across) + d * across
                heights[i, j] = upper * (1 - down) + lower * down
    return heights, known


def _write_colours(
    block: Block,
    heights: FilledHeights,
    grid: Grid,
    source: np.ndarray,
    gains: np.ndarray,
    sample: np.ndarray,
    path: Path,
) -> None:
    """Second pass: each photograph once, its colours into a disk-backed mosaic, then into the file."""
    table = view_table(block.photographs, grid)
    bands, kind = sample.shape[-1], sample.dtype
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=path.parent) as file:
        file.truncate(bands * grid.height * grid.width * kind.itemsize)
        colours = np.memmap(file, kind, "r+", shape=(bands, *grid.shape))
        for index, window in _windows(source, len(block)):
            image = read_photograph(block.photographs[index].path)
            if image.shape[-1] != bands or image.dtype != kind:
                raise MosaicError(
                    f"{block.photographs[index].path}: {image.shape[-1]} bands of {image.dtype}, others "
                    f"have {bands} of {kind}: make one site for each kind of camera."
                )
            for rows, columns in _strips(window):
                wanted = source[rows, columns] == index + 1
                z, _ = _heights_at(heights, grid, rows, columns)
                values = rectify(
                    image,
                    table[index],
                    z,
                    resolution=grid.resolution,
                    first_row=rows.start,
                    first_column=columns.start,
                    wanted=wanted,
                )
                shown = np.isfinite(values[..., 0])
                scaled = np.clip(np.rint(values[shown] * gains[index]), 1, np.iinfo(kind).max)
                for band in range(bands):
                    colours[band, rows, columns][shown] = scaled[:, band].astype(kind)
        names = ["red", "green", "blue", "nir"][:bands] if bands in (3, 4) else None
        attributes = {"units": "1", "long_name": "digital number", "band_names": names}
        with RasterWriter(
            path, grid, dtype=str(kind), bands=bands, nodata=0, attributes=attributes, resampling="average"
        ) as writer:
            for rows, columns in _strips((slice(0, grid.height), slice(0, grid.width))):
                writer.write(colours[:, rows, columns], (rows, columns))
        del colours


def _windows(source: np.ndarray, photographs: int) -> Iterator[tuple[int, tuple[slice, slice]]]:
    """Bounding window of the cells of each photograph that gives any."""
    top = np.full(photographs + 1, source.shape[0])
    left = np.full(photographs + 1, source.shape[1])
    bottom, right = np.zeros_like(top), np.zeros_like(left)
    step = 512
    for row in range(0, source.shape[0], step):
        for column in range(0, source.shape[1], step):
            part = source[row : row + step, column : column + step]
            for number in np.unique(part):
                i, j = np.nonzero(part == number)
                top[number] = min(top[number], row + i.min())
                bottom[number] = max(bottom[number], row + i.max() + 1)
                left[number] = min(left[number], column + j.min())
                right[number] = max(right[number], column + j.max() + 1)
    for index in range(photographs):
        number = index + 1
        if bottom[number]:
            yield (
                index,
                (
                    slice(int(top[number]), int(bottom[number])),
                    slice(int(left[number]), int(right[number])),
                ),
            )


def _strips(window: tuple[slice, slice]) -> Iterable[tuple[slice, slice]]:
    rows, columns = window
    for top in range(rows.start, rows.stop, _STRIP):
        yield slice(top, min(top + _STRIP, rows.stop)), columns
