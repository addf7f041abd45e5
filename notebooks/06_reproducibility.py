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
# # Reproducibility: which pixels of an orthomosaic would come out the same again?
#
# Compute the same photographs twice with the same parameters, and two different orthomosaics come out: random samples
# in matching lead to slightly different poses, surfaces and seams. Where a pixel changes with the computation, no
# change of the land can be read from it. Ludwig et al. (2020) repeat the computation, correlate all pairs of mosaics
# in a moving window, and call a pixel identical from a correlation of 0.95 on. This notebook does so.
#
# The site is a small virtual clearing: a broadleaf stand with dead trees beside a meadow, coarse enough to be
# computed three times within a minute or two. For a site of yours:
# `workbench study reproducibility --site S --repeat 5`.

# %%
import os
import tempfile
from importlib.resources import files
from pathlib import Path

import pandas as pd
import panel as pn

from workbench.params import Parameters, load_parameters
from workbench.site import load_site
from workbench.studies import repeat_chain
from workbench.virtual import simulate_scene

pn.extension()
root = Path(os.environ.get("WORKBENCH_ROOT", ".."))
file = root / "params.yaml"
parameters = load_parameters(file) if file.exists() else Parameters()
coarse = parameters.model_copy(
    update={
        "simulate": parameters.simulate.model_copy(update={"truth_resolution": 0.16}),
        # Nine photographs: without the outermost of them nothing would be left.
        "study": parameters.study.model_copy(update={"crop": False}),
    }
)
# A root of its own, so that nothing is mixed up with your sites; kept for the next time.
scratch = Path(tempfile.gettempdir()) / "workbench-reproducibility"
if not (scratch / "data/sites/clearing/site.yaml").exists():
    scene = Path(str(files("workbench.studies") / "shipped" / "scenes" / "clearing.yaml"))
    flight = {"gsd": 0.15, "reduction": 14, "forward_overlap": 0.8, "side_overlap": 0.65}
    simulate_scene(scene, scratch, coarse, flight_overrides=flight)
site = load_site("clearing", scratch)
len(site.photographs)

# %% [markdown]
# ## Three repetitions
# Each orients, matches, makes the surface, and a mosaic on the dense surface (*dsm*) and on the smoothed mesh of the
# tie points (*mesh*). Every step is kept: run the cell again, or ask for five, and only what is missing is computed.

# %%
repeated = repeat_chain(site, coarse, repetitions=3)
repeated.table.assign(share=repeated.table.share.round(3))

# %% [markdown]
# The errors of the check points of the three, as in Table 2 of the paper:

# %%
repeated.errors.round(4)

# %% [markdown]
# ## Where is it reproducible?
# Yellow pixels are identical in all pairs, blue ones in none. Move the limits. On the meadow, look for patches with
# straight borders: there another photograph gives the pixels, because a seam lies elsewhere, and its noise is another
# noise. In the crowns poses and heights that differ by millimetres and centimetres show other leaves.

# %%
from workbench.figures.reproducibility_panel import ReproducibilityPanel

looked_at = ReproducibilityPanel(site, repeated.folder, params=file if file.exists() else None)
looked_at.panel()

# %% [markdown]
# ## At gaps, or in the middle of the crowns?
# The paper finds non-reproducible pixels at clearings and dead trees. Share by the distance of a crown's pixel to the
# nearest gap:

# %%
import numpy as np

from workbench.rasters import Grid, match_grid, read_raster
from workbench.studies import share_by_distance
from workbench.studies.responses import cover_names

layer = repeated.by_surface["dsm"].layer
cover = match_grid(read_raster(site.truth / "cover.tif"), Grid.of(layer), resampling="nearest")
code = {cover_name: number for number, cover_name in cover_names(site).items()}
crowns = cover.copy(data=np.isin(cover.values, [code["broadleaf"], code["conifer"]]))
share_by_distance(repeated.by_surface["dsm"], ~crowns, crowns, edges=(0.0, 0.3, 0.6, 1.0, 2.0)).round(3)

# %% [markdown]
# ## Few repetitions or many?
# Whether two repetitions find what three find: the share of the region that they find, the overlap of both regions
# over their union, and the correlation of the shares of identical pairs.

# %%
from workbench.studies import agreement, reproducibility
from workbench.studies.repetitions import common_area

paths = sorted(repeated.folder.glob("seed_*/data/products/clearing/ortho_dsm.tif"))
mosaics = common_area([read_raster(path) for path in paths])
pd.Series(agreement(reproducibility(mosaics[:2]), reproducibility(mosaics))).round(3)

# %% [markdown]
# ## Time series
# Between dates, stable ground tells how well two mosaics lie on each other, and digitised objects tell how far things
# move. Here two repetitions stand for two dates: what shifts is the computation, not the land.

# %%
import geopandas as gpd
from shapely.geometry import box

from workbench.studies import coregistration, follow_objects, object_shifts

meadow = gpd.GeoDataFrame(geometry=[box(480004, 5630000, 480040, 5630012)], crs=site.crs)
patches = coregistration(mosaics[0], mosaics[1], meadow, patch=4.0, search=1.0)
patches[["east_m", "north_m", "shift_m", "score"]].describe().loc[["mean", "std", "max"]].round(4)

# %%
from workbench.vectors import read_vector

trees = read_vector(site.truth / "trees.gpkg").rename(columns={"tree_id": "object"})
trees = trees.loc[trees.visible & (trees.height_m > 6), ["object", "geometry"]]
later = follow_objects(trees, mosaics[0], mosaics[1], search=1.0)
shifts = object_shifts({"first": trees, "second": later})
print(f"{len(shifts.table)} crowns: {shifts.mean_m:.3f} m on average, at most {shifts.maximum_m:.3f} m")
shifts.table.drop(columns="geometry").head().round(3)
