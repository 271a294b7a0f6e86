"""Many layers in one pass, compiled; imported only where something is blended.

One signature serves all types and shapes: the kernel takes the address of a *job*, a table of int64 that `layers.py`
writes. The target is walked in blocks of pixels of a row. A block's sum is kept in float32 in the nearest cache, every
layer's share of the block is added behind it, front to back, and the sum is rounded once into the target.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types
from numba.core.cgutils import alloca_once
from numba.extending import intrinsic

from clusterviz.composite import vector_code
from clusterviz.composite.vector_code import BYTE, CHANNEL_BYTES, FLOAT, HALF

# A job begins with the target: pixels, type, how many; layers, how many of them in the front group, width of the canvas.
OUT, KIND, SIZE, LAYERS, SPLIT, WIDTH = range(6)
# Then where the target's pixels are, in six numbers, as each layer's.
HEAD = 12
# A layer: pixels, type, stored pixels, runs, number of runs; where its pixels are; which run comes next, and how many
# pixels of the runs before it are stored.
PIXELS, TYPE, STORED, RUNS, RUN_COUNT, PLACE = range(6)
RUN, PASSED = 11, 12
LAYER = 13
# Where pixels are: begin and end of a range, and the four sides of a rectangle; the kernel makes of them how many pixels of
# the rectangle come before the range, how many are in it, and the rectangle's corner, width and height.
FIRST, COUNT, X, Y, ACROSS, DOWN = range(6)

BLOCK = 512  # pixels; two sums of 8 KiB lie in the nearest cache, beside a block of a layer
_SUM_BYTES = 16  # of a pixel


def _compiled(function: Callable[..., Any], cache: bool = False) -> Any:
    return numba.njit(cache=cache, nogil=True, error_model="numpy")(function)


def _instruction(emit: Callable[[Any, Any, Any], Any], result: Any = types.void) -> Any:
    """A function of two int64 for numba, from what emits its code."""

    @intrinsic
    def instruction(typing_context, first, second):  # type: ignore[no-untyped-def]
        def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
            made = emit(builder, *args)
            return context.get_dummy_value() if result is types.void else made

        return result(types.int64, types.int64), generate

    return instruction


_I64 = ir.IntType(64)


def _offset(builder: Any, address: Any, bytes_: int) -> Any:
    return builder.add(address, ir.Constant(_I64, bytes_)) if bytes_ else address


def _adder(kind: int, pixels: int) -> Any:
    """sum = sum over source, so many pixels, four at a time."""
    at_once = min(pixels, 4)

    def emit(builder: Any, total: Any, source: Any) -> None:
        for k in range(0, pixels, at_once):
            here = _offset(builder, total, k * _SUM_BYTES)
            there = _offset(builder, source, k * 4 * CHANNEL_BYTES[kind])
            front = vector_code.load(builder, FLOAT, here, at_once)
            back = vector_code.load(builder, kind, there, at_once)
            vector_code.store(builder, FLOAT, here, vector_code.over(builder, front, back))

    return _instruction(emit)


def _writer(kind: int, pixels: int) -> Any:
    """target = sum, so many pixels, four at a time."""
    at_once = min(pixels, 4)

    def emit(builder: Any, target: Any, total: Any) -> None:
        for k in range(0, pixels, at_once):
            there = _offset(builder, target, k * 4 * CHANNEL_BYTES[kind])
            floats = vector_code.load(builder, FLOAT, _offset(builder, total, k * _SUM_BYTES), at_once)
            vector_code.store(builder, kind, there, floats)

    return _instruction(emit)


def _emit_word(builder: Any, address: Any, index: Any) -> Any:
    return builder.load(builder.gep(vector_code.place(builder, address, _I64, 1), [index]))


# 64 bytes of each type, and one pixel.
_add_floats, _add_bytes, _add_halves = _adder(FLOAT, 4), _adder(BYTE, 16), _adder(HALF, 8)
_add_float, _add_byte, _add_half = _adder(FLOAT, 1), _adder(BYTE, 1), _adder(HALF, 1)
_write_floats, _write_bytes, _write_halves = _writer(FLOAT, 16), _writer(BYTE, 16), _writer(HALF, 16)
_write_float, _write_byte, _write_half = _writer(FLOAT, 1), _writer(BYTE, 1), _writer(HALF, 1)


def _pointer(builder: Any, address: Any, index: Any, element: Any) -> Any:
    return builder.gep(builder.inttoptr(address, element.as_pointer()), [index])


_word = _instruction(lambda b, address, index: b.load(_pointer(b, address, index, _I64)), types.int64)
_int = _instruction(
    lambda b, address, index: b.sext(b.load(_pointer(b, address, index, ir.IntType(32))), _I64), types.int64
)
_alpha = _instruction(lambda b, address, index: b.load(_pointer(b, address, index, ir.FloatType())), types.float32)
_any_set = _instruction(lambda b, address, _: vector_code.any_set(b, address, 64), types.boolean)


@intrinsic
def _set_word(typing_context, address, index, value):  # type: ignore[no-untyped-def]
    """The word at an index of a table."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        builder.store(args[2], _pointer(builder, args[0], args[1], _I64))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), generate


@intrinsic
def _clear(typing_context, address, bytes_):  # type: ignore[no-untyped-def]
    """Zero so many bytes."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        pointer = builder.inttoptr(args[0], ir.IntType(8).as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, ir.IntType(8), _I64, ir.IntType(1)])
        fill = builder.module.declare_intrinsic("llvm.memset", [pointer.type, _I64], kind)
        builder.call(fill, [pointer, ir.Constant(ir.IntType(8), 0), args[1], ir.Constant(ir.IntType(1), 0)])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), generate


@intrinsic
def _scratch(typing_context, blocks):  # type: ignore[no-untyped-def]
    """The address of two blocks of sums on the stack."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        buffer = alloca_once(builder, ir.ArrayType(ir.VectorType(ir.FloatType(), 16), 2 * BLOCK // 4))
        return builder.ptrtoint(buffer, _I64)

    return types.int64(types.int64), generate


@_compiled
def _add(kind, total, source, count):  # type: ignore[no-untyped-def]
    """total = total over source; a stretch of 64 bytes that is zero adds nothing."""
    if kind == BYTE:
        whole = count // 16 * 16
        for i in range(0, whole, 16):
            if _any_set(source + 4 * i, 0):
                _add_bytes(total + 16 * i, source + 4 * i)
        for i in range(whole, count):
            _add_byte(total + 16 * i, source + 4 * i)
    elif kind == HALF:
        whole = count // 8 * 8
        for i in range(0, whole, 8):
            if _any_set(source + 8 * i, 0):
                _add_halves(total + 16 * i, source + 8 * i)
        for i in range(whole, count):
            _add_half(total + 16 * i, source + 8 * i)
    else:
        whole = count // 4 * 4
        for i in range(0, whole, 4):
            if _any_set(source + 16 * i, 0):
                _add_floats(total + 16 * i, source + 16 * i)
        for i in range(whole, count):
            _add_float(total + 16 * i, source + 16 * i)


@_compiled
def _write(kind, target, total, count):  # type: ignore[no-untyped-def]
    """target = total, rounded."""
    whole = count // 16 * 16
    if kind == BYTE:
        for i in range(0, whole, 16):
            _write_bytes(target + 4 * i, total + 16 * i)
        for i in range(whole, count):
            _write_byte(target + 4 * i, total + 16 * i)
    elif kind == HALF:
        for i in range(0, whole, 16):
            _write_halves(target + 8 * i, total + 16 * i)
        for i in range(whole, count):
            _write_half(target + 8 * i, total + 16 * i)
    else:
        for i in range(0, whole, 16):
            _write_floats(target + 16 * i, total + 16 * i)
        for i in range(whole, count):
            _write_float(target + 16 * i, total + 16 * i)


@_compiled
def _before(number, width, x, y, across, down):  # type: ignore[no-untyped-def]
    """How many pixels of a rectangle come before a number, as `Patch` counts them."""
    if width == 0 or across == 0:
        return 0
    row = number // width
    if row < y:
        return 0
    if row >= y + down:
        return across * down
    return (row - y) * across + min(max(number - row * width - x, 0), across)


@_compiled
def _settle(place, width):  # type: ignore[no-untyped-def]
    """Make of a range and the sides of a rectangle what the loops need."""
    begin, end, x, y = _word(place, FIRST), _word(place, COUNT), _word(place, X), _word(place, Y)
    across, down = max(0, _word(place, ACROSS) - x), max(0, _word(place, DOWN) - y)
    if down == 0:
        across = 0
    first = _before(begin, width, x, y, across, down)
    _set_word(place, FIRST, first)
    _set_word(place, COUNT, max(0, _before(end, width, x, y, across, down) - first))
    _set_word(place, ACROSS, across)
    _set_word(place, DOWN, down)


@_compiled
def _straighten(place):  # type: ignore[no-untyped-def]
    """Lay the rows of a rectangle as wide as the canvas end to end."""
    across = _word(place, ACROSS)
    _set_word(place, X, _word(place, X) + _word(place, Y) * across)
    _set_word(place, ACROSS, across * _word(place, DOWN))
    _set_word(place, Y, 0)
    _set_word(place, DOWN, 1)


@_compiled
def _settle_all(job):  # type: ignore[no-untyped-def]
    """Prepare all places; where target and layers are as wide as the canvas, their rows become one.

    Returns the first layer that stores another number of pixels than it has, -1 where all are right.
    """
    width, target = _word(job, WIDTH), job + 8 * (WIDTH + 1)
    _settle(target, width)
    wide = _word(target, ACROSS) == width
    layers = _word(job, LAYERS)
    for number in range(layers):
        place = job + 8 * (HEAD + LAYER * number + PLACE)
        _settle(place, width)
        wide = wide and (_word(place, ACROSS) == width or _word(place, COUNT) == 0)
        layer = place - 8 * PLACE
        if _word(layer, RUN_COUNT) < 0 and _word(layer, STORED) != _word(place, COUNT):
            return number
    if wide:
        _straighten(target)
        for number in range(layers):
            _straighten(job + 8 * (HEAD + LAYER * number + PLACE))
    return -1


@_compiled
def _opaque(total, count):  # type: ignore[no-untyped-def]
    """Whether nothing behind these pixels can be seen."""
    for i in range(count):  # noqa: SIM110, compiled
        if _alpha(total, 4 * i + 3) != 1:
            return False
    return True


@_compiled
def _add_runs(layer, total, low, high):  # type: ignore[no-untyped-def]
    """The active pixels of a layer among its own pixels [low, high), of which `total` holds the sums."""
    kind, pixels, runs = _word(layer, TYPE), _word(layer, PIXELS), _word(layer, RUNS)
    size = 16 if kind == FLOAT else 8 if kind == HALF else 4
    run, passed, stored = _word(layer, RUN), _word(layer, PASSED), _word(layer, STORED)
    while run < _word(layer, RUN_COUNT):
        first, length = _int(runs, 2 * run), _int(runs, 2 * run + 1)
        if first >= high:
            break
        begin, end = max(first, low), min(first + length, high)
        source = passed + begin - first
        # Runs that claim more pixels than are stored are cut, so nothing else is ever read.
        end = min(end, begin + stored - source)
        if begin < end and source >= 0:
            _add(kind, total + (begin - low) * 16, pixels + source * size, end - begin)
        if first + length > high:
            break
        run, passed = run + 1, passed + max(length, 0)
    _set_word(layer, RUN, run)
    _set_word(layer, PASSED, passed)


@_compiled
def _add_layer(layer, total, x, y, count, touched):  # type: ignore[no-untyped-def]
    """What a layer has of the pixels [x, x + count) of row y; returns whether `total` holds anything now."""
    place = layer + 8 * PLACE
    row = y - _word(place, Y)
    if row < 0 or row >= _word(place, DOWN):
        return touched
    left, across = _word(place, X), _word(place, ACROSS)
    begin, end = max(x, left), min(x + count, left + across)
    # The layer's own pixels, of which it may hold only some.
    start = row * across - left - _word(place, FIRST)
    low, high = max(begin + start, 0), min(end + start, _word(place, COUNT))
    if low >= high:
        return touched
    if not touched:
        _clear(total, count * 16)
    here = total + (low - start - x) * 16
    if _word(layer, RUN_COUNT) >= 0:
        _add_runs(layer, here, low, high)
    else:
        kind = _word(layer, TYPE)
        size = 16 if kind == FLOAT else 8 if kind == HALF else 4
        _add(kind, here, _word(layer, PIXELS) + low * size, high - low)
    return True


@_compiled
def _add_group(job, first, last, total, x, y, count):  # type: ignore[no-untyped-def]
    """total = the layers [first, last) over each other; returns whether it holds anything."""
    touched = False
    for number in range(first, last):
        if touched and _opaque(total, count):
            break
        touched = _add_layer(job + 8 * (HEAD + LAYER * number), total, x, y, count, touched)
    return touched


@_compiled
def _block(job, target, total, x, y, count):  # type: ignore[no-untyped-def]
    """One block of the target: front group over back group, rounded."""
    kind, layers, split = _word(job, KIND), _word(job, LAYERS), _word(job, SPLIT)
    back_total = total + BLOCK * 16
    front = _add_group(job, 0, split, total, x, y, count)
    back = False
    if not (front and _opaque(total, count)):
        back = _add_group(job, split, layers, back_total, x, y, count)
    if front and back:
        _add(FLOAT, total, back_total, count)
    if front or back:
        _write(kind, target, total if front else back_total, count)
    else:
        _clear(target, count * (16 if kind == FLOAT else 8 if kind == HALF else 4))


def _blend_layers(job):  # type: ignore[no-untyped-def]
    """Do a job: every pixel of the target is written; returns the layer that is wrong, or -1."""
    fault = _settle_all(job)
    if fault >= 0:
        return fault
    place, total = job + 8 * (WIDTH + 1), _scratch(2)
    first, count, across = _word(place, FIRST), _word(place, COUNT), _word(place, ACROSS)
    kind = _word(job, KIND)
    size = 16 if kind == FLOAT else 8 if kind == HALF else 4
    done = 0
    while done < count:
        row = (first + done) // across
        column = first + done - row * across
        length = min(across - column, count - done, BLOCK)
        target = _word(job, OUT) + done * size
        _block(job, target, total, _word(place, X) + column, _word(place, Y) + row, length)
        done += length
    return -1


blend_layers = _compiled(_blend_layers, cache=True)
