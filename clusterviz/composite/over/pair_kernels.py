"""Compiled kernel for two images: one over the other in place."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]

from clusterviz.composite.over import job as entry
from clusterviz.composite.over import vector_code
from clusterviz.composite.over.geometry import block, clip, layer_at, pixel_bytes, prepare_geometry
from clusterviz.composite.over.intrinsics import PixelLoop, choose_loop, word
from clusterviz.composite.over.merging_pixels import merge_pixels
from clusterviz.composite.over.vector_code import PIXEL_BYTES


def _blender(kind: int) -> PixelLoop:
    """Return a loop for target = front over back; the target may be either of them."""

    def emit(builder: Any, pixels: int, target: Any, front: Any, back: Any) -> None:
        if kind == entry.BYTE:
            vector = ir.VectorType(ir.IntType(8), 4 * pixels)
            there, *seen = (builder.inttoptr(address, vector.as_pointer()) for address in (target, front, back))
            blended = vector_code.over_bytes(builder, *(builder.load(place, align=1) for place in seen))
            builder.store(blended, there, align=1)
        else:
            floats = (vector_code.load(builder, kind, address, pixels) for address in (front, back))
            vector_code.store(builder, kind, target, vector_code.over(builder, *floats))

    size = PIXEL_BYTES[kind]
    return PixelLoop((size, size, size), 64 // size, emit)


# _over(kind, target, front, back, count)
_over = choose_loop({kind: _blender(kind) for kind in PIXEL_BYTES})


def put(job):  # type: ignore[no-untyped-def]
    """Blend one layer into the target; return the result of `prepare_geometry`."""
    fault, done = prepare_geometry(job), 0
    if fault != entry.OK:
        return fault
    kind, mode, operator, layer = (
        word(job, entry.KIND),
        word(job, entry.MODE),
        word(job, entry.OPERATOR),
        layer_at(job, 0),
    )
    size = pixel_bytes(kind)
    while done < word(job + 8 * entry.TARGET, entry.COUNT):
        x, y, count = block(job, done, word(job, entry.SIZE))
        low, high, begin = clip(layer, x, y, count)
        if low < high:
            target, source = word(job, entry.OUT) + (done + begin) * size, word(layer, entry.PIXELS) + low * size
            front, back = target if mode == entry.BEHIND else source, target if mode == entry.BEFORE else source
            if operator == entry.OVER:
                _over(kind, target, front, back, high - low)
            else:
                merge_pixels(operator, target, front, back, high - low)
        done += count
    return entry.OK
