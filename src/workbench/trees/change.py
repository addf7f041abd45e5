"""Two dates of the same trees: appeared, gone, grown; with the shift between the dates taken out."""

from __future__ import annotations

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
from scipy.spatial import cKDTree

from workbench.assessment.tree_matching import match_trees
from workbench.errors import TreesError

_VOTE_CELL = 0.5
_ROUNDS = 20
_SETTLED = 1e-4
_FEWEST = 3


@dataclass(frozen=True, eq=False)
class TreeChange:
    """What became of every tree between two dates."""

    trees: gpd.GeoDataFrame
    """A row a tree at its place on the later date (gone ones at their shifted place): ``change``
    (kept, appeared, gone), ``before_id``, ``after_id`` (0 none), ``height_before_m``, ``height_after_m``,
    ``growth_m`` (NaN unless kept; the shift in height is taken out)."""
    shift: tuple[float, float]
    """East and north by which the later date lies beside the earlier one, metres."""
    height_shift: float
    """Height that was taken from every growth, metres; 0 unless it was asked for."""

    @property
    def counts(self) -> dict[str, int]:
        """Number of trees kept, appeared, gone."""
        found = self.trees["change"].value_counts()
        return {name: int(found.get(name, 0)) for name in ("kept", "appeared", "gone")}

    def _repr_html_(self) -> str:
        east, north = self.shift
        return f"<p>{self.counts}, shift {east:+.2f} m east, {north:+.2f} m north</p>"


def compare_trees(
    before: gpd.GeoDataFrame,
    after: gpd.GeoDataFrame,
    max_distance: float,
    *,
    max_shift: float = 10.0,
    height_shift: float = 0.0,
) -> TreeChange:
    """Compare the tops of two dates.

    The shift is found in two steps: the displacement that most pairs of tops agree on, in cells of
    half a metre, then the mean displacement of the pairs matched with it, repeated until it rests. So it
    holds as long as most trees stay; few trees or a regular plantation may mislead it.

    Parameters
    ----------
    before, after
        Tops with ``tree_id`` and ``height_m`` in one CRS.
    max_distance
        Largest distance of the same tree on both dates once the shift is out, metres.
    max_shift
        Largest shift that is looked for, metres; 0: none is taken out.
    height_shift
        Known difference of the height datums (later minus earlier), metres, taken from the growth.

    Raises
    ------
    TreesError
        If the CRS differ, or a distance is out of range.
    """
    if before.crs is None or before.crs != after.crs:
        raise TreesError(f"The dates are in {before.crs} and {after.crs}: bring both to one CRS.")
    if not max_distance > 0 or max_shift < 0:
        raise TreesError(f"Distances of {max_distance} and {max_shift} m: give positive ones.")
    shift = np.zeros(2)
    if max_shift > 0 and min(len(before), len(after)) >= _FEWEST:
        shift = _common_shift(_places(before), _places(after), max_distance, max_shift)
    moved = before.set_geometry(before.geometry.translate(*shift))
    pairs = match_trees(after, moved, max_distance).pairs
    top, old = pairs["top"].to_numpy(int), pairs["reference"].to_numpy(int)
    gone = np.setdiff1d(np.arange(len(before)), old)
    appeared = np.setdiff1d(np.arange(len(after)), top)
    first, second = before["height_m"].to_numpy(float), after["height_m"].to_numpy(float)
    ids, later_ids = before["tree_id"].to_numpy(), after["tree_id"].to_numpy()
    nothing, none = np.full(len(gone), np.nan), np.full(len(appeared), np.nan)
    columns = {
        "change": ["kept"] * len(top) + ["appeared"] * len(appeared) + ["gone"] * len(gone),
        "before_id": np.r_[ids[old], np.zeros(len(appeared), int), ids[gone]].astype(int),
        "after_id": np.r_[later_ids[top], later_ids[appeared], np.zeros(len(gone), int)].astype(int),
        "height_before_m": np.r_[first[old], none, first[gone]],
        "height_after_m": np.r_[second[top], second[appeared], nothing],
        "growth_m": np.r_[second[top] - first[old] - height_shift, none, nothing],
    }
    places = np.r_[
        after.geometry.to_numpy()[top], after.geometry.to_numpy()[appeared], moved.geometry.to_numpy()[gone]
    ]
    trees = gpd.GeoDataFrame(columns, geometry=places, crs=after.crs)
    return TreeChange(trees, (float(shift[0]), float(shift[1])), height_shift)


def _places(tops: gpd.GeoDataFrame) -> np.ndarray:
    return np.stack([tops.geometry.x.to_numpy(), tops.geometry.y.to_numpy()], axis=1)


def _common_shift(before: np.ndarray, after: np.ndarray, reach: float, most: float) -> np.ndarray:
    near = cKDTree(before).query_ball_tree(cKDTree(after), most)
    old = np.repeat(np.arange(len(before)), [len(found) for found in near])
    if not len(old):
        return np.zeros(2)
    moves = after[np.concatenate([np.asarray(found, int) for found in near])] - before[old]
    cells, votes = np.unique(np.round(moves / _VOTE_CELL).astype(int), axis=0, return_counts=True)
    # Neighbouring cells vote too, so that a shift on a cell's border loses nothing.
    together = [votes[np.abs(cells - cell).max(axis=1) <= 1].sum() for cell in cells]
    shift = cells[int(np.argmax(together))] * _VOTE_CELL
    for _ in range(_ROUNDS):
        distance, nearest = cKDTree(after).query(before + shift, distance_upper_bound=reach)
        found = np.isfinite(distance)
        if not found.any():
            break
        better = np.median(after[nearest[found]] - before[found], axis=0)
        if np.hypot(*(better - shift)) < _SETTLED:
            return better
        shift = better
    return shift
