"""Every product against its reference: error matrices, trees, crowns, surfaces."""

from workbench.assessment.crowns import CrownComparison, compare_crowns, topological_case
from workbench.assessment.error_matrix import ErrorMatrix, error_matrix, verbal_agreement
from workbench.assessment.reference_trees import (
    extrapolate_tops,
    read_reference_trees,
    site_reference_trees,
    thick_enough,
)
from workbench.assessment.sampling import mask_accuracy, sample_points
from workbench.assessment.surfaces import height_errors
from workbench.assessment.tree_matching import TreeMatch, match_trees

__all__ = [
    "CrownComparison",
    "ErrorMatrix",
    "TreeMatch",
    "assess_site",
    "compare_crowns",
    "error_matrix",
    "extrapolate_tops",
    "height_errors",
    "mask_accuracy",
    "match_trees",
    "read_reference_trees",
    "sample_points",
    "site_reference_trees",
    "thick_enough",
    "topological_case",
    "verbal_agreement",
]


def __getattr__(name: str):
    # The stage reads whole sites; a score in a notebook does not need them.
    if name == "assess_site":
        from workbench.assessment.stage import assess_site

        return assess_site
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
