"""Parameters of the tree stage."""

from typing import Literal

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
    mask_index: Literal["auto", "ndvi", "gli", "both", "none"] = parameter(
        "auto",
        "Vegetation by NDVI, GLI, both or neither; auto takes NDVI where there is one, else GLI.",
        unit="-",
        source="thesis 3.3.1: NDVI and/or GLI",
    )
    min_ndvi: float = parameter(
        0.2,
        "Vegetation has at least this NDVI.",
        unit="1",
        source="leaves reach 0.3-0.9, soil and roofs stay below 0.2; the thesis prints no value",
        ge=-1,
        le=1,
    )
    min_gli: float = parameter(
        0.0,
        "Vegetation has at least this GLI.",
        unit="1",
        source="0 is grey: more green than the mean of red and blue",
        ge=-1,
        le=1,
    )
    surroundings: float = parameter(
        15.0,
        "Without terrain, ground is the lowest surface within this radius.",
        unit="m",
        source="wider than the largest crown (14 m), so that ground beside it is seen",
        gt=0,
        le=200,
    )
    mask_close: float = parameter(
        0.5,
        "Gaps in the mask narrower than twice this are closed.",
        unit="m",
        source="gaps between leaves, smaller than between crowns",
        ge=0,
        le=20,
    )
    mask_open: float = parameter(
        0.4,
        "Parts of the mask narrower than twice this are removed: wires, poles, edges of roofs.",
        unit="m",
        source="half of the narrowest crown at 3 m height",
        ge=0,
        le=20,
    )
    mask_min_area: float = parameter(
        1.0, "Smaller parts of the mask are removed.", unit="m2", source="a crown of 1.1 m", ge=0, le=1000
    )
    working_resolution: float | None = parameter(
        0.2,
        "Surfaces with finer cells are averaged to about this before tops are sought; null never.",
        unit="m",
        source="thesis 3.3.2 (resampling) and finding T16: 15-20 cm",
        gt=0,
        le=5,
    )
    top_smoothing: float = parameter(
        0.15,
        "Standard deviation of a Gaussian over the surface before tops are sought; 0 none.",
        unit="m",
        source="noise of a surface from photographs from cell to cell (docs/trees.md); heights stay those "
        "of the surface",
        ge=0,
        le=7,
    )
    radius: float | None = parameter(
        None,
        "Constant radius of the search disc; null lets it grow with height.",
        unit="m",
        source="thesis 3.3.2",
        gt=0,
        le=50,
    )
    window_start: float = parameter(
        0.0,
        "Radius of the growing search disc at height zero; may be negative.",
        unit="m",
        source="best over conifer and broadleaf stands together (docs/trees.md)",
        ge=-20,
        le=20,
    )
    window_growth: float = parameter(
        0.05,
        "Growth of the radius with height.",
        unit="m/m",
        source="as window_start; 1 m at 20 m",
        ge=0,
        le=1,
    )
    window_smallest: float = parameter(
        0.5, "Smallest radius of the growing disc.", unit="m", source="a young tree of 3 m", gt=0, le=20
    )
    window_largest: float = parameter(
        7.0, "Largest radius of the growing disc.", unit="m", source="thesis: crowns up to 14 m", gt=0, le=50
    )
    spacing: float | None = parameter(
        None,
        "Of tops nearer than this the highest stays; null lets it grow with height (not beside a radius).",
        unit="m",
        source="thesis 3.3.2, steps 4 and 5",
        gt=0,
        le=50,
    )
    spacing_start: float = parameter(
        -1.0,
        "Growing least distance of tops at height zero, at least 0.5 m; stands of type conifer need none.",
        unit="m",
        source="twice broadleaf_start: the discs of two trees do not overlap (docs/trees.md)",
        ge=-20,
        le=20,
    )
    spacing_growth: float = parameter(
        0.22,
        "Growth of the least distance with height.",
        unit="m/m",
        source="twice broadleaf_growth",
        ge=0,
        le=1,
    )
    saddle_share: float = parameter(
        0.075,
        "A top with a prominence of this share of its height, less 1.5 cells, is a tree at any distance.",
        unit="m/m",
        source="saddles between conifers are deep, those within a broadleaf crown seldom (docs/trees.md)",
        ge=0,
        le=1,
    )
    min_prominence: float = parameter(
        0.0,
        "Tops from which one descends less to anything higher are dropped.",
        unit="m",
        source="none by default: the share of the height holds",
        ge=0,
        le=50,
    )
    prominence_share: float = parameter(
        0.03,
        "As min_prominence, as a share of the height of the top, less 1.5 working cells.",
        unit="m/m",
        source="branches of a crown are no trees; virtual stands of other seeds than those judged "
        "(docs/trees.md). The thesis lists none",
        ge=0,
        le=1,
    )
    conifer_start: float = parameter(
        0.3,
        "As window_start, in stands of type conifer.",
        unit="m",
        source="virtual stands of other seeds than those judged (docs/trees.md)",
        ge=-20,
        le=20,
    )
    conifer_growth: float = parameter(
        0.033,
        "As window_growth, in stands of type conifer.",
        unit="m/m",
        source="as conifer_start",
        ge=0,
        le=1,
    )
    broadleaf_start: float = parameter(
        -0.5,
        "As window_start, in stands of type broadleaf.",
        unit="m",
        source="virtual stands of other seeds than those judged (docs/trees.md)",
        ge=-20,
        le=20,
    )
    broadleaf_growth: float = parameter(
        0.11,
        "As window_growth, in stands of type broadleaf.",
        unit="m/m",
        source="as broadleaf_start",
        ge=0,
        le=1,
    )
    smoothing_size: int = parameter(
        13,
        "Edge of the bilateral filter before slope and aspect, odd, in cells of 0.2 m.",
        unit="cells",
        source="a sharper aspect than the 49 of thesis 4.3 (docs/trees.md)",
        ge=1,
        le=499,
    )
    smoothing_sigma: float = parameter(
        10.0,
        "Standard deviation of the bilateral filter in height.",
        unit="m",
        source="thesis 4.3",
        gt=0,
        le=100,
    )
    crown_method: Literal["growing", "watershed", "dalponte"] = parameter(
        "growing", "How crowns are found.", unit="-", source="thesis 3.3.3; the others for comparison"
    )
    max_diameter: float = parameter(
        14.0, "Largest crown where no stand type is known.", unit="m", source="thesis 4.5.2", gt=0, le=60
    )
    conifer_diameter: float = parameter(
        6.0, "Largest crown in stands of type conifer.", unit="m", source="thesis 4.5.2", gt=0, le=60
    )
    broadleaf_diameter: float = parameter(
        14.0, "Largest crown in stands of type broadleaf.", unit="m", source="thesis 4.5.2", gt=0, le=60
    )
    min_slope: float | None = parameter(
        None,
        "Growth stops where the smoothed surface falls less than this away from the top; null: no limit.",
        unit="degree",
        source="thesis 3.3.3 prints no value",
        ge=-90,
        le=90,
    )
    max_slope: float | None = parameter(
        None,
        "Growth stops where the smoothed surface falls more than this; null: no limit, the thesis has 60.",
        unit="degree",
        source="thesis 4.5.2: 60 with a filter of 49; with a smaller one it cuts crowns (docs/trees.md)",
        ge=-90,
        le=90,
    )
    aspect: Literal["conifer", "never", "always"] = parameter(
        "conifer", "Stands in which aspect limits growth.", unit="-", source="thesis 4.5.2, finding T23"
    )
    max_aspect: int = parameter(
        4,
        "Largest difference between aspect and direction away from the top, in sixteenths of a turn.",
        unit="22.5 degree",
        source="thesis 3.3: 16 directions; a quarter turn (docs/trees.md)",
        ge=0,
        le=8,
    )
    crown_min_share: float = parameter(
        0.2,
        "A crown ends where the surface is lower than this share of its top's height.",
        unit="1",
        source="below are ground and understorey; 0 to 0.3 make no difference (docs/trees.md)",
        ge=0,
        lt=1,
    )
    crown_winding: float = parameter(
        1.5,
        "Ways from a top may be this much longer than the largest radius, in steps.",
        unit="1",
        source="a way round a gap in the crown; it bounds what a tile must see",
        ge=1,
        le=5,
    )
    max_index_change: float | None = parameter(
        None,
        "Growth stops where NDVI or GLI changes more from cell to cell; null leaves it out.",
        unit="1",
        source="thesis 4.5.2 prints no value",
        gt=0,
        le=2,
    )
    min_brightness: float | None = parameter(
        None,
        "Growth stops in shadow darker than this; null leaves it out.",
        unit="digital number",
        source="thesis 4.5.2 prints no value",
        ge=0,
    )
    dalponte_top_share: float = parameter(
        0.45, "Least share of the height of the top.", unit="1", source="Dalponte & Coomes 2016", ge=0, le=1
    )
    dalponte_mean_share: float = parameter(
        0.55,
        "Least share of the mean height of the crown.",
        unit="1",
        source="Dalponte & Coomes 2016",
        ge=0,
        le=1,
    )
    height_sd: float = parameter(
        0.1,
        "Standard deviation of the terrain and of the datum, beside the spread of the surface.",
        unit="m",
        source="lidar terrain under forest; spread of the pairs is added cell by cell",
        ge=0,
        le=10,
    )
    height_class: float = parameter(
        5.0, "Width of the height classes of the stand table.", unit="m", source="forest inventories", gt=0
    )
    tile_size: int = parameter(
        2048, "Edge of a tile; it does not change the result.", unit="cells", source="memory", ge=64, le=16384
    )
