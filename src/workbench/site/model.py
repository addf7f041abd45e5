"""A site: one area on one date, with its photographs, positions, control and references."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Literal

from rasterio.crs import CRS

from workbench.cameras import Camera

Role = Literal["control", "check", "verify"]


@dataclass(frozen=True)
class Photograph:
    """One photograph and what is known of it before orientation."""

    name: str
    """Unique name: the path below the folder of photographs."""
    path: Path
    """Image file."""
    camera: str
    """Identifier of its camera in the site."""
    position: tuple[float, float, float] | None = None
    """x, y, z of the projection centre in the site's CRS, metres, as recorded."""
    position_sd: tuple[float, float, float] | None = None
    """Standard deviations of x, y, z, metres, where the recorder states them."""
    attitude: tuple[float, float, float] | None = None
    """Omega, phi, kappa, degrees, as recorded."""
    attitude_sd: tuple[float, float, float] | None = None
    """Standard deviations of turns about x, y, z, degrees, where the recorder states them."""
    time: datetime | None = None
    """Exposure, with its time zone where that is known."""
    strip: int = 0
    """Number of the flight strip, from 0."""
    order: int = 0
    """Place within the strip, from 0."""
    height_above_ground: float | None = None
    """Metres above the place of take-off, where the drone records it."""
    bands: int = 3
    """Bands of the image."""
    sun: tuple[float, float] | None = None
    """Elevation and azimuth of the sun at the exposure, degrees, where place and time are known."""
    note: str = ""
    """What was recorded but is not believed, such as a position of 0, 0; empty if nothing."""
    set_aside: str = ""
    """Why this photograph is not used; empty for one that is."""


@dataclass(frozen=True)
class ControlPoint:
    """A surveyed point."""

    name: str
    """Unique name."""
    x: float
    """East in the site's CRS, metres."""
    y: float
    """North, metres."""
    z: float
    """Height in the site's vertical datum, metres."""
    sd_xy: float
    """Standard deviation of x and of y, metres."""
    sd_z: float
    """Standard deviation of z, metres."""
    role: Role = "control"
    """control: used; check: measures the error; verify: touched by no optimisation."""


@dataclass(frozen=True)
class Observation:
    """Where a surveyed point was measured in a photograph."""

    name: str
    """Name of the point."""
    photo: str
    """Name of the photograph."""
    column: float
    """Pixels, origin at the upper left corner of the upper left pixel."""
    row: float
    """Pixels, downwards."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with a site."""

    severity: Literal["error", "warning"]
    """error: the chain cannot run; warning: it can, with less."""
    subject: str
    """File, photograph or point."""
    text: str
    """What is wrong."""
    remedy: str
    """What to do."""

    def __str__(self) -> str:
        return f"{self.severity}: {self.subject}: {self.text} {self.remedy}"


@dataclass(frozen=True)
class Site:
    """Everything that is known of an area on a date before processing."""

    name: str
    """Name of the folder under data/sites."""
    root: Path
    """Folder that holds data/."""
    crs: CRS | None
    """Projected CRS of all coordinates and products, metres; None while it is open."""
    vertical_datum: str | None
    """What heights refer to, in words; None while it is open."""
    photographs: tuple[Photograph, ...]
    """Photographs in use, by name."""
    cameras: dict[str, Camera] = field(default_factory=dict)
    """Inner orientation a priori, by identifier; cameras with open questions are missing."""
    unanswered: tuple[str, ...] = ()
    """Questions of site.yaml without an answer."""
    set_aside: tuple[Photograph, ...] = ()
    """Photographs that are not used, each with its reason."""
    time_zone: str | None = None
    """IANA name of the zone of the cameras' clocks, where EXIF leaves it open."""
    flight: dict[str, str | None] = field(default_factory=dict)
    """Purpose, operator, platform, weather, wind and notes of the flight, as documented."""
    control: tuple[ControlPoint, ...] = ()
    """Surveyed points."""
    observations: tuple[Observation, ...] = ()
    """Their measurements in photographs."""
    water_level: float | None = None
    """Metres in the vertical datum."""
    shoreline: Path | None = None
    """Polygon of the lake side of the official shoreline."""
    dtm: Path | None = None
    """Terrain raster."""
    areas: Path | None = None
    """Areas of interest, polygons with a column aoi."""
    transects: Path | None = None
    """Transects, lines from the water to the shore with columns aoi and transect."""
    field_points: Path | None = None
    """Reed field campaign, table of points."""
    plots: Path | None = None
    """Reed field campaign, table of 1 m2 plots."""
    reference_status: Path | None = None
    """Status of reed per section from visual interpretation."""
    reference_trees: Path | None = None
    """Surveyed trees."""

    @property
    def folder(self) -> Path:
        """Inputs: data/sites/<name>."""
        return self.root / "data" / "sites" / self.name

    @property
    def products(self) -> Path:
        """Outputs: data/products/<name>."""
        return self.root / "data" / "products" / self.name

    @property
    def truth(self) -> Path | None:
        """Truth of a virtual site; None for a real one."""
        folder = self.folder / "truth"
        return folder if folder.is_dir() else None

    def photograph(self, name: str) -> Photograph:
        """Photograph of a name; KeyError if the site does not use it."""
        for photograph in self.photographs:
            if photograph.name == name:
                return photograph
        raise KeyError(name)
