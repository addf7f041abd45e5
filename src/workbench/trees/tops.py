"""Tree tops: local maxima of the unfiltered surface, in the five steps of the thesis [3.3.2]."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import dask
import geopandas as gpd
import numpy as np
import xarray as xr

from workbench.errors import TreesError
from workbench.params import TreesParameters
from workbench.rasters import Grid, Tile, require_same_grid
from workbench.trees import maxima
from workbench.trees.windows import GrowingWindow, Window, as_window
from workbench.trees.working import CutSurface, Part, WorkingGrid, reach_of_gaussian

_DEFAULTS = TreesParameters()
_LOWEST = -1e30
_WIDER = 1 + 1e-9  # 0.3 m are three cells of 0.1 m, whatever binary fractions say.
_REACH = 2.0  # The measure of prominence looks twice as far as the search disc: to the next crowns.
_FAR = _DEFAULTS.max_diameter / 2  # Two tops of one tree are seldom farther from each other, metres.
_TALLEST_TREE = 120.0  # Metres.
_HIDDEN_CELLS = 1.5  # What cells hide of a saddle: between flanks of 45 degrees about their diagonal.
PROMINENCE_SHARE = 0.05
"""Least prominence as a share of the height where no disc is asked for, on surfaces as they are; the tree
stage smooths a little and asks for less (docs/trees.md)."""
SADDLE_SHARE = _DEFAULTS.saddle_share
"""Prominence as a share of the height from which a top is a tree however near another one stands, where no
spacing is asked for (docs/trees.md)."""
INTERPOLATED = 255
"""Value of a provenance raster where a height was not measured."""


@dataclass(frozen=True, eq=False)
class TopSearch:
    """What the steps of the search for tops left."""

    maxima: gpd.GeoDataFrame
    """Step 3: all local maxima, columns as the tops, and ``multiple`` (step 4: another maximum is nearer
    than the spacing) and ``kept`` (prominent enough, and in step 5 the highest of those)."""
    resolution: float
    """Step 2: cell of the surface that was searched, metres."""

    @property
    def tops(self) -> gpd.GeoDataFrame:
        """Tops that are kept, numbered from the north, then from the west: ``tree_id`` from 1."""
        tops = self.maxima[self.maxima["kept"]].drop(columns=["multiple", "kept"]).reset_index(drop=True)
        tops.insert(0, "tree_id", np.arange(1, len(tops) + 1))
        return tops

    def _repr_html_(self) -> str:
        multiple, kept = int(self.maxima["multiple"].sum()), int(self.maxima["kept"].sum())
        return (
            f"<p>{len(self.maxima)} local maxima on cells of {self.resolution:g} m, "
            f"{multiple} of them nearer than the spacing, {kept} tops</p>"
        )


def find_tops(
    surface: xr.DataArray,
    mask: xr.DataArray | None = None,
    radius: float | Callable | Window | None = _DEFAULTS.radius,
    min_height: float = _DEFAULTS.min_height,
    *,
    window: Window | None = None,
    terrain: xr.DataArray | None = None,
    provenance: xr.DataArray | None = None,
    working_resolution: float | None = _DEFAULTS.working_resolution,
    smoothing: float = 0.0,
    spacing: float | Callable | Window | None = _DEFAULTS.spacing,
    saddle_share: float | None = None,
    min_prominence: float = _DEFAULTS.min_prominence,
    prominence_share: float | None = None,
    tile_size: int = _DEFAULTS.tile_size,
) -> gpd.GeoDataFrame:
    """Find one top per tree [thesis 3.3.2].

    1. The surface is cut with the mask and the least height. 2. Finer cells are averaged to the
    working resolution. 3. A cell is a maximum where nothing within the search disc is higher; touching
    equal maxima (a plateau) are one. 4., 5. Of maxima nearer than the spacing the highest stays.
    Two separate maxima of exactly the same height within one disc are one tree as well: the northern,
    then the western one stays.

    Parameters
    ----------
    surface
        Heights (y, x) with a metric CRS, metres; above ground, or above any datum if ``terrain`` is
        given. NaN is missing. In memory or chunked; only the heights that a tile needs are loaded.
    mask
        True (or 1) where trees may be, on the grid of the surface; None: everywhere.
    radius
        Radius of the search disc in metres, a function of the height above ground (vectorised), a
        :class:`Window`, or None for one that grows with height.
    min_height
        Least height of a tree above ground, metres.
    window
        Another name for ``radius``, for windows as values.
    terrain
        Height of the ground on the grid of the surface, metres. Tops are then maxima of the surface
        itself, which a slope does not shift, and heights are above this ground.
    provenance
        As the surface stage writes it: 255 marks interpolated cells.
    working_resolution
        Cell to average to, metres; None: search on the cells as they are. A whole number of cells is
        averaged, the one that comes nearest. The top is the highest source cell within the working
        cell, with its own height.
    smoothing
        Standard deviation of a Gaussian over the working cells before step 3, metres; missing cells take
        no part. For surfaces from photographs, whose noise from cell to cell makes tops (the tree stage
        asks for it); 0: none, as laser surfaces and the thesis need it. Heights stay those of the source.
    spacing
        Least distance of two tops, metres, or, as ``radius``, one that depends on the height of the lower
        top. Tops are judged from the highest down, and only those that stay remove others. None: if
        ``radius`` is None too, one that grows with height (:func:`growing_spacing`), so that a wide
        crown with several summits is one tree; else that of the search disc.
    saddle_share
        A top that rises above its saddle by this share of its height (less one and a half cells, as
        below) is a tree however near another one stands. None: :data:`SADDLE_SHARE` where no spacing was
        asked for, else the spacing holds for all.
    min_prominence
        Least prominence, metres: how far one must descend from a top on any way to something higher,
        within 7 m (half of the largest crown).
    prominence_share
        Least prominence as a share of the height of the top, less one and a half cells of the working
        grid, which hide that much of a saddle; the larger of both holds. None: :data:`PROMINENCE_SHARE` if
        ``radius`` is None too, so that branches of a crown are not taken for trees; else 0, so that all
        maxima in the disc that was asked for are tops.
    tile_size
        Edge of the tiles, working cells; the result does not depend on it.

    Returns
    -------
    GeoDataFrame
        A point a tree at the centre of the highest cell: ``tree_id`` (from the north, then from the
        west), ``height_m`` (above ground), ``z_m`` (of the surface), ``radius_m`` (search disc),
        ``prominence_m`` (see :func:`workbench.trees.maxima.radial_prominence`; larger is surer),
        ``interpolated`` (the highest cell was not measured), ``row``, ``column`` (of that cell).

    Raises
    ------
    TreesError
        If the disc is smaller than a cell or larger than the raster, a value is out of range, or heights
        are those of no tree (centimetres, elevations).
    RasterError
        If mask, terrain or provenance lie on another grid, or the surface has no CRS.
    """
    return search_tops(
        surface,
        mask,
        radius,
        min_height,
        window=window,
        terrain=terrain,
        provenance=provenance,
        working_resolution=working_resolution,
        smoothing=smoothing,
        spacing=spacing,
        saddle_share=saddle_share,
        min_prominence=min_prominence,
        prominence_share=prominence_share,
        tile_size=tile_size,
    ).tops


def growing_spacing() -> GrowingWindow:
    """Least distance of two tops where nothing is asked for: discs of broadleaf trees do not overlap."""
    return GrowingWindow(_DEFAULTS.spacing_start, _DEFAULTS.spacing_growth)


def search_tops(
    surface: xr.DataArray,
    mask: xr.DataArray | None = None,
    radius: float | Callable | Window | None = _DEFAULTS.radius,
    min_height: float = _DEFAULTS.min_height,
    *,
    window: Window | None = None,
    terrain: xr.DataArray | None = None,
    provenance: xr.DataArray | None = None,
    working_resolution: float | None = _DEFAULTS.working_resolution,
    smoothing: float = 0.0,
    spacing: float | Callable | Window | None = _DEFAULTS.spacing,
    saddle_share: float | None = None,
    min_prominence: float = _DEFAULTS.min_prominence,
    prominence_share: float | None = None,
    tile_size: int = _DEFAULTS.tile_size,
) -> TopSearch:
    """As :func:`find_tops`, with what every step left."""
    if not isinstance(surface, xr.DataArray):
        raise TreesError(
            f"A surface is a raster with its place, not {type(surface).__name__}: read the file with "
            "workbench.rasters.read_raster."
        )
    grid = Grid.of(surface)
    _check(surface, grid, mask, terrain, provenance, min_height, spacing)
    if not 0 <= smoothing <= _FAR:
        raise TreesError(f"A smoothing of {smoothing} m is impossible: give 0 (none) to {_FAR:g}.")
    if window is not None and radius is not None:
        raise TreesError("Give the search disc as radius or as window, not both.")
    work = WorkingGrid.of(grid, working_resolution)
    unasked = window is None and radius is None
    if prominence_share is None:
        prominence_share = PROMINENCE_SHARE if unasked else 0.0
    if spacing is None and unasked:
        spacing = growing_spacing()
        saddle_share = SADDLE_SHARE if saddle_share is None else saddle_share
    apart = None if spacing is None else as_window(spacing)
    disc = as_window(window if window is not None else radius, work.resolution)
    cut = CutSurface(surface, mask, terrain, min_height, work)
    largest = disc.largest(cut.highest(tile_size))
    _check_disc(largest, grid, work)
    _check_shares(min_prominence, prominence_share, saddle_share)
    found = _maxima(
        cut, disc, largest, smoothing, (min_prominence, prominence_share), saddle_share, tile_size
    )
    _check_heights(found["height"])
    multiple, kept = np.zeros(len(found), bool), found["stands_out"].copy()
    multiple[kept], kept[kept] = _thin(found[kept], work, apart)
    return TopSearch(_frame(found, multiple, kept, grid, provenance), work.resolution)


def _check(
    surface: xr.DataArray,
    grid: Grid,
    mask: xr.DataArray | None,
    terrain: xr.DataArray | None,
    provenance: xr.DataArray | None,
    min_height: float,
    spacing: float | Callable | Window | None,
) -> None:
    if surface.ndim != 2:
        raise TreesError(f"Tops need one band of heights (y, x), not {surface.dims}: select the band.")
    if grid.crs.is_geographic:
        raise TreesError(f"Distances need metres, but the surface is in {grid.crs}: reproject it.")
    if grid.crs.is_projected and not math.isclose(grid.crs.linear_units_factor[1], 1.0):
        raise TreesError(
            f"Distances need metres, but the surface is in {grid.crs}, whose unit is the "
            f"{grid.crs.linear_units}: reproject it."
        )
    if not min_height > 0:
        raise TreesError(f"A least height of {min_height} m makes trees of the ground: give more than 0.")
    if isinstance(spacing, int | float) and not spacing > 0:
        raise TreesError(f"A spacing of {spacing} m separates nothing: give a positive one, or None.")
    for other in (mask, terrain, provenance):
        if other is not None:
            require_same_grid(surface, other)


def _check_shares(min_prominence: float, prominence_share: float, saddle_share: float | None) -> None:
    for name, share in (("prominence_share", prominence_share), ("saddle_share", saddle_share)):
        if share is not None and not 0 <= share <= 1:
            raise TreesError(f"A {name} of {share} is no share of a height: give 0 (none) to 1.")
    if not min_prominence >= 0:
        raise TreesError(f"A least prominence of {min_prominence} m is impossible: give 0 (none) or more.")


def _check_heights(heights: np.ndarray) -> None:
    """Half of the maxima higher than any tree of the world are no trees."""
    if len(heights) and np.median(heights) > _TALLEST_TREE:
        raise TreesError(
            f"Half of the tops would be higher than {np.median(heights):.0f} m; no tree is. If the surface "
            "is in centimetres, divide it by 100; if it holds elevations, give terrain= or subtract it."
        )


def _check_disc(largest: float, grid: Grid, work: WorkingGrid) -> None:
    if largest * _WIDER < work.resolution:
        raise TreesError(
            f"The search disc has a radius of at most {largest:.3g} m, less than one cell of "
            f"{work.resolution:g} m: enlarge the radius, or give a finer working resolution."
        )
    extent = max(grid.shape) * grid.resolution
    if largest > extent:
        raise TreesError(
            f"A search disc of {largest:g} m is larger than the raster ({extent:g} m): "
            "is the radius in metres, and the raster the right one?"
        )


def _maxima(
    cut: CutSurface,
    disc: Window,
    largest: float,
    smoothing: float,
    prominence: tuple[float, float],
    saddle_share: float | None,
    tile_size: int,
) -> np.ndarray:
    """Local maxima of all tiles, one a plateau (its northern, then western cell), by place."""
    work = cut.grid
    offsets = maxima.disc(largest / work.resolution * _WIDER)
    sigma = smoothing / work.resolution
    far = _FAR if max(*prominence, saddle_share or 0.0) > 0 else 0.0
    margin = int(max(_REACH * largest, far) / work.resolution) + 1 + reach_of_gaussian(sigma)

    def of_tile(tile: Tile) -> tuple[np.ndarray, np.ndarray]:
        part = cut.load(tile.padded).smoothed(sigma)
        width = part.work.shape[1]
        places = maxima.summits(part.work, _LOWEST, *[(axis.start, axis.stop) for axis in tile.inner])
        rows, columns = np.divmod(places, width)
        top, left = (axis.start for axis in tile.padded)
        x, y = work.centres(rows + top, columns + left)
        radii = disc.radii(part.work_height[rows, columns].astype(np.float64), x, y)
        if np.any(radii > largest * _WIDER):
            raise TreesError("The window gives larger radii than its largest(): correct the window.")
        limits = (radii / work.resolution * _WIDER) ** 2
        kept = maxima.exceeded_by_none(part.work, places, limits, offsets)
        places, radii = places[kept], radii[kept]
        levels = part.work.ravel()[places]
        first = maxima.plateaus(levels, places, width)
        alone = np.flatnonzero(first == np.arange(len(places)))
        found = _describe(part, tile, work, places[alone], radii[alone], prominence, saddle_share)
        return found, _edge(tile, work, places, levels, first)

    parts = dask.compute(*[dask.delayed(of_tile)(tile) for tile in work.tiles(tile_size, margin)])
    found, edges = (np.concatenate(some) for some in zip(*parts, strict=True))
    if len(parts) > 1 and len(edges):
        width = work.shape[1]
        again = maxima.merge_plateaus(edges["place"], edges["level"], edges["first"], width)
        found = found[~np.isin(found["place"], again)]
    return found[np.argsort(found["place"], kind="stable")]


def _describe(
    part: Part,
    tile: Tile,
    work: WorkingGrid,
    places: np.ndarray,
    radii: np.ndarray,
    prominence: tuple[float, float],
    saddle_share: float | None,
) -> np.ndarray:
    found = np.zeros(len(places), _MAXIMUM)
    rows, columns = np.divmod(places, part.work.shape[1])
    top, left = (axis.start for axis in tile.padded)
    found["place"] = (rows + top) * work.shape[1] + columns + left
    found["level"], found["radius"] = part.work[rows, columns], radii
    reach = np.ceil(_REACH * radii / work.resolution).astype(np.int64)
    found["prominence"] = maxima.radial_prominence(part.work_height, rows, columns, reach)
    least, share = prominence
    hidden, far = _HIDDEN_CELLS * work.resolution, int(_FAR / work.resolution) + 1
    heights = part.work_height[rows, columns].astype(np.float64)
    depths = np.maximum(least, share * heights - hidden)
    found["stands_out"] = maxima.stand_out(part.work, rows, columns, depths, far)
    if saddle_share is not None:
        some = np.flatnonzero(found["stands_out"])
        depths = saddle_share * heights[some] - hidden
        found["alone"][some] = maxima.stand_out(part.work, rows[some], columns[some], depths, far)
    apex_rows, apex_columns = part.apexes(rows, columns, work.factor)
    found["z"], found["height"] = part.surface[apex_rows, apex_columns], part.height[apex_rows, apex_columns]
    found["row"], found["column"] = apex_rows + top * work.factor, apex_columns + left * work.factor
    return found


def _edge(
    tile: Tile, work: WorkingGrid, places: np.ndarray, levels: np.ndarray, first: np.ndarray
) -> np.ndarray:
    """Maxima along the edge of a tile, where a plateau may go on in the next."""
    width = tile.padded[1].stop - tile.padded[1].start
    places_on = maxima.on_edge(places, width, *[(axis.start, axis.stop) for axis in tile.inner])
    edge = np.zeros(len(places_on), _EDGE)
    top, left = (axis.start for axis in tile.padded)
    for name, some in (("place", places[places_on]), ("first", places[first[places_on]])):
        edge[name] = (some // width + top) * work.shape[1] + some % width + left
    edge["level"] = levels[places_on]
    return edge


def _thin(found: np.ndarray, work: WorkingGrid, spacing: Window | None) -> tuple[np.ndarray, np.ndarray]:
    """Steps 4 and 5: which maxima have another one within the spacing, and which stay."""
    multiple, kept = np.zeros(len(found), bool), np.ones(len(found), bool)
    if spacing is None:
        # Only equal maxima are left within one disc.
        _, group, size = np.unique(found["level"], return_inverse=True, return_counts=True)
        looked_at = np.flatnonzero(size[group] > 1)
    else:
        looked_at = np.arange(len(found))
    if len(looked_at) < 2:
        return multiple, kept
    some = found[looked_at]
    rows, columns = np.divmod(some["place"], work.shape[1])
    reach = some["radius"]
    if spacing is not None:
        reach = spacing.radii(some["height"].astype(np.float64), *work.centres(rows, columns))
    reach = np.where(some["alone"], 0.0, reach / work.resolution * _WIDER)
    order = np.lexsort((some["place"], -some["level"]))
    points = np.stack([rows, columns], axis=1)[order].astype(np.float64)
    near, stays = maxima.thin(points, some["level"][order], reach[order], spacing is None)
    multiple[looked_at[order]], kept[looked_at[order]] = near, stays
    return multiple, kept


def _frame(
    found: np.ndarray, multiple: np.ndarray, kept: np.ndarray, grid: Grid, provenance: xr.DataArray | None
) -> gpd.GeoDataFrame:
    rows, columns = found["row"], found["column"]
    x = grid.west + (columns + 0.5) * grid.resolution
    y = grid.north - (rows + 0.5) * grid.resolution
    interpolated = np.zeros(len(found), bool)
    if provenance is not None and len(found):
        interpolated = provenance.isel(y=xr.DataArray(rows), x=xr.DataArray(columns)).values == INTERPOLATED
    columns_of = {
        "height_m": found["height"].astype(np.float64),
        "z_m": found["z"].astype(np.float64),
        "radius_m": found["radius"],
        "prominence_m": found["prominence"].astype(np.float64),
        "interpolated": interpolated,
        "row": rows,
        "column": columns,
        "multiple": multiple,
        "kept": kept,
    }
    order = np.lexsort((columns, rows))
    values = {name: value[order] for name, value in columns_of.items()}
    return gpd.GeoDataFrame(values, geometry=gpd.points_from_xy(x[order], y[order]), crs=grid.crs)


_MAXIMUM = np.dtype(
    [
        ("place", np.int64),
        ("level", np.float32),
        ("radius", np.float64),
        ("prominence", np.float32),
        ("stands_out", np.bool_),
        ("alone", np.bool_),
        ("z", np.float32),
        ("height", np.float32),
        ("row", np.int64),
        ("column", np.int64),
    ]
)
_EDGE = np.dtype([("place", np.int64), ("level", np.float32), ("first", np.int64)])
