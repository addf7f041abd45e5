"""What the residuals say of the shape of the block."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from workbench.orientation.control import PointResidual
from workbench.site import ControlPoint

_LEAST_POINTS = 6
_SIGNIFICANT = 0.01


def doming(rows: Sequence[PointResidual], points: Sequence[ControlPoint]) -> list[str]:
    """Test for a dome or bowl: vertical residuals that bend with the distance from the centre.

    Fits ``dz = a + b r^2`` to check points (all surveyed points where there are fewer than six) and
    tests b and a against zero.

    Parameters
    ----------
    rows
        Residuals of the surveyed points.
    points
        Their places.

    Returns
    -------
    list of str
        Warnings, each with its size and remedy; empty without any.
    """
    places = {point.name: (point.x, point.y) for point in points}
    usable = [row for row in rows if row.role != "unused" and np.isfinite(row.dz)]
    checks = [row for row in usable if row.role != "control"]
    chosen = checks if len(checks) >= _LEAST_POINTS else usable
    if len(chosen) < _LEAST_POINTS:
        return []
    xy = np.array([places[row.name] for row in chosen])
    radius2 = np.sum((xy - xy.mean(axis=0)) ** 2, axis=1)
    dz = np.array([row.dz for row in chosen])
    warnings = []
    fit = stats.linregress(radius2, dz)
    if fit.pvalue < _SIGNIFICANT:
        warnings.append(
            f"Heights bend by {fit.slope * np.ptp(radius2):+.3f} m from the middle to the edge (doming): add "
            "control in the middle and at the edge, oblique photographs, or calibrate the camera."
        )
    if checks and stats.ttest_1samp(dz, 0.0).pvalue < _SIGNIFICANT:
        warnings.append(
            f"Check points lie {dz.mean():+.3f} m off in height on average: the vertical datum of recorded "
            "positions and control may differ."
        )
    return warnings
