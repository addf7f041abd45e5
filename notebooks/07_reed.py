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
# # Aquatic reed: from a surface to the status of a shore
#
# Reed that thins out, frays at its front, and breaks into islets and holes is in decline. All of that can be read
# from the heights of a surface model, if the level of the water and the official shoreline are known (Baier et al.
# 2022). This notebook measures one shore step by step, compares it with the field, and lets you move every threshold.
#
# The site is `lake`, a virtual shore with a vital and a declining belt. Any other surface does as well: see the end.

# %%
import os
from pathlib import Path

import pandas as pd
import panel as pn

from workbench.params import Parameters, load_parameters
from workbench.site import load_site
from workbench.virtual import scene_names, simulate_scene

pn.extension()
root = Path(os.environ.get("WORKBENCH_ROOT", ".."))
name = "lake"
file = root / "params.yaml"
parameters = load_parameters(file) if file.exists() else Parameters()

# %% [markdown]
# What is missing is made first: photographs, orientation, matching, surface and orthophoto, about two minutes.

# %%
from workbench.matching import match_site
from workbench.mosaic import mosaic_site
from workbench.orientation import orient_site
from workbench.surface import surface_site

if not (root / "data/sites" / name / "site.yaml").exists() and name in scene_names():
    simulate_scene(name, root, parameters)
site = load_site(name, root)
stages = {"orientation": orient_site, "matching": match_site, "surface": surface_site, "mosaic": mosaic_site}
for folder, stage in stages.items():
    if not (site.products / folder / "metrics.json").exists():
        stage(site, parameters)

# %% [markdown]
# ## Heights
# The object height model is the surface minus the water level. At every field point the highest cell within half a
# metre is compared with the height of the stem minus the depth of the water. R² is that of the fitted line, as the
# authors plot it; `efficiency` is the stricter one, about the line 1:1.

# %%
from workbench.figures.reed_heights import height_scatter
from workbench.reed import agreement_by_area, compare_heights, load_model, load_references

model, references = load_model(site, parameters.reed), load_references(site)
metrics = model.measure(parameters.reed)
compared = compare_heights(metrics.ohm, references.points, radius=parameters.reed.point_radius)
height_scatter(compared)

# %%
agreement_by_area(compared).round(2)

# %% [markdown]
# ## Extent, density, front and status
# Reed is what lies between a minimum and a maximum height on the lake side of the shoreline. Where the surface has
# no height there is neither reed nor water: such ground is unknown, and counted as unknown.

# %%
metrics.areas.drop(columns="geometry").round(1)

# %% [markdown]
# Every ten metres of shore are a section with its own index: three times the sinuosity of the front, plus islets,
# plus holes, plus the ratio of sparse to dense reed. Sections that cannot be judged say why.

# %%
metrics.sections.drop(columns="geometry").round(2)

# %% [markdown]
# ## Move the thresholds
# What are the numbers worth that the authors chose? Move them, and look at the error matrices. Only the steps that
# depend on a slider are computed again. The button writes the values to `params.yaml` and says which stages
# `dvc repro` will run.
#
# Worth trying:
#
# 1. Raise the minimum height from 0.5 to 0.8 m. Which islets and spurs before the front vanish, and what does the matrix
#    of the extent say?
# 2. Lower the water level by 0.2 m, as if the gauge were read wrongly. Which result suffers most?
# 3. Set the variance cut to 0: now height alone decides what is dense. Which plots change sides?
# 4. Find the aRSI cut with the best status matrix. Would you trust it on another lake, given so few sections?

# %%
from workbench.figures.reed import reed_panel

reed_panel(site, options=parameters.reed, parameters_file=file if file.exists() else None)

# %% [markdown]
# ## Against the field and the eye
# The papers give accuracies without intervals. With few samples these are wide.

# %%
from workbench.reed import agreements

found = agreements(metrics, references, dense_stems=parameters.reed.plot_dense_stems)
pd.concat({key: agreement.matrix.intervals() for key, agreement in found.items()}).round(2)

# %% [markdown]
# ## How sure is that?
# The spread of the surface between pairs and the water level are uncertain. A few surfaces are drawn that are as
# likely as the measured one, and measured again (50 draws give a standard deviation to 10 %; here are 5).

# %%
from workbench.rasters import read_raster
from workbench.reed import propagate

drawn = propagate(
    model, parameters.reed, spread=read_raster(site.products / "surface/spread.tif"), draws=5, seed=1
)
drawn.summary.round(2)

# %% [markdown]
# And which threshold decides? One at a time is moved by a fifth.

# %%
from workbench.reed import sensitivity

moved = sensitivity(model, parameters.reed, factors=(0.8, 1.0, 1.2))
moved[moved.factor != 1].set_index(["threshold", "factor"]).round(2)

# %% [markdown]
# ## Your own surface
# Nothing above needs a site. Any surface in metres, a water level in its vertical datum and the polygon of the lake
# will do; the rest (areas of interest, transects, field tables) may be left out. On the command line:
#
#     workbench reed-surface dsm.tif --water-level 517.93 --vertical-datum DHHN2016 --shoreline lake.gpkg --out results
#
# In Python, with the same panel:
#
#     from workbench.rasters import read_raster
#     from workbench.vectors import read_vector
#     from workbench.reed import ReedModel, doubts
#     from workbench.figures.reed import reed_panel
#
#     dsm = read_raster("dsm.tif", vertical_datum="DHHN2016")
#     model = ReedModel(dsm, 517.93, read_vector("lake.gpkg"))
#     reed_panel(model)
#
# A level in another datum, or a polygon of the land instead of the lake, gives wrong numbers and no error. Ask:

# %%
from workbench.reed import doubts, measure_reed, open_water
from workbench.vectors import read_vector

print("open water lies at", round(open_water(metrics), 2), "m; doubts:", doubts(metrics, parameters.reed))
too_low = measure_reed(model.dsm, model.water_level - 0.4, read_vector(site.shoreline))
doubts(too_low, parameters.reed)

# %% [markdown]
# Two dates of one shore are compared by `workbench.reed.compare_dates`: what was lost and gained, and by how many
# metres the front of every section moved.
