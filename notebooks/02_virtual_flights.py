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
# # Virtual flights: one forest, every camera
#
# Which camera, which overlap, which hour of the day? A real forest is photographed once, with the camera that was
# there. A virtual one can be photographed as often as you like, and the truth is known for every pixel. This notebook
# builds a small landscape, flies it with two cameras, and lets you move everything that a pilot decides.

# %%
# %matplotlib inline
import panel as pn

from workbench.virtual import build_scene
from workbench.virtual.composition import SceneSpec

pn.extension()

# %% [markdown]
# ## A landscape is a value
# A scene is a composition: terrain, stands of trees, a path, targets. The same composition and seed give the same
# leaves. Change the age of a stand, its species group or its understorey and run the cell again. The scenes that come
# with the workbench (`workbench.virtual.scene_names()`) are such compositions in YAML files.

# %%
spec = SceneSpec(
    name="clearing",
    seed=7,
    crs="EPSG:25832",
    vertical_datum="DHHN2016",
    origin=(525000.0, 5685000.0),
    size=(90.0, 60.0),
    terrain={"base": 300.0, "relief": 0.8, "longest": 40.0, "slope": (0.03, 0.0)},
    stands=[
        {"area": [(0, 0), (42, 0), (40, 60), (0, 60)], "species_group": "conifer", "age": "middle"},
        {"area": [(48, 0), (90, 0), (90, 60), (52, 60)], "species_group": "broadleaf", "age": "old"},
    ],
    paths=[{"points": [(45, -20), (46, 80)], "width": 3.0}],
    flight={"gsd": 0.15, "wind": 3.0, "time": "2021-07-14T09:30:00+00:00"},
)
scene = build_scene(spec)
scene.trees.groupby(["species_group", "understorey"])[["height_m", "dbh_m", "visible"]].mean().round(2)

# %% [markdown]
# Small trees below the canopy are flagged as understorey, and every tree says whether it can be seen from above: no
# method can find one that cannot, and it should not be blamed for it.

# %% [markdown]
# ## The truth
# Surface, land cover and single trees on a grid. The topmost leaf of a cell (`dsm`) and the mean surface that a
# camera can see at best (`dsm_mean`) differ by metres in a porous crown; a comparison has to say which it means.

# %%
from workbench.figures import draw_surface, figure
from workbench.rasters import Grid
from workbench.virtual import scene_truth

truth = scene_truth(scene, Grid.from_bounds(scene.crs, scene.extent, 0.25))
made, axes = figure(7, 4.6)
draw_surface(axes, truth["dsm"])
made

# %%
canopy = truth["cover"].isin([4, 5])
difference = (truth["dsm"] - truth["dsm_mean"]).where(canopy)
print(f"topmost leaf over mean surface in the canopy: {float(difference.mean()):.2f} m on average")

# %% [markdown]
# ## Fly it twice
# The intersection angle follows from overlap and camera, not from the height of flight. With the same overlap a large
# format sees a place under a much wider angle than a small one: heights become more precise, and leaves that one
# photograph sees are hidden in the next.

# %%
from workbench.figures.flights import draw_looks, look

options = {"gsd": 0.15, "forward_overlap": 0.8, "wind": 3.0, "time": spec.flight.time}
looks = {camera: look(scene, camera, **options) for camera in ("MACS MAR", "DMC I")}
for camera, one in looks.items():
    print(f"{camera:10s}", one.facts)
draw_looks(looks)

# %% [markdown]
# ## Move everything
# Raise the wind and compare the two exposures of one camera: crowns have moved between them, the path has not. Make
# the resolution coarser: a pixel mixes leaves, gaps and branches. Draw clouds over the sun: shadows soften and
# vanish. Choose an impossible overlap and read the answer.

# %%
from workbench.figures.flights import flights_panel

flights_panel(scene)

# %% [markdown]
# ## A site of it
# `simulate_scene` (or `workbench simulate SCENE`) writes all photographs of a flight as an ordinary site, with
# navigation, control points, and a field campaign, and the truth beside it. Save a composition as a YAML file and give
# its path instead of a name:
#
#     workbench simulate my_scene.yaml
#     workbench run --site my_scene
