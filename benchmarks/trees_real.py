"""Single trees on real surfaces: the pycrown forest, and the park of Brighton Beach.

``forest``: canopy height model of a New Zealand forest (laser scanning, from the pycrown project; not part of
the repository), tops and crowns on it. ``site``: tops and crowns of a site that ran through the chain,
on its orthophoto, with the heights of the tallest free-standing trees. Both write a picture.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd

from workbench.figures import draw_orthophoto, draw_surface, figure
from workbench.params import TreesParameters
from workbench.rasters import Grid, match_grid, read_raster
from workbench.site import load_site
from workbench.trees import TreeInputs, TreeModel, find_tops, grow_crowns, read_tree_inputs

FREE = 1.0
"""A tree whose crown is further than this from all others stands alone, metres."""

MANY = 60
"""With more crowns only those that stand alone carry their height."""


def forest(folder: Path, picture: Path) -> None:
    """Tops and crowns of the canopy height model, and of the surface minus the terrain."""
    height = read_raster(folder / "CHM.tif")
    tops = find_tops(height)
    crowns = grow_crowns(tops, height)
    dsm = read_raster(folder / "DSM.tif")
    grid = Grid.of(dsm)
    dtm = match_grid(read_raster(folder / "DTM.tif"), grid)
    other = find_tops(dsm, terrain=dtm)
    print(f"cells of {Grid.of(height).resolution:g} m, {height.shape[0]} x {height.shape[1]}")
    heights, widths = _spread(tops["height_m"]), _spread(crowns["diameter_m"])
    print(f"CHM: {len(tops)} tops, height {heights} m, crowns {widths} m")
    print(f"DSM over DTM: {len(other)} tops, height {_spread(other['height_m'])} m")
    made, axes = figure(11, 9)
    draw_surface(axes, height, label="height above ground (m)")
    crowns.boundary.plot(ax=axes, color="white", linewidth=0.5)
    axes.plot(tops.geometry.x, tops.geometry.y, "r.", markersize=3)
    made.savefig(picture, dpi=110)


def site(root: Path, name: str, picture: Path, area: tuple[float, float, float, float] | None) -> None:
    """Tops, crowns and the tallest trees that stand alone."""
    place = load_site(name, root)
    options = TreesParameters()
    model = TreeModel(_part(read_tree_inputs(place, options), area))
    tops, crowns = model.tops(options), model.crowns(options)
    alone = crowns[_alone(crowns)]
    table = alone.merge(tops.drop(columns="geometry"), on="tree_id").sort_values("height_m", ascending=False)
    columns = ["tree_id", "height_m", "height_sd_m", "diameter_m", "area_m2", "interpolated"]
    print(f"{name}: {len(tops)} tops, {len(crowns)} crowns, {len(alone)} of them stand alone")
    print(pd.DataFrame(table[columns]).head(15).round(2).to_string(index=False))
    made, axes = figure(12, 10)
    ortho = read_raster(place.products / "mosaic" / "ortho.tif")
    step = max(1, max(ortho.sizes["x"], ortho.sizes["y"]) // 2500)
    draw_orthophoto(axes, ortho.isel(x=slice(None, None, step), y=slice(None, None, step)))
    crowns.boundary.plot(ax=axes, color="yellow", linewidth=0.6)
    alone.boundary.plot(ax=axes, color="red", linewidth=1.2)
    named = table if len(crowns) > MANY else crowns.merge(tops.drop(columns="geometry"), on="tree_id")
    for row in named.itertuples():
        right, top = row.geometry.bounds[2:]
        axes.text(right, top, f"{row.height_m:.1f}", color="white", fontsize=7)
    west, south, east, north = Grid.of(model.inputs.height).bounds
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)
    made.savefig(picture, dpi=110)


def _part(inputs: TreeInputs, area: tuple[float, float, float, float] | None) -> TreeInputs:
    if area is None:
        return inputs
    from workbench.figures.tree_pictures import clipped_inputs

    return clipped_inputs(inputs, area)


def _alone(crowns: gpd.GeoDataFrame) -> np.ndarray:
    near = crowns.sindex.query(crowns.geometry, predicate="dwithin", distance=FREE)
    return np.bincount(near[0], minlength=len(crowns)) == 1


def _spread(values: pd.Series) -> str:
    return f"{values.median():.1f} ({values.quantile(0.05):.1f}-{values.quantile(0.95):.1f})"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="what", required=True)
    one = commands.add_parser("forest")
    one.add_argument("folder", type=Path, help="Folder with CHM.tif, DSM.tif, DTM.tif.")
    two = commands.add_parser("site")
    two.add_argument("name")
    two.add_argument("--root", type=Path, default=Path())
    two.add_argument("--area", type=float, nargs=4, help="West, south, east, north.")
    for command in (one, two):
        command.add_argument("--picture", type=Path, required=True)
    args = parser.parse_args()
    if args.what == "forest":
        forest(args.folder, args.picture)
    else:
        site(args.root, args.name, args.picture, args.area and tuple(args.area))


if __name__ == "__main__":
    main()
