"""Parameters of the studies."""

from typing import Literal

from workbench.params.base import Section, parameter


class StudyParameters(Section):
    """Repetitions and their comparison pixel by pixel [orthomosaic paper 2.5]."""

    repetitions: int = parameter(
        5, "Runs of the chain with different seeds.", unit="1", source="orthomosaic paper 2.5", ge=2, le=100
    )
    correlation_window: int = parameter(
        5,
        "Edge of the moving window of the local correlation, odd.",
        unit="cells",
        source="default of R raster::corLocal, which the authors used",
        ge=3,
        le=101,
    )
    correlation_method: Literal["pearson", "spearman"] = parameter(
        "pearson", "Kind of local correlation.", unit="-", source="orthomosaic paper 2.5"
    )
    identical_from: float = parameter(
        0.95,
        "A pixel is identical in two mosaics from this correlation on, in every band.",
        unit="1",
        source="orthomosaic paper 2.5",
        gt=0,
        le=1,
    )
    crop: bool = parameter(
        True,
        "Compare only inside the crop masks of the mosaics: their rim is distorted.",
        unit="-",
        source="orthomosaic paper 2.5",
    )
