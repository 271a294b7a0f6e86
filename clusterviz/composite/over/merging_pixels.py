"""Merge operators other than over: LLVM code for vectors of float pixels, and the compiled loops around it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]

from clusterviz.composite.over import vector_code
from clusterviz.composite.over.intrinsics import PixelLoop, choose_loop
from clusterviz.composite.over.job import FIRST_RUN, FLOAT, MAXIMUM, MINIMUM, SUM, TWO_FLUX
from clusterviz.composite.over.vector_code import splat
from clusterviz.image.merge import CLOSED, EXISTS, STARTS

_FLOAT, _I32 = ir.FloatType(), ir.IntType(32)


def maximum(builder: Any, front: Any, behind: Any) -> Any:
    """Return the larger scalar, where there are two."""
    return _where_both(builder, front, behind, _larger(builder, front, behind))


def minimum(builder: Any, front: Any, behind: Any) -> Any:
    """Return the smaller scalar, where there are two."""
    smaller = builder.select(builder.fcmp_ordered("<", behind, front), behind, front)
    return _where_both(builder, front, behind, smaller)


def add(builder: Any, front: Any, behind: Any) -> Any:
    """Return the sums of scalars and of slabs."""
    return builder.fadd(front, behind)


def first_run(builder: Any, front: Any, behind: Any) -> Any:
    """Return the first run: that of the front, the front's continued behind, or that behind."""
    lanes = front.type.count
    words = ir.VectorType(_I32, lanes)
    ahead, after = (builder.fptosi(_component(builder, pixels, 2), words) for pixels in (front, behind))
    starts, closed, exists, zero = (splat(_I32, bits, lanes) for bits in (STARTS, CLOSED, EXISTS, 0))
    is_there = builder.icmp_signed("!=", builder.and_(ahead, exists), zero)
    is_open = builder.icmp_signed("==", builder.and_(ahead, splat(_I32, EXISTS | CLOSED, lanes)), exists)
    goes_on = builder.and_(is_open, builder.icmp_signed("!=", builder.and_(after, starts), zero))
    larger = _larger(builder, front, behind)
    first = builder.select(is_there, builder.select(goes_on, larger, front), behind)
    ended = builder.or_(ahead, builder.select(goes_on, builder.and_(after, closed), closed))
    known = builder.select(is_there, ended, builder.and_(after, builder.not_(starts)))
    pixels = _put_component(builder, larger, 0, first)
    pixels = _put_component(builder, pixels, 2, builder.sitofp(known, front.type))
    return _where_both(builder, front, behind, pixels)


def two_flux(builder: Any, front: Any, behind: Any) -> Any:
    """Return the fluxes of two stacks, in the order of operations of `image.spectral.two_flux.stacked`."""
    (f1, b1, t1), (f2, b2, t2) = ([_component(builder, pixels, n) for n in range(3)] for pixels in (front, behind))
    one, zero = (splat(_FLOAT, value, front.type.count) for value in (1.0, 0.0))

    def at_least(value: Any, least: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">", least, value), least, value)

    within = at_least(builder.fsub(one, b1), t1)
    between = builder.fadd(within, builder.fmul(b1, at_least(builder.fsub(one, f2), t2)))
    series = builder.select(builder.fcmp_ordered(">", between, zero), builder.fdiv(one, between), zero)
    through, back = builder.fmul(t1, series), builder.fmul(t2, series)
    pixels = builder.fadd(f1, builder.fmul(t1, builder.fmul(through, f2)))
    pixels = _put_component(builder, pixels, 1, builder.fadd(b2, builder.fmul(t2, builder.fmul(back, b1))))
    pixels = _put_component(builder, pixels, 2, builder.fmul(through, t2))
    return _where_both(builder, front, behind, _put_component(builder, pixels, 3, one))


def _larger(builder: Any, front: Any, behind: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", behind, front), behind, front)


def _where_both(builder: Any, front: Any, behind: Any, both: Any) -> Any:
    """Return `both` where each part has samples, else the part that has some."""
    zero = splat(_FLOAT, 0.0, front.type.count)
    merged = builder.select(builder.fcmp_ordered("==", _component(builder, behind, 3), zero), front, both)
    return builder.select(builder.fcmp_ordered("==", _component(builder, front, 3), zero), behind, merged)


def _component(builder: Any, pixels: Any, number: int) -> Any:
    lanes = [lane // 4 * 4 + number for lane in range(pixels.type.count)]
    return builder.shuffle_vector(pixels, pixels, _lanes(lanes))


def _put_component(builder: Any, pixels: Any, number: int, given: Any) -> Any:
    count = pixels.type.count
    return builder.shuffle_vector(
        pixels, given, _lanes([lane + count if lane % 4 == number else lane for lane in range(count)])
    )


def _lanes(numbers: list[int]) -> Any:
    return ir.Constant(ir.VectorType(_I32, len(numbers)), numbers)


def _merger(merge: Callable[[Any, Any, Any], Any]) -> PixelLoop:
    """Return a loop for target = front merged with behind; the target may be either of them."""

    def emit(builder: Any, pixels: int, target: Any, front: Any, behind: Any) -> None:
        floats = (vector_code.load(builder, FLOAT, address, pixels) for address in (front, behind))
        vector_code.store(builder, FLOAT, target, merge(builder, *floats))

    return PixelLoop((16, 16, 16), 4, emit)


# merge_pixels(operator, target, front, behind, count), of float pixels
_OPERATORS = {MAXIMUM: maximum, MINIMUM: minimum, SUM: add, FIRST_RUN: first_run, TWO_FLUX: two_flux}
merge_pixels = choose_loop({operator: _merger(merge) for operator, merge in _OPERATORS.items()})
