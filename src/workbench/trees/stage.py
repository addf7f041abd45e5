"""The trees stage: mask, tops, crowns and stand table of a site."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
import xarray as xr

from workbench.params import Parameters
from workbench.rasters import Grid, write_raster
from workbench.site import Site
from workbench.stages import FOLDERS, open_stage
from workbench.trees.model import TreeInputs, TreeModel, read_tree_inputs
from workbench.trees.stands import stand_table
from workbench.vectors import write_layers

_SHORE = 25.0
"""Width of the land along a lake on which reed is to be expected, metres."""
_TALLEST_REED = 6.0
"""Reed grows 1-6 m high [reed 1], metres."""


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
        inputs = read_tree_inputs(site, options)
        model = TreeModel(inputs)
        mask = model.mask(options)
        write_raster(mask, stage.path("mask.tif"))
        search, tops, crowns = model.search(options), model.tops(options), model.crowns(options)
        write_layers(
            {"tops": tops.drop(columns=["aspect", "crown_radius"]), "crowns": crowns},
            stage.path("trees.gpkg"),
        )
        table = stand_table(tops, crowns, _areas(inputs), height_class=options.height_class)
        table.to_csv(stage.path("stands.csv"), index=False, lineterminator="\n", float_format="%.6g")
        stage.metrics.update(_metrics(inputs, mask, search.maxima, tops, crowns, table))
        stage.metrics["warnings"] = reed_warnings(inputs, tops)
    return stage.metrics


def reed_warnings(inputs: TreeInputs, tops: gpd.GeoDataFrame) -> list[str]:
    """Tops that may be reed: on land beside the lake, and not higher than reed grows."""
    if inputs.lake is None or not len(inputs.lake) or not len(tops):
        return []
    shore = inputs.lake.to_crs(tops.crs).union_all()
    near = tops["height_m"].le(_TALLEST_REED).to_numpy() & (tops.distance(shore) <= _SHORE).to_numpy()
    if not near.any():
        return []
    return [
        f"{int(near.sum())} tops stand within {_SHORE:g} m of the lake and are no higher than reed "
        f"({_TALLEST_REED:g} m): they may be reed on land. Raise trees.min_height above it if they are."
    ]


def _areas(inputs: TreeInputs) -> gpd.GeoDataFrame:
    """Stands, else all that was measured."""
    crs = Grid.of(inputs.height).crs
    if inputs.stands is not None:
        names = inputs.stands["stand"] if "stand" in inputs.stands else inputs.stands["stand_type"]
        return inputs.stands.assign(stand=names)
    return gpd.GeoDataFrame(
        {"stand": ["all"]}, geometry=[shapely.box(*Grid.of(inputs.height).bounds)], crs=crs
    )


def _metrics(
    inputs: TreeInputs,
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
