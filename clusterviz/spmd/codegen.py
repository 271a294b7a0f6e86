"""Code of a typed program: an invocation a lane, masks where lanes differ, and plain code where they do not.

A value of which all lanes are known to be equal stays one number; which variables are so is found by generating code
again until no more of them turn out to vary, usually three times. A branch that depends on the lane is skipped where no
lane takes it, and variables keep their values in the lanes that do not. Functions are inlined, but for large ones of
large programs, which are compiled once and called.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

from clusterviz.spmd.analysis import Facts, used_by
from clusterviz.spmd.emitter import Part, constant
from clusterviz.spmd.expressions import Expressions
from clusterviz.spmd.ir import (
    Block,
    Call,
    Declare,
    Evaluate,
    Function,
    If,
    Leave,
    Loop,
    Program,
    Statement,
    Variable,
)
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


CHEAP = 80  # operations that are done without asking if a lane needs them


class Generator(Expressions):
    """Code of the function `main` of a program.

    `lanes`: of a vector: 4, 8 or 16; `intrinsics`: what replaces functions of the program, by name: from the generator
    and the arguments to the value. Raises InputError: the program has no function `main`, or calls a function that CPUs
    do not have.
    """

    separates = True  # large functions of large programs are not inlined

    def __init__(
        self, program: Program, lanes: int, intrinsics: dict[str, Callable[[Generator, list[Parts]], Parts]]
    ) -> None:
        super().__init__(program, lanes, Facts(intrinsics))
        self._used, self._intrinsics = used_by(program), intrinsics
        self._paths: dict[Key, int] = {}
        self._frames: list[Frame] = []
        self._separate: dict[int, tuple[str, list[tuple[str, bool]]]] = {}
        self._functions: list[str] = []
        every = [called for named in program.functions.values() for one in named for called, _ in one.calls]
        self._repeated = {id(called) for called, count in Counter(every).items() if count > 1}

    def text(self, name: str) -> str:
        """Return the LLVM module with a function of this name, which takes the address of the blocks' addresses.

        Raises InputError: the program is nested too deeply.
        """
        try:
            while True:
                known = len(self._varying)
                self._pass(name)
                if len(self._varying) == known:
                    return self.emit.module(self._functions)
        except RecursionError:
            where = self._frames[-1].function.at if self._frames else 0
            raise self._program.places.error("nested too deeply", where) from None

    def _pass(self, name: str) -> None:
        self._begin(name)
        main = self._program.functions["main"][0]
        self._frames = [Frame(main, 0, 0, "", [], "")]
        for declaration in self._program.globals:
            if id(declaration.variable) in self._used:
                self._declare(declaration)
        self._frames.pop()
        self._inline(main, [], main.at)

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
        pairs = list(zip(call.arguments, function.parameters, strict=True))
        bindings = [self._bind(p, self.value(argument) if p.kind != "out" else [], path) for argument, p in pairs]
        # A function that is called by itself in an argument would overwrite the bindings, but there is no recursion.
        found = self._inline(function, bindings, call.at)
        for (argument, parameter), binding in zip(pairs, bindings, strict=True):
            if parameter.kind != "in":
                self._assign_to(argument, [self._load(cell) for cell in binding if isinstance(cell, Cell)])
        return found

    def _bind(self, parameter: Variable, given: Parts, path: int) -> Binding:
        """Return what a parameter is in a call: values that stay as they are, or memory that begins with them."""
        if parameter.kind == "in" and not parameter.is_assigned:
            return given
        cells = self._cells(parameter, (path, id(parameter)))
        for cell, part in zip(cells, given, strict=False):
            self._store(cell, part)
        return cells

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
        bindings, assigned = list[Binding](), list[Cell]()
        for parameter in function.parameters:
            given = [] if parameter.kind == "out" else [emit.parameter(e, True) for e in elements_of(parameter.type)]
            bindings.append(self._bind(parameter, given, path))
            if parameter.kind != "in":
                assigned += [cell for cell in bindings[-1] if isinstance(cell, Cell)]
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

    # Statements

    def _statement(self, node: Statement) -> None:
        if not self.emit.is_open:
            return
        match node:
            case Declare():
                self._declare(node)
            case Evaluate():
                self.value(node.expression)
            case Block():
                for one in node.statements:
                    self._statement(one)
            case If():
                self._if(node)
            case Loop():
                self._loop(node)
            case Leave():
                self._leave(node)

    def _if(self, node: If) -> None:
        (condition,) = self.value(node.condition)
        if condition.constant is not None:
            chosen = node.then if condition.constant else node.otherwise
            if chosen is not None:
                self._statement(chosen)
                if self.emit.is_open and self._facts.leaves(chosen):
                    self._remask()
        elif condition.varying:
            self._if_some(node, condition)
        else:
            self._if_all(node, condition)

    def _if_all(self, node: If, condition: Part) -> None:
        """Generate a branch that all lanes take, or none."""
        emit, then, otherwise, end = self.emit, *(self.emit.label() for _ in range(3))
        before = self.mask, self._mask_id
        emit.branch(condition, then, otherwise)
        emit.begin(then)
        self._statement(node.then)
        changed, open_then = self._mask_id != before[1], emit.is_open
        self.mask, self._mask_id = before
        if open_then:
            emit.jump(end)
        emit.begin(otherwise)
        if node.otherwise is not None:
            self._statement(node.otherwise)
        changed |= self._mask_id != before[1]
        self.mask, self._mask_id = before
        if emit.is_open or open_then:
            emit.begin(end)
            if changed:
                self._remask()

    def _if_some(self, node: If, condition: Part) -> None:
        """Generate both sides of a branch, each for the lanes that take it."""
        emit, masks = self.emit, [(node.then, condition)]
        if node.otherwise is not None:
            masks.append((node.otherwise, emit.inverse(condition)))
        for branch, taken in masks:
            with self._for_lanes(emit.both(self.mask, taken), self._facts.cost(branch) > CHEAP) as end:
                self._frames[-1].ends.append(end)
                self._statement(branch)
                self._frames[-1].ends.pop()
        if any(self._facts.leaves(branch) for branch, _ in masks):
            self._remask()

    def _remask(self) -> None:
        """Take away the lanes that have left, and go on where some are left."""
        emit, frame = self.emit, self._frames[-1]
        mask = self._full()
        lap = frame.loops[-1] if frame.loops else None
        if lap and lap.passed:
            mask = emit.both(mask, emit.inverse(self._load_mask(lap.passed)))
        if lap and lap.live:
            mask = emit.both(mask, self._load_mask(lap.live))
        elif frame.returned:
            mask = emit.both(mask, emit.inverse(self._load_mask(frame.returned)))
        self._narrow(mask)
        on, off = emit.label(), frame.ends[-1] if frame.ends else frame.exit
        if off:
            emit.branch(emit.any(mask), on, off)
            emit.begin(on)

    def _leave(self, node: Leave) -> None:
        frame, emit = self._frames[-1], self.emit
        if node.kind == "return":
            parts = self.value(node.value) if node.value is not None else []
            for cell, part in zip(frame.result, parts, strict=True):
                self._store(cell, part)
            if self._mask_id == frame.mask:
                emit.jump(frame.exit)
                return
            laps = frame.loops
            self._store_mask(emit.binary("|", self._load_mask(frame.returned), self._full()), frame.returned)
        else:
            laps = frame.loops[-1:]
            lap = laps[0]
            if self._mask_id == lap.mask:
                if node.kind == "break" and lap.live:
                    self._store_mask(constant("b", False), lap.live)
                emit.jump(lap.exit if node.kind == "break" else lap.go_on)
                return
        for lap in laps:
            if node.kind == "continue":
                self._store_mask(emit.binary("|", self._load_mask(lap.passed), self._full()), lap.passed)
            else:
                if not lap.live:
                    self._varying.add(lap.key)
                    lap.live = emit.room(emit.kind("b", True))
                rest = emit.both(self._load_mask(lap.live), emit.inverse(self._full()))
                self._store_mask(rest, lap.live)

    def _loop(self, node: Loop) -> None:
        emit = self.emit
        if (numbers := self._facts.unrolled(node)) is not None:
            return self._unroll(node, numbers)
        if node.begin is not None:
            self._statement(node.begin)
        key = ("loop", self._frames[-1].path, node.at)
        head, body, go_on, end = (emit.label() for _ in range(4))
        before, varying = (self.mask, self._mask_id), key in self._varying
        passed, live = self._lap_masks(node, varying)
        lap = Lap(go_on, end, self._mask_id, live, passed, key)
        emit.begin(head)
        with self._in_lap(lap):
            if varying:
                self._narrow(self._load_mask(live))
            condition = self.value(node.condition)[0] if node.condition is not None else constant("b", True)
            if varying:
                mask = emit.both(self.mask, emit.spread(condition))
                self._store_mask(mask, live)
                emit.branch(emit.any(mask), body, end)
                self._narrow(mask)
                lap.mask = self._mask_id
            else:
                if condition.varying:
                    self._varying.add(key)
                emit.branch(emit.lane(condition, 0), body, end)
            emit.begin(body)
            if passed:
                self._store_mask(constant("b", False), passed)
            self._statement(node.body)
            emit.begin(go_on)
            if varying:
                self._narrow(self._load_mask(live))
            else:
                self.mask, self._mask_id = before
            if node.step is not None:
                self.value(node.step)
            emit.jump(head)
            emit.begin(end)
        self._end_loop(node, varying, before)
        return None

    def _unroll(self, node: Loop, counted: tuple[Variable, range]) -> None:
        emit, (variable, numbers) = self.emit, counted
        key, end, before = ("loop", self._frames[-1].path, node.at), emit.label(), (self.mask, self._mask_id)
        leaves = key in self._varying
        passed, live = self._lap_masks(node, leaves)
        for number in numbers:
            self._bindings[id(variable)] = [constant("i", number)]
            lap = Lap(emit.label(), end, self._mask_id, live, passed, key)
            if passed:
                self._store_mask(constant("b", False), passed)
            if leaves and number != numbers[0]:
                self._narrow(self._load_mask(live))
                lap.mask = self._mask_id
            with self._in_lap(lap):
                self._statement(node.body)
            emit.begin(lap.go_on)
            self.mask, self._mask_id = before
        emit.begin(end)
        self._end_loop(node, leaves, before)

    def _lap_masks(self, node: Loop, varying: bool) -> tuple[str, str]:
        """Return the addresses of the masks `passed` and `live` of a loop, "" for those that it does not need."""
        emit = self.emit
        passed = emit.room(emit.kind("b", True)) if "continue" in self._facts.leaves(node.body) else ""
        live = emit.room(emit.kind("b", True)) if varying else ""
        if varying:
            self._store_mask(self._full(), live)
        return passed, live

    @contextmanager
    def _in_lap(self, lap: Lap) -> Iterator[None]:
        frame = self._frames[-1]
        frame.loops.append(lap)
        frame.ends.append(lap.go_on)
        yield
        frame.loops.pop()
        frame.ends.pop()

    def _end_loop(self, node: Loop, varying: bool, before: tuple[Part | None, int]) -> None:
        self.mask, self._mask_id = before
        if "return" in self._facts.leaves(node.body) and varying:
            self._remask()


def _pointer(cell: Cell) -> Part | None:
    """Return the address of an array, or of a variable that lanes share, which are not passed by value."""
    return Part(cell.address, "p", False) if cell.count or cell.key[0] == "shared" else None
