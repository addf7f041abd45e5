"""Crown polygons against reference crowns: overlap factor, IoU and the six topological cases."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from workbench.errors import AssessmentError

Case = Literal["equal", "inside", "contains", "overlaps", "touches", "disjoint"]
STRONG_OVERLAP = 0.5
"""A crown is right from an overlap factor above this [thesis 3.4.2, after Winter 1996]."""


@dataclass(frozen=True, eq=False)
class CrownComparison:
    """Extracted crowns and the reference crowns that they stand for."""

    pairs: pd.DataFrame
    """A row per pair: ``crown`` and ``reference`` (row numbers), ``overlap_factor``, ``iou``, ``case``
    (of the crown to the reference), ``right``."""
    crowns: int
    """Number of extracted crowns."""
    reference: int
    """Number of reference crowns."""

    @property
    def completeness(self) -> float:
        """Share of reference crowns with a right crown, 0..1; NaN without reference."""
        return float(self.pairs["right"].sum() / self.reference) if self.reference else float("nan")

    @property
    def correctness(self) -> float:
        """Share of extracted crowns that are right, 0..1; NaN without crowns."""
        return float(self.pairs["right"].sum() / self.crowns) if self.crowns else float("nan")

    @property
    def mean_iou(self) -> float:
        """Mean IoU of the pairs; NaN without pairs."""
        return float(self.pairs["iou"].mean())

    @property
    def scores(self) -> dict[str, object]:
        """Scores and number of pairs of each topological case, for a metrics file."""
        return {
            "completeness": self.completeness,
            "correctness": self.correctness,
            "mean_iou": self.mean_iou,
            "mean_overlap_factor": float(self.pairs["overlap_factor"].mean()),
            "cases": self.pairs["case"].value_counts().sort_index().to_dict(),
        }


def compare_crowns(crowns: gpd.GeoDataFrame, reference: gpd.GeoDataFrame) -> CrownComparison:
    """Pair crowns one to one so that the sum of their IoU is largest, and judge each pair.

    Parameters
    ----------
    crowns, reference
        Valid polygons in the same CRS, metres.

    Raises
    ------
    AssessmentError
        If a CRS is missing or differs, or a polygon is missing or invalid.
    """
    if crowns.crs is None or reference.crs is None or crowns.crs != reference.crs:
        raise AssessmentError(
            f"Crowns are in {crowns.crs}, reference crowns in {reference.crs}: bring both to one CRS."
        )
    ours, theirs = _polygons(crowns, "crowns"), _polygons(reference, "reference crowns")
    # Pairs that touch are looked at too: they are a case of their own.
    their, our = shapely.STRtree(ours).query(theirs, predicate="intersects")
    shared = shapely.area(shapely.intersection(ours[our], theirs[their]))
    a, b = shapely.area(ours[our]), shapely.area(theirs[their])
    iou = shared / (a + b - shared)
    chosen = _largest_sum(our, their, iou, len(ours))
    our, their, iou = our[chosen], their[chosen], iou[chosen]
    factor = shared[chosen] / np.minimum(a, b)[chosen]
    pairs = pd.DataFrame(
        {
            "crown": our,
            "reference": their,
            "overlap_factor": factor,
            "iou": iou,
            "case": [topological_case(ours[i], theirs[j]) for i, j in zip(our, their, strict=True)],
            "right": factor > STRONG_OVERLAP,
        }
    )
    return CrownComparison(pairs.sort_values("reference", ignore_index=True), len(ours), len(theirs))


def topological_case(crown: shapely.Geometry, reference: shapely.Geometry) -> Case:
    """Which of the six cases of the thesis [3.4.2, after Egenhofer 1993] two polygons are.

    A crown that covers its reference up to the border counts as ``contains``, one covered as ``inside``.
    """
    if shapely.equals(crown, reference):
        return "equal"
    if shapely.covered_by(crown, reference):
        return "inside"
    if shapely.covers(crown, reference):
        return "contains"
    if shapely.disjoint(crown, reference):
        return "disjoint"
    return "touches" if shapely.touches(crown, reference) else "overlaps"


def _polygons(frame: gpd.GeoDataFrame, name: str) -> np.ndarray:
    shapes = frame.geometry.to_numpy()
    bad = shapely.is_missing(shapes) | shapely.is_empty(shapes) | ~shapely.is_valid(shapes)
    if bad.any():
        raise AssessmentError(
            f"Rows {list(np.flatnonzero(bad))[:10]} of {name} are no valid polygons: repair with make_valid."
        )
    return shapes


def _largest_sum(our: np.ndarray, their: np.ndarray, gain: np.ndarray, ours: int) -> np.ndarray:
    """Places of a one-to-one choice with the largest sum; solved per group of linked polygons."""
    if len(our) == 0:
        return np.array([], dtype=np.int64)
    size = ours + int(their.max()) + 1
    links = coo_array((np.ones(len(our)), (our, ours + their)), shape=(size, size))
    group = np.unique(connected_components(links, directed=False)[1][our], return_inverse=True)[1]
    chosen = []
    for places in np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1]):
        rows, row = np.unique(our[places], return_inverse=True)
        columns, column = np.unique(their[places], return_inverse=True)
        value, which = np.zeros((len(rows), len(columns))), np.full((len(rows), len(columns)), -1)
        value[row, column], which[row, column] = gain[places], places
        assigned = which[linear_sum_assignment(value, maximize=True)]
        chosen.append(assigned[assigned >= 0])
    return np.concatenate(chosen)
