"""Parameters of the surface stage."""

from workbench.params.base import Section


class SurfaceParameters(Section):
    """Parameters of the surface stage."""
