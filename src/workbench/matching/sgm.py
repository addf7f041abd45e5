"""Semi-global matching of a pair in strips of rows, on several threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np

from workbench.matching.aggregate import Limits, Penalties, Winners, aggregate
from workbench.matching.census import census, census_scale
from workbench.matching.pair import Pair
from workbench.matching.simd import LANES
from workbench.params.match import SgmParameters

_LEAD = 48  # Rows by which paths are led into a strip: a path forgets its start within some dozens.
_STRIP = 96  # A strip of fewer rows would mostly work on what leads into it.
_MEGABYTE = 1_000_000
_NO_TABLE = np.zeros((0, 0), np.uint8)


def match_strips(
    pair: Pair,
    top: np.ndarray,
    width: int,
    narrowed: bool,
    parameters: SgmParameters,
    threads: int,
    table: np.ndarray | None = None,
) -> Winners:
    """Winners of the whole pair.

    Strips are cut by the image's size and ``parameters.memory`` alone, so that the result does not
    depend on the number of threads.

    Parameters
    ----------
    pair
        Images.
    top
        Largest disparity of each left pixel, int32 (rows, columns).
    width
        Disparities to search, downward from the top.
    narrowed
        Whether a guide chose the range.
    parameters
        Costs, penalties, limits and memory.
    threads
        Strips at a time.
    table
        Cost of each pair of grey values, uint8 (256, 256), instead of the census.
    """
    grey = np.rint(pair.left).astype(np.uint8)
    penalties = Penalties(parameters.p1, jump_penalties(parameters), parameters.paths)
    limits = Limits(parameters.uniqueness, parameters.max_inconsistency, width, narrowed)
    depth = -(-width // LANES) * LANES
    rows, columns = pair.shape
    strips = cut_strips(rows, columns, depth, parameters.memory)
    winners = Winners.empty(pair.shape)
    window = "census9x7" if table is not None else parameters.cost
    costs = _NO_TABLE if table is None else table

    def words(image: np.ndarray, led: slice) -> np.ndarray:
        if table is not None:
            return np.rint(image[led]).astype(np.uint64)
        return _census_rows(image, led, window)

    def match(strip: slice) -> None:
        led = slice(max(strip.start - _LEAD, 0), min(strip.stop + _LEAD, rows))
        core = slice(strip.start - led.start, strip.stop - led.start)
        part = aggregate(
            words(pair.left, led),
            pair.left_known[led],
            words(pair.right, led),
            pair.right_known[led],
            grey[led],
            top[led],
            census_scale(window),
            costs,
            penalties,
            limits,
            core,
            np.empty((strip.stop - strip.start) * columns * depth, np.uint16),
        )
        for name in ("disparity", "uniqueness", "curvature", "flag"):
            getattr(winners, name)[strip] = getattr(part, name)

    run_parallel(match, strips, threads)
    return winners


def run_parallel(work: Callable[[slice], None], parts: list[slice], threads: int) -> None:
    """Call a function on each part, several at a time; the first error is raised."""
    if threads <= 1 or len(parts) == 1:
        for part in parts:
            work(part)
        return
    with ThreadPoolExecutor(threads) as pool:
        for future in [pool.submit(work, part) for part in parts]:
            future.result()


def cut_strips(rows: int, columns: int, depth: int, memory: float) -> list[slice]:
    """Strips of rows whose volume of sums fits into ``memory`` megabytes; two at least if worth it."""
    fitting = max(int(memory * _MEGABYTE / (2 * columns * depth)), 1)
    count = max(-(-rows // fitting), 2 if rows >= 2 * _STRIP else 1)
    edges = np.linspace(0, rows, count + 1).round().astype(int)
    return [slice(int(a), int(b)) for a, b in pairwise(edges) if b > a]


def jump_penalties(parameters: SgmParameters) -> np.ndarray:
    """Penalty of a jump by the grey-value step between neighbours, uint8 (256,).

    Falls as Hirschmüller's P2' / |gradient|, from ``p2`` to ``p2_edge``.
    """
    step = np.arange(256) / parameters.p2_gradient
    falling = parameters.p2_edge + (parameters.p2 - parameters.p2_edge) / (1 + step)
    return np.maximum(np.rint(falling), parameters.p1 + 1).astype(np.uint8)


def _census_rows(image: np.ndarray, rows: slice, window: str) -> np.ndarray:
    """Census of some rows, computed with the rows around them."""
    reach = 4
    start, stop = max(rows.start - reach, 0), min(rows.stop + reach, image.shape[0])
    words = census(image[start:stop], window)
    return words[rows.start - start : rows.stop - start]
