"""Masks of the active lanes, variables that lanes assign, and uniform blocks, storage buffers and arrays in memory."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from clusterviz.spmd.checker import OPERATORS
from clusterviz.spmd.emitter import LLVM, Emitter, Part, constant
from clusterviz.spmd.ir import BUFFERS, TEXTURES, Expression, Memory, Operation, Program, Variable
from clusterviz.spmd.types import BYTES, elements_of, layout

Key = tuple[Any, ...]
Parts = list[Part]
Binding = list["Cell"] | Parts


@dataclass(slots=True)
class Cell:
    """Memory of one scalar of a variable; an array has `count` of them."""

    address: str
    element: str
    varying: bool
    mask: int
    key: Key
    count: int = 0


TABLE = {"uniform": 0, "buffer": BUFFERS, "sampler": TEXTURES}
MOST_ADDED = 64  # to indices, as part of an address


class Variables:
    """Active lanes, the memory of variables, and loads and stores in blocks."""

    emit: Emitter
    mask: Part | None  # lanes that are active; None: all

    def __init__(self, program: Program, lanes: int) -> None:
        self._program, self.lanes = program, lanes
        self._varying = set[Key]()

    def _emitter(self, name: str, caller: Emitter | None = None) -> Emitter:
        """Return the emitter of a function."""
        return Emitter(name, self.lanes, caller)

    def _begin(self, name: str) -> None:
        self.emit, self.mask = self._emitter(name), None
        self._mask_id = self._masks = 0
        self._bindings: dict[int, Binding] = {}
        self._load_addresses()

    @abstractmethod
    def value(self, node: Expression) -> Parts:
        """Return the scalars of a value."""

    # Masks

    def _narrow(self, mask: Part) -> None:
        self._masks += 1
        self.mask, self._mask_id = mask, self._masks

    @contextmanager
    def _within(self, mask: Part) -> Iterator[None]:
        """Generate code for the lanes of a mask among those that are active."""
        before = self.mask, self._mask_id
        self._narrow(mask)
        yield
        self.mask, self._mask_id = before

    @contextmanager
    def _for_lanes(self, mask: Part, skips: bool) -> Iterator[str]:
        """Generate code for the lanes of a mask, and skip it where there are none; the value is the label behind it."""
        end = self.emit.label()
        if skips:
            begin = self.emit.label()
            self.emit.branch(self.emit.any(mask), begin, end)
            self.emit.begin(begin)
        with self._within(mask):
            yield end
        self.emit.begin(end)

    def _load_mask(self, address: str) -> Part:
        return self.emit.part(f"load {self.emit.kind('b', True)}, ptr {address}", "b", True)

    def _store_mask(self, mask: Part, address: str) -> None:
        self.emit.line(f"store {self.emit.of(self.emit.spread(mask))}, ptr {address}")

    def _full(self) -> Part:
        return self.mask if self.mask is not None else self.emit.spread(constant("b", True))

    # Variables

    def _cells(self, variable: Variable, key: Key) -> list[Cell]:
        kind, count = variable.type, 0
        if kind.is_array:
            assert kind.of is not None
            kind, count = kind.of, kind.size
        return self._room(elements_of(kind), key, count)

    def _room(self, elements: str, key: Key, count: int = 0) -> list[Cell]:
        found = []
        for number, element in enumerate(elements):
            own = (*key, number)
            varying = own in self._varying
            kind = self.emit.kind(element, varying)
            address = self.emit.room(f"[{count} x {kind}]" if count else kind)
            found.append(Cell(address, element, varying, self._mask_id, own, count))
        return found

    def _vary(self, cell: Cell) -> None:
        """Note that lanes may differ, as this pass finds, whose code is of no use then."""
        self._varying.add(cell.key)
        cell.varying = True

    def _load(self, cell: Cell) -> Part:
        kind = self.emit.kind(cell.element, cell.varying)
        return self.emit.part(f"load {kind}, ptr {cell.address}", cell.element, cell.varying)

    def _store(self, cell: Cell, part: Part, address: str = "") -> None:
        """Assign to a scalar in the active lanes."""
        emit, address = self.emit, address or cell.address
        if cell.key[0] == "shared":
            self._store_once(part, address)
            return
        if not cell.varying and (part.varying or cell.mask != self._mask_id):
            self._vary(cell)
        if cell.varying:
            part = emit.spread(part)
            if cell.mask != self._mask_id and self.mask is not None:
                kind = emit.kind(cell.element, True)
                part = emit.select(self.mask, part, emit.part(f"load {kind}, ptr {address}", cell.element, True))
        emit.line(f"store {emit.of(part)}, ptr {address}")

    def _store_once(self, part: Part, address: str) -> None:
        """Write a number that all lanes share, if a lane is active."""
        emit, begin, end = self.emit, self.emit.label(), self.emit.label()
        if self.mask is not None:
            emit.branch(emit.any(self.mask), begin, end)
            emit.begin(begin)
        if part.varying:  # of several lanes the first one's is taken
            kind = f"i{self.lanes}"
            bits = emit.new(f"bitcast {emit.of(self._full())} to {kind}")
            emit.declare(f"llvm.cttz.{kind}", kind, [kind, "i1"])
            lane = emit.new(f"call {kind} @llvm.cttz.{kind}({kind} {bits}, i1 true)")
            part = emit.part(f"extractelement {emit.of(part)}, {kind} {lane}", part.element, False)
        emit.line(f"store {emit.of(part)}, ptr {address}, align 4")
        emit.begin(end)

    # Blocks

    def _load_addresses(self) -> None:
        self._addresses: dict[int, str] = {}
        for block in self._program.blocks:
            number = block.binding + TABLE[block.kind]
            place = self.emit.new(f"getelementptr ptr, ptr %blocks, i64 {number}")
            self._addresses[id(block)] = self.emit.new(f"load ptr, ptr {place}, !invariant.load !0")

    def address_of(self, block: str) -> str:
        """Return the address of a block's data."""
        return next(self._addresses[id(one)] for one in self._program.blocks if one.name == block)

    def has_block(self, name: str) -> bool:
        """Return whether the program has a block of this name."""
        return any(one.name == name for one in self._program.blocks)

    def _place(self, node: Memory) -> tuple[str, Part]:
        """Return an address in a block, and how many words of four bytes behind it a value begins in each lane."""
        found, known = constant("i", 0), node.offset // 4
        for index, stride in node.terms:
            last = constant("i", 0)
            if isinstance(index, Operation) and index.operator == "+":
                (number,), (last,) = (self.value(one) for one in index.operands)
                # What all lanes add is part of the address, as lanes that are not active may read there.
                if last.constant is None or not 0 <= last.constant < MOST_ADDED:
                    number, last = self._binary("+", number, last), constant("i", 0)
            else:
                (number,) = self.value(index)
            assert last.constant is not None
            by = self._binary("*", Part(number.text, "i", number.varying, number.constant), constant("i", stride // 4))
            found, known = self._binary("+", by, found), known + int(last.constant) * stride // 4
        return self._behind(self._addresses[id(node.block)], known), found

    def _behind(self, address: str, words: int) -> str:
        return self.emit.new(f"getelementptr i32, ptr {address}, i64 {words}") if words else address

    def _fetch(self, node: Memory, numbers: Sequence[int]) -> Parts:
        block, (base, words) = node.block, self._place(node)
        offsets = [at for _, at in layout(node.type, block.kind == "uniform")]
        is_fixed = block.kind == "uniform" or block.is_read_only
        return self._load_numbers(elements_of(node.type), base, words, offsets, numbers, is_fixed)

    def _load_numbers(
        self,
        elements: str,
        base: str,
        words: Part,
        offsets: Sequence[int] = (0, 4, 8, 12),
        numbers: Sequence[int] = range(4),
        is_fixed: bool = True,
    ) -> Parts:
        """Load some of the scalars of a value that lies some words behind an address, at offsets in bytes from there.

        `is_fixed`: what lies there does not change.
        """
        emit = self.emit
        is_row = elements in ("ffff", "dddd") and offsets[-1] == 3 * BYTES[elements[0]]
        if words.varying and is_row and len(set(numbers)) > 1 and self.lanes > 1:
            columns = self._rows(elements[0], base, words)
            return [columns[n] for n in numbers]
        found = []
        for n in numbers:
            place = self._behind(base, offsets[n] // 4)
            if words.varying:
                found.append(self._gather(elements[n], place, words))
                continue
            place = emit.new(f"getelementptr i32, ptr {place}, {emit.of(words)}")
            note = ", !invariant.load !0" if is_fixed else ""
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
        for number in emit.offsets(words, range(lanes)):
            place = emit.new(f"getelementptr i32, ptr {base}, i64 {number}")
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
        emit, (base, words), offsets = self.emit, self._place(node), [at for _, at in layout(node.type)]
        for n, part in zip(numbers, parts, strict=True):
            place = self._behind(base, offsets[n] // 4)
            if words.varying:
                self._scatter(emit.spread(part), place, words)
                continue
            self._store_once(part, emit.new(f"getelementptr i32, ptr {place}, {emit.of(words)}"))

    # Numbers

    def lane_numbers(self, element: str) -> Part:
        """Return 0, 1, 2, … in the lanes."""
        lanes = ", ".join(f"{LLVM[element]} {lane}" for lane in range(self.lanes))
        return Part(f"<{lanes}>", element, True)

    def _inside(self, index: Part, count: int) -> Part:
        """Return an index of an array, or its last one if there is no such element."""
        last = constant(index.element, count - 1)
        if index.constant is not None:
            return index if 0 <= index.constant < count else last
        # What becomes of NaN as an integer is not defined; it has to be one number before it is compared.
        index = self.emit.part(f"freeze {self.emit.of(index)}", "u", index.varying)
        return self.emit.call("umin", "u", index, last)

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
            found = OPERATORS[sign](int(a.constant), int(b.constant))
            if a.element != "b":
                low = 0 if a.element == "u" else -(1 << 31)
                found = (found - low) % (1 << 32) + low
            return constant(a.element, found)
        if a.element in "iu" and b.constant == 0 and sign in ("+", "-", "<<", ">>"):
            return a
        if a.element in "iu" and b.constant == 1 and sign in ("*", "/"):
            return a
        return self.emit.binary(sign, a, b)
