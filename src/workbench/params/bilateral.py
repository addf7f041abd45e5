"""Parameters of the bilateral filter, for those who call it without giving any."""

from workbench.params.base import Section, parameter


class BilateralParameters(Section):
    """Bilateral filter of a surface [thesis 4.3]."""

    size: int = parameter(
        49, "Edge of the window, odd.", unit="cells", source="thesis: the smaller of its two windows", ge=1
    )
    sigma_range: float = parameter(
        10.0, "Standard deviation of the Gaussian in height.", unit="m", source="thesis", gt=0
    )
    sigma_space: float | None = parameter(
        None,
        "Standard deviation of the Gaussian in space; null takes a sixth of the size.",
        unit="cells",
        source="the window then ends at three standard deviations",
        gt=0,
    )
