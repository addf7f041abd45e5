"""Parameters of the orient stage."""

from workbench.params.base import Section


class OrientParameters(Section):
    """Parameters of the orient stage."""
