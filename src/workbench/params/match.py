"""Parameters of the match stage."""

from typing import Literal

from workbench.params.base import Section, parameter


class SgmParameters(Section):
    """Semi-global matching of one rectified pair [Hirschmüller 2005, 2008]."""

    engine: Literal["sgm", "opencv"] = parameter(
        "sgm",
        "Own semi-global matcher, or OpenCV's StereoSGBM (MODE_HH) for comparison.",
        unit="-",
        source="the own engine is more accurate on pairs with exact truth, see benchmarks/matching.py",
    )
    cost: Literal["census9x7", "census5x5", "mutual_information"] = parameter(
        "census9x7",
        "Pixelwise matching cost.",
        unit="-",
        source="census is unchanged by any brightening of one image; 9 x 7 fits 62 comparisons in a word",
    )
    paths: Literal[8, 16] = parameter(
        8,
        "Directions from which costs are aggregated.",
        unit="1",
        source="Hirschmüller 2008: at least 8, 16 for good coverage; 16 costs nearly twice the time",
    )
    p1: int = parameter(
        8,
        "Penalty for a change of disparity by one pixel between neighbours.",
        unit="census bits",
        source="an eighth of the 62 bits: single wrong bits of noise do not bend a surface",
        ge=0,
        le=60,
    )
    p2: int = parameter(
        80,
        "Penalty for a larger change of disparity where the image is flat.",
        unit="census bits",
        source="above the 62 bits of the cost: in a flat region no single pixel can pay for a jump",
        ge=1,
        le=190,
    )
    p2_edge: int = parameter(
        24,
        "The same across a strong edge of the image, where depth edges are likely.",
        unit="census bits",
        source="three times p1; Hirschmüller 2008 requires p2 > p1 everywhere",
        ge=1,
        le=190,
    )
    p2_gradient: float = parameter(
        16.0,
        "Grey-value step over which p2 falls half way to p2_edge.",
        unit="1/255 of the image's range",
        source="a few times the noise of an 8-bit photograph",
        gt=0,
        le=255,
    )
    uniqueness: float = parameter(
        0.02,
        "Least advantage of the best summed cost over the best one elsewhere.",
        unit="fraction of the second cost",
        source="only ties are dropped; the rest is left to the left-right check and to confidence",
        ge=0,
        lt=1,
    )
    max_inconsistency: float = parameter(
        1.0,
        "Largest difference between the disparities found from left to right and back.",
        unit="px",
        source="Hirschmüller 2008, section 2.4",
        ge=0,
        le=16,
    )
    min_segment: int = parameter(
        100,
        "Smaller connected patches of disparity are dropped; 0 keeps all.",
        unit="px",
        source="two windows of the census cost: less can be agreement by chance",
        ge=0,
    )
    segment_step: float = parameter(
        1.0,
        "Neighbours that differ by no more belong to one patch.",
        unit="px",
        source="the step that p1 allows",
        gt=0,
        le=16,
    )
    subpixel: bool = parameter(
        True,
        "Refine disparities by least-squares matching with gain and offset; else a fit to the costs.",
        unit="-",
        source="a fit to census costs locks to whole pixels",
    )
    max_vertical_offset: float = parameter(
        1.5,
        "A pair whose rows are shifted against each other by more is refused as unrectified.",
        unit="px",
        source="half the height of the smaller census window is 2 px",
        gt=0,
        le=50,
    )
    memory: float = parameter(
        300.0,
        "Largest volume of summed costs that one thread holds; bigger images are cut into strips of rows.",
        unit="MB",
        source="two threads and the images stay within 1.5 GB at 12 megapixels",
        ge=20,
    )


class MatchParameters(Section):
    """Pairs, downscales and search limits [thesis 4.2]."""

    inflight: int = parameter(
        1,
        "Match with so many photographs before and after in the strip.",
        unit="1",
        source="thesis 4.2.3",
        ge=1,
        le=20,
    )
    across: bool | None = parameter(
        None,
        "Match also with neighbouring strips; null does so where they overlap by half or more.",
        unit="-",
        source="thesis 4.2 (off); from half side overlap on the angle is that of usable pairs in the strip",
    )
    downscales: tuple[int, ...] | None = parameter(
        None,
        "Match with photographs reduced by these factors; null derives them from the ground resolution.",
        unit="1",
        source="thesis 4.2.1: 1, 2, 3; finer photographs need those that lead to 10-20 cm (thesis 5.1)",
    )
    height_margin_up: float = parameter(
        45.0,
        "Search so far above the tie points: they miss trees.",
        unit="m",
        source="tallest trees of central Europe; at most 70 % of the flying height is used",
        ge=0,
        le=1000,
    )
    height_margin_down: float = parameter(
        5.0, "Search so far below the tie points.", unit="m", source="ditches, banks, gaps", ge=0, le=1000
    )
    guide_below: float = parameter(
        12.0,
        "A finer level searches so far below the coarser surface.",
        unit="px",
        source="ground in gaps that the coarser level closed",
        gt=0,
        le=500,
    )
    guide_above: float = parameter(
        24.0,
        "A finer level searches so far above the coarser surface.",
        unit="px",
        source="generous, so that single trees which the coarser level missed are not cut",
        gt=0,
        le=500,
    )
    threads: int = parameter(
        2,
        "Threads of the matcher; they do not change the result.",
        unit="1",
        source="two cores",
        ge=1,
        le=256,
    )
    sgm: SgmParameters = SgmParameters()
