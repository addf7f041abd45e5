"""Single trees: mask, tops, crowns, stands, change."""

from workbench.trees.change import TreeChange, compare_trees
from workbench.trees.criteria import AtLeast, Change, Reach, Slope
from workbench.trees.crowns import crown_labels, crown_table, grow_crowns, smoothed
from workbench.trees.mask import height_over_surroundings, tree_mask
from workbench.trees.methods import Dalponte, MarkerWatershed, RegionGrowing
from workbench.trees.model import (
    TreeInputs,
    TreeModel,
    crown_method,
    read_tree_inputs,
    search_spacing,
    search_window,
)
from workbench.trees.stage import trees_site
from workbench.trees.stands import stand_table, stand_types
from workbench.trees.tops import TopSearch, find_tops, search_tops
from workbench.trees.windows import (
    CombinedWindow,
    ConstantWindow,
    FunctionWindow,
    GrowingWindow,
    StandWindow,
    Window,
)

__all__ = [
    "AtLeast",
    "Change",
    "CombinedWindow",
    "ConstantWindow",
    "Dalponte",
    "FunctionWindow",
    "GrowingWindow",
    "MarkerWatershed",
    "Reach",
    "RegionGrowing",
    "Slope",
    "StandWindow",
    "TopSearch",
    "TreeChange",
    "TreeInputs",
    "TreeModel",
    "Window",
    "compare_trees",
    "crown_labels",
    "crown_method",
    "crown_table",
    "find_tops",
    "grow_crowns",
    "height_over_surroundings",
    "read_tree_inputs",
    "search_spacing",
    "search_tops",
    "search_window",
    "smoothed",
    "stand_table",
    "stand_types",
    "tree_mask",
    "trees_site",
]
