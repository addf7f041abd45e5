"""Every product against its reference: error matrices, trees, crowns, surfaces."""

from workbench.assessment.error_matrix import ErrorMatrix, error_matrix, verbal_agreement
from workbench.assessment.tree_matching import TreeMatch, match_trees

__all__ = ["ErrorMatrix", "TreeMatch", "error_matrix", "match_trees", "verbal_agreement"]
