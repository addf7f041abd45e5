"""Disparities of one rectified pair."""

from __future__ import annotations

import numpy as np
import xarray as xr

from workbench.errors import MatchingError
from workbench.matching.opencv import match_with_opencv
from workbench.matching.pair import Pair, check_range, prepare_pair
from workbench.params.match import SgmParameters

_DEFAULTS = SgmParameters()


def match_pair(
    left: np.ndarray,
    right: np.ndarray,
    disparity_range: tuple[float, float],
    *,
    guide: np.ndarray | None = None,
    guide_radius: float | tuple[float, float] = 16.0,
    parameters: SgmParameters = _DEFAULTS,
    engine: str | None = None,
    check_rectified: bool = True,
    threads: int = 2,
) -> xr.Dataset:
    """Match a rectified pair.

    Parameters
    ----------
    left, right
        Images (rows, columns) or (rows, columns, 3), any number type, NaN = nodata. A point lies in
        the same row of both.
    disparity_range
        Smallest and largest disparity, px: column in the left image minus column in the right one.
    guide
        Expected disparity of every left pixel (rows, columns), px, NaN where unknown. Limits the
        search to its surroundings; where it is unknown, that of the nearest known pixel is taken.
    guide_radius
        How far below and above the guide to search, px; one number or (below, above).
    parameters
        Costs, penalties and thresholds.
    engine
        ``sgm`` or ``opencv``; that of the parameters by default.
    check_rectified
        Refuse a pair whose rows do not correspond.
    threads
        The result does not depend on it.

    Returns
    -------
    Dataset
        Over ``row`` and ``column`` of the left image: ``disparity`` (float32, px, NaN where there is
        none), ``valid`` (bool) and ``confidence`` (float32, 0..1).

    Raises
    ------
    MatchingError
        If the images cannot be matched, the disparity range is empty, or the pair is not rectified.
    """
    pair = prepare_pair(left, right)
    first, last = check_range(disparity_range, pair.shape[1])
    name = engine or parameters.engine
    if name not in ("sgm", "opencv"):
        raise MatchingError(f"Unknown engine {name!r}: choose 'sgm' or 'opencv'.")
    disparity = match_with_opencv(pair, first, last, parameters)
    disparity[~pair.left_known] = np.nan
    if guide is not None:
        below, above = _radius(guide, guide_radius, pair)
        disparity[(disparity < guide - below) | (disparity > guide + above)] = np.nan
    valid = np.isfinite(disparity)
    return xr.Dataset(
        {
            "disparity": (("row", "column"), disparity, {"units": "px"}),
            "valid": (("row", "column"), valid),
            "confidence": (("row", "column"), valid.astype(np.float32), {"units": "1"}),
        }
    )


def _radius(guide: np.ndarray, radius: float | tuple[float, float], pair: Pair) -> tuple[float, float]:
    below, above = (radius, radius) if isinstance(radius, int | float) else radius
    if guide.shape != pair.shape:
        raise MatchingError(f"The guide has shape {guide.shape}, the images {pair.shape}: resample it.")
    if not min(below, above) > 0:
        raise MatchingError(f"A guide radius of {below}, {above} px leaves nothing to search.")
    return below, above
