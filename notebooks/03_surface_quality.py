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
# # What decides the quality of a surface: angle, ground resolution, downscale, count
#
# Every tree height, reed height and metric of this workbench is read from a surface model, and a surface model of
# vegetation is only as good as the matches it is made of. Leaves move between exposures, crowns hide each other, and a
# crown seen from two sides looks different. The thesis on single trees found what decides: the **intersection
# angle**, the **ground resolution**, and how often a place was measured, the **count**. Here you can move all three.
#
# The site is `lake`, a virtual shore with a wood: its truth is known, so that errors can be shown beside the
# statistics that a real site offers as well.

# %%
import os
from pathlib import Path

import pandas as pd
import panel as pn

from workbench.matching import match_site
from workbench.orientation import orient_site
from workbench.params import Parameters, load_parameters
from workbench.site import load_site
from workbench.stages import read_json
from workbench.surface import surface_site
from workbench.virtual import scene_names, simulate_scene

pn.extension()
root = Path(os.environ.get("WORKBENCH_ROOT", ".."))
name = "lake"
file = root / "params.yaml"
parameters = load_parameters(file) if file.exists() else Parameters()

# %% [markdown]
# What is missing is made first: photographs, orientation, matching and surface, one to two minutes.

# %%
if not (root / "data/sites" / name / "site.yaml").exists() and name in scene_names():
    simulate_scene(name, root, parameters)
site = load_site(name, root)
for folder, stage in (("orientation", orient_site), ("matching", match_site), ("surface", surface_site)):
    if not (site.products / folder / "metrics.json").exists():
        stage(site, parameters)

# %% [markdown]
# ## One pair: angle against ground resolution
#
# Take two photographs of a strip. The further apart, the larger the angle at which their rays meet; the larger the
# downscale, the coarser the pixels. A larger angle measures heights more precisely *where it matches at all*;
# coarser pixels match more and show less. Move the sliders and watch two columns: what stays **unmatched** in trees,
# and the **NMAD** (a robust standard deviation) on the meadow.

# %%
from workbench.figures.surface_panel import describe_pair, longest_strip, look_at_pair, pair_panel

pair_panel(site, parameters)

# %% [markdown]
# The same as a table: one, two and three photographs apart, at full and at half resolution. Read the tree rows from
# top to bottom: the unmatched share grows with the angle (the thesis' table 4.1) and falls with the downscale (its
# table 4.11).

# %%
from workbench.orientation import read_block

block = read_block(site.products / "orientation", site)
strip = longest_strip(block)
middle = len(strip) // 2 - 1
rows = []
for apart in (1, 2, 3):
    for downscale in (1, 2):
        look = look_at_pair(site, block, strip, middle, apart, downscale, parameters)
        table = describe_pair(site, look).set_index("cover")
        rows.append(
            {
                "photographs apart": apart,
                "angle": round(look.angle, 1),
                "downscale": downscale,
                **{
                    f"unmatched % {cover}": table["unmatched %"].get(cover)
                    for cover in ("meadow", "broadleaf", "conifer")
                },
                "NMAD meadow (m)": table["NMAD m"].get("meadow"),
            }
        )
pd.DataFrame(rows)

# %% [markdown]
# ## All pairs together: the count layer
#
# The surface stage fuses all pairs. For every cell it keeps how many of them agree (`count`), how many could have
# seen it (`possible count`, on the surface itself: fewer photographs see a crown than the ground below it), and how
# far they scatter (`spread`). V is the first divided by the second, in eleven classes. Raise the least count: what is
# left is more certain, and less.

# %%
from workbench.figures.surface_panel import surface_panel

surface_panel(site)

# %% [markdown]
# ## Downscales: measured, never invented
#
# Cells that the finest downscale left empty are filled with *measured* heights of the next one. Heights that two pairs
# agree on, or one at a small angle saw, come first: more detail does not make up for a second witness. `provenance` (in
# the panel above) says which cell came from where; interpolation happens only on request and is flagged as such.

# %%
metrics = read_json(site.products / "surface/metrics.json")
pd.DataFrame({"unmatched": metrics["unmatched_share"], "source of the surface": metrics["provenance_share"]})

# %% [markdown]
# ## What the truth says
#
# Only a virtual site can answer this: how far is the surface from the truth, where, and by which source?

# %%
from workbench.assessment.surfaces import height_errors
from workbench.rasters import Grid, match_grid, read_raster
from workbench.virtual.world import Cover

dsm, provenance = (read_raster(site.products / "surface" / f"{layer}.tif") for layer in ("dsm", "provenance"))
truth = match_grid(read_raster(site.truth / "dsm_mean.tif"), Grid.of(dsm))
cover = match_grid(read_raster(site.truth / "cover.tif"), Grid.of(dsm), resampling="nearest")
covers = {int(code): code.name.lower() for code in Cover if code != Cover.NOTHING}
height_errors(dsm, truth, cover, covers).round(3)

# %%
sources = {1: "downscale 1", 2: "downscale 2", 3: "downscale 3"}
height_errors(dsm, truth, provenance, sources).round(3)

# %% [markdown]
# ## And for your own flight
#
# The warnings of the surface stage compare the overlap and the angle *at the height of the crowns* with what a canopy
# needs: 10 degrees or less. A flight that looks generous on the ground can be useless in the forest, because the
# camera is so much nearer to the crowns.

# %%
for warning in metrics["warnings"] or ["No warning: the angle at the crowns is small enough."]:
    print(warning)
