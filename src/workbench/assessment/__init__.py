"""Every product against its reference: error matrices, trees, crowns, surfaces."""

from workbench.assessment.crowns import CrownComparison, compare_crowns, topological_case
from workbench.assessment.error_matrix import ErrorMatrix, error_matrix, verbal_agreement
from workbench.assessment.sampling import mask_accuracy, sample_points
from workbench.assessment.surfaces import height_errors
from workbench.assessment.tree_matching import TreeMatch, match_trees

__all__ = [
    "CrownComparison",
    "ErrorMatrix",
    "TreeMatch",
    "compare_crowns",
    "error_matrix",
    "height_errors",
    "mask_accuracy",
    "match_trees",
    "sample_points",
    "topological_case",
    "verbal_agreement",
]
