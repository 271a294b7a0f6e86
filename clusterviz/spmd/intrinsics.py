"""Functions of the shaders that CPUs do in their own way; what each means is its body in GLSL."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from clusterviz.spmd.emitter import Part, constant

if TYPE_CHECKING:
    from clusterviz.spmd.codegen import Generator


def words_at(generator: Generator, given: list[list[Part]]) -> list[Part]:
    """Return a word and the next one, by a load of 64 bits for each lane, which takes less time than a gather."""
    emit, lanes = generator.emit, generator.lanes
    (brick,), (word,), (more,) = given
    word = emit.binary("+", brick, word)
    if more.varying:
        word, more = emit.binary("+", word, more), constant("i", 0)
    base = emit.new(f"getelementptr i32, ptr {generator.address_of('VoxelsBlock')}, {emit.of(more)}")
    if generator.mask is not None:
        word = emit.select(generator.mask, word, generator.constant_of("IDLE_WORD"))
    wide = f"<{lanes} x i64>"
    both = "poison"
    for lane in range(lanes):
        place = emit.new(f"zext i32 {emit.lane(word, lane).text} to i64")
        place = emit.new(f"getelementptr i32, ptr {base}, i64 {place}")
        one = emit.new(f"load i64, ptr {place}, align 4, !invariant.load !0")
        both = emit.new(f"insertelement {wide} {both}, i64 {one}, i32 {lane}")
    kind = f"<{2 * lanes} x i32>"
    words = emit.new(f"bitcast {wide} {both} to {kind}")
    halves = []
    for half in range(2):
        numbers = ", ".join(f"i32 {2 * lane + half}" for lane in range(lanes))
        halves.append(emit.part(f"shufflevector {kind} {words}, {kind} poison, <{lanes} x i32> <{numbers}>", "u", True))
    return halves


def piece_row(generator: Generator, given: list[list[Part]]) -> list[Part]:
    """Return numbers of a row of the transfer function's pieces, a register, by a permutation; needs AVX-512."""
    emit, ((row,), (piece,)) = generator.emit, given
    base, kind = generator.address_of("PiecesBlock"), "<16 x float>"
    place = emit.new(f"getelementptr {kind}, ptr {base}, {emit.of(row)}")
    table = emit.part(f"load {kind}, ptr {place}, align 4, !invariant.load !0", "f", True)
    if not piece.varying:
        return [emit.part(f"extractelement {emit.of(table)}, {emit.of(piece)}", "f", False)]
    name = "llvm.x86.avx512.permvar.sf.512"
    emit.declare(name, kind, [kind, "<16 x i32>"])
    return [emit.part(f"call {kind} @{name}({emit.of(table)}, {emit.of(piece)})", "f", True)]


def _by_bytes(name: str) -> Callable[[Generator, list[list[Part]]], list[Part]]:
    """Return an intrinsic that does an operation of LLVM's with the bytes of words."""

    def found(generator: Generator, given: list[list[Part]]) -> list[Part]:
        emit, ((a,), (b,)) = generator.emit, given
        a, b = emit.spread_all(a, b)
        size = 4 * (generator.lanes if a.varying else 1)
        kind, full = f"<{size} x i8>", f"llvm.{name}.v{size}i8"
        emit.declare(full, kind, [kind, kind])
        bytes_of = [emit.new(f"bitcast {emit.of(one)} to {kind}") for one in (a, b)]
        both = emit.new(f"call {kind} @{full}({kind} {bytes_of[0]}, {kind} {bytes_of[1]})")
        return [emit.part(f"bitcast {kind} {both} to {emit.kind('u', a.varying)}", "u", a.varying)]

    return found


PREFETCHED = {16: (0, 3, 6, 9, 12, 15), 8: (0, 2, 5, 7), 4: (0, 3), 1: (0,)}
"""Lanes of a packet whose words are brought nearer: its corners, and some between them, stand for the others."""


def prefetch_word(generator: Generator, given: list[list[Part]]) -> list[Part]:
    """Prefetch the cache lines of some lanes' words."""
    emit, ((brick,), (word,)) = generator.emit, given
    word = emit.binary("+", brick, word)
    emit.declare("llvm.prefetch.p0", "void", ["ptr", "i32", "i32", "i32"])
    for lane in PREFETCHED[generator.lanes]:
        far = emit.new(f"zext i32 {emit.lane(word, lane).text} to i64")
        place = emit.new(f"getelementptr i32, ptr {generator.address_of('VoxelsBlock')}, i64 {far}")
        emit.line(f"call void @llvm.prefetch.p0(ptr {place}, i32 0, i32 3, i32 1)")
    return []


INTRINSICS: dict[str, Callable[[Generator, list[list[Part]]], list[Part]]] = {
    "words_at": words_at,
    "piece_row": piece_row,
    "prefetch_word": prefetch_word,
    "least_bytes": _by_bytes("umin"),
    "most_bytes": _by_bytes("umax"),
}
