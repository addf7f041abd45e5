"""Parameters of the surface stage."""

from typing import Literal

from workbench.params.base import Section, parameter


class SurfaceParameters(Section):
    """Gridding, fusion, terrain [thesis 4.2, 5.1]."""

    resolution: float | None = parameter(
        None,
        "Cell of all surfaces; null takes 1.25 times the finest matched ground resolution.",
        unit="m",
        source="each cell then holds a measured pixel, and none is oversampled",
        gt=0,
    )
    min_count: int = parameter(
        1, "Cells measured by fewer pairs are empty.", unit="pairs", source="thesis 3.2.1", ge=1, le=255
    )
    least_confidence: int = parameter(
        0,
        "Matched pixels of less confidence are left out.",
        unit="1/255",
        source="none by default",
        ge=0,
        le=255,
    )
    tolerance: float = parameter(
        0.1,
        "Heights of a cell that differ by more belong to different surfaces.",
        unit="m",
        source="leaf layers and steps; at least three times the height precision is used",
        gt=0,
        le=10,
    )
    min_patch: float = parameter(
        1.0,
        "Measured patches smaller than this are removed at each downscale: specks are worse than holes.",
        unit="m2",
        source="a crown of about one metre, the smallest single tree",
        ge=0,
        le=1000,
    )
    min_single_patch: float = parameter(
        16.0,
        "Patches that only one pair measured, at a large angle, are removed below this area.",
        unit="m2",
        source="a crown of 4.5 m; isolated heights of one wide pair are mostly chance (docs/surface.md)",
        ge=0,
        le=10000,
    )
    single_angle: float = parameter(
        12.0,
        "Up to this intersection angle one pair is believed like two; min_patch holds for its patches.",
        unit="degree",
        source="thesis 4.2, 5.1: canopy is matched up to about 10 degrees on the ground, a fifth more at "
        "crowns (docs/surface.md)",
        gt=0,
        lt=90,
    )
    patch_step: float = parameter(
        0.5,
        "Neighbouring cells that differ by more do not belong to one patch.",
        unit="m",
        source="larger than the relief of ground and roofs over one fine cell, smaller than a speck's height",
        gt=0,
        le=50,
    )
    patch_slope: float = parameter(
        8.0,
        "Nor do those that are steeper, if that allows more: on coarse cells a crown falls by metres a cell.",
        unit="m/m",
        source="flank of a conifer, crown 18 m long and 4.5 m wide (thesis 2.4.1); at 0.5 m alone, two "
        "thirds of the crowns of a virtual stand were taken for specks at cells of 0.25 m",
        ge=0,
        le=100,
    )
    interpolate: Literal["none", "linear"] = parameter(
        "none",
        "Fill what no downscale measured; always flagged 255 in provenance.tif.",
        unit="-",
        source="thesis 5.1: interpolated holes hold no tree",
    )
    tile_size: int = parameter(
        512, "Edge of a tile; it does not change the result.", unit="cells", source="memory", ge=64, le=16384
    )
    ground_cell: float = parameter(
        0.5,
        "Cell of the cloth for the terrain.",
        unit="m",
        source="Zhang et al. 2016: 0.5 m for general terrain",
        gt=0,
        le=20,
    )
    ground_rigidness: int = parameter(
        2,
        "Rigidness of the cloth: 1 steep, 2 with relief, 3 flat.",
        unit="1",
        source="Zhang et al. 2016",
        ge=1,
        le=3,
    )
    ground_threshold: float = parameter(
        0.5,
        "Cells within this distance of the cloth are ground.",
        unit="m",
        source="Zhang et al. 2016",
        gt=0,
        le=10,
    )

    def largest_step(self, cell: float) -> float:
        """Largest difference of heights, metres, between neighbouring cells (``cell`` metres) of a patch."""
        return max(self.patch_step, self.patch_slope * cell)
