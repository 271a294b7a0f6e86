"""Profile of generated code: how often each statement is executed, by how many lanes, and how many cycles it takes.

Counts are exact. Cycles come from programs of their own, as reading the counter disturbs what it measures: one in
which functions are told apart, and one for lines. Statements of functions that cost little are timed as part of
their callers, since reading the counter would take longer than they do.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.kernels.objects import function_address, optimized_object, optimizes
from clusterviz.spmd.analysis import Facts, children
from clusterviz.spmd.codegen import CHEAP, Generator
from clusterviz.spmd.ir import PROFILE_BLOCK, Block, Expression, Function, Leave, Loop, Program, Statement, Variable
from clusterviz.spmd.machine_code import code_of
from clusterviz.spmd.parser import parse
from clusterviz.spmd.source import ShaderSource
from clusterviz.spmd.tokens import tokens_of
from clusterviz.spmd.variables import Binding, Parts

COUNTERS = "executions", "lanes", "cycles", "switches"
INTERRUPTED = 1 << 16  # cycles between switches in which another process has had the core
Mode = Literal["counts", "functions", "lines"]


@dataclass(frozen=True)
class Site:
    """Statement or function with counters of its own."""

    function: str  # that it is in
    # "" and 0 for a function
    file: str = ""
    line: int = 0
    column: int = 0


@dataclass(frozen=True)
class Instrumented:
    """Instrumented machine code of a shader."""

    # function of the address of a table of addresses, with that of the counters at `PROFILE_BLOCK`
    call: Callable[[int], None]
    sites: tuple[Site, ...]  # of the counters

    def counters(self) -> NDArray[np.int64]:
        """Return zeros, int64 (sites, 4): `COUNTERS` of each site."""
        return np.zeros((len(self.sites), len(COUNTERS)), np.int64)


class ProfilingGenerator(Generator):
    """Generator of instrumented code. `mode`: what is measured; counters of the others stay 0."""

    separates = False

    def __init__(self, program: Program, lanes: int, intrinsics: dict[str, Any], mode: Mode) -> None:
        super().__init__(program, lanes, intrinsics)
        self._mode: Mode = mode
        self._numbers: dict[tuple[str, int], int] = {("", 0): 0}
        self._current, self._untimed = 0, 0
        self._marked = dict(_marked(program, self._facts))

    @property
    def keys(self) -> list[tuple[str, int]]:
        """Function, and position of the statement or 0, of each site."""
        return list(self._numbers)

    def _begin(self, name: str) -> None:
        super()._begin(name)
        emit, self._current = self.emit, 0
        self._counters = emit.new(f"load ptr, ptr {emit.new(f'getelementptr ptr, ptr %blocks, i64 {PROFILE_BLOCK}')}")
        if self._mode != "counts":
            self._last, self._site = emit.room("i64"), emit.room("i64")
            emit.declare("llvm.readcyclecounter", "i64", [])
            emit.line(f"store i64 {emit.new('call i64 @llvm.readcyclecounter()')}, ptr {self._last}")
            emit.line(f"store i64 0, ptr {self._site}")

    def _inline(self, function: Function, bindings: Sequence[Binding], at: int) -> Parts:
        outermost, outer = not self._frames, self._current
        untimed = not outermost and self._facts.cost(function.body) <= CHEAP  # type: ignore[arg-type]
        self._untimed += untimed
        if self._mode == "counts":
            self._count(self._number(function.name, 0))
        elif self._mode == "functions" and not untimed:
            self._switch(self._number(function.name, 0))
        found = super()._inline(function, bindings, at)
        if not untimed:
            self._switch(outer)
        self._untimed -= untimed
        return found

    def _statement(self, node: Statement) -> None:
        if not isinstance(node, Block | Loop) or (isinstance(node, Loop) and node.condition is None):
            self._visit(node.at)
        super()._statement(node)

    def value(self, node: Expression) -> Parts:
        """Return the scalars of a value; conditions of loops, and what a last `return` gives, count as statements."""
        if (at := self._marked.get(id(node))) is not None:
            self._visit(at)
        return super().value(node)

    def _unroll(self, node: Loop, counted: tuple[Variable, range]) -> None:
        self._visit(node.at)
        super()._unroll(node, counted)

    def _visit(self, at: int) -> None:
        if self._mode == "functions":
            return
        number = self._number(self._frames[-1].function.name, at)
        if self._mode == "counts":
            self._count(number)
        elif not self._untimed:
            self._switch(number)

    def _number(self, function: str, at: int) -> int:
        return self._numbers.setdefault((function, at), len(self._numbers))

    def _count(self, number: int) -> None:
        emit, lanes = self.emit, f"{self.lanes}"
        if self.mask is not None:
            kind = f"i{self.lanes}"
            bits = emit.new(f"bitcast {emit.of(emit.spread(self.mask))} to {kind}")
            emit.declare(f"llvm.ctpop.{kind}", kind, [kind])
            active = emit.new(f"call {kind} @llvm.ctpop.{kind}({kind} {bits})")
            lanes = emit.new(f"zext {kind} {active} to i64")
        for counter, more in enumerate(("1", lanes)):
            self._add(str(number), counter, more)

    def _switch(self, number: int) -> None:
        """Charge the time since the last switch to the site that was current, and make another one current."""
        if self._mode == "counts":
            return
        emit, self._current = self.emit, number
        now, last = emit.new("call i64 @llvm.readcyclecounter()"), emit.new(f"load i64, ptr {self._last}")
        site = emit.new(f"load i64, ptr {self._site}")
        passed = emit.new(f"sub i64 {now}, {last}")
        own = emit.new(f"icmp ult i64 {passed}, {INTERRUPTED}")
        self._add(site, 2, emit.new(f"select i1 {own}, i64 {passed}, i64 0"))
        self._add(site, 3, "1")
        emit.line(f"store i64 {now}, ptr {self._last}")
        emit.line(f"store i64 {number}, ptr {self._site}")

    def _add(self, site: str, counter: int, more: str) -> None:
        emit, kind = self.emit, f"[{len(COUNTERS)} x i64]"
        place = emit.new(f"getelementptr {kind}, ptr {self._counters}, i64 {site}, i64 {counter}")
        total = emit.new(f"add i64 {emit.new(f'load i64, ptr {place}')}, {more}")
        emit.line(f"store i64 {total}, ptr {place}")


def _marked(program: Program, facts: Facts) -> Iterator[tuple[int, int]]:
    """Yield the ids of expressions that stand for statements, and the positions of these."""
    waiting: list[Any] = [each.body for named in program.functions.values() for each in named if each.body]
    for body in waiting:
        last = body.statements[-1] if body.statements else None
        if isinstance(last, Leave) and last.value is not None and facts.returns_last(body):
            yield id(last.value), last.at
    while waiting:
        node = waiting.pop()
        waiting += children(node)
        if isinstance(node, Loop) and node.condition is not None:
            yield id(node.condition), node.at


def reached(source: ShaderSource, names: Collection[str]) -> frozenset[str]:
    """Return the functions of a shader with these names, and all that they call."""
    waiting = [each for name, named in parse(source).functions.items() if name in names for each in named]
    found = set[str]()
    while waiting:
        function = waiting.pop()
        if function.name not in found:
            found.add(function.name)
            waiting += [called for called, _ in function.calls]
    return frozenset(found)


def instrument(source: ShaderSource, name: str, lanes: int, mode: Mode) -> Instrumented:
    """Return the instrumented code of a shader's `main`; see `object_code`."""
    made: list[ProfilingGenerator] = []

    def make(program: Program, lanes: int, intrinsics: dict[str, Any]) -> Generator:
        made.append(ProfilingGenerator(program, lanes, intrinsics, mode))
        return made[0]

    text, (_, places) = code_of(source, name, lanes, make=make), tokens_of(source)
    sites = []
    for function, at in made[0].keys:
        file, line, column = places.where(at).rsplit(":", 2) if at else ("", "0", "0")
        sites.append(Site(function, file, int(line), int(column)))
    address = function_address(name, (text.encode(), str(optimizes()).encode()), lambda: optimized_object(text))
    return Instrumented(ctypes.CFUNCTYPE(None, ctypes.c_void_p)(address), tuple(sites))
