"""Parameters of the reed stage."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from workbench.params.base import Section, parameter


class ReedParameters(Section):
    """Thresholds of the aquatic reed metrics [reed paper 2.5]."""

    water_level: float | None = parameter(
        None,
        "Height of the water in the vertical datum of the surface; null takes the site's.",
        unit="m",
        source="reed 2.3: gauge of the flight day (517.93 m there)",
        ge=-500,
        le=9000,
    )
    min_height: float = parameter(
        0.5,
        "b: reed is higher than this above the water.",
        unit="m",
        source="reed 2.5.2 leaves it open; above waves, floating leaves and matching noise over water",
        ge=0,
        le=10,
    )
    max_height: float = parameter(
        6.0,
        "c: reed is lower than this above the water.",
        unit="m",
        source="reed 1: stands of 1-6 m; trees on the shore are taller",
        gt=0,
        le=20,
    )
    min_area: float = parameter(
        1.0,
        "Reed patches below this area are dropped.",
        unit="m²",
        source="one density cell [reed 2.5.3]: less is not told from noise",
        ge=0,
        le=1000,
    )
    min_hole: float = parameter(
        1.0,
        "Gaps in the reed below this area are closed.",
        unit="m²",
        source="one density cell [reed 2.5.3]",
        ge=0,
        le=1000,
    )
    sliver_width: float = parameter(
        0.3,
        "Patches narrower than this everywhere, left by the cut at the shoreline, are dropped.",
        unit="m",
        source="two pixels of 0.14 m",
        ge=0,
        le=10,
    )
    edge_share: float = parameter(
        0.0,
        "Reed is also higher than this share of the highest reed within the edge reach: 0.5 puts a front "
        "that matching smeared over the water where it falls to half the stand; 0: limits of height alone.",
        unit="1",
        source="0 as reed 2.5.2; a step that was averaged lies at half of its height",
        ge=0,
        lt=1,
    )
    edge_reach: float = parameter(
        1.5,
        "Distance at which a smeared front or gap has reached the height of its stand.",
        unit="m",
        source="matching windows of 9 pixels of 0.14 m",
        gt=0,
        le=20,
    )
    point_radius: float = parameter(
        0.5,
        "The highest cell within this distance of a field point is its height.",
        unit="m",
        source="reed 2.5.1",
        gt=0,
        le=10,
    )
    cell_size: float = parameter(1.0, "Edge of a density cell.", unit="m", source="reed 2.5.3", gt=0, le=20)
    cell_weights: Literal["area", "centre"] = parameter(
        "area",
        "How pixels on the border of a cell count: by their area in it, or wholly if their centre is.",
        unit="-",
        source="exact; centre is what QGIS zonal statistics [reed 2.5.3] did",
    )
    cell_variance: Literal["population", "sample"] = parameter(
        "population",
        "Divisor of the variance: the number of pixels, or one less.",
        unit="-",
        source="QGIS zonal statistics",
    )
    cell_spread: bool = parameter(
        True,
        "The variance of a cell is that of all measured heights: the surface's, plus the squared spread of "
        "the pairs of photographs, where the surface comes with it; off: of the surface alone.",
        unit="-",
        source="reed 2.5.3 after its [23], which takes all points of the cloud; a median keeps one of them",
    )
    cell_known: float = parameter(
        0.5,
        "A cell is unknown if less than this share of it has a height.",
        unit="1",
        source="a variance of the smaller half says little of the whole",
        ge=0,
        le=1,
    )
    variance_cut: float = parameter(
        0.1,
        "A cell is sparse if its variance is above this and its mean below the mean cut.",
        unit="m²",
        source="reed 2.5.3",
        ge=0,
        le=100,
    )
    mean_cut: float = parameter(
        2.5,
        "A cell is sparse if its mean is below this and its variance above the variance cut.",
        unit="m",
        source="reed 2.5.3",
        ge=0,
        le=20,
    )
    shore_tolerance: float = parameter(
        0.5,
        "Outline within this distance of the shoreline is no front.",
        unit="m",
        source="precision of the reference points, 0.465 m [reed table 1]",
        ge=0,
        le=20,
    )
    front_smoothing: float = parameter(
        1.5,
        "Corners of pixels within this distance of a straight line are taken off the front; 0: none.",
        unit="pixel",
        source="corners of a straight front lie within 1.41 pixels: its sinuosity is 1 in every direction",
        ge=0,
        le=20,
    )
    front_piece: float = parameter(
        1.0,
        "Open pieces of front shorter than this are dropped.",
        unit="m",
        source="remains of the shoreline; one density cell",
        ge=0,
        le=100,
    )
    section_length: float = parameter(
        10.0,
        "Length of a section where there are no transects.",
        unit="m",
        source="reed 2.5.4",
        gt=0,
        le=1000,
    )
    shore_smoothing: float = parameter(
        10.0,
        "Where there are no transects: standard deviation of the Gaussian along the shore that "
        "smooths the line they stand on.",
        unit="m",
        source="one section",
        gt=0,
        le=1000,
    )
    transect_length: float = parameter(
        50.0,
        "Where there are no transects: how far sections reach into the lake.",
        unit="m",
        source="several widths of the belts of the paper",
        gt=0,
        le=2000,
    )
    box_buffer: float = parameter(
        10.0,
        "Half the width of the box around the front of a section.",
        unit="m",
        source="reed 2.5.5",
        gt=0,
        le=200,
    )
    arsi_cut: float = parameter(
        8.0,
        "Sections with an aRSI below this are healthy; at it and above, stressed.",
        unit="1",
        source="reed 3.5; at the cut by precaution",
        ge=0,
        le=1000,
    )
    plot_dense_stems: float = parameter(
        50.0,
        "Field plots with at least so many stems a square metre are dense; a column density goes first.",
        unit="1/m²",
        source="reed 2.4 gives none; vital stands of the literature have 50 to 100",
        gt=0,
        le=1000,
    )
    draws: int = parameter(
        0,
        "Surfaces drawn to propagate the spread of the surface and the water level; 0: none.",
        unit="1",
        source="off: costs as many runs of the stage; 50 give a standard deviation to 10 %",
        ge=0,
        le=10_000,
    )
    water_level_sd: float = parameter(
        0.02,
        "Standard deviation of the water level.",
        unit="m",
        source="daily gauge readings to 1 cm, wind set-up",
        ge=0,
        le=5,
    )
    error_length: float = parameter(
        1.0,
        "Distance over which errors of the surface are alike.",
        unit="m",
        source="matching windows of 7-9 pixels of 0.14 m",
        ge=0,
        le=100,
    )
    seed: int = parameter(1, "Seed of the draws.", unit="1", source="any", ge=0)

    @model_validator(mode="after")
    def _ordered(self) -> ReedParameters:
        if self.min_height >= self.max_height:
            raise ValueError(f"min_height {self.min_height} is not below max_height {self.max_height}")
        return self
