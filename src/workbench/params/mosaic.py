"""Parameters of the mosaic stage."""

from typing import Literal

from workbench.params.base import Section, parameter


class MosaicParameters(Section):
    """True orthophoto, seamlines, colour balance and crop mask [orthomosaic paper 2.5-2.6]."""

    resolution: float | None = parameter(
        None,
        "Cell of the orthophoto; null takes the median ground sampling distance.",
        unit="m",
        source="usual practice: no coarser than the photographs, no empty magnification",
        gt=0,
    )
    surface: Literal["dsm", "mesh", "dtm"] = parameter(
        "dsm",
        "Surface that the photographs are projected on.",
        unit="-",
        source="orthomosaic paper 2.6; mesh is the smoothed 2.5D mesh of the tie points",
    )
    mesh_smoothing: int = parameter(
        35,
        "Rounds of Laplacian smoothing of the tie-point mesh.",
        unit="1",
        source="orthomosaic paper 2.6: smoothing strength 35",
        ge=0,
        le=1000,
    )
    visibility: bool = parameter(
        True,
        "Test for every cell whether the photograph sees it (true orthophoto).",
        unit="-",
        source="thesis 2.3.1.2",
    )
    visibility_tolerance: float = parameter(
        2.0,
        "A neighbour hides a cell if it rises this far above the line of sight; fades out within 8 cells.",
        unit="cells",
        source="noise on a slope must not hide the slope itself; far obstacles need no tolerance",
        ge=0,
        le=50,
    )
    hidden_specks: int = parameter(
        5,
        "Hidden areas narrower than this are pits of a rough surface: shown all the same, and flagged.",
        unit="cells of the surface",
        source="width of the matching windows, below which a surface has no detail of its own",
        ge=0,
        le=100,
    )
    seams: Literal["low-difference", "best-view"] = parameter(
        "low-difference",
        "Seamlines around what looks different in neighbours, or just where the better view changes.",
        unit="-",
        source="thesis 2.3.1.2; Soille 2006; best-view is the plain rule of smallest angle",
    )
    seam_cell: int = parameter(
        8,
        "Seamlines and colour balance are found on cells this many times coarser than the orthophoto.",
        unit="1",
        source="seams follow objects of decimetres to metres, not single pixels; cost falls by its square",
        ge=1,
        le=64,
    )
    seam_band: float = parameter(
        0.25,
        "A seam may stay with a photograph whose view is this much more slanted than the best one.",
        unit="tangent of the angle from the vertical, in parts of the base-height ratio of neighbours",
        source="halfway to the next station the views are alike; a quarter leaves each photograph its middle",
        gt=0,
        le=2,
    )
    balance: bool = parameter(
        True,
        "Balance brightness between photographs, one gain for each band.",
        unit="-",
        source="thesis 2.3.1.2; switch off where radiometry matters",
    )
    blending: Literal["none", "multi-band"] = parameter(
        "none",
        "Hide seams by blending bands of detail across them; off where radiometry matters.",
        unit="-",
        source="Burt & Adelson 1983; colours then are no longer those of one photograph",
    )
    blending_levels: int = parameter(
        4,
        "Bands of detail: coarse ones are blended over 2 to the power of this many cells.",
        unit="1",
        source="16 cells: wider than misfits of a cell or two, narrower than objects",
        ge=1,
        le=7,
    )
    crop: bool = parameter(
        True,
        "Write crop.gpkg: the area without the outermost seamline polygons.",
        unit="-",
        source="orthomosaic paper 2.5",
    )
    clip: bool = parameter(
        False,
        "Leave the mosaic empty outside of that area.",
        unit="-",
        source="orthomosaic paper 2.5: the outermost are distorted; off: a small block would lose most",
    )
    crop_ratio: float = parameter(
        0.3,
        "Concavity of the hull around the seamlines: 0 follows every bay, 1 is the convex hull.",
        unit="1",
        source="GEOS concave hull by edge-length ratio; 0.3 keeps the bays of a strip layout",
        ge=0,
        le=1,
    )
