"""Parameters of the match stage."""

from workbench.params.base import Section


class MatchParameters(Section):
    """Parameters of the match stage."""
