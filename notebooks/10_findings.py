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
# # Findings: what three papers found, tested again
#
# The thesis on single trees, the paper on aquatic reed and the paper on reproducible orthomosaics state findings that
# others rely on. Here each of them meets our own studies on virtual flights, whose truth is known. For every finding a
# rule was written down, with its threshold, and committed *before* the studies ran: see `findings_reed.py`,
# `findings_trees.py` and `findings_ortho.py` in `workbench.studies`.
#
# A verdict is *confirmed* if every criterion of the rule holds for the mean over seeds, *not confirmed* if one does
# not, and *not testable* where the evidence is missing. *Sure* says that no interval over seeds holds its threshold;
# with the two or three seeds of the quick presets many are not.
#
# The tables that this notebook reads come with the repository. To make them yourself: `workbench study all --quick`,
# then `workbench study findings`.

# %%
# %matplotlib inline
import os
from pathlib import Path

import pandas as pd
from IPython.display import display

from workbench.figures.study_figures import draw_beside_published, draw_collapse, draw_response, draw_verdicts
from workbench.figures.sweeps_panel import read_study
from workbench.studies.advice import advise, unmatched_lines
from workbench.studies.findings import findings_table, judge_findings
from workbench.studies.side_by_side import side_by_side

root = Path(os.environ.get("WORKBENCH_ROOT", ".."))
findings = judge_findings(root)
table = findings_table(findings)
table.groupby(["source", "verdict"]).size().unstack(fill_value=0)

# %%
draw_verdicts(table)

# %% [markdown]
# ## Simulated beside published
# Every table that a study repeats, cell by cell. What counts is the order of the cells (rank correlation): the
# matcher, the forest and the wind differ, so that equal numbers would be chance.

# %%
pairs = side_by_side(root)
pd.DataFrame(
    [(p.table, p.study, len(p.cells), p.rho) for p in pairs], columns=["table", "study", "cells", "rank"]
)

# %%
for pair in pairs:
    if len(pair.cells) >= 8:
        display(draw_beside_published(pair.cells, pair.rho, pair.table))

# %% [markdown]
# ## Reed
# Virtual belts of known stems, photographed as the 3K system does, and a field campaign with the positioning errors
# of the authors.


# %%
def show(source):
    columns = ["id", "finding", "published", "ours", "verdict", "sure", "why"]
    return table.loc[table["source"] == source, columns].style.hide(axis="index")


show("reed")

# %% [markdown]
# ## Single trees
# Conifers, broadleaf trees and a suburb, small enough that many flights can be flown over them.

# %%
show("tree")

# %% [markdown]
# ### Completeness over overlap
# Table 4.19 of the thesis: at 9 cm completeness falls with the overlap, at 20 cm it does not.

# %%
draw_response(read_study(root, "tops-overlap-quick"), "completeness_visible", over="thin", by="gsd_cm")

# %% [markdown]
# ## Orthomosaics

# %%
show("ortho")

# %% [markdown]
# ## One variable for angle and resolution
# This finding is our own. A metre of height shifts a place by tan(angle) / GSD pixels from one photograph to the next.
# The published Table 4.1 nearly collapses on this one number. Do virtual flights? The line is fitted to the logits of
# the unmatched share in trees; the offsets say how far each ground resolution lies from it.

# %%
lines = unmatched_lines(root)
summary = {
    name: {"slope": line.slope, "R2": line.r2, "holds": line.holds, **line.offsets.round(2).to_dict()}
    for name, line in lines.items()
}
pd.DataFrame(summary)

# %%
draw_collapse(lines["virtual"], lines["published"])

# %% [markdown]
# ## What follows for a flight
# The planner turns this into overlap, height and angle at the canopy, with what it rests on.

# %%
print(advise("MACS MAR", 25.0, "conifer", root=root))

# %%
print(advise("DJI FC6310", 17.0, "broadleaf", highest=120.0, root=root))
