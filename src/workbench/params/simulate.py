"""Parameters of the simulate stage."""

from workbench.params.base import Section


class SimulateParameters(Section):
    """Parameters of the simulate stage."""
