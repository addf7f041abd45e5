"""Parameters of the tree stage."""

from workbench.params.base import Section, parameter


class TreesParameters(Section):
    """Thresholds of the single-tree metrics [thesis 3.3-3.4]."""

    min_height: float = parameter(
        3.0,
        "A tree is at least this high above the ground.",
        unit="m",
        source="thesis 3.3",
        gt=0,
        le=150,
    )
