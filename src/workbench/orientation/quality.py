"""What the residuals say of the shape of the block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import stats

from workbench.orientation.control import PointResidual
from workbench.site import ControlPoint

_LEAST_POINTS = 6
_LEAST_CHECKS = 3
_SIGNIFICANT = 0.01


def doming(rows: Sequence[PointResidual], points: Sequence[ControlPoint]) -> list[str]:
    """Test for a dome or bowl: vertical residuals that bend with the distance from the centre.

    Fits ``dz = a + b r^2`` to check points (all surveyed points where there are fewer than six) and
    tests b against zero; tests the mean of the check points, from three on, as well.

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
    found = _bend(chosen, places) if len(chosen) >= _LEAST_POINTS else []
    dz = np.array([row.dz for row in checks])
    if len(checks) >= _LEAST_CHECKS and stats.ttest_1samp(dz, 0.0).pvalue < _SIGNIFICANT:
        found.append(
            f"Check points lie {dz.mean():+.3f} m off in height on average: the vertical datum of recorded "
            "positions and control may differ."
        )
    return found


def _bend(rows: Sequence[PointResidual], places: Mapping[str, tuple[float, float]]) -> list[str]:
    xy = np.array([places[row.name] for row in rows])
    radius2 = np.sum((xy - xy.mean(axis=0)) ** 2, axis=1)
    fit = stats.linregress(radius2, [row.dz for row in rows])
    if fit.pvalue >= _SIGNIFICANT:
        return []
    return [
        f"Heights bend by {fit.slope * np.ptp(radius2):+.3f} m from the middle to the edge (doming): add "
        "control in the middle and at the edge, oblique photographs, or calibrate the camera."
    ]
