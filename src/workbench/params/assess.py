"""Parameters of the assess stage."""

from workbench.params.base import Section


class AssessParameters(Section):
    """Parameters of the assess stage."""
