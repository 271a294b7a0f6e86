"""Functions of the shaders that CPUs do in their own way; what each means is its body in GLSL."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from clusterviz.spmd.emitter import Part, constant

if TYPE_CHECKING:
    from clusterviz.spmd.codegen import Generator

BELOW = 1 << 28  # words before the first brick's that addresses without a sign reach, more than lie beside a brick
IDLE_WORD = 32
"""Word that idle lanes read of the first brick of several volumes: behind its header (render/storage.py), whose small
integers would be denormal float32 numbers, which a CPU multiplies slowly."""


def _places(generator: Generator, given: list[list[Part]], lanes: Sequence[int]) -> list[str]:
    """Return the addresses of lanes' words: of a brick's number and a word's; see words.glsl and words_wide.glsl.

    Lanes that are not active read about where the first brick begins, or its voxels, of which all words are in memory.
    """
    emit, ((brick,), (word,), *others) = generator.emit, given
    ((more,),) = others or [[constant("i", 0)]]
    if more.varying:
        word, more = emit.binary("+", word, more), constant("i", 0)
    is_wide = generator.has_block("BasesBlock")
    brick = brick if is_wide else emit.binary("+", emit.binary("+", brick, word), constant("i", BELOW))
    if generator.mask is not None:
        idle = IDLE_WORD if generator.has_block("volumeBlock") else 0
        brick = emit.select(generator.mask, brick, constant("i", 0 if is_wide else idle + BELOW))
        word = emit.select(generator.mask, word, constant("i", idle)) if is_wide else word
    if is_wide:
        bases, found = generator.address_of("BasesBlock"), []
        word = emit.binary("+", word, more)
        for lane in lanes:
            row = emit.new(f"getelementptr i64, ptr {bases}, {emit.of(emit.lane(brick, lane))}")
            base = emit.new(f"load ptr, ptr {row}, align 8, !invariant.load !0")
            found.append(emit.new(f"getelementptr i32, ptr {base}, {emit.of(emit.lane(word, lane))}"))
        return found
    base = emit.new(f"getelementptr i32, ptr {generator.address_of('VoxelsBlock')}, i64 -{BELOW}")
    base = emit.new(f"getelementptr i32, ptr {base}, {emit.of(more)}")
    return [emit.new(f"getelementptr i32, ptr {base}, i64 {number}") for number in emit.offsets(brick, lanes)]


def word_at(generator: Generator, given: list[list[Part]]) -> list[Part]:
    """Return a word, by a load for each lane."""
    emit, lanes = generator.emit, generator.lanes
    kind, words = f"<{lanes} x i32>", "poison"
    for lane, place in enumerate(_places(generator, given, range(lanes))):
        one = emit.new(f"load i32, ptr {place}, align 4, !invariant.load !0")
        words = emit.new(f"insertelement {kind} {words}, i32 {one}, i32 {lane}")
    return [Part(words, "u", True)]


def words_at(generator: Generator, given: list[list[Part]]) -> list[Part]:
    """Return a word and the next one, by a load of 64 bits for each lane, which takes less time than a gather."""
    emit, lanes = generator.emit, generator.lanes
    size = max(1, lanes // 2)
    wide, kind = f"<{size} x i64>", f"<{2 * size} x i32>"
    # Of four lanes two are in each vector, so that a shuffle within 128 bits parts the words.
    both, numbers = ["poison", "poison"], list[int]()
    for lane, place in enumerate(_places(generator, given, range(lanes))):
        one = emit.new(f"load i64, ptr {place}, align 4, !invariant.load !0")
        side, at = lane % 4 // 2, lane // 4 * 2 + lane % 2
        both[side] = emit.new(f"insertelement {wide} {both[side]}, i64 {one}, i32 {at}")
        numbers.append(2 * (size * side + at))
    low, high = (emit.new(f"bitcast {wide} {part} to {kind}") for part in both)
    halves = []
    for half in range(2):
        chosen = ", ".join(f"i32 {number + half}" for number in numbers)
        halves.append(emit.part(f"shufflevector {kind} {low}, {kind} {high}, <{lanes} x i32> <{chosen}>", "u", True))
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


def _in_parts(name: str, bits: int) -> Callable[[Generator, list[list[Part]]], list[Part]]:
    """Return an intrinsic that does an operation of LLVM's with the parts of words, of so many bits each."""

    def found(generator: Generator, given: list[list[Part]]) -> list[Part]:
        emit, ((a,), (b,)) = generator.emit, given
        a, b = emit.spread_all(a, b)
        size = 32 // bits * (generator.lanes if a.varying else 1)
        kind, full = f"<{size} x i{bits}>", f"llvm.{name}.v{size}i{bits}"
        emit.declare(full, kind, [kind, kind])
        parts = [emit.new(f"bitcast {emit.of(one)} to {kind}") for one in (a, b)]
        both = emit.new(f"call {kind} @{full}({kind} {parts[0]}, {kind} {parts[1]})")
        return [emit.part(f"bitcast {kind} {both} to {emit.kind('u', a.varying)}", "u", a.varying)]

    return found


PREFETCHED = {16: (0, 3, 6, 9, 12, 15), 8: (0, 2, 5, 7), 4: (0, 3), 1: (0,)}
"""Lanes of a packet whose words are brought nearer: its corners, and some between them, stand for the others."""


def prefetch_word(generator: Generator, given: list[list[Part]]) -> list[Part]:
    """Prefetch the cache lines of some lanes' words; those of the first lane are `more` words behind, or of any."""
    emit, (brick, word, (more,)) = generator.emit, given
    given = [brick, word, [emit.part(f"freeze {emit.of(emit.lane(more, 0))}", "i", False)]]
    emit.declare("llvm.prefetch.p0", "void", ["ptr", "i32", "i32", "i32"])
    for place in _places(generator, given, PREFETCHED[generator.lanes]):
        emit.line(f"call void @llvm.prefetch.p0(ptr {place}, i32 0, i32 3, i32 1)")
    return []


INTRINSICS: dict[str, Callable[[Generator, list[list[Part]]], list[Part]]] = {
    "word_at": word_at,
    "words_at": words_at,
    "piece_row": piece_row,
    "prefetch_word": prefetch_word,
    "least_bytes": _in_parts("umin", 8),
    "most_bytes": _in_parts("umax", 8),
    "least_halves": _in_parts("umin", 16),
    "most_halves": _in_parts("umax", 16),
}
