"""The trees stage: mask, tops, crowns and stand table of a site."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
import xarray as xr
from rasterio.features import geometry_mask

from workbench.errors import TreesError
from workbench.params import Parameters, TreesParameters
from workbench.rasters import Grid, match_grid, read_raster, write_raster
from workbench.site import Site
from workbench.stages import FOLDERS, open_stage
from workbench.trees.criteria import AtLeast, Change, Reach, Slope, StepCriterion
from workbench.trees.crowns import grow_crowns
from workbench.trees.indices import brightness
from workbench.trees.mask import height_over_surroundings, tree_mask
from workbench.trees.methods import CrownMethod, Dalponte, MarkerWatershed, RegionGrowing
from workbench.trees.stands import stand_table, stand_types
from workbench.trees.tops import search_tops
from workbench.trees.windows import ConstantWindow, GrowingWindow, StandWindow, Window
from workbench.vectors import read_vector, write_layers

STANDS = "stands.gpkg"
"""Optional file beside ``site.yaml``: polygons with ``stand_type`` (conifer, broadleaf) and ``stand``."""
_CONIFER, _BROADLEAF = "conifer", "broadleaf"


@dataclass(frozen=True, eq=False)
class _Inputs:
    height: xr.DataArray
    """Height above ground."""
    normalised: bool
    """Whether terrain was subtracted; else the surroundings stand for it."""
    provenance: xr.DataArray | None
    spread: xr.DataArray | None
    layers: dict[str, xr.DataArray]
    """``ndvi``, ``gli``, ``brightness``: those that there are, on the grid of the heights."""
    stands: gpd.GeoDataFrame | None
    lake: gpd.GeoDataFrame | None
    """Lake side of the shoreline."""


def trees_site(site: Site, parameters: Parameters) -> dict:
    """Find the trees of a site on its surface and orthophoto.

    Reads ``surface/ndsm.tif`` (without it ``dsm.tif``, over its surroundings), ``provenance.tif`` and
    ``spread.tif``, and of the mosaic ``ndvi.tif``, ``gli.tif`` and ``ortho.tif`` as far as they exist;
    stand types from ``stands.gpkg`` beside ``site.yaml``; what lies on the lake side of the site's
    shoreline is no tree. Writes ``mask.tif``, ``trees.gpkg`` (layers
    ``tops``, ``crowns``) and ``stands.csv``.

    Returns
    -------
    dict
        The metrics: mask share, number of maxima and tops, heights, crowns.

    Raises
    ------
    TreesError
        If there is no surface, or the mask needs an index that is not there.
    """
    options = parameters.trees
    with open_stage(site.products / FOLDERS["trees"], {"trees": options}) as stage:
        inputs = _read(site, options)
        mask = _mask(inputs, options)
        write_raster(mask, stage.path("mask.tif"))
        search = search_tops(
            inputs.height,
            mask,
            None,
            options.min_height,
            window=_window(inputs.stands, options),
            provenance=inputs.provenance,
            working_resolution=options.working_resolution,
            spacing=options.spacing,
            min_prominence=options.min_prominence,
            tile_size=options.tile_size,
        )
        tops = _with_details(search.tops, inputs, options)
        crowns = grow_crowns(
            tops,
            inputs.height,
            crown_method(options, tuple(inputs.layers)),
            mask=mask,
            layers=inputs.layers,
            min_height=options.min_height,
            working_resolution=options.working_resolution,
            smoothing_size=options.smoothing_size,
            smoothing_sigma=options.smoothing_sigma,
            tile_size=options.tile_size,
        )
        write_layers(
            {"tops": tops.drop(columns=["aspect", "crown_radius"]), "crowns": crowns},
            stage.path("trees.gpkg"),
        )
        table = stand_table(tops, crowns, _areas(inputs), height_class=options.height_class)
        table.to_csv(stage.path("stands.csv"), index=False, lineterminator="\n", float_format="%.6g")
        stage.metrics.update(_metrics(inputs, mask, search.maxima, tops, crowns, table))
    return stage.metrics


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
    return RegionGrowing(
        tuple(steps), Reach("crown_radius", options.crown_min_share, "aspect", winding=options.crown_winding)
    )


def _read(site: Site, options: TreesParameters) -> _Inputs:
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
        name: match_grid(read_raster(mosaic / f"{name}.tif"), grid, resampling="average")
        for name in ("ndvi", "gli")
        if (mosaic / f"{name}.tif").exists()
    }
    if (mosaic / "ortho.tif").exists():
        layers["brightness"] = _brightness(mosaic / "ortho.tif", grid)
    stands = site.folder / STANDS
    return _Inputs(
        height,
        normalised,
        read_raster(surface / "provenance.tif") if (surface / "provenance.tif").exists() else None,
        read_raster(surface / "spread.tif") if (surface / "spread.tif").exists() else None,
        layers,
        read_vector(stands, crs=grid.crs) if stands.exists() else None,
        None if site.shoreline is None else read_vector(site.shoreline, crs=grid.crs),
    )


def _brightness(path: Path, grid: Grid) -> xr.DataArray:
    ortho = read_raster(path)
    bands = ortho if ortho.ndim == 3 else ortho.expand_dims("band")
    mean = ortho.isel(band=0, drop=True) if ortho.ndim == 3 else ortho
    mean = mean.copy(data=brightness(*bands.values).astype(np.float32))
    mean = mean.where((bands > 0).any("band")).rio.write_nodata(np.nan)
    return match_grid(mean, grid, resampling="average")


def _mask(inputs: _Inputs, options: TreesParameters) -> xr.DataArray:
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
        # Reed is green and higher than three metres, but stands in the water.
        grid = Grid.of(mask)
        land = geometry_mask(inputs.lake.geometry, grid.shape, grid.transform)
        mask = mask.copy(data=mask.values * land.astype(np.uint8))
    return mask


def _window(stands: gpd.GeoDataFrame | None, options: TreesParameters) -> Window:
    if options.radius is not None:
        return ConstantWindow(options.radius)
    limits = {"smallest": options.window_smallest, "limit": options.window_largest}
    usual = GrowingWindow(options.window_start, options.window_growth, **limits)
    if stands is None:
        return usual
    types: dict[str, Window] = {
        _CONIFER: GrowingWindow(options.conifer_start, options.conifer_growth, **limits),
        _BROADLEAF: GrowingWindow(options.broadleaf_start, options.broadleaf_growth, **limits),
    }
    return StandWindow(stands, types, usual)


def _with_details(tops: gpd.GeoDataFrame, inputs: _Inputs, options: TreesParameters) -> gpd.GeoDataFrame:
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


def _areas(inputs: _Inputs) -> gpd.GeoDataFrame:
    """Stands, else all that was measured."""
    crs = Grid.of(inputs.height).crs
    if inputs.stands is not None:
        names = inputs.stands["stand"] if "stand" in inputs.stands else inputs.stands["stand_type"]
        return inputs.stands.assign(stand=names)
    return gpd.GeoDataFrame(
        {"stand": ["all"]}, geometry=[shapely.box(*Grid.of(inputs.height).bounds)], crs=crs
    )


def _metrics(
    inputs: _Inputs,
    mask: xr.DataArray,
    maxima: gpd.GeoDataFrame,
    tops: gpd.GeoDataFrame,
    crowns: gpd.GeoDataFrame,
    table: pd.DataFrame,
) -> dict:
    known = np.isfinite(inputs.height.values)
    heights = tops["height_m"].to_numpy(float)

    def rounded(value: float) -> float | None:
        return round(float(value), 4) if np.isfinite(value) else None

    return {
        "ground": "terrain" if inputs.normalised else "lowest surroundings",
        "indices": [name for name in ("ndvi", "gli") if name in inputs.layers],
        "mask_share": rounded(mask.values.sum() / max(int(known.sum()), 1)),
        "maxima": len(maxima),
        "multiple_maxima": int(maxima["multiple"].sum()),
        "trees": len(tops),
        "tops_interpolated": int(tops["interpolated"].sum()),
        "height_mean_m": rounded(heights.mean()) if len(heights) else None,
        "height_max_m": rounded(heights.max()) if len(heights) else None,
        "height_sd_median_m": rounded(tops["height_sd_m"].median()) if len(tops) else None,
        "crowns": len(crowns),
        "crown_diameter_mean_m": rounded(crowns["diameter_m"].mean()) if len(crowns) else None,
        "crown_area_m2": rounded(crowns["area_m2"].sum()),
        "stems_per_ha": {
            str(name): rounded(value)
            for name, value in zip(table["stand"], table["stems_per_ha"], strict=True)
        },
    }
