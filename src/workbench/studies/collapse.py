"""Our own finding: unmatched shares follow one variable, the disparity in pixels per metre of height.

A metre of height shifts a place by ``tan(angle) / GSD`` pixels between the photographs of a pair. On the
published Table 4.1 the logit of the unmatched share is nearly a straight line over its logarithm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from workbench.errors import StudyError

LEAST_R2 = 0.9
"""The shares collapse if the line explains so much of the logits; fixed before the studies ran."""
LARGEST_OFFSET = 0.5
"""And if no ground resolution lies farther from the line than this on average, in logits; fixed before."""


@dataclass(frozen=True, eq=False)
class Collapse:
    """A line through the logits of unmatched shares over the logarithm of disparity per metre."""

    slope: float
    """Logits per factor of e."""
    intercept: float
    """Logit at one pixel per metre."""
    r2: float
    """Share of the variance of the logits that the line explains, 0..1."""
    cells: pd.DataFrame
    """gsd_cm, angle, percent, pixels_per_metre, logit, residual (logit minus line)."""
    left_out: int
    """Cells without or with nothing but matches, whose logit is infinite."""

    @property
    def offsets(self) -> pd.Series:
        """Mean residual of each ground resolution, logits: where the collapse breaks."""
        return self.cells.groupby("gsd_cm")["residual"].mean()

    @property
    def holds(self) -> bool:
        """Whether the shares collapse, by :data:`LEAST_R2` and :data:`LARGEST_OFFSET`."""
        return self.r2 >= LEAST_R2 and float(self.offsets.abs().max()) <= LARGEST_OFFSET

    def percent(self, pixels_per_metre: float) -> float:
        """Unmatched share that the line expects, per cent."""
        return float(100 / (1 + np.exp(-self.intercept - self.slope * np.log(pixels_per_metre))))


def disparity_collapse(gsd_cm: np.ndarray, angle: np.ndarray, percent: np.ndarray) -> Collapse:
    """Fit unmatched shares over disparity per metre of height.

    Parameters
    ----------
    gsd_cm
        Ground resolution, cm.
    angle
        Intersection angle, degrees.
    percent
        Unmatched share, 0..100.

    Raises
    ------
    StudyError
        If fewer than three cells have a share between 0 and 100.
    """
    cells = pd.DataFrame({"gsd_cm": gsd_cm, "angle": angle, "percent": percent}).dropna()
    inside = (cells["percent"] > 0) & (cells["percent"] < 100)
    left_out, cells = int((~inside).sum()), cells[inside].reset_index(drop=True)
    if len(cells) < 3:
        raise StudyError(f"{len(cells)} cells with a share between 0 and 100 %: a line needs three.")
    cells["pixels_per_metre"] = np.tan(np.radians(cells["angle"])) / (cells["gsd_cm"] / 100)
    share = cells["percent"] / 100
    cells["logit"] = np.log(share / (1 - share))
    slope, intercept = np.polyfit(np.log(cells["pixels_per_metre"]), cells["logit"], 1)
    cells["residual"] = cells["logit"] - intercept - slope * np.log(cells["pixels_per_metre"])
    r2 = 1 - float(cells["residual"].var(ddof=0) / cells["logit"].var(ddof=0))
    return Collapse(float(slope), float(intercept), r2, cells, left_out)
