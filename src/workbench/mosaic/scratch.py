"""Arrays on disk for a mosaic in the making: read and written by window, never whole in memory."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

Window = tuple[slice, slice]
"""Rows and columns."""


class Scratch:
    """A file of zeros of the shape (..., rows, columns), gone when nobody refers to it any more."""

    def __init__(self, folder: Path, shape: tuple[int, ...], dtype: np.dtype | type) -> None:
        self.shape, self.dtype = shape, np.dtype(dtype)
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - lives as long as the array
        self._file.truncate(int(np.prod(shape, dtype=np.int64)) * self.dtype.itemsize)

    def read(self, window: Window) -> np.ndarray:
        """A copy of the values of a window."""
        return np.array(self._map()[(..., *window)])

    def write(self, values: np.ndarray, window: Window, where: np.ndarray | None = None) -> None:
        """Put values into a window, or into those of its cells that ``where`` (rows, columns) names."""
        target = self._map()[(..., *window)]
        if where is None:
            target[...] = values
        else:
            np.copyto(target, values, where=where)

    def _map(self) -> np.memmap:
        # Mapped anew for each window: pages of an open mapping would count as memory of the process.
        return np.memmap(self._file, self.dtype, "r+", shape=self.shape)
