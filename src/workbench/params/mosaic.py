"""Parameters of the mosaic stage."""

from workbench.params.base import Section


class MosaicParameters(Section):
    """Parameters of the mosaic stage."""
