"""Parameters of the orientation stage."""

from typing import Literal

from workbench.params.base import Section, parameter


class OrientParameters(Section):
    """Structure from motion and georeferencing [orthomosaic paper 2.4; reed paper 2.3]."""

    seed: int = parameter(1, "Seed of all random choices of this stage.", unit="1", source="any", ge=0)
    threads: int = parameter(
        2,
        "Threads for features; they do not change the result.",
        unit="1",
        source="-",
        ge=1,
        le=256,
    )
    max_image_size: int = parameter(
        2000,
        "Longest edge at which features are sought.",
        unit="px",
        source="measured: nearly the accuracy of full size at a tenth of time and memory",
        ge=200,
        le=20000,
    )
    first_octave: int = parameter(
        0,
        "First octave of the feature pyramid; -1 doubles the image before.",
        unit="1",
        source="measured: -1 takes three times the time and memory for 0.06 px less residual",
        ge=-1,
        le=4,
    )
    max_features: int = parameter(
        8192,
        "Key points per photograph at most.",
        unit="1",
        source="measured: more add time, not accuracy (reed paper 150 000, orthomosaic paper 40 000)",
        ge=100,
        le=150_000,
    )
    max_matches: int = parameter(
        32768, "Matches per pair at most.", unit="1", source="no limit in practice, as reed paper", ge=100
    )
    neighbours: int = parameter(
        12,
        "Photographs to match each one with, nearest first; all where positions are missing.",
        unit="1",
        source="two before and after in three strips at 80 % forward and 60 % side overlap",
        ge=2,
        le=500,
    )
    gnss_sd_xy: float = parameter(
        2.0,
        "Standard deviation of horizontal positions that do not state theirs.",
        unit="m",
        source="single-frequency GNSS of drones",
        gt=0,
        le=1000,
    )
    gnss_sd_z: float = parameter(
        4.0, "The same, vertical.", unit="m", source="single-frequency GNSS of drones", gt=0, le=1000
    )
    attitude_sd: float | None = parameter(
        None,
        "Standard deviation of recorded attitudes that do not state theirs; without it they are not used.",
        unit="degrees",
        source="gimbals of drones drift by degrees: weighted by 1 they turned a real block by as much",
        gt=0,
        le=90,
    )
    mounting_sd: float = parameter(
        1.0,
        "Standard deviation of the turn between the instrument that records attitudes and the camera.",
        unit="degrees",
        source="reasoned: not calibrated; holds the roll of a single strip, and moves no block of several",
        gt=0,
        le=90,
    )
    georeference: Literal["positions", "control", "both"] = parameter(
        "both",
        "What fixes the block: recorded positions, control points, or both as far as there are any.",
        unit="-",
        source="orthomosaic paper 2.4",
    )
    focal_length: Literal["auto", "fixed", "free"] = parameter(
        "auto",
        "auto frees the focal length only where the block can see it (obliques, relief, control).",
        unit="-",
        source="a nadir block of constant height cannot: it stretched heights by 25 % in a trial",
    )
    observation_sd: float = parameter(
        1.0,
        "Standard deviation of a measured image position, where the block has too few to show it.",
        unit="px",
        source="pointing at signalised targets",
        gt=0,
        le=50,
    )
    max_reprojection_error: float = parameter(
        4.0,
        "Observations of tie points beyond are dropped.",
        unit="px",
        source="COLMAP default",
        gt=0,
        le=100,
    )
    outlier_sds: float = parameter(
        6.0,
        "So are those beyond so many robust standard deviations of the block's residuals (moving leaves, "
        "reed, water), unless optimise chooses the threshold.",
        unit="1",
        source="normal errors never are; with 3 to 6 alike, poses of a virtual lake improve from 12 to 5 cm. "
        "The largest of these: what a lens model leaves in corners is no outlier (at 5 a real block bends)",
        ge=3,
        le=1000,
    )
    optimise: bool = parameter(
        False,
        "Choose the reprojection-error threshold by the error of the checkpoints, which spends them.",
        unit="-",
        source="orthomosaic paper 2.4; points of role verify measure the error that is left",
    )
    max_reconstruction_uncertainty: float = parameter(
        50.0,
        "First filter of the optimisation: longest over shortest axis of a tie point's error ellipsoid.",
        unit="1",
        source="orthomosaic paper 2.4 and its scripts",
        gt=1,
    )
    max_projection_accuracy: float = parameter(
        10.0,
        "Second filter of the optimisation: mean size of the features relative to the finest.",
        unit="1",
        source="orthomosaic paper 2.4 and its scripts",
        gt=1,
    )
    thresholds: tuple[float, ...] = parameter(
        (4.0, 3.0, 2.0, 1.5, 1.2, 1.0, 0.8, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1),
        "Reprojection errors that the optimisation tries, descending.",
        unit="px",
        source="orthomosaic paper 3.1: best at 0.4, worse at 0.1; begins at the mapping's own limit",
        min_length=1,
    )
    least_tie_points: int = parameter(
        15,
        "A photograph with fewer tie points counts as lost.",
        unit="1",
        source="fewest matches that connect two photographs in COLMAP",
        ge=3,
        le=1000,
    )
    folds: int = parameter(
        5,
        "Parts of the checkpoints to cross-validate the optimised error; leave-one-out if fewer points.",
        unit="1",
        source="usual",
        ge=2,
        le=1000,
    )
    repetitions: int = parameter(
        5, "Seeds to repeat the optimisation with.", unit="1", source="orthomosaic paper 2.4", ge=2, le=1000
    )
