"""Parameters of the reed stage."""

from workbench.params.base import Section, parameter


class ReedParameters(Section):
    """Thresholds of the aquatic reed metrics [reed paper 2.5]."""

    min_height: float = parameter(
        0.5, "Reed is at least this high above the water.", unit="m", source="reed 2.5", ge=0, le=10
    )
