"""Disparities of one rectified pair."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import cv2
import numpy as np
import xarray as xr

from workbench.errors import MatchingError
from workbench.matching.aggregate import AMBIGUOUS, MEASURED, NODATA, SPECK
from workbench.matching.mutual import mutual_information_costs
from workbench.matching.opencv import match_with_opencv
from workbench.matching.pair import Pair, check_range, prepare_pair
from workbench.matching.rectified import vertical_offset
from workbench.matching.refine import refine, smooth_disparity
from workbench.matching.segments import small_segments
from workbench.matching.sgm import cut_strips, match_strips, run_parallel
from workbench.params.match import SgmParameters

_DEFAULTS = SgmParameters()
_FLAGS = "measured nodata outside_right_image at_limit_of_guide ambiguous inconsistent small_segment"
_HALF_UNIQUE = 0.05  # Uniqueness, curvature and correlation that count as half certain.
_HALF_CURVED = 2.0
_ROUNDS = 2  # Of mutual information, after which its costs hardly change.
_LARGEST_STEP = 1.0  # Refinement may correct the winner by a pixel, not choose another one.


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
    """Match a rectified pair [Hirschmüller 2005, 2008].

    Parameters
    ----------
    left, right
        Images (rows, columns) or (rows, columns, 3), any number type, NaN = nodata. A point lies in
        the same row of both.
    disparity_range
        Smallest and largest disparity, px: column in the left image minus column in the right one.
    guide
        Expected disparity of every left pixel (rows, columns), px, NaN where unknown. Limits the
        search, and the work, to its surroundings; where it is unknown, that of the nearest known
        pixel is taken.
    guide_radius
        How far below and above the guide to search, px; one number or (below, above).
    parameters
        Cost, paths, penalties and thresholds.
    engine
        ``sgm`` (own) or ``opencv`` (StereoSGBM, MODE_HH); that of the parameters by default.
    check_rectified
        Refuse a pair whose rows do not correspond.
    threads
        Strips of rows at a time; the result does not depend on it.

    Returns
    -------
    Dataset
        Over ``row`` and ``column`` of the left image: ``disparity`` (float32, px, NaN where there is
        none), ``valid`` (bool), ``confidence`` (float32, 0..1, 0 where invalid), ``uniqueness``
        (float32, advantage of the winner's sum as a fraction), ``curvature`` (float32, second
        difference of the sums, bits per path), ``correlation`` (float32, of the images around the
        pixel at its disparity) and ``flag`` (uint8: measured, or why not; see ``flag_meanings``).
        OpenCV tells no more than valid or not.

    Raises
    ------
    MatchingError
        If sizes differ, an image is constant or all nodata, the disparity range is empty, the guide
        does not fit, or the rows of the pair are shifted against each other.
    """
    pair = prepare_pair(left, right)
    first, last = check_range(disparity_range, pair.shape[1])
    search = _search(guide, guide_radius, first, last, pair.shape)
    if check_rectified:
        _require_rectified(pair, first, last, parameters.max_vertical_offset)
    name = engine or parameters.engine
    if name == "sgm":
        return _match(pair, search, parameters, threads)
    if name == "opencv":
        return _match_with_opencv(pair, first, last, search, parameters)
    raise MatchingError(f"Unknown engine {name!r}: choose 'sgm' or 'opencv'.")


@dataclass(frozen=True, eq=False)
class _Search:
    """Disparities to try."""

    top: np.ndarray
    """Largest of each pixel, int32 (rows, columns)."""
    width: int
    """How many, downward from the top."""
    narrowed: bool
    """Whether this is less than the whole range."""


def _search(
    guide: np.ndarray | None,
    radius: float | tuple[float, float],
    first: int,
    last: int,
    shape: tuple[int, int],
) -> _Search:
    below, above = (radius, radius) if isinstance(radius, int | float) else radius
    if not (below >= 0 and above >= 0 and below + above > 0):
        raise MatchingError(f"A guide radius of {below}, {above} px leaves nothing to search.")
    whole = _Search(np.full(shape, last, np.int32), last - first + 1, False)
    if guide is None:
        return whole
    guide = np.asarray(guide, dtype=np.float32)
    if guide.shape != shape:
        raise MatchingError(f"The guide has shape {guide.shape}, the images {shape}: resample it.")
    known = np.isfinite(guide)
    if not known.any():
        raise MatchingError("The guide knows no disparity at all: match without it.")
    width = int(np.ceil(below) + np.ceil(above)) + 1
    if width >= whole.width:
        return whole
    if not known.all():
        _, nearest = cv2.distanceTransformWithLabels(
            (~known).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
        )
        # Every known pixel has its own label, in the order of rows.
        guide = guide[known][nearest - 1]
    top = np.clip(np.rint(guide) + np.ceil(above), first + width - 1, last)
    return _Search(top.astype(np.int32), width, True)


def _require_rectified(pair: Pair, first: int, last: int, most: float) -> None:
    offset = vertical_offset(pair, first, last)
    if not offset.proven:
        return
    told = (
        f"corresponding points lie {offset.median:+.1f} px lower in the right image (median of "
        f"{offset.points} points; typically {offset.typical:.1f} px off)"
    )
    if offset.typical > most:
        raise MatchingError(f"The pair is not rectified: {told}. Rectify it, or shift one image.")
    if offset.typical > most / 2:
        warnings.warn(f"The pair is poorly rectified: {told}.", stacklevel=3)


def _match(pair: Pair, search: _Search, parameters: SgmParameters, threads: int) -> xr.Dataset:
    table = None
    if parameters.cost == "mutual_information":
        table = _mutual_information(pair, search, parameters, threads)
    winners = match_strips(pair, search.top, search.width, search.narrowed, parameters, threads, table)
    disparity, flag = winners.disparity, winners.flag
    trusted = flag == MEASURED
    if parameters.min_segment > 1:
        small = small_segments(disparity, trusted, parameters.min_segment, parameters.segment_step)
        flag[small] = SPECK
        trusted &= ~small
    correlation = np.zeros_like(disparity)
    smooth = smooth_disparity(disparity, trusted)
    refined = np.empty_like(disparity)

    def refine_rows(rows: slice) -> None:
        refine(pair.left, pair.right, smooth, trusted, rows, refined, correlation)

    run_parallel(refine_rows, cut_strips(pair.shape[0], 1, 1, parameters.memory), threads)
    # Where the images have nothing in common at the match (no texture at all), paths only carried on
    # what lies beside: that is interpolation, not measurement.
    alike = correlation > 0
    flag[trusted & ~alike] = AMBIGUOUS
    trusted &= alike
    if parameters.subpixel:
        good = np.abs(refined - disparity) <= _LARGEST_STEP
        disparity = np.where(good, refined, smooth)
    disparity[~trusted] = np.nan
    return _dataset(
        disparity,
        flag,
        confidence=_confidence(winners.uniqueness, winners.curvature, correlation) * trusted,
        uniqueness=winners.uniqueness,
        curvature=winners.curvature,
        correlation=correlation,
    )


def _mutual_information(pair: Pair, search: _Search, parameters: SgmParameters, threads: int) -> np.ndarray:
    """Cost of each pair of grey values, from disparities that begin with a census and get better."""
    first = parameters.model_copy(update={"cost": "census9x7"})
    left, right = (np.rint(image).astype(np.uint8) for image in (pair.left, pair.right))

    def better(table: np.ndarray | None) -> np.ndarray:
        winners = match_strips(pair, search.top, search.width, search.narrowed, first, threads, table)
        found = np.where(winners.flag == MEASURED, winners.disparity, np.nan)
        return mutual_information_costs(left, right, found)

    table = better(None)
    for _ in range(1, _ROUNDS):
        table = better(table)
    return table


def _confidence(uniqueness: np.ndarray, curvature: np.ndarray, correlation: np.ndarray) -> np.ndarray:
    """Geometric mean of three signs of a good match, each 0..1."""
    unique = uniqueness / (uniqueness + np.float32(_HALF_UNIQUE))
    curved = np.maximum(curvature, 0) / (np.maximum(curvature, 0) + np.float32(_HALF_CURVED))
    return np.cbrt(unique * curved * np.clip(correlation, 0, 1))


def _match_with_opencv(
    pair: Pair, first: int, last: int, search: _Search, parameters: SgmParameters
) -> xr.Dataset:
    disparity = match_with_opencv(pair, first, last, parameters)
    disparity[(disparity > search.top) | (disparity <= search.top - search.width)] = np.nan
    disparity[~pair.left_known] = np.nan
    valid = np.isfinite(disparity)
    flag = np.where(valid, MEASURED, np.where(pair.left_known, AMBIGUOUS, NODATA)).astype(np.uint8)
    return _dataset(disparity, flag, confidence=valid.astype(np.float32))


def _dataset(disparity: np.ndarray, flag: np.ndarray, **measures: np.ndarray) -> xr.Dataset:
    dims = ("row", "column")
    meanings = {"flag_values": list(range(7)), "flag_meanings": _FLAGS}
    variables = {
        "disparity": (dims, disparity, {"units": "px", "long_name": "left column minus right column"}),
        "valid": (dims, flag == MEASURED),
        "flag": (dims, flag, meanings),
    }
    for name, values in measures.items():
        variables[name] = (dims, values.astype(np.float32, copy=False), {"units": "1"})
    return xr.Dataset(variables)
