"""From a free or roughly placed model to the site's CRS: by positions, control points, or both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pycolmap

from workbench.orientation.adjust import (
    adjust,
    drop_outliers,
    focal_length_is_visible,
    tie_point_precision,
)
from workbench.orientation.control import (
    PointResidual,
    align_to_control,
    by_point,
    pointing_precision,
    residuals,
    worst_fitting,
)
from workbench.orientation.datum import describe_shift, require_upright, shift_of_records, without_shift
from workbench.orientation.misread import Misread, misread_measurements, without_misread
from workbench.params import OrientParameters
from workbench.site import ControlPoint, Site, on_a_line
from workbench.site.places import far_from_rest

_LEAST_CONTROL = 3
_LEAST_PLACED = 3
_STANDS_OUT = 4.0  # Standard deviations of three coordinates: beyond is one good point of a thousand.
_GROSS = 5.0  # Times the residual of the worst of the others, once they are alone.
_ROUNDS = 2  # Outliers hide others; more rounds eat into the good ones.


@dataclass(frozen=True, eq=False)
class Placing:
    """How a model came into the frame of the site, before its adjustment."""

    gross: tuple[str, ...] = ()
    """Control points left out because they contradict the others."""
    shift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Recorded minus surveyed frame, metres, where they differ by more than receivers err."""
    on_a_line: bool = False
    """Whether recorded positions alone keep the block from turning about its control points."""


@dataclass(frozen=True, eq=False)
class Georeference:
    """What fixes a block, and how to adjust and to measure it again after its tie points changed."""

    site: Site
    """The site; its recorded positions in the frame of the control points."""
    offset: np.ndarray
    """(3,) site coordinates minus model coordinates, metres."""
    options: OrientParameters
    """Parameters of the stage."""
    measured: Mapping[str, list[tuple[str, float, float]]]
    """Image measurements of surveyed points by name."""
    control: tuple[ControlPoint, ...]
    """Control points in the adjustment; never one of role check or verify."""
    placing: Placing
    """How the model came into the frame of the site."""
    free_focal_length: bool
    """Whether the focal length is adjusted."""
    focal_length_reason: str
    """What lets the block see its focal length, or hides it."""
    visible: bool
    """Whether the block can see its focal length."""
    misread: tuple[Misread, ...] = ()
    """Measurements of surveyed points that contradict the others of their point, and are left out."""
    tie_point_sd: float | None = None
    """Standard deviation of the image position of a tie point, px, once the block has shown it."""
    pointing_sd: float | None = None
    """The same of the measurement of a control point, where there are enough to show it."""
    left_out: tuple[str, ...] = ()
    """Control points left out after the adjustment because they contradict the others."""
    doubtful: str = ""
    """Control point that fits badly, and how badly, where the others do not tell whether it is wrong."""

    @property
    def gross(self) -> tuple[str, ...]:
        """Control points left out because they contradict the others."""
        return (*self.placing.gross, *self.left_out)

    def adjust(self, model: pycolmap.Reconstruction) -> None:
        """Adjust the bundle in place."""
        adjust(
            model,
            self.site,
            self.offset,
            self.options,
            control=self.control,
            measured=self.measured,
            free_focal_length=self.free_focal_length,
            tie_point_sd=self.tie_point_sd,
            pointing_sd=self.pointing_sd,
        )

    def residuals(self, model: pycolmap.Reconstruction) -> list[PointResidual]:
        """Residual of every surveyed point of the site."""
        return residuals(model, self.site.control, self.measured, self.offset, unused=self.gross)

    def worst_fitting(self, model: pycolmap.Reconstruction) -> tuple[str, float]:
        """The control point that fits worst, and its residual in standard deviations."""
        return worst_fitting(
            model,
            self.residuals(model),
            self.control,
            self.measured,
            observation_sd=self.options.observation_sd,
        )

    def warnings(self) -> list[str]:
        """What the user should know of the way the block is fixed."""
        found = [str(one) for one in self.misread]
        found += [f"Control point {name} does not fit the others and is not used." for name in self.gross]
        if self.placing.shift.any():
            found.append(describe_shift(self.placing.shift))
        if self.placing.on_a_line:
            found.append(
                "The control points lie on a line: recorded positions alone keep the block from turning "
                "about it. Add a point beside."
            )
        if self.doubtful:
            found.append(
                f"A control point fits badly, {self.doubtful}: look at its coordinates and measurements. It "
                "is used, as the others are too few or too rough to say that it is wrong."
            )
        if not self.visible and not self.control:
            found.append(
                f"Heights rest on the focal length of the camera table: {self.focal_length_reason}, and "
                "there is no control. Add control points, oblique photographs, or a second flying height."
            )
        if self.control and all(point.role == "control" for point in self.site.control):
            found.append(
                "All surveyed points are control: nothing measures the error of the block. "
                "Give some of them the role check."
            )
        return found


def georeference(
    model: pycolmap.Reconstruction, site: Site, offset: np.ndarray, options: OrientParameters
) -> Georeference:
    """Place and adjust a model in place, in the site's CRS minus ``offset``.

    A similarity onto the control points comes first where there are three of them (robust: points
    that contradict the others are named and left out), then the weighted adjustment. Recorded positions may
    be in another frame; the control points decide. In the adjustment tie points and
    measurements of control points count by the precision that their residuals show: taken for less, they
    let the block bend after the errors of its recorded positions. A free block bends, so that an error of
    decimetres shows only after it: where a point stands out, the adjustment is tried without it.

    Raises
    ------
    OrientationError
        If neither positions nor control points fix the block, or control points turn it upside down.
    """
    measured = by_point(site.observations)
    misread = misread_measurements(model, measured, observation_sd=options.observation_sd)
    measured = without_misread(measured, misread)
    use_control = options.georeference != "positions"
    control = [
        p for p in site.control if p.role == "control" and use_control and len(measured.get(p.name, [])) > 1
    ]
    placing = _place(model, site, offset, options, control, measured)
    control = [p for p in control if p.name not in placing.gross]
    visible, why = focal_length_is_visible(model, control)
    free = options.focal_length == "free" or (options.focal_length == "auto" and visible)
    site = without_shift(site, placing.shift)
    result = Georeference(
        site, offset, options, measured, tuple(control), placing, free, why, visible, misread
    )
    result.adjust(model)
    # Where a threshold is sought by the checkpoints, nothing below the mapping's limit is decided before.
    sds = None if options.optimise else options.outlier_sds
    for _ in range(_ROUNDS):
        drop_outliers(model, options.max_reprojection_error, sds)
        pointing = pointing_precision(result.residuals(model))
        result = replace(result, tie_point_sd=tie_point_precision(model), pointing_sd=pointing)
        result.adjust(model)
    return _without_gross_points(result, model)


def _place(
    model: pycolmap.Reconstruction,
    site: Site,
    offset: np.ndarray,
    options: OrientParameters,
    control: Sequence[ControlPoint],
    measured: Mapping[str, list[tuple[str, float, float]]],
) -> Placing:
    """Bring a model into the frame of the control points, and find out how recorded positions lie in it."""
    placed = sum(p.position is not None for p in site.photographs) >= _LEAST_PLACED
    alone = options.georeference == "control" or not placed
    several = len(control) >= _LEAST_CONTROL
    xy = np.array([(p.x, p.y) for p in control]).reshape(-1, 2)
    # A point with swapped axes or of another zone makes all others look like one place.
    in_line = several and on_a_line(xy[~far_from_rest(xy)])
    aligned = alone or (several and not in_line)
    gross: tuple[str, ...] = ()
    if aligned:
        gross = align_to_control(model, control, measured, offset)
        require_upright(model)
    if alone:
        return Placing(gross)
    control = [p for p in control if p.name not in gross]
    shift = shift_of_records(model, site, offset, options, control, measured, aligned=aligned)
    if not aligned:  # The model lies where it was recorded.
        model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), -shift))
    return Placing(gross, shift, in_line)


def _without_gross_points(fixed: Georeference, model: pycolmap.Reconstruction) -> Georeference:
    """Leave out, one by one, control points that fit badly and without which the others fit much better."""
    while fixed.control:
        name, misfit = fixed.worst_fitting(model)
        if misfit < _STANDS_OUT:
            break
        rest = tuple(point for point in fixed.control if point.name != name)
        without = replace(fixed, control=rest, left_out=(*fixed.left_out, name))
        if not _fits_without(without, model, misfit):
            return replace(fixed, doubtful=f"{name} by {misfit:.1f} standard deviations")
        without.adjust(model)
        fixed = without
    return fixed


def _fits_without(without: Georeference, model: pycolmap.Reconstruction, misfit: float) -> bool:
    """Whether the other points fit much better among themselves; three fit whatever they are."""
    if len(without.control) <= _LEAST_CONTROL:
        return False
    trial = pycolmap.Reconstruction(model)
    without.adjust(trial)
    return misfit >= _GROSS * without.worst_fitting(trial)[1]
