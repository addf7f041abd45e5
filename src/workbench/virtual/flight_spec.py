"""The flight of a scene: the section ``flight`` of its YAML file."""

from __future__ import annotations

from datetime import datetime

from pydantic import BaseModel, ConfigDict, Field


class FlightSpec(BaseModel):
    """How a scene is photographed. Frozen, and closed to unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    camera: str = Field("MACS MAR", description="Name of a virtual camera, see flight_cameras().")
    frame: tuple[int, int] | None = Field(
        None, description="Columns and rows that are kept of the middle of the frame; null for all."
    )
    reduction: float = Field(1.0, ge=1, le=16, description="Factor by which photographs are reduced.")
    gsd: float | None = Field(0.1, gt=0, le=5, description="Ground sampling distance, m.")
    height: float | None = Field(None, gt=0, description="Above ground, m, instead of the GSD.")
    forward_overlap: float = Field(0.8, description="Of whole frames along the strip, 0..1.")
    side_overlap: float = Field(0.6, description="Of whole frames between strips, 0..1.")
    direction: float = Field(90.0, description="Of the first strip, degrees clockwise from north.")
    strips: int | None = Field(None, ge=1, description="Number of strips; null for as many as are needed.")
    run_in: float = Field(
        0.0, ge=0, le=2, description="Frames (along the strip) flown beyond the area at either end."
    )
    crossing: bool = Field(False, description="Fly a second set of strips at right angles.")
    speed: float = Field(50.0, gt=0, le=300, description="Over ground, m/s.")
    time: datetime = Field(
        datetime.fromisoformat("2021-07-14T10:30:00+00:00"), description="Of the first photograph, with zone."
    )
    cloudiness: float = Field(0.0, ge=0, le=1, description="0 clear .. 1 overcast.")
    wind: float = Field(2.0, ge=0, le=20, description="m/s.")
    wind_direction: float = Field(250.0, description="Where it comes from, degrees clockwise from north.")
    gnss_sd: tuple[float, float] = Field(
        (0.05, 0.08), description="Standard deviation of recorded positions, horizontal per axis and up, m."
    )
    attitude_sd: tuple[float, float] = Field(
        (0.01, 0.03), description="Standard deviation of recorded roll and pitch, and of heading, degrees."
    )
    navigation: bool = Field(True, description="A navigation file beside the EXIF positions.")
    calibrated: bool = Field(True, description="The site states the distortion, as a certificate does.")
