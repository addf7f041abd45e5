# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3 (ipykernel)
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Single trees: tops, crowns, and how many of them are right
#
# A tree, seen from above, is something higher than three metres and green, with one highest point and a crown
# that falls away from it to all sides. This notebook finds tops and crowns with that model, first on a small
# stand whose trees are known, then on the surface of a site.
#
# The limits of the model are parameters (`trees` in `params.yaml`). At the end of the first part a panel lets
# you move every one of them and see what becomes of tops, crowns and errors.

# %%
# %matplotlib inline
import os
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import panel as pn
import shapely

from workbench.figures import draw_surface, figure
from workbench.params import Parameters, load_parameters

pn.extension()
root = Path(os.environ.get("WORKBENCH_ROOT", ".."))
file = root / "params.yaml"
parameters = load_parameters(file) if file.exists() else Parameters()

# %% [markdown]
# ## A stand with known trees
# Three small stands of a virtual landscape, seen straight from above without any photograph: errors that are
# found here are those of the method, not of the surface.

# %%
from workbench.rasters import Grid, new_raster
from workbench.virtual import build_scene, scene_truth
from workbench.virtual.composition import SceneSpec

stands = {
    "conifer": ("old", [(0, 0), (32, 0), (32, 50), (0, 50)]),
    "broadleaf": ("old", [(36, 0), (80, 0), (80, 50), (36, 50)]),
}
spec = SceneSpec(
    name="two-stands",
    seed=7,
    crs="EPSG:25832",
    vertical_datum="DHHN2016",
    origin=(525000, 5685000),
    size=(80, 50),
    terrain={"base": 400.0, "relief": 0.5},
    stands=[{"area": area, "species_group": kind, "age": age} for kind, (age, area) in stands.items()],
)
scene = build_scene(spec)
truth = scene_truth(scene, Grid.from_bounds(scene.crs, scene.extent, 0.2))
height = new_raster((truth.dsm - truth.dtm).values, Grid.of(truth.dsm), name="height", units="m")

trees = scene.trees[(scene.trees.height_m >= 3) & scene.trees.visible].reset_index(drop=True)
crowns_true = trees[["tree_id", "geometry"]]
trees = trees.set_geometry(gpd.points_from_xy(trees.top_x, trees.top_y, crs=trees.crs))
areas = gpd.GeoDataFrame(
    {"stand_type": list(stands), "stand": list(stands)},
    geometry=[shapely.Polygon(np.add(area, spec.origin)) for _, area in stands.values()],
    crs=spec.crs,
)

picture, axes = figure(9, 5.5)
draw_surface(axes, height, label="height above ground (m)")
axes.plot(trees.geometry.x, trees.geometry.y, "r.", markersize=3)
picture

# %% [markdown]
# ## Tops in five steps
# The surface is cut with mask and least height, averaged to a working resolution, and searched for cells that
# nothing within a disc exceeds. Of tops that are too near each other the highest stays. `search_tops` keeps
# what every step left.

# %%
from workbench.trees import search_tops

search = search_tops(height)
search

# %% [markdown]
# ### The disc decides
# A disc that suits conifers finds many tops on one broadleaf crown; one that suits broadleaf trees loses
# conifers. Besides, a top must rise a little above the saddle to anything higher, so that branches are no trees,
# and the surface is smoothed lightly, since noise from photographs makes tops too. At last, of two tops that are
# nearer than crowns of their height usually are the higher one stays, unless a deep saddle parts them: so several
# summits of one broadleaf crown are one tree. Scores for three discs in both stands, for the last disc alone, and
# for the last disc with all that, as the stage searches where no stand is known:

# %%
from workbench.assessment import match_trees
from workbench.trees import GrowingWindow, find_tops, search_spacing

own = parameters.trees
windows = {
    "conifer": GrowingWindow(own.conifer_start, own.conifer_growth),
    "broadleaf": GrowingWindow(own.broadleaf_start, own.broadleaf_growth),
    "for any stand": GrowingWindow(own.window_start, own.window_growth),
}
limits = {"smoothing": own.top_smoothing, "prominence_share": own.prominence_share}
found_by = {name: find_tops(height, window=window, **limits) for name, window in windows.items()}
found_by["for any stand, disc alone"] = find_tops(height, window=windows["for any stand"])
apart = {"spacing": search_spacing(own), "saddle_share": own.saddle_share}
found_by["for any stand, kept apart"] = find_tops(height, window=windows["for any stand"], **limits, **apart)
rows = []
for window_name, tops in found_by.items():
    for stand, shape in zip(areas.stand, areas.geometry, strict=True):
        match = match_trees(tops, trees, parameters.assess.match_distance, area=shape)
        rows.append({"disc": window_name, "stand": stand, **match.scores})
pd.DataFrame(rows).round(3)

# %% [markdown]
# Each score comes with an interval: 50 trees say less than 500.

# %%
tops = found_by["for any stand, kept apart"]
match = match_trees(tops, trees, parameters.assess.match_distance)
match.intervals().round(3)

# %% [markdown]
# ## Crowns
# All crowns grow from their tops at once, ring by ring. Where two want the same cell, the nearer top has it;
# so the result does not depend on which top is named first. Watershed and the growing of Dalponte and Coomes
# (2016) stand behind the same function.

# %%
from workbench.assessment import compare_crowns
from workbench.trees import Dalponte, MarkerWatershed, RegionGrowing, grow_crowns

found = {
    name: grow_crowns(tops, height, method)
    for name, method in {
        "region growing": RegionGrowing(),
        "watershed": MarkerWatershed(),
        "Dalponte": Dalponte(),
    }.items()
}
pd.DataFrame({name: compare_crowns(crowns, crowns_true).scores for name, crowns in found.items()}).T

# %%
picture, axes = figure(9, 5.5)
draw_surface(axes, height, label="height above ground (m)")
crowns_true.boundary.plot(ax=axes, color="white", linewidth=0.6)
found["region growing"].boundary.plot(ax=axes, color="red", linewidth=0.6)
picture

# %% [markdown]
# White: true crowns; red: grown ones. True crowns reach into each other, which crowns made of cells cannot.

# %% [markdown]
# ## All limits at once
# Move a slider: tops and crowns are found again, green where a tree was found, red where a top is no tree,
# orange where a tree was missed. Click a tree for its profile. The button writes the values to `params.yaml`.

# %%
from workbench.figures.trees import tree_panel
from workbench.trees import TreeInputs

tree_panel(
    TreeInputs(height, stands=areas),
    references={"visible from above": trees},
    options=parameters.trees,
    assessment=parameters.assess,
    parameters_file=file if file.exists() else None,
)

# %% [markdown]
# ## The table of a forester

# %%
from workbench.trees import stand_table

stand_table(tops, found["region growing"], areas).set_index("stand").T.round(2)

# %% [markdown]
# ## A site
# The same on what photographs gave. The stage also makes the mask from NDVI or GLI of the orthophoto, and flags
# tops that stand on interpolated heights. It needs the surface of the site: run notebook 01 first, or the chain.

# %%
from workbench.site import load_site
from workbench.trees import TreeModel, read_tree_inputs

name = os.environ.get("WORKBENCH_SITE", "lake")
folder = root / "data/products" / name / "surface/metrics.json"
if folder.exists():
    site = load_site(name, root)
    inputs = read_tree_inputs(site, own)
    site_tops = TreeModel(inputs).tops(own)
    print(f"{len(site_tops)} trees, {int(site_tops.interpolated.sum())} on interpolated cells")
else:
    site = None
    print(f"{name} has no surface yet: run 01_first_look, or `workbench run --site {name}`.")

# %%
panel = None
if site is not None and len(site_tops):
    # The hectare around the tree in the middle.
    middle = site_tops.geometry.iloc[len(site_tops) // 2]
    area = (middle.x - 50, middle.y - 50, middle.x + 50, middle.y + 50)
    panel = tree_panel(site, area=area, options=own, assessment=parameters.assess)
panel
