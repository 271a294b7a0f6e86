"""Calls: functions are inlined, but for large ones of large programs, which are compiled once and called."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

from clusterviz.spmd.analysis import Facts
from clusterviz.spmd.emitter import Part, constant
from clusterviz.spmd.expressions import Expressions
from clusterviz.spmd.ir import Call, Declare, Expression, Function, Leave, Program, Statement, Variable
from clusterviz.spmd.types import elements_of
from clusterviz.spmd.variables import Binding, Cell, Key, Parts

LARGE_PROGRAM, LARGE_FUNCTION = 60_000, 6_000
"""Cost from which a program calls functions, and cost of these: compiling each once takes less time then."""


@dataclass(slots=True)
class Frame:
    """Call of a function: its variables, where its returns go, and the ends of the branches and loops that are open.

    Lanes that have left skip to the innermost end, since others may go on behind it.
    """

    function: Function
    path: int
    mask: int
    exit: str
    result: list[Cell]
    returned: str
    loops: list[Lap] = field(default_factory=list)
    ends: list[str] = field(default_factory=list)


@dataclass(slots=True)
class Lap:
    """Loop that is being generated; `live` and `passed` are masks in memory, "" while all lanes stay together."""

    go_on: str
    exit: str
    mask: int
    live: str
    passed: str
    key: Key


class Calls(Expressions):
    """Declarations, and calls of functions.

    Attributes
    ----------
    separates : large functions of large programs are not inlined
    """

    separates = True

    def __init__(self, program: Program, lanes: int, facts: Facts, intrinsics: dict[str, Callable[..., Parts]]) -> None:
        super().__init__(program, lanes, facts)
        self._intrinsics = intrinsics
        self._paths: dict[Key, int] = {}
        self._frames: list[Frame] = []
        self._separate: dict[int, tuple[str, list[tuple[str, bool]]]] = {}
        self._functions: list[str] = []
        every = [called for named in program.functions.values() for one in named for called, _ in one.calls]
        self._repeated = {id(called) for called, count in Counter(every).items() if count > 1}

    @abstractmethod
    def _statement(self, node: Statement) -> None:
        """Generate a statement."""

    def _begin(self, name: str) -> None:
        super()._begin(name)
        self._separate, self._functions = {}, []

    @property
    def _path(self) -> int:
        return self._frames[-1].path if self._frames else 0

    def _declare(self, declaration: Declare) -> None:
        variable, value = declaration.variable, declaration.value
        if value is not None and not variable.is_assigned:
            self._bindings[id(variable)] = self.value(value)
            return
        parts = self.value(value) if value is not None else []
        first = "shared" if variable.kind == "shared" else self._path
        cells = self._cells(variable, (first, id(variable)))
        self._bindings[id(variable)] = cells
        for cell, part in zip(cells, parts, strict=False):
            self._store(cell, part)

    # Calls

    def _number_of(self, *key: Any) -> int:
        return self._paths.setdefault(key, len(self._paths) + 1)

    def _inline(self, function: Function, bindings: Sequence[Binding], at: int) -> Parts:
        return self._body(function, bindings, self._number_of(self._path, at, id(function)))

    def _body(self, function: Function, bindings: Sequence[Binding], path: int) -> Parts:
        assert function.body is not None
        emit, last = self.emit, function.body.statements[-1] if function.body.statements else None
        simple = self._facts.returns_last(function.body)
        frame = Frame(function, path, self._mask_id, "" if simple else emit.label(), [], "")
        if not simple:
            frame.result = self._room(elements_of(function.result), (path, "result"))
            frame.returned = emit.room(emit.kind("b", True))
            self._store_mask(constant("b", False), frame.returned)
        for parameter, binding in zip(function.parameters, bindings, strict=True):
            self._bindings[id(parameter)] = binding
        before = self.mask, self._mask_id
        self._frames.append(frame)
        found: Parts = []
        for statement in function.body.statements:
            if simple and statement is last and isinstance(last, Leave):
                found = self.value(last.value) if last.value is not None else []
            else:
                self._statement(statement)
        self._frames.pop()
        self.mask, self._mask_id = before
        if not simple:
            emit.begin(frame.exit)
            found = [self._load(cell) for cell in frame.result]
        return found

    def _call(self, call: Call) -> Parts:
        function = call.function
        if function.name in self._intrinsics:
            return self._intrinsics[function.name](self, [self.value(one) for one in call.arguments])
        if self._is_separate(function):
            return self._call_separate(call)
        path = self._number_of(self._path, call.at, id(function))
        bindings: list[Binding] = []
        results: list[tuple[Expression, list[Cell]]] = []
        for argument, parameter in zip(call.arguments, function.parameters, strict=True):
            if parameter.kind == "in" and not parameter.is_assigned:
                bindings.append(self.value(argument))
                continue
            given = self.value(argument) if parameter.kind != "out" else []
            cells = self._cells(parameter, (path, id(parameter)))
            for cell, part in zip(cells, given, strict=False):
                self._store(cell, part)
            bindings.append(cells)
            if parameter.kind != "in":
                results.append((argument, cells))
        # A function that is called by itself in an argument would overwrite the bindings, but there is no recursion.
        found = self._inline(function, bindings, call.at)
        for argument, cells in results:
            self._assign_to(argument, [self._load(cell) for cell in cells])
        return found

    # Functions that are compiled once

    def _is_separate(self, function: Function) -> bool:
        whole, body = self._program.functions["main"][0].body, function.body
        if not (self.separates and whole and body and id(function) in self._repeated):
            return False
        return self._facts.cost(whole) > LARGE_PROGRAM and self._facts.cost(body) > LARGE_FUNCTION

    def _call_separate(self, call: Call) -> Parts:
        """Call a function that takes the active lanes, its parameters and all globals that it uses, by value.

        It returns its value, parameters that are assigned, and globals that it may assign. Lanes may differ in all of
        them but globals, so that there is one such function.
        """
        emit, function = self.emit, call.function
        given = [
            [emit.spread(part) for part in self.value(argument)] if parameter.kind != "out" else []
            for argument, parameter in zip(call.arguments, function.parameters, strict=True)
        ]
        known = self._facts.used_in(function) & self._bindings.keys()
        used = [one.variable for one in self._program.globals if id(one.variable) in known]
        if id(function) not in self._separate:
            self._separate[id(function)] = self._function(function, used)
        name, kinds = self._separate[id(function)]
        parts = [emit.spread(self._full()), *(part for one in given for part in one)]
        kept = (each for variable in used for each in self._bindings[id(variable)])
        parts += [each if isinstance(each, Part) else _pointer(each) or self._load(each) for each in kept]
        kind = emit.struct(kinds)
        arguments = ", ".join(emit.of(part) for part in parts)
        whole = emit.new(f"call fastcc {kind} @{name}(ptr %blocks, {arguments})")
        results = iter(
            emit.part(f"extractvalue {kind} {whole}, {number}", element, varying)
            for number, (element, varying) in enumerate(kinds)
        )
        found = list(islice(results, function.result.parts))
        for cell in self._assigned_cells(function, used):
            part = next(results)
            if part.varying and not cell.varying:
                self._vary(cell)
            emit.line(f"store {emit.of(part)}, ptr {cell.address}")
        for argument, parameter in zip(call.arguments, function.parameters, strict=True):
            if parameter.kind != "in":
                self._assign_to(argument, list(islice(results, parameter.type.parts)))
        return found

    def _assigned_cells(self, function: Function, used: Sequence[Variable]) -> list[Cell]:
        assigned = self._facts.assigned_by(function)
        cells = [each for variable in used if id(variable) in assigned for each in self._bindings[id(variable)]]
        return [each for each in cells if isinstance(each, Cell) and _pointer(each) is None]

    def _function(self, function: Function, used: Sequence[Variable]) -> tuple[str, list[tuple[str, bool]]]:
        """Generate a function; return its name, and the elements of its results and whether lanes may differ."""
        outer = self.emit, self.mask, self._mask_id, self._bindings, self._addresses, self._frames
        globals_, path = self._bindings, self._number_of(id(function))
        name = f"{function.name}.{path}"
        emit = self.emit = self._emitter(name, self.emit)
        self._bindings, self._frames = {}, []
        self._load_addresses()
        self._narrow(emit.parameter("b", True))
        bindings: list[Binding] = []
        assigned = list[Cell]()
        for parameter in function.parameters:
            given = [] if parameter.kind == "out" else [emit.parameter(e, True) for e in elements_of(parameter.type)]
            if parameter.kind == "in" and not parameter.is_assigned:
                bindings.append(given)
                continue
            cells = self._cells(parameter, (path, id(parameter)))
            for cell, part in zip(cells, given, strict=False):
                self._store(cell, part)
            bindings.append(cells)
            assigned += cells if parameter.kind != "in" else []
        for variable in used:
            own = [self._taken(each) for each in globals_[id(variable)]]
            self._bindings[id(variable)] = own  # type: ignore[assignment]
        found = self._body(function, bindings, path)
        found += [self._load(cell) for cell in (*self._assigned_cells(function, used), *assigned)]
        self._functions.append(emit.function(found))
        self.emit, self.mask, self._mask_id, self._bindings, self._addresses, self._frames = outer
        return name, [(part.element, part.varying) for part in found]

    def _taken(self, each: Cell | Part) -> Cell | Part:
        """Return a global in a function that takes it as a parameter; no lane has assigned it there yet."""
        emit, address = self.emit, ""
        if isinstance(each, Part):
            return emit.parameter(each.element, each.varying)
        if pointer := _pointer(each):
            address = emit.parameter(pointer.element, False).text
        else:
            address = emit.room(emit.kind(each.element, each.varying))
            emit.line(f"store {emit.of(emit.parameter(each.element, each.varying))}, ptr {address}")
        return Cell(address, each.element, each.varying, -1, each.key, each.count)


def _pointer(cell: Cell) -> Part | None:
    """Return the address of an array, or of a variable that lanes share, which are not passed by value."""
    return Part(cell.address, "p", False) if cell.count or cell.key[0] == "shared" else None
