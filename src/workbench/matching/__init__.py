"""Dense matching of rectified pairs."""

from workbench.matching.engine import match_pair

__all__ = ["match_pair"]
