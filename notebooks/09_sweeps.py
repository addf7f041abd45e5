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
# # Sweeps: what happens when a flight changes
#
# A *study* is a small YAML file: a scene, factors with levels, repeated seeds, and what is measured. The command
# `workbench study angle-gsd --quick` runs one, shares the steps that cells have in common, and writes one long
# table: a row per cell, seed and response. Everything below is drawn from such tables; nothing is computed again.
#
# The tables of the quick presets come with the repository. `workbench study list` names all studies, and
# `workbench study NAME --estimate` says what the full design would cost on your machine.

# %%
# %matplotlib inline
import os
from pathlib import Path

import pandas as pd
import panel as pn

from workbench.figures.study_figures import (
    count_table,
    draw_angle_over_overlap,
    draw_count_maps,
    draw_ratio_histogram,
    draw_response,
)
from workbench.figures.sweeps_panel import read_study, sweeps_panel
from workbench.rasters import read_raster
from workbench.studies.analysis import effects, means, optimum
from workbench.studies.design import list_studies

pn.extension()
root = Path(os.environ.get("WORKBENCH_ROOT", ".."))
list_studies()

# %% [markdown]
# ## The angle
# The intersection angle of two neighbouring photographs follows from overlap, pixels and focal length alone. These
# are the cameras of the thesis (its figures 4.3, 4.9 and 4.15 in one).

# %%
cameras = pd.read_csv(root / "data" / "published" / "cameras.csv")
thesis = cameras[
    cameras["camera"].isin(["UltraCam Eagle 80", "UltraCam Eagle 210", "DMC II 230", "MACS Hale"])
]
draw_angle_over_overlap(thesis)

# %% [markdown]
# ## Angle and ground resolution in a conifer stand
# One strip was flown at 90 % forward overlap and four ground resolutions. Leaving out every second photograph, two
# of three, and three of four gives 80, 70 and 60 %. `count_0_mask` is the share of tree cells that no pair
# measured. Bars are Student intervals over the seeds; with two seeds they are wide.

# %%
sweep = read_study(root, "angle-gsd-quick")
sweep.head()

# %%
draw_response(
    sweep, "count_0_mask", over="thin", by="gsd_cm", label="every n-th photograph (90, 80, 70, 60 %)"
)

# %% [markdown]
# The same over the angle that was really measured, and the opposite side of the trade: how far the matched tree
# cells are from the truth (68 % are nearer than this).

# %%
draw_response(sweep, "count_0_mask", over="angle", by="gsd_cm", label="intersection angle (°)")

# %%
draw_response(sweep, "p68_trees", over="angle", by="gsd_cm", label="intersection angle (°)")

# %% [markdown]
# Which factor explains how much? The shares are sums of squares of an analysis of variance; `seeds` is what the
# wind, the noise and the place of the photographs change without any factor.

# %%
effects(sweep, "count_0_mask")

# %% [markdown]
# Where is the optimum of the share of tree cells within half a metre of the truth, and how sure is that? `wins` is
# the share of bootstrap samples over seeds in which a cell is the best.

# %%
optimum(sweep, "right_trees", best="highest").head()

# %% [markdown]
# ## Count tables and V
# The count layer says how many pairs measured each cell. Table and histogram have the form of the thesis.

# %%
cells = {f"{gsd} cm": {"gsd_cm": gsd, "thin": 2} for gsd in (9, 15, 20)}
count_table(sweep, cells).round(1)

# %%
draw_ratio_histogram(sweep, cells, "mask")

# %% [markdown]
# ## Maps of the count layer
# Red cells were measured by no pair. The stand fills the upper three quarters of each map; below lie a path and a
# meadow.

# %%
folder = root / "data" / "studies" / "angle-gsd-quick" / "maps"
maps = {
    f"{gsd} cm, every {n}": read_raster(folder / f"gsd_cm-{gsd}_thin-{n}.tif")
    for gsd in (9, 20)
    for n in (1, 2, 3, 4)
}
draw_count_maps(maps, (397000.0, 5767000.0, 397048.0, 5767036.0))

# %% [markdown]
# ## Any study, any factor
# Choose a study, a response, what lies along the axis, and the lines and panels.

# %%
sweeps_panel(root)

# %% [markdown]
# ## Numbers behind a line

# %%
means(sweep, "count_0_mask").round(2)
