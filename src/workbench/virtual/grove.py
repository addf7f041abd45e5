"""Trees of a scene in the form that compiled loops read, grown block by block where they are needed.

A tree is some two hundred clumps of foliage, 10 kB. As long as all of them together fit into ``_MOST_BYTES``
they are kept. Of a larger scene only the table of trees is: the clumps of a block of land are grown when a
tile of a photograph, of a shadow map or of the truth touches it, and the blocks that were not used for
longest are forgotten. A tree grows from its own seed, so that it is the same tree every time.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock

import numpy as np

from workbench.virtual.particles import CLUMPS, TX, TY, Plants, leaf_library
from workbench.virtual.trees3d import CLUMP_COLUMNS

_MOST_BYTES = 192_000_000
_BLOCK = 32.0  # Edge of a block of land, m: about a tile of a photograph at 15 cm.


class Grove:
    """All trees of a scene.

    Parameters
    ----------
    table
        (n, 12) float32, columns as in :mod:`workbench.virtual.particles`.
    grow
        Gives the clumps (m, 13) of the tree of an index.
    grown
        Clumps of all trees in their order, as far as they were kept.
    most_bytes
        Of clumps that are kept.
    """

    def __init__(
        self,
        table: np.ndarray,
        grow: Callable[[int], np.ndarray],
        grown: list[np.ndarray] | None,
        *,
        most_bytes: int = _MOST_BYTES,
    ) -> None:
        self.table = table
        numbers = table[:, CLUMPS].astype(np.int64)
        self.first = np.cumsum(numbers) - numbers
        self._numbers = numbers
        self._grow = grow
        self._most_bytes = most_bytes
        self._lock = Lock()
        self._blocks: OrderedDict[int, np.ndarray] = OrderedDict()
        self._bytes = 0
        self._members, self._block_of = _blocks_of(table)
        self._whole = None if grown is None else self._plants(_joined(grown), self.first)

    @property
    def empty(self) -> Plants:
        """The table of trees without any clump."""
        return self._plants(_joined([]), np.full(len(self.table), -1, dtype=np.int64))

    def plants(self, chosen: np.ndarray) -> Plants:
        """The table of trees with the clumps of at least the chosen ones (indices)."""
        if self._whole is not None:
            return self._whole
        rows = np.full(len(self.table), -1, dtype=np.int64)
        pieces, total = [], 0
        for block in np.unique(self._block_of[chosen]):
            members = self._members[block]
            numbers = self._numbers[members]
            rows[members] = total + np.cumsum(numbers) - numbers
            pieces.append(self._block(int(block)))
            total += int(numbers.sum())
        return self._plants(_joined(pieces), rows)

    def _plants(self, clumps: np.ndarray, rows: np.ndarray) -> Plants:
        return Plants(self.table, clumps, self.first, rows, leaf_library())

    def _block(self, block: int) -> np.ndarray:
        """Clumps of all trees of a block, in the order of the trees."""
        with self._lock:
            if block in self._blocks:
                self._blocks.move_to_end(block)
                return self._blocks[block]
            clumps = _joined([self._grow(int(index)) for index in self._members[block]])
            self._blocks[block] = clumps
            self._bytes += clumps.nbytes
            while self._bytes > self._most_bytes and len(self._blocks) > 1:
                self._bytes -= self._blocks.popitem(last=False)[1].nbytes
            return clumps


def fits(clumps: int) -> bool:
    """Whether so many clumps may be kept."""
    return clumps * CLUMP_COLUMNS * 4 <= _MOST_BYTES


def _blocks_of(table: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Trees (indices) of every block of land, and the block of every tree."""
    if len(table) == 0:
        return [], np.zeros(0, dtype=np.int64)
    cells = np.floor(table[:, [TX, TY]] / _BLOCK).astype(np.int64)
    _, block_of = np.unique(cells, axis=0, return_inverse=True)
    block_of = block_of.ravel()
    order = np.argsort(block_of, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(block_of[order])) + 1), block_of


def _joined(pieces: list[np.ndarray]) -> np.ndarray:
    if not pieces:
        return np.zeros((0, CLUMP_COLUMNS), dtype=np.float32)
    return np.concatenate(pieces).astype(np.float32)
