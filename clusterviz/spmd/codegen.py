"""Code of a typed program: an invocation a lane, masks where lanes differ, and plain code where they do not.

Functions are inlined. A value of which all lanes are known to be equal stays one number; which variables are so is
found by generating code again until no more of them turn out to vary. A branch that depends on the lane is skipped
where no lane takes it, and variables keep their values in the lanes that do not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from typing import Any

from clusterviz.spmd.built_in import BUILT_INS
from clusterviz.spmd.checker import FOLDED
from clusterviz.spmd.emitter import LLVM, Emitter, Part, constant
from clusterviz.spmd.ir import (
    Assign,
    Block,
    BuiltIn,
    Call,
    Constant,
    Construct,
    Declare,
    Either,
    Element,
    Evaluate,
    Expression,
    Function,
    If,
    Leave,
    Loop,
    Memory,
    Name,
    Operation,
    Pick,
    Program,
    Statement,
    Variable,
)
from clusterviz.spmd.types import BYTES

MOST_UNROLLED = 4  # iterations of a loop
CHEAP = 80  # operations that are done without asking if a lane needs them
SYSTEM_BLOCK = 48  # number of the group, numbers of groups, and the first invocation's number in its group: uint32 (7,)
BUFFERS = 16  # number of the first storage buffer in the table of addresses; uniform blocks come first
Key = tuple[Any, ...]
Parts = list[Part]


@dataclass(slots=True)
class Cell:
    """Memory of one scalar of a variable; an array has `count` of them."""

    address: str
    element: str
    varying: bool
    mask: int
    key: Key
    count: int = 0


@dataclass(slots=True)
class Frame:
    """Call of a function: its variables, and where its returns go."""

    function: Function
    path: int
    mask: int
    exit: str
    result: list[Cell]
    returned: str
    loops: list[Lap] = field(default_factory=list)


@dataclass(slots=True)
class Lap:
    """Loop that is being generated; `live` and `passed` are masks in memory, "" while all lanes stay together."""

    go_on: str
    exit: str
    mask: int
    live: str
    passed: str
    key: Key


def children(node: Any) -> Iterator[Any]:
    """Return the parts of a node of the typed program, but not what it refers to."""
    for one in fields(node):
        if one.name in ("type", "at", "function", "variable", "block"):
            continue
        value = getattr(node, one.name)
        for item in value if isinstance(value, (tuple, list)) else (value,):
            item = item[0] if isinstance(item, tuple) else item
            if isinstance(item, (Expression, Statement)):
                yield item


class Generator:
    """Code of the function `main` of a program.

    Parameters
    ----------
    lanes : of a vector: 4, 8 or 16
    intrinsics : what replaces functions of the program, by name: from the generator and the arguments to the value
    """

    def __init__(
        self, program: Program, lanes: int, intrinsics: dict[str, Callable[[Generator, list[Parts]], Parts]]
    ) -> None:
        self._program, self.lanes, self._intrinsics = program, lanes, intrinsics
        self._varying = set[Key]()
        self._paths: dict[Key, int] = {}
        self._facts: dict[Key, Any] = {}
        self._used = self._used_by(program.functions["main"][0])

    def text(self, name: str) -> str:
        """Return the LLVM module with a function of this name, which takes the address of the blocks' addresses.

        Raises
        ------
        NotImplementedError
            The program calls a built-in function that has no code yet: one of textures, for example.
        """
        while True:
            known = len(self._varying)
            self._pass(name)
            if len(self._varying) == known:
                return self.emit.module()

    def _pass(self, name: str) -> None:
        self.emit = Emitter(name, self.lanes)
        self.mask: Part | None = None
        self._mask_id = self._masks = 0
        self._bindings: dict[int, list[Cell] | Parts] = {}
        self._frames: list[Frame] = []
        self._addresses: dict[int, str] = {}
        for block in self._program.blocks:
            number = block.binding + (0 if block.kind == "uniform" else BUFFERS)
            place = self.emit.new(f"getelementptr ptr, ptr %blocks, i64 {number}")
            self._addresses[id(block)] = self.emit.new(f"load ptr, ptr {place}, !invariant.load !0")
        main, used = self._program.functions["main"][0], self._used
        self._frames.append(Frame(main, 0, 0, "", [], ""))
        for declaration in self._program.globals:
            if id(declaration.variable) in used:
                self._declare(declaration)
        self._frames.pop()
        self._inline(main, [], main.at)

    def _used_by(self, main: Function) -> set[int]:
        """Return the variables that a function, and what it calls, may use."""
        values = {id(d.variable): d.value for d in self._program.globals if d.value is not None}
        found, waiting, seen = set[int](), list[Any]([main.body]), {id(main)}
        while waiting:
            node = waiting.pop()
            if isinstance(node, Call) and id(node.function) not in seen:
                seen.add(id(node.function))
                waiting.append(node.function.body)
            if isinstance(node, Name) and id(node.variable) not in found:
                found.add(id(node.variable))
                if id(node.variable) in values:
                    waiting.append(values[id(node.variable)])
            waiting += children(node)
        return found

    # Facts of the program, found once

    def _fact(self, kind: str, node: Any, find: Callable[[Any], Any]) -> Any:
        key = kind, id(node)
        if key not in self._facts:
            self._facts[key] = find(node)
        return self._facts[key]

    def _leaves(self, node: Statement | Expression) -> frozenset[str]:
        """Return how a statement may leave what surrounds it."""

        def find(node: Any) -> frozenset[str]:
            if isinstance(node, Leave):
                return frozenset([node.kind])
            if isinstance(node, Expression):
                return frozenset()
            found = frozenset[str]().union(*(self._leaves(child) for child in children(node)))
            return found - {"break", "continue"} if isinstance(node, Loop) else found

        return self._fact("leaves", node, find)  # type: ignore[no-any-return]

    def _cost(self, node: Statement | Expression) -> int:
        """Return about how many operations a node takes; much for memory and loops."""

        def find(node: Any) -> int:
            own = 1 + sum(self._cost(child) for child in children(node))
            if isinstance(node, Call):
                known = node.function.name in self._intrinsics or node.function.body is None
                return own + (1 if known else self._cost(node.function.body))  # type: ignore[arg-type]
            if isinstance(node, Loop | Leave):
                return own + 1000 * isinstance(node, Loop)
            return own + 100 * isinstance(node, Memory)

        return self._fact("cost", node, find)  # type: ignore[no-any-return]

    def _price(self, node: Expression) -> int:
        """Return the cost of an expression that not all lanes may evaluate; very much if it changes anything."""

        def changes(node: Any) -> bool:
            if isinstance(node, Call) and any(p.kind != "in" for p in node.function.parameters):
                return True
            return isinstance(node, Assign) or self._has_effect(node) or any(changes(child) for child in children(node))

        return self._cost(node) + 1000 * self._fact("changes", node, changes)  # type: ignore[no-any-return]

    def _has_effect(self, node: Any) -> bool:
        """Return whether a call changes anything but what it is given."""

        def find(node: Any) -> bool:
            if isinstance(node, Assign) and (
                (root := self._root(node.target)) is None or root.kind in ("global", "shared")
            ):
                return True
            if isinstance(node, BuiltIn) and node.name in ("atomicAdd", "atomicMin", "barrier"):
                return True
            if isinstance(node, Call) and node.function.body is not None and inside(node.function.body):
                return True
            return any(find(child) for child in children(node))

        def inside(body: Block) -> bool:
            return self._fact("effects", body, find)  # type: ignore[no-any-return]

        return isinstance(node, Call) and node.function.body is not None and inside(node.function.body)

    def _assigns(self, node: Any, variable: Variable) -> bool:
        if isinstance(node, Assign) and self._root(node.target) is variable:
            return True
        if isinstance(node, Call):
            pairs = zip(node.arguments, node.function.parameters, strict=True)
            if any(p.kind != "in" and self._root(a) is variable for a, p in pairs):
                return True
        return any(self._assigns(child, variable) for child in children(node))

    @staticmethod
    def _root(target: Expression) -> Variable | None:
        while isinstance(target, Pick | Element):
            target = target.base
        return target.variable if isinstance(target, Name) else None

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
        return self._room(_elements(kind), key, count)

    def _room(self, elements: str, key: Key, count: int = 0) -> list[Cell]:
        found = []
        for number, element in enumerate(elements):
            own = (*key, number)
            varying = own in self._varying
            kind = self.emit.kind(element, varying)
            address = self.emit.room(f"[{count} x {kind}]" if count else kind)
            found.append(Cell(address, element, varying, self._mask_id, own, count))
        return found

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
            self._varying.add(cell.key)
            return
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

    def _declare(self, declaration: Declare) -> None:
        variable, value = declaration.variable, declaration.value
        if value is not None and not variable.is_assigned:
            self._bindings[id(variable)] = self.value(value)
            return
        parts = self.value(value) if value is not None else []
        first = "shared" if variable.kind == "shared" else self._frames[-1].path
        cells = self._cells(variable, (first, id(variable)))
        self._bindings[id(variable)] = cells
        for cell, part in zip(cells, parts, strict=False):
            self._store(cell, part)

    # Calls

    def _inline(self, function: Function, bindings: Sequence[list[Cell] | Parts], at: int) -> Parts:
        """Generate a function's body in place of a call."""
        assert function.body is not None
        parent = self._frames[-1].path if self._frames else 0
        path = self._paths.setdefault((parent, at, id(function)), len(self._paths) + 1)
        emit, last = self.emit, function.body.statements[-1] if function.body.statements else None
        returns = self._fact("returns", function.body, lambda node: sum(1 for _ in _returns(node)))
        simple = returns == (1 if isinstance(last, Leave) else 0)
        frame = Frame(function, path, self._mask_id, "" if simple else emit.label(), [], "")
        if not simple:
            frame.result = self._room(_elements(function.result), (path, "result"))
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
        parent = self._frames[-1].path
        path = self._paths.setdefault((parent, call.at, id(function)), len(self._paths) + 1)
        bindings: list[list[Cell] | Parts] = []
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
        emit, (condition,) = self.emit, self.value(node.condition)
        if condition.constant is not None:
            chosen = node.then if condition.constant else node.otherwise
            if chosen is not None:
                self._statement(chosen)
            return
        if not condition.varying:
            then, otherwise, end = emit.label(), emit.label(), emit.label()
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
            return
        before = self.mask, self._mask_id
        masks = [(node.then, condition)]
        if node.otherwise is not None:
            masks.append((node.otherwise, emit.inverse(condition)))
        for branch, taken in masks:
            mask, end = emit.both(before[0], taken), emit.label()
            if self._cost(branch) > CHEAP:
                begin = emit.label()
                emit.branch(emit.any(mask), begin, end)
                emit.begin(begin)
            self._narrow(mask)
            self._statement(branch)
            emit.begin(end)
            self.mask, self._mask_id = before
        if any(self._leaves(branch) for branch, _ in masks):
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
        on, off = emit.label(), lap.go_on if lap else frame.exit
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
            elif not lap.live:
                self._varying.add(lap.key)
            else:
                rest = emit.both(self._load_mask(lap.live), emit.inverse(self._full()))
                self._store_mask(rest, lap.live)

    def _loop(self, node: Loop) -> None:
        emit, frame = self.emit, self._frames[-1]
        if (numbers := self._unrolled(node)) is not None:
            return self._unroll(node, numbers)
        if node.begin is not None:
            self._statement(node.begin)
        key = ("loop", frame.path, node.at)
        head, body, go_on, end = (emit.label() for _ in range(4))
        before, varying = (self.mask, self._mask_id), key in self._varying
        lap = Lap(go_on, end, self._mask_id, "", "", key)
        if "continue" in self._leaves(node.body):
            lap.passed = emit.room(emit.kind("b", True))
        if varying:
            lap.live = emit.room(emit.kind("b", True))
            self._store_mask(self._full(), lap.live)
        emit.begin(head)
        frame.loops.append(lap)
        if varying:
            self._narrow(self._load_mask(lap.live))
        condition = self.value(node.condition)[0] if node.condition is not None else constant("b", True)
        if varying:
            mask = emit.both(self.mask, emit.spread(condition))
            self._store_mask(mask, lap.live)
            emit.branch(emit.any(mask), body, end)
            self._narrow(mask)
            lap.mask = self._mask_id
        else:
            if condition.varying:
                self._varying.add(key)
            emit.branch(emit.lane(condition, 0), body, end)
        emit.begin(body)
        if lap.passed:
            self._store_mask(constant("b", False), lap.passed)
        self._statement(node.body)
        emit.begin(go_on)
        if varying:
            self._narrow(self._load_mask(lap.live))
        else:
            self.mask, self._mask_id = before
        if node.step is not None:
            self.value(node.step)
        emit.jump(head)
        emit.begin(end)
        frame.loops.pop()
        self.mask, self._mask_id = before
        if "return" in self._leaves(node.body) and varying:
            self._remask()
        return None

    def _unrolled(self, node: Loop) -> tuple[Variable, range] | None:
        """Return the variable of a loop that is counted from constant to constant in few steps, and its values."""

        def find(node: Loop) -> tuple[Variable, range] | None:
            begin, condition, step = node.begin, node.condition, node.step
            if not (isinstance(begin, Declare) and isinstance(begin.value, Constant) and isinstance(step, Assign)):
                return None
            if not (isinstance(condition, Operation) and condition.operator == "<"):
                return None
            (a, b), variable, by = condition.operands, begin.variable, step.value
            counts = isinstance(by, Operation) and by.operator == "+" and isinstance(by.operands[1], Constant)
            if not (counts and isinstance(a, Name) and a.variable is variable and isinstance(b, Constant)):
                return None
            assert isinstance(by, Operation)
            assert isinstance(by.operands[1], Constant)
            if self._root(step.target) is not variable or self._assigns(node.body, variable):
                return None
            numbers = range(int(begin.value.value), int(b.value), int(by.operands[1].value))
            return (variable, numbers) if len(numbers) <= MOST_UNROLLED else None

        return self._fact("unrolled", node, find)  # type: ignore[no-any-return]

    def _unroll(self, node: Loop, counted: tuple[Variable, range]) -> None:
        emit, frame, (variable, numbers) = self.emit, self._frames[-1], counted
        key, end, before = ("loop", frame.path, node.at), emit.label(), (self.mask, self._mask_id)
        leaves = key in self._varying
        live = emit.room(emit.kind("b", True)) if leaves else ""
        passed = emit.room(emit.kind("b", True)) if "continue" in self._leaves(node.body) else ""
        if leaves:
            self._store_mask(self._full(), live)
        for number in numbers:
            self._bindings[id(variable)] = [constant("i", number)]
            lap = Lap(emit.label(), end, self._mask_id, live, passed, key)
            if passed:
                self._store_mask(constant("b", False), passed)
            if leaves and number != numbers[0]:
                self._narrow(self._load_mask(live))
                lap.mask = self._mask_id
            frame.loops.append(lap)
            self._statement(node.body)
            frame.loops.pop()
            emit.begin(lap.go_on)
            self.mask, self._mask_id = before
        emit.begin(end)
        if "return" in self._leaves(node.body) and leaves:
            self._remask()

    # Expressions

    def value(self, node: Expression) -> Parts:
        """Return the scalars of a value."""
        return _VALUES[type(node)](self, node)

    def _picked(self, node: Expression, numbers: Sequence[int]) -> Parts:
        """Return some of the scalars of a value, without loading the others."""
        if isinstance(node, Pick):
            return self._picked(node.base, [node.numbers[n] for n in numbers])
        if isinstance(node, Name):
            if node.variable.kind == "system":
                return [self._system(node.variable.name, n) for n in numbers]
            binding = self._bindings[id(node.variable)]
            return [self._load(one) if isinstance(one, Cell) else one for one in (binding[n] for n in numbers)]
        if isinstance(node, Memory):
            return self._fetch(node, numbers)
        parts = self.value(node)
        return [parts[n] for n in numbers]

    def _name(self, node: Name) -> Parts:
        return self._picked(node, range(node.type.parts))

    def _system(self, name: str, number: int) -> Part:
        """Return a number of the invocation."""
        emit, offset = self.emit, {"gl_WorkGroupID": 0, "gl_NumWorkGroups": 3, "gl_LocalInvocationIndex": 6}[name]
        block = emit.new(f"load ptr, ptr {emit.new(f'getelementptr ptr, ptr %blocks, i64 {SYSTEM_BLOCK}')}")
        place = emit.new(f"getelementptr i32, ptr {block}, i64 {offset + number}")
        found = emit.part(f"load i32, ptr {place}", "u", False)
        return self._binary("+", found, self.lane_numbers("u")) if offset == 6 else found

    def lane_numbers(self, element: str) -> Part:
        """Return 0, 1, 2, … in the lanes."""
        lanes = ", ".join(f"{LLVM[element]} {lane}" for lane in range(self.lanes))
        return Part(f"<{lanes}>", element, True)

    def _element(self, node: Element) -> Parts:
        (index,) = self.value(node.index)
        if node.base.type.is_array:
            assert isinstance(node.base, Name)
            cells, emit = self._bindings[id(node.base.variable)], self.emit
            found = []
            for cell in cells:
                assert isinstance(cell, Cell)
                kind = emit.kind(cell.element, cell.varying)
                if not index.varying:
                    place = emit.new(f"getelementptr {kind}, ptr {cell.address}, {emit.of(index)}")
                    found.append(emit.part(f"load {kind}, ptr {place}", cell.element, cell.varying))
                else:
                    found.append(self._gather(cell.element, cell.address, self._own_words(cell, index)))
            return found
        parts, width = self.value(node.base), node.type.parts
        found = parts[:width]
        for n in range(1, node.base.type.size):
            here = self._compare("==", index, constant("i", n))
            found = [self.emit.select(here, parts[n * width + k], found[k]) for k in range(width)]
        return found

    def _own_words(self, cell: Cell, index: Part) -> Part:
        """Return where each lane's element of an array lies, in words."""
        words = BYTES[cell.element] // 4
        if not cell.varying:
            return self._binary("*", index, constant("i", words))
        by = self._binary("*", index, constant("i", words * self.lanes))
        return self.emit.binary("+", by, self._binary("*", self.lane_numbers("i"), constant("i", words)))

    def _operation(self, node: Operation) -> Parts:
        given = [self.value(one) for one in node.operands]
        operator, emit = node.operator, self.emit
        if operator == "transform":
            matrix, vector = given
            return [
                emit.binary(
                    "+",
                    emit.binary(
                        "+", emit.binary("*", matrix[row], vector[0]), emit.binary("*", matrix[3 + row], vector[1])
                    ),
                    emit.binary("*", matrix[6 + row], vector[2]),
                )
                for row in range(3)
            ]
        if operator == "neg":
            return [self._negative(part) for part in given[0]]
        if operator in ("!", "~"):
            true = constant(given[0][0].element, 1 if operator == "!" else -1)
            return [self._binary("^", part, true) for part in given[0]]
        a, b = given
        size = max(len(a), len(b))
        pairs = [(a[n % len(a)], b[n % len(b)]) for n in range(size)]
        if operator in ("==", "!="):
            found = [self._compare(operator, x, y) for x, y in pairs]
            return [self._joined("&" if operator == "==" else "|", found)]
        if operator in ("<", "<=", ">", ">="):
            return [self._compare(operator, x, y) for x, y in pairs]
        return [self._binary(operator, x, y) for x, y in pairs]

    def _joined(self, sign: str, parts: Parts) -> Part:
        found = parts[0]
        for part in parts[1:]:
            found = self.emit.binary(sign, found, part)
        return found

    def _negative(self, part: Part) -> Part:
        if part.element in "fd":
            return self.emit.part(f"fneg {self.emit.of(part)}", part.element, part.varying)
        return self._binary("-", constant(part.element, 0), part)

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

    def _compare(self, sign: str, a: Part, b: Part) -> Part:
        if a.constant is not None and b.constant is not None:
            return constant("b", FOLDED[sign](a.constant, b.constant))  # type: ignore[arg-type]
        return self.emit.compare(sign, a, b)

    def _either(self, node: Either) -> Parts:
        (condition,) = self.value(node.condition)
        a, b = node.a, node.b
        if node.operator == "?":
            assert b is not None
            if condition.constant is not None:
                return self.value(a if condition.constant else b)
            return self._chosen(condition, a, b)
        stops = node.operator == "||"
        if condition.constant is not None:
            return [condition] if bool(condition.constant) == stops else self.value(a)
        fixed = Constant(node.type, node.at, stops)
        if self._price(a) < 100 or not stops:
            taken = self.emit.inverse(condition) if stops else condition
            if self._price(a) < 1000:
                with self._within(self.emit.both(self.mask, taken)) if self._price(a) >= 100 else _unchanged():
                    (found,) = self.value(a)
                return [self.emit.binary("|" if stops else "&", condition, found)]
        return self._chosen(condition, fixed, a) if stops else self._chosen(condition, a, fixed)

    def _chosen(self, condition: Part, a: Expression, b: Expression) -> Parts:
        emit = self.emit
        if self._price(a) + self._price(b) < 100:
            return [emit.select(condition, x, y) for x, y in zip(self.value(a), self.value(b), strict=True)]
        key = (self._frames[-1].path, "either", a.at, b.at)
        cells = self._room(_elements(a.type), key)
        if not condition.varying:
            then, otherwise, end = (emit.label() for _ in range(3))
            emit.branch(condition, then, otherwise)
            for label, one in ((then, a), (otherwise, b)):
                emit.begin(label)
                for cell, part in zip(cells, self.value(one), strict=True):
                    self._store(cell, part)
                emit.jump(end)
            emit.begin(end)
            return [self._load(cell) for cell in cells]
        for one, taken in ((a, condition), (b, emit.inverse(condition))):
            mask, end = emit.both(self.mask, taken), emit.label()
            if self._price(one) >= 1000:
                begin = emit.label()
                emit.branch(emit.any(mask), begin, end)
                emit.begin(begin)
            with self._within(mask):
                for cell, part in zip(cells, self.value(one), strict=True):
                    self._store(cell, part)
            emit.begin(end)
        return [self._load(cell) for cell in cells]

    def _construct(self, node: Construct) -> Parts:
        given = [part for one in node.arguments for part in self.value(one)]
        elements = _elements(node.type)
        if len(given) == 1:
            given *= len(elements)
        return [self.emit.convert(part, element) for part, element in zip(given, elements, strict=False)]

    def _built_in(self, node: BuiltIn) -> Parts:
        given = [self.value(one) for one in node.arguments]
        if node.name == "barrier":
            return []
        if node.name in ("atomicAdd", "atomicMin"):
            return self._atomic(node.name == "atomicAdd", node.arguments[0], given[1][0])
        if node.name not in BUILT_INS:
            raise NotImplementedError(node.name)
        return BUILT_INS[node.name](self.emit, given)

    def _atomic(self, adds: bool, target: Expression, more: Part) -> Parts:
        emit, prefix = self.emit, "" if adds else {"i": "s", "u": "u"}[more.element]
        neutral = 0 if adds else (1 << 32) - 1 if more.element == "u" else (1 << 31) - 1
        chosen = emit.spread(emit.select(self._full(), more, constant(more.element, neutral)))
        total = emit.reduced("add" if adds else f"{prefix}min", chosen)
        if isinstance(target, Name):
            (cell,) = self._bindings[id(target.variable)]
            assert isinstance(cell, Cell)
            address = cell.address
        else:
            assert isinstance(target, Memory)
            words = self._words(target)
            address = emit.new(f"getelementptr i32, ptr {self._addresses[id(target.block)]}, {emit.of(words)}")
        word = "add" if adds else f"{prefix}min".removeprefix("s")
        old = emit.part(f"atomicrmw {word} ptr {address}, {emit.of(total)} monotonic", more.element, False)
        # Each lane's own: what the lanes before it have added.
        found = emit.spread(old)
        for lane in range(1, self.lanes):
            before = emit.lane(chosen, lane - 1)
            old = emit.binary("+", old, before) if adds else emit.select(emit.compare("<", before, old), before, old)
            text = f"insertelement {emit.of(found)}, {emit.of(old)}, i32 {lane}"
            found = emit.part(text, more.element, True)
        return [found]

    def _assign(self, node: Assign) -> Parts:
        before = self.value(node.target) if node.gives_old else []
        parts = self.value(node.value)
        self._assign_to(node.target, parts)
        return before or parts

    def _assign_to(self, target: Expression, parts: Parts) -> None:
        numbers = range(target.type.parts) if not target.type.is_array else range(0)
        while isinstance(target, Pick):
            numbers = [target.numbers[n] for n in numbers]  # type: ignore[assignment]
            target = target.base
        if isinstance(target, Memory):
            self._put(target, numbers, parts)
        elif isinstance(target, Element):
            self._assign_element(target, numbers, parts)
        else:
            assert isinstance(target, Name)
            cells = self._bindings[id(target.variable)]
            for n, part in zip(numbers, parts, strict=True):
                cell = cells[n]
                assert isinstance(cell, Cell)
                self._store(cell, part)

    def _assign_element(self, target: Element, numbers: Sequence[int], parts: Parts) -> None:
        (index,), emit = self.value(target.index), self.emit
        if not target.base.type.is_array:
            width, old = target.type.parts, self.value(target.base)
            new = list(old)
            for n in range(target.base.type.size):
                here = self._compare("==", index, constant("i", n))
                for number, part in zip(numbers, parts, strict=True):
                    new[n * width + number] = emit.select(here, part, old[n * width + number])
            return self._assign_to(target.base, new)
        assert isinstance(target.base, Name)
        cells = self._bindings[id(target.base.variable)]
        for number, part in zip(numbers, parts, strict=True):
            cell = cells[number]
            assert isinstance(cell, Cell)
            if index.varying:
                if not cell.varying:
                    self._varying.add(cell.key)
                    continue
                self._scatter(emit.spread(part), cell.address, self._own_words(cell, index))
            else:
                kind = emit.kind(cell.element, cell.varying)
                self._store(cell, part, emit.new(f"getelementptr {kind}, ptr {cell.address}, {emit.of(index)}"))
        return None

    # Memory

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
        emit, elements, words = self.emit, _elements(node.type), self._words(node)
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


@contextmanager
def _unchanged() -> Iterator[None]:
    yield


def _returns(node: Any) -> Iterator[Leave]:
    if isinstance(node, Leave) and node.kind == "return":
        yield node
    for child in children(node):
        if isinstance(child, Statement):
            yield from _returns(child)


def _elements(kind: Any) -> str:
    """Return the element of each scalar of a value."""
    if kind.fields:
        return "".join(_elements(of) for _, of in kind.fields)
    return str(kind.element * kind.parts)


def _offsets(kind: Any, uniform: bool) -> list[int]:
    """Return the bytes from the begin of a value in a block to each of its scalars."""
    if kind.fields:
        return [kind.offset(name, uniform) + at for name, of in kind.fields for at in _offsets(of, uniform)]
    if kind.of:
        return [n * kind.of.stride(uniform) + at for n in range(kind.size) for at in _offsets(kind.of, uniform)]
    return [n * BYTES[kind.element] for n in range(kind.size)]


_VALUES: dict[type, Callable[[Generator, Any], Parts]] = {
    Constant: lambda self, node: [constant(node.type.element, node.value)],
    Name: Generator._name,
    Pick: lambda self, node: self._picked(node.base, node.numbers),
    Element: Generator._element,
    Memory: lambda self, node: self._fetch(node, range(node.type.parts)),
    Operation: Generator._operation,
    Either: Generator._either,
    Construct: Generator._construct,
    BuiltIn: Generator._built_in,
    Call: Generator._call,
    Assign: Generator._assign,
}
