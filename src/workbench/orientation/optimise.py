"""Which tie points to keep: the reprojection-error threshold with the smallest checkpoint error."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pycolmap

from workbench.errors import OrientationError
from workbench.orientation.control import PointResidual, rms
from workbench.orientation.tie_points import tie_points
from workbench.params import OrientParameters

_DEFAULTS = OrientParameters()
_CONTINUE = 0.7  # About the square root of a half: two steps halve the threshold, as in the usual lists.
_WORSE = 2  # Thresholds in a row: one alone may be worse by chance.
_ROLES = ("control", "check", "verify")


@dataclass(frozen=True)
class Trial:
    """One threshold of the optimisation, after its adjustment."""

    threshold: float
    """Largest reprojection error of a tie point, px."""
    tie_points: int
    """How many are left."""
    residuals: tuple[PointResidual, ...]
    """Of all surveyed points."""

    @property
    def check_error(self) -> float:
        """Root mean square of the spatial residuals of the checkpoints, metres."""
        return _spatial(_of_role(self.residuals, "check"))


@dataclass(frozen=True, eq=False)
class Optimisation:
    """The chosen threshold, and what it is worth."""

    model: pycolmap.Reconstruction
    """The adjusted model at the chosen threshold."""
    trials: tuple[Trial, ...]
    """Thresholds in descending order, as far as no photograph was lost; stricter ones than asked for come
    last, where the strictest of those was the best."""
    best: int
    """Index of the chosen trial."""
    cross_validated_error: float
    """Root mean square of the checkpoints' spatial residuals, metres, each at the threshold that the other
    parts of them choose: what the optimised error would be without having been optimised."""
    stopped: str
    """Which photographs a stricter threshold would lose; empty if the search ended with a larger error."""

    @property
    def threshold(self) -> float:
        """Chosen threshold, px."""
        return self.trials[self.best].threshold

    @property
    def optimised_error(self) -> float:
        """Checkpoint error at the chosen threshold, metres; too good, as it was minimised."""
        return self.trials[self.best].check_error

    @property
    def verify_error(self) -> float | None:
        """The same of the points of role verify, which chose nothing, metres; None without any."""
        points = _of_role(self.trials[self.best].residuals, "verify")
        return _spatial(points) if points else None

    @property
    def is_interior(self) -> bool:
        """Whether looser and stricter thresholds are both worse, or stricter ones lose photographs."""
        last = len(self.trials) - 1
        return self.best > 0 and (self.best < last or bool(self.stopped))

    def table(self) -> pd.DataFrame:
        """One row a threshold: tie points left and errors by role, metres."""
        rows = []
        for k, trial in enumerate(self.trials):
            row: dict[str, object] = {
                "threshold_px": trial.threshold,
                "tie_points": trial.tie_points,
                "chosen": k == self.best,
            }
            rows.append(row | errors_by_role(trial.residuals))
        return pd.DataFrame(rows)


def optimise_tie_points(
    model: pycolmap.Reconstruction,
    adjust: Callable[[pycolmap.Reconstruction], None],
    measure: Callable[[pycolmap.Reconstruction], Sequence[PointResidual]],
    *,
    scales: Mapping[str, np.ndarray] | None = None,
    thresholds: Sequence[float] = _DEFAULTS.thresholds,
    max_reconstruction_uncertainty: float = _DEFAULTS.max_reconstruction_uncertainty,
    max_projection_accuracy: float = _DEFAULTS.max_projection_accuracy,
    least_tie_points: int = _DEFAULTS.least_tie_points,
    folds: int = _DEFAULTS.folds,
) -> Optimisation:
    """Filter tie points by ever stricter reprojection errors and keep the best [orthomosaic paper 2.4].

    First tie points of high reconstruction uncertainty go, then those of poor projection accuracy,
    then those beyond each threshold in turn, each followed by a bundle adjustment. After each
    threshold the checkpoints are measured. If the last two thresholds are not both worse than the best,
    the list was too short: the search goes on, each threshold 0.7 times the one before, until they are.
    It ends when a photograph would keep fewer than ``least_tie_points``.

    The smallest error of several is too good to report. The error without that gain comes from
    ``folds`` parts of the checkpoints (leave-one-out if there are fewer points): each is measured at
    the threshold that the others choose. As checkpoints never enter the adjustment, this needs none.

    Parameters
    ----------
    model
        Georeferenced; is not changed.
    adjust
        Adjusts a model in place, without checkpoints.
    measure
        Residuals of the surveyed points.
    scales
        Feature sizes, see :func:`workbench.orientation.tie_points.tie_points`.

    Raises
    ------
    OrientationError
        If there are fewer than two checkpoints, or the loosest threshold already loses a photograph.
    """
    if len(_of_role(measure(model), "check")) < 2:
        raise OrientationError(
            "Optimising tie points needs at least two points of role check that are measured in two "
            "registered photographs each. Change roles of control points, or set orient.optimise to false."
        )
    current = pycolmap.Reconstruction(model)
    stopped = ""
    for attribute, limit in (
        ("reconstruction_uncertainty", max_reconstruction_uncertainty),
        ("projection_accuracy", max_projection_accuracy),
    ):
        filtered, lost = filter_tie_points(current, attribute, limit, scales, least_tie_points)
        if not lost:  # A filter that costs photographs is worse than the points that it would remove.
            adjust(filtered)
            current = filtered
    trials: list[Trial] = []
    best = current
    pending = sorted(thresholds, reverse=True)
    while pending:
        threshold = pending.pop(0)
        filtered, lost = filter_tie_points(current, "reprojection_error", threshold, scales, least_tie_points)
        if lost:
            stopped = f"{threshold:g} px would lose {', '.join(lost)}"
            break
        adjust(filtered)
        current = filtered
        trials.append(Trial(threshold, current.num_points3D(), tuple(measure(current))))
        if trials[-1].check_error == min(trial.check_error for trial in trials):
            best = pycolmap.Reconstruction(current)
        if not pending and _is_open(trials):
            pending = [_stricter(threshold)]
    if not trials:
        raise OrientationError(f"Tie points cannot be optimised: {stopped}. Give larger orient.thresholds.")
    return Optimisation(best, tuple(trials), _best_of(trials), _cross_validate(trials, folds), stopped)


def filter_tie_points(
    model: pycolmap.Reconstruction,
    attribute: str,
    limit: float,
    scales: Mapping[str, np.ndarray] | None,
    least_tie_points: int,
) -> tuple[pycolmap.Reconstruction, list[str]]:
    """A copy without the tie points whose attribute exceeds a limit, and the photographs that it loses."""
    points = tie_points(model, dict(scales) if scales is not None else None)
    copy = pycolmap.Reconstruction(model)
    for number in points.numbers[getattr(points, attribute) > limit]:
        copy.delete_point3D(int(number))
    images = [copy.image(number) for number in copy.reg_image_ids()]
    return copy, sorted(image.name for image in images if image.num_points3D < least_tie_points)


def errors_by_role(residuals: Sequence[PointResidual]) -> dict[str, float | None]:
    """Horizontal and vertical root mean squares, metres, as ``<role>_xy_m`` and ``<role>_z_m``."""
    values: dict[str, float | None] = {}
    for role in _ROLES:
        values[f"{role}_xy_m"], values[f"{role}_z_m"] = rms(residuals, role)
    return values


def summarise_repetitions(table: pd.DataFrame) -> pd.DataFrame:
    """Mean and standard deviation over seeds [orthomosaic paper, Table 2].

    Parameters
    ----------
    table
        One row a seed, with the columns of :func:`errors_by_role`.

    Returns
    -------
    DataFrame
        One row, columns ``control_xy_mean_m``, ``control_xy_sd_m``, ``control_z_mean_m`` ... for each
        role that has points.

    Raises
    ------
    OrientationError
        With fewer than two repetitions.
    """
    if len(table) < 2:
        raise OrientationError("A standard deviation over seeds needs at least two repetitions.")
    row: dict[str, float] = {}
    for role in _ROLES:
        for axis in ("xy", "z"):
            values = table[f"{role}_{axis}_m"].astype(float)
            if values.notna().all():
                row[f"{role}_{axis}_mean_m"] = float(values.mean())
                row[f"{role}_{axis}_sd_m"] = float(values.std(ddof=1))
    return pd.DataFrame([row])


def _best_of(trials: Sequence[Trial]) -> int:
    return int(np.argmin([trial.check_error for trial in trials]))


def _is_open(trials: Sequence[Trial]) -> bool:
    """Whether stricter thresholds may be better: one of the last is as good as the best."""
    errors = [trial.check_error for trial in trials]
    return min(errors[-_WORSE:]) <= min(errors)


def _stricter(threshold: float) -> float:
    """The next threshold, with two digits; tie points run out long before it is zero."""
    return float(f"{_CONTINUE * threshold:.2g}")


def _cross_validate(trials: Sequence[Trial], folds: int) -> float:
    checks = np.array([[_squared(r) for r in _of_role(t.residuals, "check")] for t in trials])
    count = checks.shape[1]
    part = np.arange(count) % min(folds, count)
    held_out = np.empty(count)
    for fold in np.unique(part):
        choice = checks[:, part != fold].mean(axis=1).argmin()
        held_out[part == fold] = checks[choice, part == fold]
    return float(np.sqrt(held_out.mean()))


def _of_role(residuals: Sequence[PointResidual], role: str) -> list[PointResidual]:
    return [row for row in residuals if row.role == role]


def _squared(row: PointResidual) -> float:
    return row.dx**2 + row.dy**2 + row.dz**2


def _spatial(rows: Sequence[PointResidual]) -> float:
    return float(np.sqrt(np.mean([_squared(row) for row in rows])))
