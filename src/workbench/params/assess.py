"""Parameters of the assess stage."""

from typing import Literal

from workbench.params.base import Section, parameter


class AssessParameters(Section):
    """Comparison of the products with their references [reed paper 2.6, thesis 3.4]."""

    gross_error: float = parameter(
        0.5, "Height errors above this are counted as gross.", unit="m", source="field notes", gt=0, le=100
    )
    mask_points: int = parameter(
        150,
        "Random points that judge the tree mask.",
        unit="1",
        source="thesis 4.4: 50-150",
        ge=10,
        le=1000000,
    )
    mask_design: Literal["simple", "stratified"] = parameter(
        "simple", "Points anywhere, or as many in trees as outside.", unit="-", source="thesis 4.4: simple"
    )
    match_distance: float = parameter(
        2.0,
        "Largest distance of a top from its reference tree.",
        unit="m",
        source="published/tree_match_distance.csv: 1.5-3 m",
        gt=0,
        le=20,
    )
    match_method: Literal["nearest", "optimal"] = parameter(
        "nearest", "Closest pairs first, or as many pairs as possible.", unit="-", source="thesis 3.4.2"
    )
    height_difference: float | None = parameter(
        None,
        "Largest difference of heights of a pair; null: not compared.",
        unit="m",
        source="thesis: heights are not compared",
        gt=0,
        le=50,
    )
    smallest_dbh_broadleaf: float = parameter(
        0.25, "Thinner broadleaf stems are no reference.", unit="m", source="thesis 3.4.1", ge=0, le=2
    )
    smallest_dbh_conifer: float = parameter(
        0.20, "Thinner conifer stems are no reference.", unit="m", source="thesis 3.4.1", ge=0, le=2
    )
    bootstrap: int = parameter(
        2000,
        "Samples of the bootstrap intervals.",
        unit="1",
        source="two digits are stable",
        ge=100,
        le=100000,
    )
    seed: int = parameter(1, "Seed of random points and bootstrap.", unit="1", source="any", ge=0)
