"""What the residuals say of the shape of the block: dome, tilt, scale, datum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from workbench.orientation.control import PointResidual
from workbench.site import ControlPoint

_LEAST_POINTS = 6
_LEAST_CHECKS = 3
_SIGNIFICANT = 0.01
_NEGLIGIBLE = 1e-12  # Metres squared: residuals without any error leave nothing to test with.


@dataclass(frozen=True)
class Deformation:
    """How residuals of surveyed points change over the block; each value with the chance of being none."""

    points: int
    """Points that were used: the check points, or all surveyed ones where those are fewer than six."""
    doming_m: float
    """Bend of the heights from the middle to the outermost point, metres."""
    doming_p: float
    """Probability of such a bend by chance."""
    tilt_mrad: float
    """Slope of the residuals in height, thousandths."""
    tilt_azimuth: float
    """Where it rises to, degrees clockwise from north."""
    tilt_m: float
    """Difference in height that it makes over the points, metres."""
    tilt_p: float
    """Probability of such a tilt by chance."""
    scale_ppm: float
    """By how much distances in the block are too long, parts in a million."""
    scale_m: float
    """Error of the outermost point that it makes, metres."""
    scale_p: float
    """Probability of such a scale by chance."""

    def values(self) -> dict[str, float]:
        """Sizes for the metrics."""
        return {
            "doming_m": round(self.doming_m, 5),
            "tilt_mrad": round(self.tilt_mrad, 5),
            "scale_ppm": round(self.scale_ppm, 2),
        }

    def warnings(self, sd_xy: float, sd_z: float) -> list[str]:
        """What is neither chance nor below the precision of the survey (metres), with size and remedy."""
        found = []
        if self.doming_p < _SIGNIFICANT:
            found.append(
                f"Heights bend by {self.doming_m:+.3f} m from the middle to the edge (doming): add control "
                "in the middle and at the edge, oblique photographs, or calibrate the camera."
            )
        if self.tilt_p < _SIGNIFICANT and self.tilt_m > sd_z:
            found.append(
                f"Heights tilt by {self.tilt_m:.3f} m over the surveyed points ({self.tilt_mrad:.2f} mrad, "
                f"rising to {self.tilt_azimuth:.0f} degrees): add control on both sides."
            )
        if self.scale_p < _SIGNIFICANT and self.scale_m > sd_xy:
            size = "long" if self.scale_ppm > 0 else "short"
            found.append(
                f"Distances are {abs(self.scale_ppm):.0f} parts in a million too {size} "
                f"({self.scale_m:.3f} m at the edge): add control there, look at the CRS of both."
            )
        return found


def deformation(rows: Sequence[PointResidual], points: Sequence[ControlPoint]) -> Deformation | None:
    """Test residuals for a dome or bowl, a tilt, and a scale.

    Least squares over the check points (all surveyed points where there are fewer than six):
    ``dz = a + b r^2`` with the distance r from the middle, tested by t; ``dz = a + b x + c y``, tested by F;
    ``(dx, dy) = t + s (x, y) + w (-y, x)``, s tested by t.

    Parameters
    ----------
    rows
        Residuals of the surveyed points.
    points
        Their places.

    Returns
    -------
    Deformation or None
        None with fewer than six points.
    """
    places = {point.name: (point.x, point.y) for point in points}
    usable = [row for row in rows if row.role != "unused" and np.isfinite(row.dz)]
    checks = [row for row in usable if row.role != "control"]
    chosen = checks if len(checks) >= _LEAST_POINTS else usable
    if len(chosen) < _LEAST_POINTS:
        return None
    xy = np.array([places[row.name] for row in chosen])
    xy -= xy.mean(axis=0)
    dx, dy, dz = np.array([(row.dx, row.dy, row.dz) for row in chosen]).T
    radius2 = np.sum(xy**2, axis=1)
    bend = stats.linregress(radius2, dz)
    slope, tilt_p = _plane(xy, dz)
    scale, scale_p = _scale(xy, np.stack([dx, dy], axis=1))
    steepest = np.hypot(*slope)
    return Deformation(
        points=len(chosen),
        doming_m=float(bend.slope * np.ptp(radius2)),
        doming_p=float(bend.pvalue),
        tilt_mrad=float(1000 * steepest),
        tilt_azimuth=float(np.degrees(np.arctan2(slope[0], slope[1])) % 360),
        tilt_m=float(np.ptp(xy @ slope)),
        tilt_p=tilt_p,
        scale_ppm=1e6 * scale,
        scale_m=abs(scale) * float(np.sqrt(radius2.max())),
        scale_p=scale_p,
    )


def shape_warnings(rows: Sequence[PointResidual], points: Sequence[ControlPoint]) -> list[str]:
    """Warnings of :func:`deformation`, and of check points that lie too high or too low on average."""
    found = deformation(rows, points)
    warnings = []
    if found is not None:
        warnings = found.warnings(*np.median([(point.sd_xy, point.sd_z) for point in points], axis=0))
    dz = np.array([row.dz for row in rows if row.role in ("check", "verify") and np.isfinite(row.dz)])
    if len(dz) >= _LEAST_CHECKS and stats.ttest_1samp(dz, 0.0).pvalue < _SIGNIFICANT:
        warnings.append(
            f"Check points lie {dz.mean():+.3f} m off in height on average: the vertical datum of recorded "
            "positions and control may differ."
        )
    return warnings


def _plane(xy: np.ndarray, dz: np.ndarray) -> tuple[np.ndarray, float]:
    """Slope (2,) of a plane through residuals, and the probability of it by chance."""
    design = np.column_stack([np.ones(len(xy)), xy])
    fitted = np.linalg.lstsq(design, dz, rcond=None)[0]
    left = float(np.sum((dz - design @ fitted) ** 2))
    explained = float(np.sum((dz - dz.mean()) ** 2)) - left
    spare = len(xy) - design.shape[1]
    ratio = (explained / 2) / max(left / spare, _NEGLIGIBLE)
    return fitted[1:], float(stats.f.sf(ratio, 2, spare))


def _scale(xy: np.ndarray, residuals: np.ndarray) -> tuple[float, float]:
    """Scale of a similarity through horizontal residuals, and the probability of it by chance."""
    around = np.column_stack([-xy[:, 1], xy[:, 0]])
    centred = residuals - residuals.mean(axis=0)
    size = float(np.sum(xy**2))
    scale, turn = float(np.sum(xy * centred)) / size, float(np.sum(around * centred)) / size
    left = float(np.sum((centred - scale * xy - turn * around) ** 2))
    spare = 2 * len(xy) - 4
    deviation = np.sqrt(max(left / spare, _NEGLIGIBLE) / size)
    return scale, float(2 * stats.t.sf(abs(scale) / deviation, spare))
