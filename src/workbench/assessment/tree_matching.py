"""Tree tops against reference trees: one to one within a distance; completeness and correctness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from workbench.errors import AssessmentError

Method = Literal["nearest", "optimal"]


@dataclass(frozen=True, eq=False)
class TreeMatch:
    """Which top is which reference tree, and the scores that follow [thesis 3.4.2]."""

    pairs: pd.DataFrame
    """A row per found tree: ``top`` and ``reference`` (row numbers of the inputs), ``distance_m``."""
    missed: np.ndarray
    """Row numbers of reference trees without a top (false negatives)."""
    false: np.ndarray
    """Row numbers of tops without a reference tree (false positives)."""
    outside: np.ndarray
    """Row numbers of reference trees outside the area, which are not counted."""
    duplicates: np.ndarray
    """Row numbers of reference trees at the place of an earlier one, which are not counted."""

    @property
    def completeness(self) -> float:
        """TP / (TP + FN), 0..1; NaN without reference trees."""
        return _share(len(self.pairs), len(self.missed))

    @property
    def correctness(self) -> float:
        """TP / (TP + FP), 0..1; NaN without tops."""
        return _share(len(self.pairs), len(self.false))

    @property
    def f1(self) -> float:
        """Harmonic mean of both: 2 TP / (2 TP + FN + FP); NaN without tops and trees."""
        return _share(2 * len(self.pairs), len(self.missed) + len(self.false))

    def intervals(self, level: float = 0.95, repetitions: int = 2000, seed: int = 0) -> pd.DataFrame:
        """Bootstrap intervals of the scores: found, missed and false trees are drawn anew with replacement.

        Trees are taken as independent; in clumped stands the true interval is somewhat wider.

        Parameters
        ----------
        level
            Confidence, 0..1.
        repetitions
            Number of drawn samples.
        seed
            Seed of the draws; the same seed gives the same interval.

        Returns
        -------
        DataFrame
            Columns score, value, low, high.
        """
        counts = np.array([len(self.pairs), len(self.missed), len(self.false)], dtype=float)
        values = {"completeness": self.completeness, "correctness": self.correctness, "f1": self.f1}
        if counts.sum() == 0:
            return pd.DataFrame([(n, v, np.nan, np.nan) for n, v in values.items()], columns=_COLUMNS)
        drawn = np.random.default_rng(seed).multinomial(
            int(counts.sum()), counts / counts.sum(), size=repetitions
        )
        found, missed, false = drawn.T.astype(float)
        with np.errstate(invalid="ignore"):
            samples = {
                "completeness": found / (found + missed),
                "correctness": found / (found + false),
                "f1": 2 * found / (2 * found + missed + false),
            }
        tail = (1 - level) / 2
        rows = []
        for name, value in values.items():
            defined = samples[name][np.isfinite(samples[name])]
            low, high = np.quantile(defined, [tail, 1 - tail]) if len(defined) else (np.nan, np.nan)
            rows.append((name, value, float(low), float(high)))
        return pd.DataFrame(rows, columns=_COLUMNS)

    @property
    def scores(self) -> dict[str, float | int]:
        """Counts and scores under their names, for a metrics file."""
        return {
            "found": len(self.pairs),
            "missed": len(self.missed),
            "false": len(self.false),
            "completeness": self.completeness,
            "correctness": self.correctness,
            "f1": self.f1,
        }

    def _repr_html_(self) -> str:
        return pd.DataFrame([self.scores]).to_html(index=False)


_COLUMNS = ["score", "value", "low", "high"]


def match_trees(
    tops: gpd.GeoDataFrame | np.ndarray,
    reference: gpd.GeoDataFrame | np.ndarray,
    max_distance: float,
    *,
    method: Method = "nearest",
    height_difference: float | None = None,
    area: Any | None = None,
) -> TreeMatch:
    """Match tops and reference trees one to one.

    Of several tops near one tree one is right and the rest are false [thesis 3.4.2].

    Parameters
    ----------
    tops, reference
        Points with a CRS in metres (and ``height_m`` where ``height_difference`` is used), or arrays
        of (n, 2) x and y, or (n, 3) with the height above ground.
    max_distance
        Largest horizontal distance of a pair, metres (``published/tree_match_distance.csv``).
    method
        ``nearest``: the closest pair of all first, then the closest of what is left, and so on, as an
        interpreter does; equal distances in the order of the rows. ``optimal``: as many pairs as
        possible, and of these the ones with the smallest sum of distances.
    height_difference
        Largest difference of heights of a pair, metres; None: heights are not compared.
    area
        Polygon, or GeoDataFrame of polygons, that the reference was surveyed in completely. Trees
        outside are not counted, tops outside are not false; a top outside may still be that of a tree
        inside, near the border.

    Raises
    ------
    AssessmentError
        If a table has no CRS, a geographic one, missing geometries or heights that are needed, or the
        distance is not positive.
    """
    if not max_distance > 0:
        raise AssessmentError(f"max_distance of {max_distance} m matches nothing: give a positive distance.")
    if method not in ("nearest", "optimal"):
        raise AssessmentError(f"Unknown method {method!r}: choose 'nearest' or 'optimal'.")
    if isinstance(tops, gpd.GeoDataFrame) and isinstance(reference, gpd.GeoDataFrame):
        reference = _same_crs(tops, reference)
    found, heights = _points(tops, "tops", height_difference is not None)
    trees, tree_heights = _points(reference, "reference", height_difference is not None)
    kept, outside, duplicates = _countable(trees, _polygon(area, tops))

    pair_top, pair_tree, distance = _candidates(found, trees[kept], max_distance)
    if height_difference is not None:
        near = np.abs(heights[pair_top] - tree_heights[kept][pair_tree]) <= height_difference
        pair_top, pair_tree, distance = pair_top[near], pair_tree[near], distance[near]
    choose = _nearest_first if method == "nearest" else _optimal
    chosen = choose(pair_top, pair_tree, distance)
    pairs = pd.DataFrame(
        {"top": pair_top[chosen], "reference": kept[pair_tree[chosen]], "distance_m": distance[chosen]}
    ).sort_values("reference", ignore_index=True)

    alone = np.setdiff1d(np.arange(len(found)), pairs["top"])
    polygon = _polygon(area, tops)
    if polygon is not None and len(alone):
        alone = alone[shapely.intersects_xy(polygon, *found[alone].T)]
    return TreeMatch(pairs, np.setdiff1d(kept, pairs["reference"]), alone, outside, duplicates)


def _same_crs(tops: gpd.GeoDataFrame, reference: gpd.GeoDataFrame) -> gpd.GeoDataFrame:
    for name, table in (("tops", tops), ("reference", reference)):
        if table.crs is None:
            raise AssessmentError(f"The table of {name} has no CRS: set it with .set_crs().")
    if tops.crs.is_geographic:
        raise AssessmentError(f"Distances need metres, but tops are in {tops.crs.name}: use .to_crs().")
    return reference if reference.crs == tops.crs else reference.to_crs(tops.crs)


def _points(table: gpd.GeoDataFrame | np.ndarray, name: str, with_height: bool) -> tuple:
    """(n, 2) x and y, and (n,) heights (NaN where they are not needed)."""
    if isinstance(table, gpd.GeoDataFrame):
        shapes = table.geometry.to_numpy()
        bad = shapely.is_missing(shapes) | shapely.is_empty(shapes)
        if bad.any():
            raise AssessmentError(f"Rows {list(np.flatnonzero(bad))[:10]} of {name} have no point.")
        shapes = np.where(shapely.get_type_id(shapes) == 0, shapes, shapely.centroid(shapes))
        places = shapely.get_coordinates(shapes)
        heights = table["height_m"].to_numpy(float) if "height_m" in table else None
    else:
        values = np.asarray(table, dtype=float)
        if values.size == 0:
            values = values.reshape(0, 3)
        if values.ndim != 2 or values.shape[1] not in (2, 3):
            raise AssessmentError(f"{name} of shape {values.shape}: give (n, 2) or (n, 3) coordinates.")
        if not np.all(np.isfinite(values[:, :2])):
            raise AssessmentError(f"{name} hold coordinates that are not finite: leave those rows out.")
        places, heights = values[:, :2], values[:, 2] if values.shape[1] == 3 else None
    if with_height and (heights is None or not np.all(np.isfinite(heights))):
        raise AssessmentError(f"{name} lack heights (height_m): give them, or no height_difference.")
    return places, heights


def _polygon(area: Any, tops: gpd.GeoDataFrame | np.ndarray) -> Any:
    if area is None:
        return None
    if isinstance(area, gpd.GeoDataFrame | gpd.GeoSeries):
        if isinstance(tops, gpd.GeoDataFrame) and area.crs is not None:
            area = area.to_crs(tops.crs)
        area = area.union_all()
    shapely.prepare(area)
    return area


def _countable(trees: np.ndarray, polygon: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row numbers of trees that count, of those outside, and of repetitions of an earlier place."""
    rows = np.arange(len(trees))
    inside = np.ones(len(trees), bool)
    if polygon is not None and len(trees):
        inside = shapely.intersects_xy(polygon, *trees.T)
    repeated = pd.DataFrame(trees).duplicated().to_numpy(bool)
    return rows[inside & ~repeated], rows[~inside], rows[inside & repeated]


def _candidates(found: np.ndarray, trees: np.ndarray, reach: float) -> tuple:
    """Row numbers of tops and trees within reach of each other, and their distances."""
    none = np.array([], dtype=np.int64)
    if len(found) == 0 or len(trees) == 0:
        return none, none, np.array([])
    # The tree search is generous by a rounding error; the distance itself decides.
    near = cKDTree(trees).sparse_distance_matrix(cKDTree(found), reach * (1 + 1e-9), output_type="coo_matrix")
    tree, top = near.row.astype(np.int64), near.col.astype(np.int64)
    distance = np.hypot(*(found[top] - trees[tree]).T)
    keep = distance <= reach
    order = np.lexsort((top[keep], tree[keep]))
    return top[keep][order], tree[keep][order], distance[keep][order]


def _nearest_first(top: np.ndarray, tree: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Places of the chosen pairs: closest first; each top and each tree once."""
    chosen, taken_tops, taken_trees = [], set(), set()
    for place in np.lexsort((top, tree, distance)):
        if top[place] not in taken_tops and tree[place] not in taken_trees:
            taken_tops.add(top[place])
            taken_trees.add(tree[place])
            chosen.append(place)
    return np.array(chosen, dtype=np.int64)


def _optimal(top: np.ndarray, tree: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Places of the chosen pairs: most pairs, then least sum of distances.

    Solved for each group of tops and trees that are linked, so that cost grows with the number of
    groups and not with the square of the number of trees.
    """
    if len(top) == 0:
        return np.array([], dtype=np.int64)
    tops, top_node = np.unique(top, return_inverse=True)
    trees, tree_node = np.unique(tree, return_inverse=True)
    size = len(tops) + len(trees)
    links = coo_array((np.ones(len(top)), (top_node, len(tops) + tree_node)), shape=(size, size))
    group = connected_components(links, directed=False)[1][top_node]
    chosen = []
    for places in np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1]):
        rows, row = np.unique(top[places], return_inverse=True)
        columns, column = np.unique(tree[places], return_inverse=True)
        # Dearer than all distances together: no pair is given up to shorten the others.
        cost = np.full((len(rows), len(columns)), distance[places].sum() + 1.0)
        which = np.full(cost.shape, -1)
        cost[row, column], which[row, column] = distance[places], places
        assigned = which[linear_sum_assignment(cost)]
        chosen.append(assigned[assigned >= 0])
    return np.concatenate(chosen)


def _share(part: int, rest: int) -> float:
    return part / (part + rest) if part + rest else float("nan")
