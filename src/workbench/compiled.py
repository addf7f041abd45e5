"""Loops compiled by numba, and when their machine code is out of date.

numba keeps machine code until the file that holds the loop changes. What the loop calls from other files
is compiled into it, so that a change there would go unnoticed and an old result come back: here the code
counts as current only while no compiled loop of its package, or of the cameras, has changed.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import caching

_config: Any = numba.config  # Filled from the environment, unknown to type checkers.
_SHARED = "cameras"  # Projection is compiled into the loops of other packages.


def compiled(**options: Any) -> Callable[[Callable], Any]:
    """Decorator for a loop that is called from Python: :func:`numba.njit`, kept on disk.

    Parameters
    ----------
    **options
        Those of :func:`numba.njit` but ``cache``.
    """

    def decorate(function: Callable) -> Any:
        usual = _config.CACHE_LOCATOR_CLASSES
        # numba asks where to keep code, and for which source it holds, when a loop is decorated.
        _config.CACHE_LOCATOR_CLASSES = ",".join(f"{__name__}.{place.__name__}" for place in _PLACES)
        try:
            return numba.njit(cache=True, **options)(function)
        finally:
            _config.CACHE_LOCATOR_CLASSES = usual

    return decorate


class _FromAllSources:
    """Takes the sources of all loops that may be compiled into a function for its version."""

    _py_file: str

    def get_source_stamp(self) -> bytes:
        return source_stamp(Path(self._py_file).parent)


class GivenFolder(_FromAllSources, caching.UserProvidedCacheLocator):
    """In the folder that NUMBA_CACHE_DIR names."""


class BesideSource(_FromAllSources, caching.InTreeCacheLocator):
    """In ``__pycache__``, where that can be written."""


class UserFolder(_FromAllSources, caching.UserWideCacheLocator):
    """In the user's cache."""


_PLACES = (GivenFolder, BesideSource, UserFolder)


@functools.cache
def source_stamp(package: Path) -> bytes:
    """Digest of the files of a package, and of the cameras, that hold compiled loops."""
    digest = hashlib.sha256()
    for folder in (package, package.parent / _SHARED):
        for path in sorted(folder.glob("*.py")):
            source = path.read_bytes()
            if b"compiled" in source or b"numba" in source:
                digest.update(path.name.encode() + source)
    return digest.digest()
