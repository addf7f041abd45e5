"""OpenCV's StereoSGBM behind the interface of our own matcher, for comparison."""

from __future__ import annotations

import cv2
import numpy as np

from workbench.matching.pair import Pair
from workbench.params.match import SgmParameters

_STEPS = 16  # StereoSGBM counts sixteenths of a pixel.
_BLOCK = 5
_MODES = {
    "hh": cv2.STEREO_SGBM_MODE_HH,
    "hh4": cv2.STEREO_SGBM_MODE_HH4,
    "sgbm": cv2.STEREO_SGBM_MODE_SGBM,
    "3way": cv2.STEREO_SGBM_MODE_SGBM_3WAY,
}


def match_with_opencv(
    pair: Pair, first: int, last: int, parameters: SgmParameters, *, mode: str = "hh"
) -> np.ndarray:
    """Disparities (rows, columns) float32, NaN where OpenCV finds none.

    StereoSGBM never computes as many columns as there are disparities, so both sides are padded.

    Parameters
    ----------
    pair
        Images.
    first, last
        Limits of the disparity, px, both included.
    parameters
        Segment size and consistency are taken from here; penalties are those of OpenCV's samples.
    mode
        ``hh`` (8 paths), ``hh4``, ``sgbm`` (5 paths) or ``3way``.
    """
    count = -(-(last - first + 1) // 16) * 16
    before, after = max(last, 0) + count, max(-first, 0) + count
    padding = (0, 0, before, after)
    left, right = (
        cv2.copyMakeBorder(np.rint(image).astype(np.uint8), *padding, cv2.BORDER_REPLICATE)
        for image in (pair.left, pair.right)
    )
    matcher = cv2.StereoSGBM.create(
        minDisparity=first,
        numDisparities=count,
        blockSize=_BLOCK,
        P1=8 * _BLOCK**2,
        P2=32 * _BLOCK**2,
        disp12MaxDiff=int(parameters.max_inconsistency),
        uniquenessRatio=5,
        speckleWindowSize=parameters.min_segment,
        speckleRange=max(round(parameters.segment_step), 1),
        mode=_MODES[mode],
    )
    found = matcher.compute(left, right)[:, before : before + pair.shape[1]]
    disparity = found.astype(np.float32) / _STEPS
    return np.where((found < first * _STEPS) | (disparity > last), np.float32(np.nan), disparity)
