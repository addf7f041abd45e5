"""The trees of one area, step by step: what a changed parameter does not touch is not computed again."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import geopandas as gpd
import numpy as np
import xarray as xr
from rasterio.features import geometry_mask

from workbench.errors import TreesError
from workbench.params import TreesParameters
from workbench.rasters import Grid, read_raster
from workbench.site import Site
from workbench.stages import FOLDERS
from workbench.trees.criteria import AtLeast, Change, Reach, Slope, StepCriterion
from workbench.trees.crowns import crown_labels, crown_table, on_working_grid, smoothed
from workbench.trees.layers import read_brightness, read_index
from workbench.trees.mask import height_over_surroundings, tree_mask
from workbench.trees.methods import CrownMethod, Dalponte, MarkerWatershed, RegionGrowing
from workbench.trees.stands import stand_types
from workbench.trees.tops import TopSearch, search_tops
from workbench.trees.windows import ConstantWindow, GrowingWindow, StandWindow, Window
from workbench.trees.working import WorkingGrid
from workbench.vectors import read_vector

STANDS = "stands.gpkg"
"""Optional file beside ``site.yaml``: polygons with ``stand_type`` (conifer, broadleaf) and ``stand``."""
_CONIFER, _BROADLEAF = "conifer", "broadleaf"
_MASK = ("min_height", "mask_index", "min_ndvi", "min_gli", "mask_close", "mask_open", "mask_min_area")
_WINDOW = ("radius", "window_start", "window_growth", "window_smallest", "window_largest")
_STAND_WINDOW = ("conifer_start", "conifer_growth", "broadleaf_start", "broadleaf_growth")
_SEARCH = (
    *_MASK,
    *_WINDOW,
    *_STAND_WINDOW,
    "working_resolution",
    "top_smoothing",
    "spacing",
    "spacing_start",
    "spacing_growth",
    "saddle_share",
    "min_prominence",
    "prominence_share",
)
_SMOOTHING = ("working_resolution", "smoothing_size", "smoothing_sigma")


@dataclass(frozen=True, eq=False)
class TreeInputs:
    """What the trees of an area are sought in, all on the grid of the heights."""

    height: xr.DataArray
    """Height above ground, metres."""
    layers: dict[str, xr.DataArray] = field(default_factory=dict)
    """``ndvi``, ``gli``, ``brightness``: those that there are."""
    normalised: bool = True
    """Whether terrain was subtracted; else the surroundings stand for it."""
    provenance: xr.DataArray | None = None
    """Source of every height."""
    spread: xr.DataArray | None = None
    """Spread of the pairs, metres."""
    stands: gpd.GeoDataFrame | None = None
    """Polygons with ``stand_type``."""
    lake: gpd.GeoDataFrame | None = None
    """Lake side of the shoreline: reed is green and higher than three metres, but stands in the water."""


class TreeModel:
    """Mask, tops and crowns of an area for any parameters; each step keeps its last result."""

    def __init__(self, inputs: TreeInputs) -> None:
        self.inputs = inputs
        self._kept: dict[str, tuple[Any, Any]] = {}

    def mask(self, options: TreesParameters) -> xr.DataArray:
        """Where trees may be.

        Raises
        ------
        TreesError
            If the mask needs an index that is not there.
        """
        return self._step("mask", options, _MASK, lambda: _mask(self.inputs, options))

    def search(self, options: TreesParameters) -> TopSearch:
        """Search for tops with all its steps."""
        return self._step(
            "search",
            options,
            _SEARCH,
            lambda: search_tops(
                self.inputs.height,
                self.mask(options),
                None,
                options.min_height,
                window=search_window(options, self.inputs.stands, self._cell(options)),
                provenance=self.inputs.provenance,
                working_resolution=options.working_resolution,
                smoothing=options.top_smoothing,
                spacing=search_spacing(options, self.inputs.stands),
                saddle_share=options.saddle_share if options.spacing is None else None,
                min_prominence=options.min_prominence,
                prominence_share=options.prominence_share,
                tile_size=options.tile_size,
            ),
        )

    def tops(self, options: TreesParameters) -> gpd.GeoDataFrame:
        """Tops with ``stand_type``, ``height_sd_m``, and what limits their crowns."""
        return _with_details(self.search(options).tops, self.inputs, options)

    def labels(self, options: TreesParameters) -> xr.DataArray:
        """Raster of ``tree_id``: the cells of every crown."""
        method = crown_method(options, tuple(self.inputs.layers))
        return self._step(
            "labels",
            options,
            tuple(type(options).model_fields),
            lambda: crown_labels(
                self.tops(options),
                self.inputs.height,
                method,
                mask=self.mask(options),
                layers=self.inputs.layers,
                min_height=options.min_height,
                working_resolution=options.working_resolution,
                smooth=self.smooth(options) if method.smooths else None,
                tile_size=options.tile_size,
            ),
        )

    def smooth(self, options: TreesParameters) -> xr.DataArray:
        """Surface after the bilateral filter, for slope and aspect."""
        return self._step(
            "smooth",
            options,
            _SMOOTHING,
            lambda: smoothed(
                self.inputs.height,
                options.smoothing_size,
                options.smoothing_sigma,
                working_resolution=options.working_resolution,
            ),
        )

    def crowns(self, options: TreesParameters) -> gpd.GeoDataFrame:
        """Outlines, areas and mean indices of the crowns."""
        means = {
            name: on_working_grid(layer, options.working_resolution)
            for name, layer in self.inputs.layers.items()
        }
        return crown_table(self.labels(options), means)

    def _cell(self, options: TreesParameters) -> float:
        return WorkingGrid.of(Grid.of(self.inputs.height), options.working_resolution).resolution

    def _step(
        self, name: str, options: TreesParameters, fields: tuple[str, ...], compute: Callable[[], Any]
    ) -> Any:
        key = tuple(getattr(options, field_name) for field_name in fields)
        if name not in self._kept or self._kept[name][0] != key:
            self._kept[name] = (key, compute())
        return self._kept[name][1]


def read_tree_inputs(site: Site, options: TreesParameters) -> TreeInputs:
    """What a site has to find trees in.

    Raises
    ------
    TreesError
        If there is no surface.
    """
    surface, mosaic = site.products / FOLDERS["surface"], site.products / FOLDERS["mosaic"]
    normalised = (surface / "ndsm.tif").exists()
    if normalised:
        height = read_raster(surface / "ndsm.tif")
    elif (surface / "dsm.tif").exists():
        height = height_over_surroundings(read_raster(surface / "dsm.tif"), options.surroundings)
    else:
        raise TreesError(f"{surface}: no surface. Run `workbench surface --site {site.name}` first.")
    grid = Grid.of(height)
    layers = {
        name: read_index(mosaic / f"{name}.tif", grid)
        for name in ("ndvi", "gli")
        if (mosaic / f"{name}.tif").exists()
    }
    if (mosaic / "ortho.tif").exists():
        layers["brightness"] = read_brightness(mosaic / "ortho.tif", grid)
    stands = site.folder / STANDS
    return TreeInputs(
        height,
        layers,
        normalised,
        read_raster(surface / "provenance.tif") if (surface / "provenance.tif").exists() else None,
        read_raster(surface / "spread.tif") if (surface / "spread.tif").exists() else None,
        read_vector(stands, crs=grid.crs) if stands.exists() else None,
        None if site.shoreline is None else read_vector(site.shoreline, crs=grid.crs),
    )


def search_window(
    options: TreesParameters, stands: gpd.GeoDataFrame | None = None, cell: float = 0.0
) -> Window:
    """Search window that the parameters ask for; by stand type where there are stands.

    A window that grows looks at least at the eight neighbours of a working ``cell`` (metres).
    """
    if options.radius is not None:
        return ConstantWindow(options.radius)
    usual = _growing(options, options.window_start, options.window_growth, cell)
    if stands is None:
        return usual
    types: dict[str, Window] = {
        _CONIFER: _growing(options, options.conifer_start, options.conifer_growth, cell),
        _BROADLEAF: _growing(options, options.broadleaf_start, options.broadleaf_growth, cell),
    }
    return StandWindow(stands, types, usual)


def _growing(options: TreesParameters, start: float, growth: float, cell: float) -> GrowingWindow:
    smallest = max(options.window_smallest, math.sqrt(2.0) * cell)
    return GrowingWindow(start, growth, smallest, max(options.window_largest, smallest))


def search_spacing(options: TreesParameters, stands: gpd.GeoDataFrame | None = None) -> Window | None:
    """Least distance of two tops that the parameters ask for; None: that of the search disc.

    In stands of type conifer it is the search disc as well: neighbours may be near, and a crown has one
    summit.
    """
    if options.spacing is not None:
        return ConstantWindow(options.spacing)
    if options.radius is not None:
        return None
    usual = GrowingWindow(options.spacing_start, options.spacing_growth)
    if stands is None:
        return usual
    conifers = _growing(options, options.conifer_start, options.conifer_growth, 0.0)
    return StandWindow(stands, {_CONIFER: conifers}, usual)


def crown_method(options: TreesParameters, layers: tuple[str, ...] = ()) -> CrownMethod:
    """The way to find crowns that the parameters ask for.

    Region growing reads the columns ``crown_radius`` (m) and ``aspect`` (sixteenths, -1 none) of the tops.

    Parameters
    ----------
    options
        Section ``trees``.
    layers
        Names of the rasters that there are beside the surface.
    """
    if options.crown_method == "watershed":
        return MarkerWatershed(options.crown_min_share, options.max_diameter / 2)
    if options.crown_method == "dalponte":
        return Dalponte(options.dalponte_top_share, options.dalponte_mean_share, options.max_diameter / 2)
    steps: list[StepCriterion] = []
    if options.min_slope is not None or options.max_slope is not None:
        low = -90.0 if options.min_slope is None else options.min_slope
        steps.append(Slope(low, 90.0 if options.max_slope is None else options.max_slope))
    if options.max_index_change is not None:
        steps += [Change(name, options.max_index_change) for name in ("ndvi", "gli") if name in layers]
    if options.min_brightness is not None and "brightness" in layers:
        steps.append(AtLeast("brightness", options.min_brightness))
    aspect: int | str = -1 if options.aspect == "never" else "aspect"
    return RegionGrowing(
        tuple(steps), Reach("crown_radius", options.crown_min_share, aspect, winding=options.crown_winding)
    )


def _mask(inputs: TreeInputs, options: TreesParameters) -> xr.DataArray:
    wanted = options.mask_index
    if wanted == "auto":
        wanted = "ndvi" if "ndvi" in inputs.layers else "gli" if "gli" in inputs.layers else "none"
    names = {"ndvi": ("ndvi",), "gli": ("gli",), "both": ("ndvi", "gli"), "none": ()}[wanted]
    absent = [name for name in names if name not in inputs.layers]
    if absent:
        raise TreesError(
            f"The mask needs {absent}, but the mosaic has no such raster: the photographs lack a band, or "
            "the mosaic stage has not run. Set trees.mask_index to what there is."
        )
    mask = tree_mask(
        inputs.height,
        ndvi=inputs.layers.get("ndvi") if "ndvi" in names else None,
        gli=inputs.layers.get("gli") if "gli" in names else None,
        min_height=options.min_height,
        min_ndvi=options.min_ndvi,
        min_gli=options.min_gli,
        close=options.mask_close,
        open=options.mask_open,
        min_area=options.mask_min_area,
        tile_size=options.tile_size,
    )
    if inputs.lake is not None and len(inputs.lake):
        grid = Grid.of(mask)
        land = geometry_mask(inputs.lake.geometry, grid.shape, grid.transform)
        mask = mask.copy(data=mask.values * land.astype(np.uint8))
    return mask


def _with_details(tops: gpd.GeoDataFrame, inputs: TreeInputs, options: TreesParameters) -> gpd.GeoDataFrame:
    """Tops with stand type, what limits their crown, and the uncertainty of their height."""
    tops = tops.copy()
    tops["stand_type"] = stand_types(tops, inputs.stands).astype(str)
    kind = tops["stand_type"].to_numpy()
    diameter = np.select(
        [kind == _CONIFER, kind == _BROADLEAF],
        [options.conifer_diameter, options.broadleaf_diameter],
        options.max_diameter,
    )
    tops["crown_radius"] = diameter / 2
    used = (options.aspect == "always") | ((options.aspect == _CONIFER) & (kind == _CONIFER))
    tops["aspect"] = np.where(used, options.max_aspect, -1)
    spread = np.zeros(len(tops))
    if inputs.spread is not None and len(tops):
        at = {"y": xr.DataArray(tops["row"].to_numpy()), "x": xr.DataArray(tops["column"].to_numpy())}
        spread = np.nan_to_num(inputs.spread.isel(at).values.astype(np.float64))
    # Pairs that agree may be wrong together by the terrain and the datum.
    tops["height_sd_m"] = np.hypot(spread, options.height_sd)
    return tops
