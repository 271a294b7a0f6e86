"""Functions of int64 addresses for numba: loads, stores, and other LLVM code.

Kernels take addresses instead of arrays, so that one signature serves all types, shapes and read-only arrays. Arrays
are checked in Python (`job.py`). No function here raises, so none needs Python.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types

from clusterviz.codec.intrinsics import define_intrinsic
from clusterviz.composite.over import vector_code

# numba's functions have no type annotations.
_on_stack: Callable[..., Any] = cgutils.alloca_once
_range: Callable[..., Any] = cgutils.for_range

_BYTE, _INT, _WORD = ir.IntType(8), ir.IntType(32), ir.IntType(64)


@dataclass(frozen=True)
class PixelLoop:
    """Loop over pixels, some at a time and then one after the other."""

    strides: tuple[int, ...]  # bytes of a pixel at each address; 0 for a number that stays
    pixels: int  # number of pixels at a time
    emit: Callable[..., None]  # writes code for some pixels, `emit(builder, pixels, *addresses)`

    def __call__(self, builder: Any, addresses: Sequence[Any], count: Any) -> None:
        blocks, zero = builder.sdiv(count, ir.Constant(_WORD, self.pixels)), ir.Constant(_WORD, 0)
        rest = builder.mul(blocks, ir.Constant(_WORD, self.pixels))
        for pixels, begin, end in ((self.pixels, zero, blocks), (1, rest, count)):
            with _range(builder, end, begin) as loop:
                steps = [builder.mul(loop.index, ir.Constant(_WORD, stride * pixels)) for stride in self.strides]
                self.emit(builder, pixels, *map(builder.add, addresses, steps))


def choose_loop(loops: Mapping[int, PixelLoop]) -> Any:
    """Return a numba function of the number of a loop, its addresses and the count of pixels."""

    def emit(builder: Any, chosen: Any, *given: Any) -> None:
        for number, loop in loops.items():
            with builder.if_then(builder.icmp_signed("==", chosen, ir.Constant(_WORD, number))):
                loop(builder, given[:-1], given[-1])

    return define_intrinsic(2 + len(next(iter(loops.values())).strides), emit)


def _pointer(builder: Any, address: Any, index: Any, element: Any) -> Any:
    return builder.gep(builder.inttoptr(address, element.as_pointer()), [index])


def _load_int(builder: Any, address: Any, index: Any) -> Any:
    return builder.sext(builder.load(_pointer(builder, address, index, _INT), align=1), _WORD)


def _load_alpha(builder: Any, address: Any, pixel: Any) -> Any:
    lane = builder.add(builder.shl(pixel, ir.Constant(_WORD, 2)), ir.Constant(_WORD, 3))
    return builder.load(_pointer(builder, address, lane, ir.FloatType()))


def _fill(builder: Any, address: Any, bytes_: Any) -> None:
    pointer = builder.inttoptr(address, _BYTE.as_pointer())
    kind = ir.FunctionType(ir.VoidType(), [pointer.type, _BYTE, _WORD, ir.IntType(1)])
    fill = builder.module.declare_intrinsic("llvm.memset", [pointer.type, _WORD], kind)
    builder.call(fill, [pointer, ir.Constant(_BYTE, 0), bytes_, ir.Constant(ir.IntType(1), 0)])


# word(address, index), number(address, index): the int64 or int32 at an index of a table.
word = define_intrinsic(2, lambda b, address, index: b.load(_pointer(b, address, index, _WORD)), types.int64)
number = define_intrinsic(2, _load_int, types.int64)
# set_word(address, index, value)
set_word = define_intrinsic(3, lambda b, address, index, value: b.store(value, _pointer(b, address, index, _WORD)))
# alpha(address, pixel): the alpha of a float pixel.
alpha = define_intrinsic(2, _load_alpha, types.float32)
# any_set(address): whether any bit of 64 bytes is set.
any_set = define_intrinsic(1, lambda b, address: vector_code.any_set(b, address, 64), types.boolean)
# clear(address, bytes)
clear = define_intrinsic(2, _fill)


def scratch(bytes_: int) -> Any:
    """Return a function that returns the address of `bytes_` bytes on the stack of its caller."""

    def emit(builder: Any) -> Any:
        lines = ir.ArrayType(ir.VectorType(ir.FloatType(), 16), bytes_ // 64)
        return builder.ptrtoint(_on_stack(builder, lines), _WORD)

    return define_intrinsic(0, emit, types.int64)
