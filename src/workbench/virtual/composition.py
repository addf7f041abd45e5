"""What a scene is composed of: the typed form of ``scenes/<name>.yaml``.

Positions are metres in the scene's local frame: x east and y north of its south-west corner.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from workbench.virtual.flight_spec import FlightSpec

Point = tuple[float, float]
Range = tuple[float, float]


class Part(BaseModel):
    """A part of a scene: frozen, and closed to unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class TerrainSpec(Part):
    """Fractal land surface."""

    base: float = Field(description="Mean height, m.")
    relief: float = Field(0.5, ge=0, le=60, description="Standard deviation of the heights, m.")
    longest: float = Field(80.0, gt=0, description="Correlation length of the largest forms, m.")
    slope: Point = Field((0.0, 0.0), description="Rise to the east and to the north, m per m.")
    step: float = Field(0.5, gt=0, le=5, description="Spacing of the samples, m.")


class LakeSpec(Part):
    """A lake with a shelving bed."""

    level: float = Field(description="Water level, m.")
    outline: tuple[Point, ...] = Field(min_length=3, description="Polygon of the water, may leave the scene.")
    bed_slope: float = Field(0.06, gt=0, le=1, description="Fall of the bed at the shore, m per m.")
    beach_slope: float = Field(0.04, gt=0, le=1, description="Rise of the land at the shore, m per m.")
    deepest: float = Field(4.0, gt=0, description="Depth far from the shore, m.")


class ReedSpec(Part):
    """A reed belt along a part of the shore."""

    aoi: str = Field("1", description="Name of the area of interest.")
    along: Range = Field(description="From and to, m along the lake outline from its first point.")
    width: float = Field(14.0, gt=0, description="Mean distance of the front from the shoreline, m.")
    ashore: float = Field(3.0, ge=0, description="How far the reed stands on land, m.")
    fray: float = Field(0.1, ge=0, le=1, description="0 straight front .. 1 frayed.")
    density: float = Field(60.0, gt=0, le=200, description="Stems per square metre at the shore.")
    height: float = Field(3.4, gt=0, le=6, description="Length of stems at the shore, foot to panicle, m.")
    deepest: float = Field(1.4, gt=0, description="Water depth in which the last stems grow, m.")
    green: float = Field(0.75, ge=0, le=1, description="Share of green stems at the shore.")
    islets: int = Field(0, ge=0, le=100, description="Patches of reed in front of the front.")
    holes: int = Field(0, ge=0, le=100, description="Patches of water within the reed.")
    single_stems: float = Field(0.3, ge=0, le=4, description="Stems per square metre just outside the front.")


class StandSpec(Part):
    """A forest stand; sizes that are not given follow from species group and age."""

    area: tuple[Point, ...] = Field(min_length=3, description="Polygon.")
    species_group: str = Field(description="broadleaf or conifer.")
    age: Literal["young", "middle", "old"] = "middle"
    height: Range | None = Field(None, description="Mean and standard deviation, m.")
    crown: Range | None = Field(None, description="Mean and standard deviation of the crown diameter, m.")
    spacing: float | None = Field(None, gt=0, description="Mean distance of neighbouring stems, m.")
    clumping: float = Field(0.2, ge=0, le=1, description="0 even .. 1 strongly clumped with gaps.")
    admixture: float = Field(0.05, ge=0, le=1, description="Share of the other species group.")
    dead: float = Field(0.01, ge=0, le=1, description="Share of dead trees.")
    lean: float = Field(0.02, ge=0, le=0.3, description="Standard deviation of the lean, m per m of height.")
    understorey: float = Field(300.0, ge=0, description="Small trees below the canopy per hectare.")


class SingleTreesSpec(Part):
    """Trees that stand alone."""

    number: int = Field(ge=0, le=5000, description="How many.")
    area: tuple[Point, ...] | None = Field(None, description="Polygon, by default the whole scene.")
    species_group: str = "broadleaf"
    height: Range = Field((6.0, 14.0), description="From and to, m.")
    crown_share: Range = Field((0.55, 0.8), description="Crown diameter over height, from and to.")
    apart: float = Field(6.0, ge=0, description="Smallest distance of two trees, m.")


class LineSpec(Part):
    """A road or path."""

    points: tuple[Point, ...] = Field(min_length=2, description="Axis.")
    width: float = Field(3.0, gt=0, le=60, description="Width, m.")


class BuildingSpec(Part):
    """A house or hall."""

    x: float
    y: float
    length: float = Field(12.0, gt=0, le=200, description="Along the ridge, m.")
    width: float = Field(9.0, gt=0, le=100, description="Across the ridge, m.")
    eaves: float = Field(4.0, gt=0, le=60, description="Height of the walls, m.")
    ridge: float = Field(7.5, gt=0, le=80, description="Height of the ridge, m; of the roof if it is flat.")
    azimuth: float = Field(0.0, description="Direction of the ridge, degrees clockwise from north.")
    roof: Literal["gabled", "flat"] = "gabled"
    colour: Literal["red", "brown", "grey", "white"] = "red"


class CarSpec(Part):
    """A parked car."""

    x: float
    y: float
    azimuth: float = 0.0
    colour: Literal["red", "white", "black", "silver", "blue"] = "silver"


class TargetSpec(Part):
    """A signal for a control point, painted on the ground."""

    name: str
    x: float
    y: float
    edge: float = Field(0.6, gt=0, le=5, description="Edge length, m.")
    azimuth: float = Field(0.0, description="Turn, degrees clockwise.")
    kind: Literal["quadrant", "letter"] = "quadrant"


class SceneSpec(Part):
    """A scene."""

    name: str = Field(min_length=1)
    title: str = ""
    seed: int = Field(ge=0, description="Another seed gives another scene of the same composition.")
    crs: str = Field(description="Projected, metric, as EPSG:n.")
    vertical_datum: str = Field(min_length=1)
    origin: Point = Field(description="South-west corner in the CRS, m.")
    size: tuple[float, float] = Field(description="East-west and north-south, m.")
    terrain: TerrainSpec
    lake: LakeSpec | None = None
    reed: tuple[ReedSpec, ...] = ()
    stands: tuple[StandSpec, ...] = ()
    single_trees: tuple[SingleTreesSpec, ...] = ()
    roads: tuple[LineSpec, ...] = ()
    paths: tuple[LineSpec, ...] = ()
    buildings: tuple[BuildingSpec, ...] = ()
    cars: tuple[CarSpec, ...] = ()
    boulders: int = Field(0, ge=0, le=2000, description="How many lie on open land.")
    targets: tuple[TargetSpec, ...] = ()
    flight: FlightSpec = Field(FlightSpec(), description="How it is photographed.")
