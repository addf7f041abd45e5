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
# # Georeferencing: where is the block, and how do we know?
#
# Structure from motion finds the shape of a block. Where it lies on the ground, how it is tilted and how large it is
# comes from elsewhere: from recorded camera positions, from surveyed points measured in the photographs, or from
# both. This notebook looks at what each tie point is worth, removes the bad ones as Ludwig et al. (2020) do, asks what
# the reported error means, measures points by clicking, and ends with what makes an orthophoto a true one.
#
# The site is `lake`. Change `name` for your own; it needs a control file with a few points of role `check`.

# %%
import os
import tempfile
from pathlib import Path

import pandas as pd
import panel as pn

from workbench.orientation import orient_site, read_block
from workbench.params import Parameters, load_parameters
from workbench.site import load_site
from workbench.virtual import scene_names, simulate_scene

pn.extension()
root = Path(os.environ.get("WORKBENCH_ROOT", ".."))
name = "lake"
file = root / "params.yaml"
parameters = load_parameters(file) if file.exists() else Parameters()
if not (root / "data/sites" / name / "site.yaml").exists() and name in scene_names():
    simulate_scene(name, root, parameters)
site = load_site(name, root)
if not (site.products / "orientation/metrics.json").exists():
    orient_site(site, parameters)

# %% [markdown]
# ## Surveyed points and their residuals
# Control points enter the adjustment with their standard deviations. Check points do not: their residuals tell the
# error. A third role, `verify`, is not even looked at when thresholds are chosen.

# %%
pd.read_csv(site.products / "orientation/control.csv").round(3)

# %%
from workbench.figures.georeferencing_panel import residual_arrows

residual_arrows(site)

# %% [markdown]
# Arrows that point outwards or inwards mean a wrong scale, vertical ones that grow towards the edge a dome, and ones
# that rise to one side a tilt. The orientation warns of a dome or an offset when the checkpoints prove it:

# %%
from workbench.stages import read_json

read_json(site.products / "orientation/metrics.json")["warnings"] or "no warnings"

# %% [markdown]
# ## What a tie point is worth
# Four numbers each: the largest *reprojection error* in its photographs; the *reconstruction uncertainty*, longest
# over shortest axis of its error ellipsoid (rays that meet at a small angle); the *projection accuracy*, mean size of
# its features against the finest ones; and the *image count*.

# %%
from workbench.figures.georeferencing_panel import tie_point_table

tie_point_table(site).describe().loc[["mean", "50%", "max"]].round(2)

# %% [markdown]
# ## The threshold with the smallest checkpoint error
# Points of high uncertainty go first, then those of poor accuracy, then those beyond ever smaller reprojection
# errors, with a bundle adjustment after each. Too loose a threshold leaves wrong matches in, too strict a one leaves
# photographs without points.
#
# The matches of this site are good, so the curve would be flat. To see what the method is for, one measurement in
# twenty is moved by 2 to 50 pixels first.

# %%
from workbench.orientation.thresholds import try_thresholds

optimisation = try_thresholds(site, parameters.orient, outliers=0.05)
optimisation.table().round(4)

# %% [markdown]
# The smallest of several errors is too good to report: it was chosen for being small. *Cross-validated*, every
# checkpoint is measured at the threshold that the others choose.

# %%
pd.Series(
    {
        "threshold (px)": optimisation.threshold,
        "error of the checkpoints there (m)": optimisation.optimised_error,
        "cross-validated (m)": optimisation.cross_validated_error,
        "points of role verify (m)": optimisation.verify_error,
        "looser and stricter are both worse": optimisation.is_interior,
    }
)

# %% [markdown]
# Move the threshold. The map shows which tie points of the oriented block would go; the button writes the limits into
# `params.yaml` and says what `dvc repro` will run again.

# %%
from workbench.figures.georeferencing_panel import GeoreferencingPanel

limits = GeoreferencingPanel(site, optimisation, params=file if file.exists() else None)
limits.panel()

# %% [markdown]
# ## Measuring points by clicking
# Choose a point and a photograph, click roughly on the left, exactly on the right. After two photographs the tool
# knows where the point should be in all others; the residual of each click against the others shows a slip. *Save*
# writes `observations.csv`, and `workbench orient` uses it.

# %%
from workbench.figures.clicking import click_tool

block = read_block(site.products / "orientation", site)
with_copy = Path(tempfile.mkdtemp()) / "observations.csv"  # leave it out to write into the site
clicking = click_tool(site, block, with_copy)
clicking.panel()

# %% [markdown]
# ## From poses to a true orthophoto
# A roof hides ground. An orthophoto that does not ask what a photograph can see shows the roof twice: once where it
# stands, and once on the ground behind it. The house below is from the scene `park`, here with its true poses and
# surface, so that only the test of visibility differs.

# %%
from workbench.figures import draw_orthophoto, figure
from workbench.mosaic import make_orthophoto
from workbench.params import MosaicParameters
from workbench.rasters import read_raster
from workbench.studies.known_poses import orient_by_truth

scratch = Path(tempfile.mkdtemp())
coarse = Parameters(simulate={"truth_resolution": 0.15})
park = simulate_scene("park", scratch, coarse, flight_overrides={"gsd": 0.15, "reduction": 10})
orient_by_truth(park, coarse)
surface = read_raster(park.truth / "dsm_mean.tif")
for visible in (False, True):
    folder = scratch / f"visibility_{visible}"
    plain = MosaicParameters(visibility=visible, seams="best-view", balance=False)
    made = make_orthophoto(read_block(park.products / "orientation", park), surface, folder, plain)
    print(f"visibility tested: {visible}; hidden from all photographs: {made.share(3):.1%}")

# %%
pictures = []
for visible in (False, True):
    picture, axes = figure(6, 5)
    ortho = read_raster(scratch / f"visibility_{visible}" / "ortho.tif")
    west, north = float(ortho.x.min()), float(ortho.y.max())
    draw_orthophoto(axes, ortho.sel(x=slice(west + 8, west + 62), y=slice(north - 2, north - 34)))
    axes.set_title("what each photograph sees was tested" if visible else "not tested: roofs appear twice")
    pictures.append(pn.pane.Matplotlib(picture, dpi=110, tight=True))
pn.Row(*pictures)

# %% [markdown]
# White cells in the second picture are hidden from all photographs. They stay empty, and `validity.tif` says so:
# better a hole than a picture of something else.
