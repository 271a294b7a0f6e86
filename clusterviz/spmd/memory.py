"""Uniform blocks, storage buffers and arrays in memory: loads and stores, of all lanes or lane by lane."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

from clusterviz.spmd.checker import FOLDED
from clusterviz.spmd.emitter import LLVM, Part, constant
from clusterviz.spmd.ir import Expression, Memory, Program
from clusterviz.spmd.types import BYTES
from clusterviz.spmd.variables import Cell, Parts, Variables, elements_of

SYSTEM_BLOCK = 48  # number of the group, numbers of groups, and the first invocation's number in its group: uint32 (7,)
BUFFERS = 16  # number of the first storage buffer in the table of addresses; uniform blocks come first


def _offsets(kind: Any, uniform: bool) -> list[int]:
    """Return the bytes from the begin of a value in a block to each of its scalars."""
    if kind.fields:
        return [kind.offset(name, uniform) + at for name, of in kind.fields for at in _offsets(of, uniform)]
    if kind.of:
        return [n * kind.of.stride(uniform) + at for n in range(kind.size) for at in _offsets(kind.of, uniform)]
    return [n * BYTES[kind.element] for n in range(kind.size)]


class Blocks(Variables):
    """Loads and stores in blocks."""

    def __init__(self, program: Program, lanes: int) -> None:
        super().__init__(lanes)
        self._program = program

    @abstractmethod
    def value(self, node: Expression) -> Parts:
        """Return the scalars of a value."""

    def _begin(self, name: str) -> None:
        super()._begin(name)
        self._addresses: dict[int, str] = {}
        for block in self._program.blocks:
            number = block.binding + (0 if block.kind == "uniform" else BUFFERS)
            place = self.emit.new(f"getelementptr ptr, ptr %blocks, i64 {number}")
            self._addresses[id(block)] = self.emit.new(f"load ptr, ptr {place}, !invariant.load !0")

    def address_of(self, block: str) -> str:
        """Return the address of a block's data."""
        return next(self._addresses[id(one)] for one in self._program.blocks if one.name == block)

    def _words(self, node: Memory) -> Part:
        """Return where a value begins, in words of four bytes from the begin of its block."""
        found = constant("i", node.offset // 4)
        for index, stride in node.terms:
            (number,) = self.value(index)
            by = self._binary("*", Part(number.text, "i", number.varying, number.constant), constant("i", stride // 4))
            found = self._binary("+", by, found)
        return found

    def _fetch(self, node: Memory, numbers: Sequence[int]) -> Parts:
        emit, elements, words = self.emit, elements_of(node.type), self._words(node)
        base, read_only = self._addresses[id(node.block)], node.block.kind == "uniform" or node.block.is_read_only
        offsets = _offsets(node.type, node.block.kind == "uniform")
        if (
            words.varying
            and node.type.is_vector
            and node.type.size == 4
            and elements[0] in "fd"
            and len(set(numbers)) > 1
        ):
            columns = self._rows(elements[0], base, words)
            return [columns[n] for n in numbers]
        found = []
        for n in numbers:
            at = self._binary("+", words, constant("i", offsets[n] // 4))
            if at.varying:
                found.append(self._gather(elements[n], base, at))
                continue
            place = emit.new(f"getelementptr i32, ptr {base}, {emit.of(at)}")
            note = ", !invariant.load !0" if read_only else ""
            found.append(emit.part(f"load {LLVM[elements[n]]}, ptr {place}, align 4{note}", elements[n], False))
        return found

    def _gather(self, element: str, base: str, at: Part) -> Part:
        """Load a number a lane; `at` counts words of four bytes, also for those of eight."""
        emit, lanes = self.emit, self.lanes
        kind, pointers = emit.kind(element, True), f"<{lanes} x ptr>"
        places = emit.new(f"getelementptr i32, ptr {base}, {emit.of(at)}")
        name = f"llvm.masked.gather.v{lanes}{'f' if element in 'fd' else 'i'}{8 * BYTES[element]}.v{lanes}p0"
        emit.declare(name, kind, [pointers, "i32", emit.kind("b", True), kind])
        mask = emit.of(emit.spread(self._full()))
        return emit.part(f"call {kind} @{name}({pointers} {places}, i32 4, {mask}, {kind} poison)", element, True)

    def _rows(self, element: str, base: str, words: Part) -> Parts:
        """Load four numbers a lane, with one load each, and turn them into vectors; gathers would take longer."""
        emit, lanes = self.emit, self.lanes
        if self.mask is not None:
            words = emit.select(self.mask, words, constant("i", 0))
        quads = []
        for lane in range(lanes):
            place = emit.new(f"getelementptr i32, ptr {base}, {emit.of(emit.lane(words, lane))}")
            quads.append(emit.new(f"load <4 x {LLVM[element]}>, ptr {place}, align 4, !invariant.load !0"))

        def mixed(a: str, b: str, numbers: Sequence[int], size: int) -> str:
            kind = f"<{size} x {LLVM[element]}>"
            chosen = ", ".join(f"i32 {n}" for n in numbers)
            return emit.new(f"shufflevector {kind} {a}, {kind} {b}, <{len(numbers)} x i32> <{chosen}>")

        groups = []
        for start in range(4):  # rows start, start + 4, …, so that each quarter of the lanes is turned by itself
            parts, size = quads[start::4], 4
            while len(parts) > 1:
                parts = [mixed(a, b, range(2 * size), size) for a, b in zip(parts[::2], parts[1::2], strict=True)]
                size *= 2
            groups.append(parts[0])

        def turned(a: str, b: str, pattern: Sequence[int]) -> str:
            quarters = range(0, lanes, 4)
            return mixed(a, b, [q + (n if n < 4 else lanes + n - 4) for q in quarters for n in pattern], lanes)

        low, high, left, right = (0, 4, 1, 5), (2, 6, 3, 7), (0, 1, 4, 5), (2, 3, 6, 7)
        pairs = [turned(groups[k], groups[k + 1], half) for half in (low, high) for k in (0, 2)]
        columns = [turned(pairs[k], pairs[k + 1], side) for k in (0, 2) for side in (left, right)]
        return [Part(column, element, True) for column in columns]

    def _scatter(self, part: Part, base: str, at: Part) -> None:
        emit, lanes = self.emit, self.lanes
        kind, pointers = emit.kind(part.element, True), f"<{lanes} x ptr>"
        places = emit.new(f"getelementptr i32, ptr {base}, {emit.of(at)}")
        name = f"llvm.masked.scatter.v{lanes}{'f' if part.element in 'fd' else 'i'}{8 * BYTES[part.element]}.v{lanes}p0"
        emit.declare(name, "void", [kind, pointers, "i32", emit.kind("b", True)])
        emit.line(f"call void @{name}({emit.of(part)}, {pointers} {places}, i32 4, {emit.of(self._full())})")

    def _put(self, node: Memory, numbers: Sequence[int], parts: Parts) -> None:
        emit, words, base = self.emit, self._words(node), self._addresses[id(node.block)]
        offsets = _offsets(node.type, False)
        for n, part in zip(numbers, parts, strict=True):
            at = self._binary("+", words, constant("i", offsets[n] // 4))
            if at.varying:
                self._scatter(emit.spread(part), base, at)
                continue
            self._store_once(part, emit.new(f"getelementptr i32, ptr {base}, {emit.of(at)}"))

    # Numbers

    def lane_numbers(self, element: str) -> Part:
        """Return 0, 1, 2, … in the lanes."""
        lanes = ", ".join(f"{LLVM[element]} {lane}" for lane in range(self.lanes))
        return Part(f"<{lanes}>", element, True)

    def _own_words(self, cell: Cell, index: Part) -> Part:
        """Return where each lane's element of an array lies, in words."""
        words = BYTES[cell.element] // 4
        if not cell.varying:
            return self._binary("*", index, constant("i", words))
        by = self._binary("*", index, constant("i", words * self.lanes))
        return self.emit.binary("+", by, self._binary("*", self.lane_numbers("i"), constant("i", words)))

    def _binary(self, sign: str, a: Part, b: Part) -> Part:
        if (
            a.constant is not None
            and b.constant is not None
            and a.element in "iub"
            and (b.constant or sign not in "/%")
        ):
            found = FOLDED[sign](int(a.constant), int(b.constant))
            if a.element != "b":
                low = 0 if a.element == "u" else -(1 << 31)
                found = (found - low) % (1 << 32) + low
            return constant(a.element, found)
        if a.element in "iu" and b.constant == 0 and sign in ("+", "-", "<<", ">>"):
            return a
        if a.element in "iu" and b.constant == 1 and sign in ("*", "/"):
            return a
        return self.emit.binary(sign, a, b)
