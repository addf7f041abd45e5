"""Parameters of the report stage."""

from workbench.params.base import Section


class ReportParameters(Section):
    """Parameters of the report stage."""
