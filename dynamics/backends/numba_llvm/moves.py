"""Compiled moves of values between the workspace and a caller's arrays."""

from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, register_jitable

from dynamics.backends.numba_llvm.vector_code import WORD, bytes_of, once, vector
from dynamics.runtime.jit import CACHE_LINE
from dynamics.runtime.numba_internals import array_struct, data_pointer, for_range, unpack_tuple

_BYTES = ir.IntType(8).as_pointer()
_FETCH, _TO_WRITE = "llvm.prefetch.p0i8", (1, 3, 1)  # to write, into the nearest cache, data


@cache
def lane_moves(lanes: int, apart: int | None = None) -> tuple[Any, Any, Any]:
    """Functions `take`, `put` and `expect` on runs of consecutive elements of an array's rows.

    `take(w, at, count, array, first, stride)` copies `count` runs to the slots from offset `at` of
    w on; run k is elements first + k stride ... + lanes of the flat array. Slots are `apart`
    numbers apart, `lanes` if that is not given. `put` copies them back. Numbers are converted; in
    an array of booleans every nonzero number is true. `expect(array, count, first, stride)`
    prefetches the cache lines of such runs for writing. Gain: docs/results/tricks.md.
    """
    apart = lanes if apart is None else apart

    def pointer(context, builder, kind, array, offset):  # type: ignore[no-untyped-def]
        data = data_pointer(context, builder, kind, array)
        return _place(builder, data, offset, vector(data.type.pointee, lanes))

    def convert(builder, value, number):  # type: ignore[no-untyped-def]
        kind = vector(number, lanes)
        if isinstance(number, ir.IntType):
            zero = ir.Constant(value.type, [0.0] * lanes if lanes > 1 else 0.0)
            return builder.zext(builder.fcmp_unordered("!=", value, zero), kind)
        return _converted(builder, value, kind)

    def move(inwards: bool) -> Any:
        @intrinsic
        def lanes_moved(typingctx, w, at, count, array, first, stride):  # type: ignore[no-untyped-def]
            def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
                kinds = w, array
                number = context.get_data_type(kinds[1 - inwards].dtype)
                sizes = [context.get_abi_sizeof(context.get_data_type(x.dtype)) for x in kinds]
                with for_range(builder, args[2]) as loop:
                    slot = _after(builder, args[1], loop.index, WORD(apart))
                    element = _after(builder, args[4], loop.index, args[5])
                    places = (
                        pointer(context, builder, w, args[0], slot),
                        pointer(context, builder, array, args[3], element),
                    )
                    value = builder.load(places[inwards], align=sizes[inwards])
                    value = convert(builder, value, number)
                    builder.store(value, places[1 - inwards], align=sizes[1 - inwards])
                return context.get_dummy_value()

            return types.void(w, at, count, array, first, stride), codegen

        return lanes_moved

    @intrinsic
    def expect(typingctx, array, count, first, stride):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            data = data_pointer(context, builder, signature.args[0], args[0])
            size = context.get_abi_sizeof(data.type.pointee)
            kind = ir.FunctionType(ir.VoidType(), [_BYTES, *3 * [ir.IntType(32)]])
            fetch = builder.module.globals.get(_FETCH) or ir.Function(builder.module, kind, _FETCH)
            with for_range(builder, args[1]) as loop:
                offset = _after(builder, args[2], loop.index, args[3])
                place = _place(builder, data, offset, ir.IntType(8))
                for byte in range(0, lanes * size, CACHE_LINE):
                    line = builder.gep(place, [WORD(byte)])
                    builder.call(fetch, [line, *map(ir.IntType(32), _TO_WRITE)])
            return context.get_dummy_value()

        return types.void(array, count, first, stride), codegen

    return move(inwards=True), move(inwards=False), expect


@cache
def row_moves(lanes: int) -> tuple[Any, Any]:
    """Functions `gather` and `scatter` on rows of an array.

    `gather(w, at, rows, first)` copies rows first ... first + lanes to the slots from offset `at`
    on, a slot per column and a lane per row; the last row stands in for missing ones.
    `scatter(w, at, rows, row)` copies the lane at offset `at` of every slot to a row. Numbers are
    converted.
    """

    def gathered(builder, slots, data, count, columns, down, along, first):  # type: ignore[no-untyped-def]
        last = builder.sub(count, WORD(1))
        offsets = []
        for b in range(lanes):
            row = builder.add(first, WORD(b))
            row = builder.select(builder.icmp_unsigned("<", row, last), row, last)
            offsets.append(builder.mul(row, down))
        with for_range(builder, columns) as loop:
            place = builder.mul(loop.index, along)
            slot = builder.gep(slots, [builder.mul(loop.index, WORD(lanes))])
            for b, offset in enumerate(offsets):
                value = builder.load(_element(builder, data, builder.add(offset, place)))
                value = _converted(builder, value, slots.type.pointee)
                builder.store(value, builder.gep(slot, [WORD(b)]))

    def scattered(builder, slots, data, count, columns, down, along, row):  # type: ignore[no-untyped-def]
        start = builder.mul(row, down)
        with for_range(builder, columns) as loop:
            slot = builder.gep(slots, [builder.mul(loop.index, WORD(lanes))])
            value = _converted(builder, builder.load(slot), data.type.pointee)
            place = builder.add(start, builder.mul(loop.index, along))
            builder.store(value, _element(builder, data, place))

    def move(body: Callable[..., None]) -> Any:
        @intrinsic
        def rows_moved(typingctx, w, at, rows, row):  # type: ignore[no-untyped-def]
            def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
                slots = data_pointer(context, builder, signature.args[0], args[0])
                array = array_struct(context, builder, signature.args[2], args[2])
                sizes = [*unpack_tuple(builder, array.shape), *unpack_tuple(builder, array.strides)]
                given = [builder.gep(slots, [args[1]]), array.data, *sizes, args[3]]
                name = f"{body.__name__}_{slots.type.pointee}_{array.data.type.pointee}"
                builder.call(once(builder.module, name, given, body), given)
                return context.get_dummy_value()

            return types.void(w, at, rows, row), codegen

        return rows_moved

    return move(gathered), move(scattered)


@cache
def block_moves(lanes: int, columns: int) -> tuple[Any, Any]:
    """Functions `take_rows` and `put_rows` on consecutive rows of a C-ordered array.

    `take_rows(w, at, rows, first)` copies rows first ... first + lanes to the slots from offset
    `at` on, as `gather` does; `put_rows(w, at, rows, first)` copies them back, as far as there are
    such rows. Whole blocks are transposed in vector registers. Gain: docs/results/tricks.md.
    """

    def runs(builder, data, row, at, width):  # type: ignore[no-untyped-def]
        """Addresses of `width` columns: one per row, or one in all if there are no others."""
        start = builder.mul(row, WORD(columns))
        count, size = (1, lanes * width) if width == columns else (lanes, width)
        kind = ir.VectorType(data.type.pointee, size)
        offsets = [builder.add(start, WORD(b * columns + at)) for b in range(count)]
        return [_place(builder, data, offset, kind) for offset in offsets]

    def slots_of(builder, slots, at, width):  # type: ignore[no-untyped-def]
        kind = ir.VectorType(slots.type.pointee, lanes)
        return [_place(builder, slots, WORD(k * lanes), kind) for k in range(at, at + width)]

    def taken(builder, slots, data, first):  # type: ignore[no-untyped-def]
        own, other = (bytes_of(x.type.pointee) for x in (slots, data))
        for at, width in _chunks(columns, other):
            places = runs(builder, data, first, at, width)
            block = _joined(builder, [builder.load(x, align=other) for x in places])
            for k, slot in enumerate(slots_of(builder, slots, at, width)):
                column = _picked(builder, block, range(k, lanes * width, width))
                builder.store(_converted(builder, column, slot.type.pointee), slot, align=own)

    def put(builder, slots, data, first):  # type: ignore[no-untyped-def]
        own, other = (bytes_of(x.type.pointee) for x in (slots, data))
        kind = ir.VectorType(data.type.pointee, lanes)
        for at, width in _chunks(columns, other):
            values = [builder.load(x, align=own) for x in slots_of(builder, slots, at, width)]
            block = _zipped(builder, [_converted(builder, value, kind) for value in values])
            places = runs(builder, data, first, at, width)
            each = lanes * width // len(places)
            for b, place in enumerate(places):
                part = _picked(builder, block, range(b * each, (b + 1) * each))
                builder.store(part, place, align=other)

    def move(body: Callable[..., None]) -> Any:
        @intrinsic
        def block_moved(typingctx, w, at, rows, first):  # type: ignore[no-untyped-def]
            def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
                slots = data_pointer(context, builder, signature.args[0], args[0])
                data = data_pointer(context, builder, signature.args[2], args[2])
                given = [builder.gep(slots, [args[1]]), data, args[3]]
                name = f"{body.__name__}_{columns}_{slots.type.pointee}_{data.type.pointee}"
                builder.call(once(builder.module, name, given, body), given)
                return context.get_dummy_value()

            return types.void(w, at, rows, first), codegen

        return block_moved

    take_block, put_block = move(taken), move(put)
    gather, scatter = row_moves(lanes)
    whole = np.uint64(lanes)

    @register_jitable(inline="always")  # or each would bring copies of gather and scatter along
    def take_rows(w, at, rows, first):  # type: ignore[no-untyped-def]
        if first + whole <= np.uint64(rows.shape[0]):
            take_block(w, at, rows, first)
        else:
            gather(w, at, rows, first)

    @register_jitable(inline="always")
    def put_rows(w, at, rows, first):  # type: ignore[no-untyped-def]
        count = np.uint64(rows.shape[0])
        if first + whole <= count:
            put_block(w, at, rows, first)
        else:
            for b in range(count - first):
                scatter(w, at + b, rows, first + b)

    return take_rows, put_rows


def _chunks(columns: int, size: int) -> Iterator[tuple[int, int]]:
    """First column and width of chunks, powers of two of at most a cache line."""
    at = 0
    while at < columns:
        width = min(CACHE_LINE // size, 1 << ((columns - at).bit_length() - 1))
        yield at, width
        at += width


def _picked(builder: ir.IRBuilder, values: ir.Value, order: Iterable[int]) -> ir.Value:
    """The elements of a vector with these numbers."""
    return _shuffled(builder, values, ir.Constant(values.type, ir.Undefined), order)


def _shuffled(builder: ir.IRBuilder, a: ir.Value, b: ir.Value, order: Iterable[int]) -> ir.Value:
    """The elements of two vectors with these numbers, counted through both."""
    numbers = list(order)
    kind = ir.VectorType(ir.IntType(32), len(numbers))
    return builder.shuffle_vector(a, b, ir.Constant(kind, numbers))


def _joined(builder: ir.IRBuilder, parts: list[ir.Value]) -> ir.Value:
    """Vectors one after the other; their number is a power of two."""
    while len(parts) > 1:
        count = 2 * parts[0].type.count
        pairs = zip(parts[::2], parts[1::2], strict=True)
        parts = [_shuffled(builder, a, b, range(count)) for a, b in pairs]
    return parts[0]


def _zipped(builder: ir.IRBuilder, parts: list[ir.Value]) -> ir.Value:
    """First elements of all vectors, then the second ones, ...; as many as a power of two."""
    if len(parts) == 1:
        return parts[0]
    a, b = _zipped(builder, parts[::2]), _zipped(builder, parts[1::2])
    count = a.type.count
    return _shuffled(builder, a, b, (k for i in range(count) for k in (i, count + i)))


def _after(builder: ir.IRBuilder, first: ir.Value, k: ir.Value, stride: ir.Value) -> ir.Value:
    """first + k stride"""
    return builder.add(first, builder.mul(k, stride))


def _place(builder: ir.IRBuilder, data: ir.Value, offset: ir.Value, kind: ir.Type) -> ir.Value:
    """Address of an element by its number, as one of another type."""
    return builder.bitcast(builder.gep(data, [offset]), kind.as_pointer())


def _element(builder: ir.IRBuilder, data: ir.Value, offset: ir.Value) -> ir.Value:
    """Address of an element by its offset in bytes."""
    bytes_ = builder.bitcast(data, ir.IntType(8).as_pointer())
    return builder.bitcast(builder.gep(bytes_, [offset]), data.type)


def _converted(builder: ir.IRBuilder, value: ir.Value, kind: ir.Type) -> ir.Value:
    """A number, or a vector of them, in another precision."""
    if value.type == kind:
        return value
    narrower = isinstance(getattr(kind, "element", kind), ir.FloatType)
    return builder.fptrunc(value, kind) if narrower else builder.fpext(value, kind)
