"""How the loops of the renderer are compiled."""

from __future__ import annotations

import numba

from workbench.compiled import compiled

# Everything of "fast math" but the right to reorder sums: a result must not depend on the tile that it
# is computed in. Division by zero gives infinity instead of a branch to an exception.
_MATH = {"nnan", "ninf", "nsz", "arcp", "contract", "afn"}

inner = numba.njit(error_model="numpy", fastmath=_MATH)
"""For functions that are called from kernels."""
kernel = compiled(nogil=True, error_model="numpy", fastmath=_MATH)
"""For loops that are called from Python: they release the interpreter and are kept on disk."""
