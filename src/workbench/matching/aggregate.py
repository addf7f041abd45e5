"""Semi-global aggregation of matching costs in two sweeps, and the choice of the winners.

A downward sweep adds half of the paths into a volume of 16-bit sums, an upward sweep the other half;
as soon as a row is complete, the disparities of its pixels and of their partners are chosen. Every
left pixel searches ``width`` disparities that end at its own ``top``; index k means ``top - k``, so
that the right pixels of ascending k lie side by side in memory. Where neighbours have different
tops, path costs are read with the difference as offset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workbench.compiled import compiled
from workbench.matching.simd import (
    LANES,
    add_to_sums,
    census_costs,
    find_winner,
    offer_to_right,
    start_sums,
)

MEASURED, NODATA, OUTSIDE, LIMIT, AMBIGUOUS, INCONSISTENT, SPECK = range(7)
"""Flags of a pixel; see :func:`workbench.matching.match_pair`."""

OUTSIDE_COST = 36  # Between a match and chance (31 of 62 bits on average, more where texture repeats).
_PAD = LANES  # Cells of 255 between the path costs of neighbouring pixels.
_NEVER = 255
_NO_SUM = 0xFFFF


@dataclass(frozen=True, eq=False)
class Winners:
    """What the volume of one strip says about each of its pixels, (rows, columns) each."""

    disparity: np.ndarray
    """float32, px, with a fit to the sums around the winner."""
    uniqueness: np.ndarray
    """float32, 0..1: how far, as a fraction, the best sum lies below the best one elsewhere."""
    curvature: np.ndarray
    """float32, 0..: second difference of the sums at the winner, in bits per path."""
    flag: np.ndarray
    """uint8: MEASURED, or why not."""

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> Winners:
        """Room for the result."""
        return cls(
            np.full(shape, np.nan, np.float32),
            np.zeros(shape, np.float32),
            np.zeros(shape, np.float32),
            np.zeros(shape, np.uint8),
        )


@dataclass(frozen=True, eq=False)
class Penalties:
    """Costs of changes of disparity."""

    small: int
    """For one pixel."""
    jump: np.ndarray
    """For more, by the grey-value step between the neighbours, uint8 (256,)."""
    paths: int
    """8 or 16."""


@dataclass(frozen=True, eq=False)
class Limits:
    """What makes a winner acceptable."""

    uniqueness: float
    """Least uniqueness."""
    inconsistency: float
    """Largest difference between left-right and right-left, px."""
    width: int
    """Disparities searched per pixel; the volume holds this many, rounded up to whole blocks."""
    narrowed: bool
    """Whether a winner at the end of its search range is refused (the range came from a guide)."""


def aggregate(
    left_words: np.ndarray,
    left_known: np.ndarray,
    right_words: np.ndarray,
    right_known: np.ndarray,
    grey: np.ndarray,
    top: np.ndarray,
    scale: int,
    table: np.ndarray,
    penalties: Penalties,
    limits: Limits,
    core: slice,
    volume: np.ndarray,
) -> Winners:
    """Disparities of the rows ``core`` of a strip; the other rows only lead the paths in.

    Parameters
    ----------
    left_words, right_words
        Census or other words whose differing bits are the cost, uint64 (rows, columns).
    left_known, right_known
        Where the images have data, bool.
    grey
        Left image, uint8, for the penalties.
    top
        Largest disparity of each left pixel, int32 (rows, columns).
    scale
        Factor on the bits, in sixteenths; costs must stay within 0..62.
    table
        Cost of each pair of words instead, uint8 (256, 256), for words below 256; empty for bits.
    penalties, limits
        See there.
    core
        Rows that are wanted.
    volume
        uint16 work space of at least rows of core x columns x whole blocks; its content is lost.
    """
    rows, columns = grey.shape
    blocks = -(-limits.width // LANES)
    depth = blocks * LANES
    before = max(int(top.max()), 0)
    after = max(depth - 1 - int(top.min()), 0) + LANES
    words = np.zeros((rows, before + columns + after), np.uint64)
    words[:, before : before + columns] = right_words
    fences = np.full(words.shape, OUTSIDE_COST, np.uint8)
    fences[:, before : before + columns][right_known] = 0
    winners = Winners.empty((core.stop - core.start, columns))
    work = _workspace(columns, depth, penalties.paths)
    for upward in (False, True):
        _sweep(
            upward,
            left_words,
            left_known,
            words,
            fences,
            before,
            grey,
            top,
            scale,
            table,
            penalties.small,
            penalties.jump,
            penalties.paths,
            limits.uniqueness,
            limits.inconsistency,
            limits.width,
            limits.narrowed,
            core.start,
            core.stop,
            work,
            volume,
            winners.disparity,
            winners.uniqueness,
            winners.curvature,
            winners.flag,
        )
    return winners


def _workspace(columns: int, depth: int, paths: int) -> np.ndarray:
    """Costs of a pixel, four scratch areas, two pixels of the row path, rings of rows of the others."""
    stride = depth + _PAD
    row_paths = paths // 2 - 1
    ring = 2 if paths == 8 else 3
    return np.full(_PAD + (1 + 4 + 2 + row_paths * ring * columns + 1) * stride, _NEVER, np.uint8)


@compiled(nogil=True, error_model="numpy")
def _sweep(
    upward: bool,
    left_words: np.ndarray,
    left_known: np.ndarray,
    words: np.ndarray,
    fences: np.ndarray,
    before: int,
    grey: np.ndarray,
    top: np.ndarray,
    scale: int,
    table: np.ndarray,
    small: int,
    jump: np.ndarray,
    paths: int,
    least_uniqueness: float,
    most_inconsistency: float,
    width: int,
    narrowed: bool,
    first: int,
    last: int,
    work: np.ndarray,
    volume: np.ndarray,
    disparity: np.ndarray,
    uniqueness: np.ndarray,
    curvature: np.ndarray,
    flag: np.ndarray,
) -> None:
    # The loop over columns neither names nor passes on arrays: each would cost an atomic count of
    # references, which together took two thirds of the time.
    rows, columns = grey.shape
    depth = -(-width // LANES) * LANES
    blocks, stride = depth // LANES, depth + _PAD
    turn = -1 if upward else 1
    tabled = table.size > 0
    flat_words, flat_fences, span = words.reshape(-1), fences.reshape(-1), words.shape[1]
    totals = np.empty(depth, np.uint16)
    least, owner = np.empty(span + LANES, np.uint16), np.empty(span + LANES, np.uint16)
    chosen = np.empty(columns, np.int64)
    ring = 2 if paths == 8 else 3
    near, area = _PAD + 5 * stride, columns * stride
    sources, floors, jumps = _plans(columns)
    minima = np.zeros((2, 3, columns), np.int64)
    for i in range(rows - first if upward else last):
        row = rows - 1 - i if upward else i
        wanted = first <= row < last
        least[:] = _NO_SUM
        _plan_row(grey, top, jump, minima, row, i, turn, depth, ring, sources, floors, jumps)
        far = _PAD + 7 * stride + (i % ring) * area
        new = 0
        for j in range(columns):
            column = columns - 1 - j if upward else j
            right = column - top[row, column] + before
            cost = _PAD
            if left_known[row, column]:
                start = row * span + right
                if tabled:
                    own = left_words[row, column]
                    for k in range(width):
                        work[cost + k] = max(table[own, flat_words[start + k]], flat_fences[start + k])
                else:
                    census_costs(  # type: ignore[call-arg]
                        left_words[row, column],
                        flat_words,
                        start,
                        flat_fences,
                        start,
                        scale,
                        work,
                        cost,
                        blocks,
                    )
                for k in range(width, depth):
                    work[cost + k] = OUTSIDE_COST
            else:
                for k in range(depth):
                    work[cost + k] = 0
            s = ((row - first) * columns + column) * depth
            q0, q1 = sources[0, column], sources[1, column]
            q2, q3 = sources[2, column], sources[3, column]
            if min(q0, q1, q2, q3) < 0:
                _copy_far(work, grey, top, row, column, turn, depth, sources, 0)
                q0, q1 = _scratch(q0, 0, stride), _scratch(q1, 1, stride)
                q2, q3 = _scratch(q2, 2, stride), _scratch(q3, 3, stride)
            p0, p1 = near + (column & 1) * stride, far + column * stride
            p2, p3 = p1 + ring * area, p1 + 2 * ring * area
            floor, penalty = floors[0, column] | (new & 255), jumps[0, column]
            if wanted and upward:
                new = add_to_sums(
                    work, cost, q0, q1, q2, q3, p0, p1, p2, p3,
                    floor, penalty, small, volume, s, totals, 0, blocks,
                )  # fmt: skip
            elif wanted:
                new = start_sums(
                    work, cost, q0, q1, q2, q3, p0, p1, p2, p3,
                    floor, penalty, small, volume, s, volume, s, blocks,
                )  # fmt: skip
            else:
                new = start_sums(
                    work, cost, q0, q1, q2, q3, p0, p1, p2, p3,
                    floor, penalty, small, totals, 0, totals, 0, blocks,
                )  # fmt: skip
            minima[0, 0, column] = new
            if paths == 16:
                q0, q1 = sources[4, column], sources[5, column]
                q2, q3 = sources[6, column], sources[7, column]
                if min(q0, q1, q2, q3) < 0:
                    _copy_far(work, grey, top, row, column, turn, depth, sources, 4)
                    q0, q1 = _scratch(q0, 0, stride), _scratch(q1, 1, stride)
                    q2, q3 = _scratch(q2, 2, stride), _scratch(q3, 3, stride)
                p0, p1 = p3 + ring * area, p3 + 2 * ring * area
                p2, p3 = p3 + 3 * ring * area, p3 + 4 * ring * area
                floor, penalty = floors[1, column], jumps[1, column]
                if wanted and not upward:
                    minima[1, 0, column] = add_to_sums(
                        work, cost, q0, q1, q2, q3, p0, p1, p2, p3,
                        floor, penalty, small, volume, s, volume, s, blocks,
                    )  # fmt: skip
                else:
                    minima[1, 0, column] = add_to_sums(
                        work, cost, q0, q1, q2, q3, p0, p1, p2, p3,
                        floor, penalty, small, totals, 0, totals, 0, blocks,
                    )  # fmt: skip
            if upward and wanted:
                # A pixel without data costs nothing anywhere: it must not take partners from others.
                if left_known[row, column]:
                    offer_to_right(totals, 0, least, owner, right, column, blocks)  # type: ignore[call-arg]
                packed: int = find_winner(totals, 0, blocks)  # type: ignore[call-arg]
                best, k, second = packed & 0xFFFF, (packed >> 16) & 0xFFFF, packed >> 32
                chosen[column] = k
                out = row - first
                bend, fit = 0.0, 0.0
                if 0 < k < width - 1:
                    bend, fit = _fit(np.int64(totals[k - 1]), best, np.int64(totals[k + 1]))
                advantage = 1.0 - best / max(second, 1)
                uniqueness[out, column] = advantage
                curvature[out, column] = bend / paths
                disparity[out, column] = top[row, column] - k - fit
                code = MEASURED
                if not left_known[row, column]:
                    code = NODATA
                elif fences[row, right + k] != 0:
                    code = OUTSIDE
                elif narrowed and (k == 0 or k >= width - 1):
                    code = LIMIT
                elif advantage < least_uniqueness:
                    code = AMBIGUOUS
                flag[out, column] = code
        if upward and wanted:
            for column in range(columns):
                partner = column - top[row, column] + before + chosen[column]
                code = flag[row - first, column]
                apart = abs(np.int64(owner[partner]) - column) > most_inconsistency
                if apart and code in (MEASURED, AMBIGUOUS):
                    flag[row - first, column] = INCONSISTENT


@compiled()
def _plans(columns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Room for the plan of a row."""
    return (
        np.zeros((8, columns), np.int64),
        np.zeros((2, columns), np.int64),
        np.zeros((2, columns), np.int64),
    )


@compiled(error_model="numpy")
def _plan_row(
    grey: np.ndarray,
    top: np.ndarray,
    jump: np.ndarray,
    minima: np.ndarray,
    row: int,
    i: int,
    turn: int,
    depth: int,
    ring: int,
    sources: np.ndarray,
    floors: np.ndarray,
    jumps: np.ndarray,
) -> None:
    """For every pixel and path: where the predecessor's costs begin, its minimum, and the penalty.

    The minima and penalties of four paths are packed, a byte each. Without a predecessor both are
    0, so that the path starts with the pixelwise costs. A place is negative where the neighbours'
    ranges differ by more than the padding. The minima of former rows move on by a row.
    """
    columns, stride = grey.shape[1], depth + _PAD
    area = columns * stride
    for group in range(ring - 1):
        for column in range(columns):
            minima[group, 2, column] = minima[group, 1, column]
            minima[group, 1, column] = minima[group, 0, column]
            floors[group, column] = jumps[group, column] = 0
    for path in range(4 * (ring - 1)):
        back, beside = _predecessor(path)
        group, shift = path // 4, 8 * (path % 4)
        for column in range(columns):
            sources[path, column] = _PAD
        if i < back:
            continue
        start = _PAD + 7 * stride + ((path - 1) * ring + (i - back) % ring) * area
        other_row = row - turn * back
        for column in range(max(turn * beside, 0), columns + min(turn * beside, 0)):
            other = column - turn * beside
            place = start + other * stride if path else _PAD + (5 + (other & 1)) * stride
            offset = np.int64(top[other_row, other]) - np.int64(top[row, column])
            step = abs(np.int64(grey[row, column]) - np.int64(grey[other_row, other]))
            sources[path, column] = place + offset if -_PAD < offset < _PAD else -place
            jumps[group, column] |= np.int64(jump[step]) << shift
            if path:
                floors[group, column] |= minima[group, back, other] & (255 << shift)


@compiled()
def _predecessor(path: int) -> tuple[int, int]:
    """Rows and columns that a path comes from, against the direction of the sweep."""
    if path < 4:
        return (0 if path == 0 else 1), (1 if path < 2 else 2 - path)
    if path < 6:
        return 1, (2 if path == 4 else -2)
    return 2, (1 if path == 6 else -1)


@compiled()
def _copy_far(
    work: np.ndarray,
    grey: np.ndarray,
    top: np.ndarray,
    row: int,
    column: int,
    turn: int,
    depth: int,
    sources: np.ndarray,
    first_path: int,
) -> None:
    """Copy the overlap of distant search ranges into the scratch areas, between fresh padding."""
    stride = depth + _PAD
    for lane in range(4):
        place = -sources[first_path + lane, column]
        if place <= 0:
            continue
        back, beside = _predecessor(first_path + lane)
        offset = np.int64(top[row - turn * back, column - turn * beside]) - np.int64(top[row, column])
        scratch = _PAD + (1 + lane) * stride
        for k in range(-1, depth + 1):
            inside = 0 <= k + offset < depth
            work[scratch + k] = work[place + k + offset] if inside else np.uint8(_NEVER)


@compiled()
def _scratch(source: int, lane: int, stride: int) -> int:
    return source if source >= 0 else _PAD + (1 + lane) * stride


@compiled(error_model="numpy")
def _fit(low: int, centre: int, high: int) -> tuple[float, float]:
    """Second difference of three sums, and place of their minimum beside the middle, -0.5..0.5."""
    steeper = max(low, high) - centre
    if steeper <= 0:
        return 0.0, 0.0
    return float(low + high - 2 * centre), 0.5 * (low - high) / steeper
