"""Specks: connected patches of a surface that are too small to be trusted, found tile by tile."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from workbench.rasters import Tile, tiles


def remove_specks(
    height: np.ndarray,
    least_cells: float,
    step: float,
    *,
    agreed: np.ndarray | None = None,
    least_alone: float = 0.0,
    tile_size: int = 4096,
) -> None:
    """Empty, in place, connected patches of fewer cells; neighbours within a step (metres) connect.

    With ``agreed`` (bool), patches that hold fewer than ``least_cells`` cells that are vouched for need
    ``least_alone`` cells.
    """
    finder = SpeckFinder(height.shape, least_cells, step, least_alone)
    parts = list(tiles(height.shape, size=tile_size))
    for tile in parts:
        finder.add(tile, height[tile.core], None if agreed is None else agreed[tile.core])
    finder.finish()
    for tile in parts:
        finder.clean(tile, height[tile.core])


@dataclass(eq=False)
class SpeckFinder:
    """Removes small patches of a surface that is seen one tile at a time, twice.

    What lies within one tile is judged at once. Of patches that reach into the next tile only the
    cells along the border are remembered, so that memory grows with the length of the borders and
    the result does not depend on the tiles.
    """

    shape: tuple[int, int]
    """Rows and columns of the whole surface."""
    least_cells: float
    """Smaller patches are specks."""
    step: float
    """Neighbours within this difference, metres, belong to one patch."""
    least_alone: float = 0.0
    """Patches with fewer than ``least_cells`` cells that are vouched for are specks below this size."""
    _sizes: list[int] = field(default_factory=list)
    _agreed: list[int] = field(default_factory=list)
    _parents: list[int] = field(default_factory=list)
    _border: dict[tuple[int, int], tuple[np.ndarray, int]] = field(default_factory=dict)
    _rows: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    _columns: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def add(self, tile: Tile, height: np.ndarray, agreed: np.ndarray | None = None) -> None:
        """Look at a tile (tiles come row by row); its inner specks are emptied in place.

        Without ``agreed`` (bool) every cell is taken to be vouched for.
        """
        if max(self.least_cells, self.least_alone) <= 1:
            return
        rows, columns = tile.core
        labels = patches(height, self.step)
        sizes = np.bincount(labels.ravel())
        sure = sizes
        if agreed is not None:
            sure = np.bincount(labels.ravel(), weights=agreed.ravel()).astype(np.int64)
        sides = (
            (rows.start > 0, np.s_[0, :]),
            (rows.stop < self.shape[0], np.s_[-1, :]),
            (columns.start > 0, np.s_[:, 0]),
            (columns.stop < self.shape[1], np.s_[:, -1]),
        )
        rims = [np.zeros(1, np.int64), *(labels[side].astype(np.int64) for inner, side in sides if inner)]
        shared = np.unique(np.concatenate(rims))[1:]
        small = self._is_speck(sizes, sure)
        small[0] = False
        small[shared] = False
        height[small[labels]] = np.nan
        first = len(self._sizes)
        self._sizes.extend(int(n) for n in sizes[shared])
        self._agreed.extend(int(n) for n in sure[shared])
        self._parents.extend(range(first, first + len(shared)))
        names = np.full(len(sizes), -1, np.int64)
        names[shared] = first + np.arange(len(shared))
        # A patch is found again by one of its cells: labels are given anew in the second look.
        flat = labels.ravel()
        cells = np.full(len(sizes), -1, np.int64)
        edge = np.zeros(labels.shape, bool)
        for inner, side in sides:
            edge[side] |= inner
        places = np.flatnonzero(edge.ravel() & (flat > 0))[::-1]
        cells[flat[places]] = places
        self._border[rows.start, columns.start] = (cells[shared], first)
        top, left = self._rows.get(columns.start), self._columns.get(rows.start)
        if rows.start > 0 and top is not None:
            self._link(*top, height[0], names[labels[0]])
        if columns.start > 0 and left is not None:
            self._link(*left, height[:, 0], names[labels[:, 0]])
        self._rows[columns.start] = height[-1].copy(), names[labels[-1]]
        self._columns[rows.start] = height[:, -1].copy(), names[labels[:, -1]]

    def finish(self) -> None:
        """Add up the sizes of what belongs together; call between the two looks."""
        for name in range(len(self._sizes)):
            root = self._root(name)
            if root != name:
                self._sizes[root] += self._sizes[name]
                self._agreed[root] += self._agreed[name]

    def clean(self, tile: Tile, height: np.ndarray) -> bool:
        """Empty, in place, the specks that reach over the tile's border; whether there were any."""
        cells, first = self._border.get((tile.core[0].start, tile.core[1].start), (np.empty(0, int), 0))
        roots = [self._root(first + number) for number in range(len(cells))]
        sizes, agreed = (np.array([sums[root] for root in roots]) for sums in (self._sizes, self._agreed))
        specks = cells[self._is_speck(sizes, agreed)]
        if not len(specks):
            return False
        labels = patches(height, self.step)
        small = np.zeros(int(labels.max()) + 1, bool)
        small[labels.ravel()[specks]] = True
        small[0] = False
        height[small[labels]] = np.nan
        return True

    def _is_speck(self, sizes: np.ndarray, agreed: np.ndarray) -> np.ndarray:
        return (sizes < self.least_cells) | ((agreed < self.least_cells) & (sizes < self.least_alone))

    def _link(
        self, height: np.ndarray, names: np.ndarray, other: np.ndarray, other_names: np.ndarray
    ) -> None:
        with np.errstate(invalid="ignore"):
            joined = np.abs(height - other) <= self.step
        if not joined.any():
            return
        for a, b in np.unique(np.stack([names[joined], other_names[joined]]), axis=1).T:
            first, second = self._root(int(a)), self._root(int(b))
            self._parents[max(first, second)] = min(first, second)

    def _root(self, name: int) -> int:
        while self._parents[name] != name:
            self._parents[name] = self._parents[self._parents[name]]
            name = self._parents[name]
        return name


def patches(height: np.ndarray, step: float) -> np.ndarray:
    """Labels (rows, columns) from 1 of connected patches; 0 where there is no height."""
    # Doubling the grid puts the link between two cells into a cell of its own.
    rows, columns = height.shape
    links = np.zeros((2 * rows - 1, 2 * columns - 1), np.uint8)
    links[::2, ::2] = np.isfinite(height)
    with np.errstate(invalid="ignore"):
        links[1::2, ::2] = np.abs(np.diff(height, axis=0)) <= step
        links[::2, 1::2] = np.abs(np.diff(height, axis=1)) <= step
    _, labels = cv2.connectedComponents(links, connectivity=4, ltype=cv2.CV_32S)
    return labels[::2, ::2]
