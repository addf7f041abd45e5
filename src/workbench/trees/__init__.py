"""Single trees: mask, tops, crowns."""

from workbench.trees.criteria import AtLeast, Change, Reach, Slope
from workbench.trees.crowns import crown_labels, crown_table, grow_crowns
from workbench.trees.mask import height_over_surroundings, tree_mask
from workbench.trees.methods import Dalponte, MarkerWatershed, RegionGrowing
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
    "Window",
    "crown_labels",
    "crown_table",
    "find_tops",
    "grow_crowns",
    "height_over_surroundings",
    "search_tops",
    "tree_mask",
]
