"""Code of a typed program: an invocation a lane, masks where lanes differ, and plain code where they do not.

A value of which all lanes are known to be equal stays one number; which variables are so is
found by generating code again until no more of them turn out to vary, usually three times. A branch that depends on
the lane is skipped where no lane takes it, and variables keep their values in the lanes that do not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from clusterviz.spmd import ir
from clusterviz.spmd.analysis import Facts, used_by
from clusterviz.spmd.calls import Calls, Frame, Lap
from clusterviz.spmd.emitter import Part, constant
from clusterviz.spmd.variables import Parts

CHEAP = 80  # operations that are done without asking if a lane needs them


class Generator(Calls):
    """Code of the function `main` of a program.

    `lanes`: of a vector: 4, 8 or 16; `intrinsics`: what replaces functions of the program, by name: from the generator
    and the arguments to the value. Raises InputError: the program has no function `main`, or calls a function that CPUs
    do not have.
    """

    def __init__(
        self, program: ir.Program, lanes: int, intrinsics: dict[str, Callable[[Generator, list[Parts]], Parts]]
    ) -> None:
        super().__init__(program, lanes, Facts(intrinsics), intrinsics)
        self._used = used_by(program)

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

    def _statement(self, node: ir.Statement) -> None:
        if not self.emit.is_open:
            return
        match node:
            case ir.Declare():
                self._declare(node)
            case ir.Evaluate():
                self.value(node.expression)
            case ir.Block():
                for one in node.statements:
                    self._statement(one)
            case ir.If():
                self._if(node)
            case ir.Loop():
                self._loop(node)
            case ir.Leave():
                self._leave(node)

    def _if(self, node: ir.If) -> None:
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

    def _if_all(self, node: ir.If, condition: Part) -> None:
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

    def _if_some(self, node: ir.If, condition: Part) -> None:
        """Generate both sides of a branch, each for the lanes that take it."""
        emit, before = self.emit, (self.mask, self._mask_id)
        masks = [(node.then, condition)]
        if node.otherwise is not None:
            masks.append((node.otherwise, emit.inverse(condition)))
        for branch, taken in masks:
            mask, end = emit.both(before[0], taken), emit.label()
            if self._facts.cost(branch) > CHEAP:
                begin = emit.label()
                emit.branch(emit.any(mask), begin, end)
                emit.begin(begin)
            self._narrow(mask)
            self._frames[-1].ends.append(end)
            self._statement(branch)
            self._frames[-1].ends.pop()
            emit.begin(end)
            self.mask, self._mask_id = before
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

    def _leave(self, node: ir.Leave) -> None:
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

    def _loop(self, node: ir.Loop) -> None:
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

    def _unroll(self, node: ir.Loop, counted: tuple[ir.Variable, range]) -> None:
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

    def _lap_masks(self, node: ir.Loop, varying: bool) -> tuple[str, str]:
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

    def _end_loop(self, node: ir.Loop, varying: bool, before: tuple[Part | None, int]) -> None:
        self.mask, self._mask_id = before
        if "return" in self._facts.leaves(node.body) and varying:
            self._remask()
