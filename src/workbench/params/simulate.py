"""Parameters of the simulate stage."""

from workbench.params.base import Section, parameter

_SCENE = "the scene's own flight; the papers' flights are in published/cameras.csv"


class SimulateParameters(Section):
    """Flight, optics, survey and field campaign of a virtual site [methods 6, 7 and 9]."""

    seed: int = parameter(
        4,
        "Seed of disturbances, noise and survey; the landscape has its own.",
        unit="1",
        source="any; with 4 the biases of the navigation are as large as stated, with 1 twice as large",
        ge=0,
    )
    camera: str | None = parameter(None, "Virtual camera; null takes the scene's.", unit="-", source=_SCENE)
    frame: tuple[int, int] | None = parameter(
        None,
        "Columns and rows kept of the middle; null takes the scene's, or all of another camera.",
        unit="px",
        source=_SCENE,
    )
    gsd: float | None = parameter(
        None,
        "Ground sampling distance, decides the height; null takes the scene's.",
        unit="m",
        source=_SCENE,
        gt=0,
        le=5,
    )
    forward_overlap: float | None = parameter(
        None, "Along the strip; null takes the scene's.", unit="1", source=_SCENE, ge=0, lt=1
    )
    side_overlap: float | None = parameter(
        None, "Between strips; null takes the scene's.", unit="1", source=_SCENE, ge=0, lt=1
    )
    strips: int | None = parameter(
        None, "Strips, centred on the scene; null takes the scene's.", unit="1", source=_SCENE, ge=1, le=200
    )
    direction: float | None = parameter(
        None,
        "Of the first strip, clockwise from north; null takes the scene's.",
        unit="degrees",
        source=_SCENE,
        ge=-360,
        le=360,
    )
    wind: float | None = parameter(
        None, "Wind speed; null takes the scene's.", unit="m/s", source=_SCENE, ge=0, le=20
    )
    supersampling: int = parameter(
        3,
        "Samples along the edge of a pixel.",
        unit="1",
        source="field notes: one sample a pixel adds false failures of matching",
        ge=1,
        le=8,
    )
    near_infrared: bool = parameter(
        False, "Four bands as lossless TIFF instead of three as JPEG.", unit="-", source="thesis 3.1: CIR"
    )
    point_spread: float = parameter(
        0.4,
        "Standard deviation of the lens point spread.",
        unit="px",
        source="a good lens keeps 45 % contrast at the Nyquist frequency: exp(-2 (pi 0.4 0.5)^2)",
        ge=0,
        le=5,
    )
    vignetting: float = parameter(
        0.25,
        "Loss of light in the corners of the whole frame, growing with the square of the radius.",
        unit="1",
        source="half a stop or less after stopping down",
        ge=0,
        lt=1,
    )
    exposure_time: float = parameter(
        0.0008, "Exposure time.", unit="s", source="usual aerial shutter, 1/1250 s", ge=0, le=0.1
    )
    readout_time: float = parameter(
        0.0,
        "Time between the first and the last row of a rolling shutter; 0 for a global or leaf shutter.",
        unit="s",
        source="aerial cameras have none; 0.03 s is usual for small drones",
        ge=0,
        le=0.2,
    )
    brightness: float = parameter(
        1.6,
        "Exposure: radiance times this reaches full scale at 1.",
        unit="1",
        source="vegetation near a third of the scale, white signals just below saturation of the sensor",
        gt=0,
        le=20,
    )
    full_well: float = parameter(
        25000.0, "Electrons of a pixel at full scale.", unit="1", source="pixels of 5-7 um", gt=0, le=1e6
    )
    read_noise: float = parameter(
        12.0, "Read noise, electrons.", unit="1", source="CCD and early CMOS sensors", ge=0, le=1000
    )
    jpeg_quality: int = parameter(
        93, "Quality of JPEG, colour at half resolution along rows.", unit="1", source="'fine'", ge=1, le=100
    )
    trigger_jitter: float = parameter(
        0.02, "Standard deviation of the moment of release.", unit="s", source="intervalometers", ge=0, le=5
    )
    attitude_disturbance: float = parameter(
        1.0,
        "Standard deviation of roll, pitch and heading against the plan.",
        unit="degrees",
        source="stabilised mount or quiet air",
        ge=0,
        le=20,
    )
    track_disturbance: float = parameter(
        0.01,
        "Standard deviation of cross-track position and height, as a share of the height above ground.",
        unit="1",
        source="navigation by autopilot",
        ge=0,
        le=0.2,
    )
    bias_share: float = parameter(
        0.3,
        "Share of the variance of position and attitude errors that is one bias for the whole flight.",
        unit="1",
        source="reasoned: datum, lever arm and boresight outlast the flight",
        ge=0,
        le=1,
    )
    drift_share: float = parameter(
        0.3,
        "Share of the variance that drifts from strip to strip; the rest is noise.",
        unit="1",
        source="reasoned: satellite geometry and ionosphere change in minutes",
        ge=0,
        le=1,
    )
    survey_sd_xy: float = parameter(
        0.01, "Standard deviation of surveyed targets in x and y.", unit="m", source="RTK", gt=0, le=1
    )
    survey_sd_z: float = parameter(
        0.015, "Standard deviation of surveyed targets in height.", unit="m", source="RTK", gt=0, le=1
    )
    measuring_sd: float = parameter(
        0.15,
        "Standard deviation of measurements of targets in photographs.",
        unit="px",
        source="careful pointing by hand",
        ge=0,
        le=5,
    )
    check_every: int = parameter(
        3, "Every so many-th target is a checkpoint.", unit="1", source="METHODS 2: split", ge=2, le=100
    )
    line_length: float = parameter(
        100.0,
        "Line parallel to the shore of a reed campaign; shorter where the belt is.",
        unit="m",
        source="reed 2.4 (70 m at one area)",
        gt=0,
        le=1000,
    )
    transect_spacing: float = parameter(
        10.0, "Distance of transects.", unit="m", source="reed 2.4", gt=0, le=100
    )
    point_spacing: float = parameter(
        1.0, "Distance of points along a transect.", unit="m", source="reed 2.4", gt=0, le=10
    )
    height_reading: float = parameter(
        0.01, "Graduation of the folding rule.", unit="m", source="reed 2.4", gt=0, le=0.5
    )
    field_gnss_error: float = parameter(
        0.465,
        "Horizontal root mean square error of recorded transects and plots.",
        unit="m",
        source="reed 2.4: mean horizontal precision",
        ge=0,
        le=10,
    )
    scan_sd: float = parameter(
        0.01,
        "Standard deviation of points on stems from the terrestrial scan.",
        unit="m",
        source="thesis 3.4, reasoned",
        ge=0,
        le=0.5,
    )
    min_dbh_broadleaf: float = parameter(
        0.25, "Stems are counted from this diameter.", unit="m", source="METHODS 7", ge=0, le=2
    )
    min_dbh_conifer: float = parameter(
        0.20, "Stems are counted from this diameter.", unit="m", source="METHODS 7", ge=0, le=2
    )
    truth_resolution: float = parameter(
        0.1, "Cell of the rasters of truth.", unit="m", source="about the GSD of the scenes", gt=0, le=5
    )
    truth_per_photograph: bool = parameter(
        False, "Also write depth, land cover and tree of every pixel.", unit="-", source="on request"
    )
