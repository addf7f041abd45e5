"""Vector instructions for the inner loops of the matcher.

Numba widens sums of small integers to 64 bits and so loses the vector units; these few operations are
written down in LLVM's vector types instead. They read and write flat arrays at given offsets without
bounds checks: the caller answers for offsets. A block is 32 disparities.

The first argument of an intrinsic is numba's own and callers leave it out, which mypy cannot know.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

LANES = 32

_BYTE, _SHORT, _INT, _LONG = (ir.IntType(bits) for bits in (8, 16, 32, 64))
_BYTES, _SHORTS, _LONGS = (ir.VectorType(kind, LANES) for kind in (_BYTE, _SHORT, _LONG))


@intrinsic
def census_costs(  # type: ignore[no-untyped-def]
    typingctx, word, words, start, penalties, start_penalty, scale, costs, start_cost, blocks
):
    """Matching costs of one left pixel with consecutive right pixels.

    ``costs[start_cost + k]`` becomes the number of bits in which ``word`` and ``words[start + k]``
    differ, times ``scale / 16``; where ``penalties[start_penalty + k]`` is not 0, that value.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word, words, start, penalties, start_penalty, scale, costs, start_cost, blocks = arguments
        words, penalties, costs = (
            _data(context, builder, signature.args[i], arguments[i]) for i in (1, 3, 6)
        )
        repeated = _splat(builder, word, _LONGS)
        factor = _splat(builder, builder.trunc(scale, _SHORT), _SHORTS)
        with cgutils.for_range(builder, blocks) as loop:
            k = builder.mul(loop.index, _LONG(LANES))
            bits = builder.xor(repeated, _load(builder, words, builder.add(start, k), _LONGS))
            count = builder.trunc(_call(builder, "llvm.ctpop", _LONGS, bits), _SHORTS)
            scaled = builder.lshr(builder.mul(count, factor), ir.Constant(_SHORTS, [4] * LANES))
            penalty = _load(builder, penalties, builder.add(start_penalty, k), _BYTES)
            free = builder.icmp_unsigned("==", penalty, ir.Constant(_BYTES, [0] * LANES))
            cost = builder.select(free, builder.trunc(scaled, _BYTES), penalty)
            _store(builder, cost, costs, builder.add(start_cost, k), _BYTES)
        return context.get_dummy_value()

    u8, u64 = types.Array(types.uint8, 1, "C"), types.Array(types.uint64, 1, "C")
    i64 = types.int64
    return types.void(types.uint64, u64, i64, u8, i64, i64, u8, i64, i64), generate


def _aggregation(accumulate: bool) -> Callable[..., Any]:
    """Build the step of four paths; ``accumulate`` adds to sums that are there already."""

    @intrinsic
    def step(  # type: ignore[no-untyped-def]
        typingctx,
        work,
        cost,
        q0,
        q1,
        q2,
        q3,
        p0,
        p1,
        p2,
        p3,
        minima,
        jumps,
        small,
        before,
        b,
        after,
        a,
        blocks,
    ):
        """One pixel's step of four paths [Hirschmüller 2008, equation 13].

        Path costs of the predecessors start at ``work[q0]`` ... ``work[q3]``, readable one before and one
        behind; those of this pixel are written to ``work[p0]`` ... ``work[p3]``; the pixelwise costs
        start at ``work[cost]``. ``minima`` holds the smallest path cost of each predecessor,
        ``jumps`` the penalty for a jump, a byte each; ``small`` is the penalty for one step. The sum
        of the four is written to ``after[a]``..., added to ``before[b]``... if accumulating. Returns
        the smallest new path costs, a byte each.
        """

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            work = _data(context, builder, signature.args[0], arguments[0])
            cost, *rest = arguments[1:]
            sources, targets, (minima, jumps, small) = rest[:4], rest[4:8], rest[8:11]
            before = _data(context, builder, signature.args[13], arguments[13])
            after = _data(context, builder, signature.args[15], arguments[15])
            b, a, blocks = arguments[14], arguments[16], arguments[17]
            step_cost = _splat(builder, builder.trunc(small, _BYTE), _BYTES)
            floors, ceilings, lowest = [], [], []
            for path in range(4):
                floor = builder.trunc(builder.lshr(minima, _LONG(8 * path)), _BYTE)
                jump = builder.trunc(builder.lshr(jumps, _LONG(8 * path)), _BYTE)
                floors.append(_splat(builder, floor, _BYTES))
                ceilings.append(_splat(builder, builder.add(floor, jump), _BYTES))
                lowest.append(cgutils.alloca_once_value(builder, ir.Constant(_BYTES, [255] * LANES)))
            with cgutils.for_range(builder, blocks) as loop:
                k = builder.mul(loop.index, _LONG(LANES))
                pixel = _load(builder, work, builder.add(cost, k), _BYTES)
                total = _load(builder, before, builder.add(b, k), _SHORTS) if accumulate else None
                for path in range(4):
                    same = builder.add(sources[path], k)
                    down = _load(builder, work, builder.sub(same, _LONG(1)), _BYTES)
                    up = _load(builder, work, builder.add(same, _LONG(1)), _BYTES)
                    beside = _call(builder, "llvm.umin", _BYTES, down, up)
                    beside = _call(builder, "llvm.uadd.sat", _BYTES, beside, step_cost)
                    best = _call(builder, "llvm.umin", _BYTES, _load(builder, work, same, _BYTES), beside)
                    best = _call(builder, "llvm.umin", _BYTES, best, ceilings[path])
                    new = builder.add(pixel, builder.sub(best, floors[path]))
                    _store(builder, new, work, builder.add(targets[path], k), _BYTES)
                    least = _call(builder, "llvm.umin", _BYTES, builder.load(lowest[path]), new)
                    builder.store(least, lowest[path])
                    wide = builder.zext(new, _SHORTS)
                    total = wide if total is None else builder.add(total, wide)
                _store(builder, total, after, builder.add(a, k), _SHORTS)
            packed = _LONG(0)
            for path in range(4):
                least = _reduce(builder, builder.load(lowest[path]), _BYTES)
                packed = builder.or_(packed, builder.shl(builder.zext(least, _LONG), _LONG(8 * path)))
            return packed

        u8, u16 = types.Array(types.uint8, 1, "C"), types.Array(types.uint16, 1, "C")
        i64 = types.int64
        return i64(u8, *([i64] * 12), u16, i64, u16, i64, i64), generate

    return step


start_sums = _aggregation(accumulate=False)
add_to_sums = _aggregation(accumulate=True)


@intrinsic
def find_winner(typingctx, totals, start, blocks):  # type: ignore[no-untyped-def]
    """Smallest sum, its index and the smallest sum elsewhere, packed as 16 bits each from the lowest.

    Elsewhere means not at the winner or right beside it. Of equal sums the first wins.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        totals = _data(context, builder, signature.args[0], arguments[0])
        _, start, blocks = arguments
        full = ir.Constant(_SHORTS, [0xFFFF] * LANES)
        lowest = cgutils.alloca_once_value(builder, full)
        with cgutils.for_range(builder, blocks) as loop:
            values = _load(builder, totals, _block(builder, start, loop.index), _SHORTS)
            builder.store(_call(builder, "llvm.umin", _SHORTS, builder.load(lowest), values), lowest)
        best = _reduce(builder, builder.load(lowest), _SHORTS)
        repeated = _splat(builder, best, _SHORTS)
        place = cgutils.alloca_once_value(builder, _INT(0xFFFF))
        with cgutils.for_range(builder, blocks) as loop:
            values = _load(builder, totals, _block(builder, start, loop.index), _SHORTS)
            hits = builder.bitcast(builder.icmp_unsigned("==", values, repeated), _INT)
            first = builder.cttz(hits, ir.IntType(1)(0))
            k = builder.trunc(builder.mul(loop.index, _LONG(LANES)), _INT)
            new = builder.and_(
                builder.icmp_unsigned("!=", hits, _INT(0)),
                builder.icmp_unsigned("==", builder.load(place), _INT(0xFFFF)),
            )
            builder.store(builder.select(new, builder.add(first, k), builder.load(place)), place)
        winner = builder.trunc(builder.load(place), _SHORT)
        second = cgutils.alloca_once_value(builder, full)
        origin = _splat(builder, builder.sub(winner, _SHORT(1)), _SHORTS)
        lanes = ir.Constant(_SHORTS, list(range(LANES)))
        with cgutils.for_range(builder, blocks) as loop:
            values = _load(builder, totals, _block(builder, start, loop.index), _SHORTS)
            k = _splat(builder, builder.trunc(builder.mul(loop.index, _LONG(LANES)), _SHORT), _SHORTS)
            distance = builder.sub(builder.add(lanes, k), origin)
            far = builder.icmp_unsigned(">", distance, ir.Constant(_SHORTS, [2] * LANES))
            values = builder.select(far, values, full)
            builder.store(_call(builder, "llvm.umin", _SHORTS, builder.load(second), values), second)
        runner_up = _reduce(builder, builder.load(second), _SHORTS)
        packed = builder.zext(best, _LONG)
        packed = builder.or_(packed, builder.shl(builder.zext(winner, _LONG), _LONG(16)))
        return builder.or_(packed, builder.shl(builder.zext(runner_up, _LONG), _LONG(32)))

    i64 = types.int64
    return i64(types.Array(types.uint16, 1, "C"), i64, i64), generate


@intrinsic
def offer_to_right(typingctx, totals, start, least, owner, place, column, blocks):  # type: ignore[no-untyped-def]
    """Let right pixels keep the left column with the smallest sum.

    Where ``totals[start + k]`` is below ``least[place + k]`` it replaces it, and ``column`` is noted
    in ``owner[place + k]``.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        totals, least, owner = (_data(context, builder, signature.args[i], arguments[i]) for i in (0, 2, 3))
        _, start, _, _, place, column, blocks = arguments
        repeated = _splat(builder, builder.trunc(column, _SHORT), _SHORTS)
        with cgutils.for_range(builder, blocks) as loop:
            values = _load(builder, totals, _block(builder, start, loop.index), _SHORTS)
            target = _block(builder, place, loop.index)
            known = _load(builder, least, target, _SHORTS)
            better = builder.icmp_unsigned("<", values, known)
            _store(builder, builder.select(better, values, known), least, target, _SHORTS)
            owners = _load(builder, owner, target, _SHORTS)
            _store(builder, builder.select(better, repeated, owners), owner, target, _SHORTS)
        return context.get_dummy_value()

    u16, i64 = types.Array(types.uint16, 1, "C"), types.int64
    return types.void(u16, i64, u16, u16, i64, i64, i64), generate


def _data(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    return context.make_array(kind)(context, builder, value).data


def _block(builder: Any, start: Any, index: Any) -> Any:
    return builder.add(start, builder.mul(index, _LONG(LANES)))


def _address(builder: Any, data: Any, index: Any, kind: Any) -> Any:
    return builder.bitcast(builder.gep(data, [index]), kind.as_pointer())


def _load(builder: Any, data: Any, index: Any, kind: Any) -> Any:
    return builder.load(_address(builder, data, index, kind), align=1)


def _store(builder: Any, value: Any, data: Any, index: Any, kind: Any) -> None:
    builder.store(value, _address(builder, data, index, kind), align=1)


def _splat(builder: Any, scalar: Any, kind: Any) -> Any:
    undefined = ir.Constant(kind, ir.Undefined)
    single = builder.insert_element(undefined, scalar, _INT(0))
    order = ir.Constant(ir.VectorType(_INT, LANES), [0] * LANES)
    return builder.shuffle_vector(single, undefined, order)


def _suffix(kind: Any) -> str:
    return f"v{LANES}i{kind.element.width}"


def _call(builder: Any, name: str, kind: Any, *operands: Any) -> Any:
    signature = ir.FunctionType(kind, [kind] * len(operands))
    function = cgutils.get_or_insert_function(builder.module, signature, f"{name}.{_suffix(kind)}")
    return builder.call(function, operands)


def _reduce(builder: Any, vector: Any, kind: Any) -> Any:
    signature = ir.FunctionType(kind.element, [kind])
    name = f"llvm.vector.reduce.umin.{_suffix(kind)}"
    return builder.call(cgutils.get_or_insert_function(builder.module, signature, name), [vector])
