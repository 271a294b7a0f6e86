"""Masks of the active lanes, and the variables that lanes assign."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from clusterviz.spmd.emitter import Emitter, Part, constant
from clusterviz.spmd.ir import Variable
from clusterviz.spmd.types import elements_of

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


class Variables:
    """Active lanes, and the memory of variables."""

    emit: Emitter
    mask: Part | None  # lanes that are active; None: all

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        self._varying = set[Key]()

    def _emitter(self, name: str, caller: Emitter | None = None) -> Emitter:
        """Return the emitter of a function."""
        return Emitter(name, self.lanes, caller)

    def _begin(self, name: str) -> None:
        self.emit, self.mask = self._emitter(name), None
        self._mask_id = self._masks = 0
        self._bindings: dict[int, Binding] = {}

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
