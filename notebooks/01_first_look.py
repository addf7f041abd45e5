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
# # A first look: from photographs to a report
#
# A *site* is one area on one date: photographs, the positions of the cameras, control points. This notebook
# takes one through the whole chain, and looks at what every stage makes. Each stage is one function; the command
# line (`workbench orient --site lake`) and DVC (`dvc repro`) call the same ones.
#
# The site is `lake`, a virtual landscape with known truth. To use your own photographs, make a site with
# `workbench new-site` and change `name` below.

# %%
# %matplotlib inline
import os
from pathlib import Path

import pandas as pd

from workbench.figures import draw_classes, draw_orthophoto, draw_surface, draw_values, figure
from workbench.params import Parameters, load_parameters
from workbench.rasters import read_overview
from workbench.site import check_site, load_site
from workbench.stages import read_json
from workbench.virtual import scene_names, simulate_scene

root = Path(os.environ.get("WORKBENCH_ROOT", ".."))
name = "lake"
file = root / "params.yaml"
parameters = load_parameters(file) if file.exists() else Parameters()

# %% [markdown]
# ## The site
# A virtual site is photographed first, which takes a minute. It is an ordinary site: nothing that follows knows
# that it is virtual.

# %%
if not (root / "data/sites" / name / "site.yaml").exists() and name in scene_names():
    simulate_scene(name, root, parameters)
site = load_site(name, root)
print(check_site(site, parameters))

# %% [markdown]
# ## Orientation
# Structure from motion finds where each camera stood. Recorded positions and control points enter by their
# precision; check points do not enter, and tell the error.

# %%
from workbench.orientation import orient_site

done = (site.products / "orientation/metrics.json").exists()
metrics = read_json(site.products / "orientation/metrics.json") if done else orient_site(site, parameters)
pd.Series({key: value for key, value in metrics.items() if not isinstance(value, list | dict)})

# %%
pd.read_csv(site.products / "orientation/control.csv").round(3)

# %% [markdown]
# ## Matching and surface
# Pairs are matched at several downscales. The finest gives most heights; coarser ones fill holes with measured
# heights, and `provenance` says which cell came from where. Nothing is interpolated unless you ask for it.

# %%
from workbench.matching import match_site
from workbench.surface import surface_site

if not (site.products / "matching/metrics.json").exists():
    match_site(site, parameters)
if not (site.products / "surface/metrics.json").exists():
    surface_site(site, parameters)
picture, axes = figure()
draw_surface(axes, read_overview(site.products / "surface/dsm.tif"))
picture

# %%
picture, axes = figure()
count = read_overview(site.products / "surface/count.tif")
draw_values(axes, count, label="pairs that measured the cell", vmin=0)
picture

# %%
picture, axes = figure()
classes = {
    0: ("no data", "#ffffff"),
    1: ("downscale 1", "#1f77b4"),
    2: ("downscale 2", "#2ca02c"),
    3: ("downscale 3", "#ff9f1c"),
}
draw_classes(axes, read_overview(site.products / "surface/provenance.tif"), classes)
picture

# %% [markdown]
# Where is the count zero? In the crowns, at their edges, and on the water: leaves move between exposures,
# and a smooth surface has nothing to match.

# %% [markdown]
# ## Orthophoto

# %%
from workbench.mosaic import mosaic_site

if not (site.products / "mosaic/metrics.json").exists():
    mosaic_site(site, parameters)
picture, axes = figure(9, 8)
draw_orthophoto(axes, read_overview(site.products / "mosaic/ortho.tif", longest=2000))
picture

# %% [markdown]
# ## Against the truth
# Only a virtual site has one. Heights of the surface minus true heights, where both are known:

# %%
from workbench.rasters import Grid, match_grid, read_raster

if site.truth is not None:
    dsm = read_raster(site.products / "surface/dsm.tif")
    truth = match_grid(read_raster(site.truth / "dsm.tif"), Grid.of(dsm))
    difference = dsm - truth
    picture, axes = figure()
    draw_values(
        axes, difference.rio.write_crs(dsm.rio.crs), label="difference (m)", cmap="RdBu", vmin=-1, vmax=1
    )
    print(f"median {float(difference.median()):+.3f} m")
picture

# %% [markdown]
# ## Reed, trees, and how good it is
# The same functions that the command line calls: aquatic reed along the shore, single trees on land, and every product
# against its reference. Notebooks 07 and 08 take them apart.

# %%
from workbench.assessment import assess_site
from workbench.reed import reed_site
from workbench.trees import trees_site

for stage, folder in ((reed_site, "reed"), (trees_site, "trees"), (assess_site, "assessment")):
    if not (site.products / folder / "metrics.json").exists():
        stage(site, parameters)
pd.Series(
    {
        "reed, area (m²)": read_json(site.products / "reed/metrics.json")["extent_m2"],
        "trees": read_json(site.products / "trees/metrics.json")["trees"],
    },
    name=name,
).to_frame()

# %% [markdown]
# ## The report
# One HTML file with all of this, the parameters, the environment and the run times.

# %%
from workbench.figures import report_site

report_site(site, parameters)
site.products / "report/report.html"
