"""Crowns: the cells and the outline of every tree, from its top."""

from __future__ import annotations

from collections.abc import Mapping

import dask
import geopandas as gpd
import numpy as np
import xarray as xr

from workbench.errors import TreesError
from workbench.params import TreesParameters
from workbench.rasters import Grid, Tile, new_raster, require_same_grid
from workbench.surface import bilateral
from workbench.trees.criteria import Ground
from workbench.trees.growing import trim
from workbench.trees.maxima import MISSING
from workbench.trees.methods import CrownMethod, RegionGrowing, Tops
from workbench.trees.outlines import outlines
from workbench.trees.working import CutSurface, WorkingGrid

_DEFAULTS = TreesParameters()
_SMOOTHING_CELL = 0.2
_ROWS = 1024


def grow_crowns(
    tops: gpd.GeoDataFrame,
    surface: xr.DataArray,
    method: CrownMethod | None = None,
    *,
    mask: xr.DataArray | None = None,
    layers: Mapping[str, xr.DataArray] | None = None,
    min_height: float = _DEFAULTS.min_height,
    working_resolution: float | None = _DEFAULTS.working_resolution,
    smoothing_size: int = _DEFAULTS.smoothing_size,
    smoothing_sigma: float = _DEFAULTS.smoothing_sigma,
    tile_size: int = _DEFAULTS.tile_size,
) -> gpd.GeoDataFrame:
    """Crown of every top as a polygon [thesis 3.3.3].

    Parameters are those of :func:`crown_labels`; the mean of each raster in ``layers`` within a crown
    becomes a column ``<name>_mean``.

    Returns
    -------
    GeoDataFrame
        A row a crown: ``tree_id`` of its top, ``area_m2`` (its cells), ``diameter_m`` (of the circle of
        that area), means of the layers, and its outline. A top on a missing or masked cell has none.

    Raises
    ------
    TreesError, RasterError
        As :func:`crown_labels`.
    """
    layers = dict(layers or {})
    labels = crown_labels(
        tops,
        surface,
        method,
        mask=mask,
        layers=layers,
        min_height=min_height,
        working_resolution=working_resolution,
        smoothing_size=smoothing_size,
        smoothing_sigma=smoothing_sigma,
        tile_size=tile_size,
    )
    return crown_table(
        labels, {name: on_working_grid(layer, working_resolution) for name, layer in layers.items()}
    )


def crown_labels(
    tops: gpd.GeoDataFrame,
    surface: xr.DataArray,
    method: CrownMethod | None = None,
    *,
    mask: xr.DataArray | None = None,
    layers: Mapping[str, xr.DataArray] | None = None,
    min_height: float = _DEFAULTS.min_height,
    working_resolution: float | None = _DEFAULTS.working_resolution,
    smoothing_size: int = _DEFAULTS.smoothing_size,
    smoothing_sigma: float = _DEFAULTS.smoothing_sigma,
    smooth: xr.DataArray | None = None,
    tile_size: int = _DEFAULTS.tile_size,
) -> xr.DataArray:
    """Cells of every crown: a raster of ``tree_id``, 0 none.

    Parameters
    ----------
    tops
        Points in the CRS of the surface with ``tree_id`` (positive, each once), as of
        :func:`workbench.trees.find_tops`; ``height_m`` is read from the surface where it is missing.
    surface
        Heights above ground (y, x), metres.
    method
        :class:`RegionGrowing` with its criteria (by default), :class:`MarkerWatershed` or
        :class:`Dalponte`.
    mask
        True where trees may be.
    layers
        Rasters that the criteria name (``gli``, ``ndvi``, ``brightness``), on the grid of the surface.
    min_height
        Cells below do not belong to a crown, metres.
    working_resolution
        As for the tops: cells are averaged to about this, and crowns consist of these cells.
    smoothing_size, smoothing_sigma
        Bilateral filter of the surface before slope and aspect: window in cells of 0.2 m (the window
        keeps its extent in metres on other cells) and standard deviation in metres; a window of 1 is none.
    smooth
        What :func:`smoothed` made of the surface, where it is at hand already.
    tile_size
        Edge of the tiles, working cells; the result does not depend on it.

    Returns
    -------
    DataArray
        int32 on the working grid.

    Raises
    ------
    TreesError
        If tops have no or a wrong CRS, repeat an id, lie outside, or the method asks for what is not there.
    RasterError
        If a raster lies on another grid.
    """
    method = RegionGrowing() if method is None else method
    layers = dict(layers or {})
    for raster in ([] if mask is None else [mask]) + list(layers.values()):
        require_same_grid(surface, raster)
    missing = [name for name in method.layers if name not in layers]
    if missing:
        raise TreesError(f"The criteria look at {missing}, given are {sorted(layers)}: pass them as layers.")
    grid = Grid.of(surface)
    work = WorkingGrid.of(grid, working_resolution)
    cut = CutSurface(surface, mask, None, min_height, work)
    on_work = {name: on_working_grid(layers[name], working_resolution) for name in method.layers}
    everything = _tops(tops, surface, work, method)
    if smooth is None and method.smooths:
        smooth = smoothed(surface, smoothing_size, smoothing_sigma, working_resolution=working_resolution)
    owner = np.full(work.shape, -1, np.int32)

    def of_tile(tile: Tile) -> None:
        mine, numbers = _within(everything, tile)
        if not len(numbers):
            return
        values = cut.load(tile.padded).work
        known = np.where(values > MISSING, values, np.nan)
        standing = np.isfinite(known[mine.rows, mine.columns])
        mine, numbers = _some(mine, standing), numbers[standing]
        ground = Ground(
            known,
            known if smooth is None else smooth.values[tile.padded],
            {name: layer.values[tile.padded] for name, layer in on_work.items()},
            work.resolution,
        )
        found = method.label(mine, ground)[tile.inner]
        owner[tile.core] = np.where(found >= 0, numbers[found] if len(numbers) else -1, -1)

    margin = method.margin(work.resolution, everything.values)
    size = max(work.shape) if margin is None else max(tile_size, margin)
    dask.compute(*[dask.delayed(of_tile)(tile) for tile in work.tiles(size, margin or 0)])
    area = getattr(getattr(method, "reach", None), "area", None)
    if area is not None and len(everything.rows):
        trim(owner, everything.rows, everything.columns, max(int(area / work.resolution**2 + 1e-6), 1))
    # From numbers of tops to their ids, in place: a raster of a city is not held twice.
    ids = np.append(tops["tree_id"].to_numpy(np.int32), np.int32(0))
    for top in range(0, work.shape[0], _ROWS):
        owner[top : top + _ROWS] = ids[owner[top : top + _ROWS]]
    return new_raster(
        owner,
        work.grid,
        name="crowns",
        units="1",
        long_name="tree_id",
        nodata=0,
        copy=False,
    )


def crown_table(labels: xr.DataArray, layers: Mapping[str, xr.DataArray] | None = None) -> gpd.GeoDataFrame:
    """Outlines, area, diameter and means of the crowns in a raster of ``tree_id``."""
    grid = Grid.of(labels)
    values = labels.values
    ids, shapes, cells = outlines(values, grid)
    area = cells * grid.resolution**2
    columns = {"tree_id": ids, "area_m2": area, "diameter_m": 2 * np.sqrt(area / np.pi)}
    for name, layer in (layers or {}).items():
        require_same_grid(labels, layer)
        known = np.isfinite(layer.values) & (values > 0)
        place = np.searchsorted(ids, values[known])
        total = np.bincount(place, weights=layer.values[known].astype(np.float64), minlength=len(ids))
        count = np.bincount(place, minlength=len(ids))
        columns[f"{name}_mean"] = np.divide(total, count, out=np.full(len(ids), np.nan), where=count > 0)
    return gpd.GeoDataFrame(columns, geometry=shapes, crs=grid.crs)


def smoothed(
    surface: xr.DataArray,
    size: int = _DEFAULTS.smoothing_size,
    sigma: float = _DEFAULTS.smoothing_sigma,
    *,
    working_resolution: float | None = _DEFAULTS.working_resolution,
) -> xr.DataArray:
    """The surface on working cells after the bilateral filter, whose window is stated in cells of 0.2 m."""
    work = on_working_grid(surface, working_resolution)
    reach = round((size - 1) / 2 * _SMOOTHING_CELL / Grid.of(work).resolution)
    return work if reach < 1 else work.copy(data=np.asarray(bilateral(work.values, 2 * reach + 1, sigma)))


def on_working_grid(layer: xr.DataArray, resolution: float | None) -> xr.DataArray:
    """A raster averaged to working cells."""
    work = WorkingGrid.of(Grid.of(layer), resolution)
    name = str(layer.name or "layer")
    return new_raster(work.average(layer.values), work.grid, name=name, units=layer.attrs.get("units", "1"))


def _tops(tops: gpd.GeoDataFrame, surface: xr.DataArray, work: WorkingGrid, method: CrownMethod) -> Tops:
    grid = work.source
    if tops.crs is None or tops.crs != grid.crs:
        raise TreesError(f"Tops are in {tops.crs}, the surface in {grid.crs}: bring the tops to its CRS.")
    if "tree_id" not in tops or not tops["tree_id"].is_unique or (len(tops) and tops["tree_id"].min() < 1):
        raise TreesError("Tops need a column tree_id with positive numbers, each once.")
    absent = [name for name in method.columns if name not in tops]
    if absent:
        raise TreesError(f"The criteria look at columns {absent} of the tops, which are not there.")
    columns = np.floor((tops.geometry.x.to_numpy() - grid.west) / grid.resolution).astype(np.int64)
    rows = np.floor((grid.north - tops.geometry.y.to_numpy()) / grid.resolution).astype(np.int64)
    outside = (rows < 0) | (rows >= grid.height) | (columns < 0) | (columns >= grid.width)
    if outside.any():
        raise TreesError(
            f"{int(outside.sum())} tops lie outside the surface (first: tree_id "
            f"{tops['tree_id'].to_numpy()[outside][0]}): cut them to its extent."
        )
    if "height_m" in tops:
        heights = tops["height_m"].to_numpy(np.float64)
    else:
        heights = surface.isel(y=xr.DataArray(rows), x=xr.DataArray(columns)).values.astype(np.float64)
    ranks = np.empty(len(tops), np.int64)
    ranks[np.lexsort((columns, rows, -heights))] = np.arange(len(tops))
    values = {name: tops[name].to_numpy(np.float64) for name in method.columns}
    return Tops(rows // work.factor, columns // work.factor, heights, ranks, values)


def _within(tops: Tops, tile: Tile) -> tuple[Tops, np.ndarray]:
    """Tops in the padded window of a tile, in its rows and columns, and their numbers."""
    rows, columns = tile.padded
    inside = (tops.rows >= rows.start) & (tops.rows < rows.stop)
    inside &= (tops.columns >= columns.start) & (tops.columns < columns.stop)
    some = _some(tops, inside)
    moved = Tops(some.rows - rows.start, some.columns - columns.start, some.heights, some.ranks, some.values)
    return moved, np.flatnonzero(inside).astype(np.int32)


def _some(tops: Tops, chosen: np.ndarray) -> Tops:
    values = {name: value[chosen] for name, value in tops.values.items()}
    return Tops(tops.rows[chosen], tops.columns[chosen], tops.heights[chosen], tops.ranks[chosen], values)
