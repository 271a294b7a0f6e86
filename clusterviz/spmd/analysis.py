"""Facts of a typed program that decide how its code is generated: costs, effects, and how statements are left."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator
from dataclasses import fields
from functools import cache
from typing import Any

from clusterviz.spmd import ir
from clusterviz.spmd.types import INT

MOST_UNROLLED = 4  # iterations of a loop
COSTLY = 100  # cost from which lanes that do not need a value are masked
SEPARATE = 1000  # cost from which a value that no lane needs is not computed
ATOMIC = "atomicAdd", "atomicMin"


@cache
def _parts_of(kind: type) -> tuple[str, ...]:
    skipped = "type", "at", "function", "variable", "block"
    return tuple(one.name for one in fields(kind) if one.name not in skipped)


def children(node: Any) -> Iterator[Any]:
    """Return the parts of a node of the typed program, but not what it refers to."""
    for name in _parts_of(type(node)):  # type: ignore[arg-type]
        value = getattr(node, name)
        for item in value if isinstance(value, (tuple, list)) else (value,):
            item = item[0] if isinstance(item, tuple) else item
            if isinstance(item, (ir.Expression, ir.Statement)):
                yield item


def root(target: ir.Expression) -> ir.Variable | None:
    """Return the variable of which a value is a part; None if it is in a block, or computed."""
    while isinstance(target, ir.Pick | ir.Element):
        target = target.base
    return target.variable if isinstance(target, ir.Name) else None


def returns(node: Any) -> Iterator[ir.Leave]:
    """Return the `return` statements inside of a node."""
    if isinstance(node, ir.Leave) and node.kind == "return":
        yield node
    for child in children(node):
        if isinstance(child, ir.Statement):
            yield from returns(child)


def walk(*roots: Any, calls: bool = False) -> Iterator[Any]:
    """Yield nodes and all their parts; with `calls`, also the bodies of the functions that they call, each once."""
    waiting, seen = list(roots), set[int]()
    while waiting:
        node = waiting.pop()
        yield node
        if calls and isinstance(node, ir.Call) and id(node.function) not in seen and node.function.body is not None:
            seen.add(id(node.function))
            waiting.append(node.function.body)
        waiting += children(node)


def used_by(program: ir.Program) -> set[int]:
    """Return the ids of the variables that `main`, and what it calls, may use.

    Raises InputError: there is no `main`, or a function is called that CPUs do not have.
    """
    if "main" not in program.functions:
        raise program.places.error("no function main", 0)
    values = {id(d.variable): d.value for d in program.globals if d.value is not None}
    found, roots = set[int](), list[Any]([program.functions["main"][0].body])
    while roots:
        names = set[int]()
        for node in walk(*roots, calls=True):
            if isinstance(node, ir.BuiltIn) and node.name == "texture":
                raise program.places.error("CPUs do not filter textures", node.at, node.name, "texelFetch")
            if isinstance(node, ir.Name):
                names.add(id(node.variable))
        roots = [values[each] for each in names - found if each in values]
        found |= names
    return found


class Facts:
    """Facts of statements and expressions, each found once.

    `intrinsics`: names of functions that do not get their code from their bodies.
    """

    def __init__(self, intrinsics: Container[str]) -> None:
        self._intrinsics = intrinsics
        self._known: dict[tuple[str, int], Any] = {}

    def _fact(self, kind: str, node: Any, find: Callable[[Any], Any]) -> Any:
        key = kind, id(node)
        if key not in self._known:
            self._known[key] = find(node)
        return self._known[key]

    def leaves(self, node: ir.Statement | ir.Expression) -> frozenset[str]:
        """Return how a statement may leave what surrounds it."""

        def find(node: Any) -> frozenset[str]:
            if isinstance(node, ir.Leave):
                return frozenset([node.kind])
            if isinstance(node, ir.Expression):
                return frozenset()
            found = frozenset[str]().union(*(self.leaves(child) for child in children(node)))
            return found - {"break", "continue"} if isinstance(node, ir.Loop) else found

        return self._fact("leaves", node, find)  # type: ignore[no-any-return]

    def returns_last(self, body: ir.Block) -> bool:
        """Return whether a function returns nowhere but at its end."""
        last = body.statements[-1] if body.statements else None

        def find(node: Any) -> bool:
            return sum(1 for _ in returns(node)) == (1 if isinstance(last, ir.Leave) else 0)

        return self._fact("returns", body, find)  # type: ignore[no-any-return]

    def cost(self, node: ir.Statement | ir.Expression) -> int:
        """Return about how many operations a node takes; much for memory and loops."""

        def find(node: Any) -> int:
            own = 1 + sum(self.cost(child) for child in children(node))
            if isinstance(node, ir.Call):
                known = node.function.name in self._intrinsics or node.function.body is None
                return own + (1 if known else self.cost(node.function.body))  # type: ignore[arg-type]
            if isinstance(node, ir.Loop | ir.Leave):
                return own + 1000 * isinstance(node, ir.Loop)
            return own + 100 * isinstance(node, ir.Memory)

        return self._fact("cost", node, find)  # type: ignore[no-any-return]

    def price(self, node: ir.Expression) -> int:
        """Return the cost of an expression that not all lanes may evaluate; very much if it changes anything."""

        def changes(node: Any) -> bool:
            if isinstance(node, ir.Call) and any(p.kind != "in" for p in node.function.parameters):
                return True
            return (
                isinstance(node, ir.Assign) or self._has_effect(node) or any(changes(child) for child in children(node))
            )

        return self.cost(node) + SEPARATE * self._fact("changes", node, changes)  # type: ignore[no-any-return]

    def _has_effect(self, node: Any) -> bool:
        """Return whether a call changes anything but what it is given."""

        def find(node: Any) -> bool:
            if isinstance(node, ir.Assign) and ((of := root(node.target)) is None or of.kind in ("global", "shared")):
                return True
            if isinstance(node, ir.BuiltIn) and node.name in (*ATOMIC, "barrier"):
                return True
            if isinstance(node, ir.Call) and node.function.body is not None and inside(node.function.body):
                return True
            return any(find(child) for child in children(node))

        def inside(body: ir.Block) -> bool:
            return self._fact("effects", body, find)  # type: ignore[no-any-return]

        return isinstance(node, ir.Call) and node.function.body is not None and inside(node.function.body)

    def used_in(self, function: ir.Function) -> frozenset[int]:
        """Return the ids of the variables that a function, and what it calls, may use."""

        def find(function: ir.Function) -> frozenset[int]:
            return frozenset(id(node.variable) for node in walk(function.body, calls=True) if isinstance(node, ir.Name))

        return self._fact("used", function, find)  # type: ignore[no-any-return]

    def assigned_by(self, function: ir.Function) -> frozenset[int]:
        """Return the ids of the variables that a function, and what it calls, may assign."""

        def find(function: ir.Function) -> frozenset[int]:
            targets = list[ir.Expression]()
            for node in walk(function.body, calls=True):
                if isinstance(node, ir.Assign):
                    targets.append(node.target)
                if isinstance(node, ir.Call):
                    pairs = zip(node.arguments, node.function.parameters, strict=True)
                    targets += [argument for argument, parameter in pairs if parameter.kind != "in"]
            return frozenset(id(root(target)) for target in targets)

        return self._fact("assigned", function, find)  # type: ignore[no-any-return]

    def unrolled(self, node: ir.Loop) -> tuple[ir.Variable, range] | None:
        """Return the variable of a loop that is counted from constant to constant in few steps, and its values."""
        counted = self.counted(node)
        return counted if counted and len(counted[1]) <= MOST_UNROLLED else None

    def counted(self, node: ir.Loop) -> tuple[ir.Variable, range] | None:
        """Return the variable of a loop that is counted upwards from constant to constant, and its values."""

        def find(node: ir.Loop) -> tuple[ir.Variable, range] | None:
            begin, condition, step = node.begin, node.condition, node.step
            if not (
                isinstance(begin, ir.Declare) and isinstance(begin.value, ir.Constant) and isinstance(step, ir.Assign)
            ):
                return None
            if not (isinstance(condition, ir.Operation) and condition.operator == "<"):
                return None
            (a, b), variable, by = condition.operands, begin.variable, step.value
            counts = isinstance(by, ir.Operation) and by.operator == "+" and isinstance(by.operands[1], ir.Constant)
            if not (counts and isinstance(a, ir.Name) and a.variable is variable and isinstance(b, ir.Constant)):
                return None
            assert isinstance(by, ir.Operation)
            assert isinstance(by.operands[1], ir.Constant)
            if variable.type is not INT or by.operands[1].value < 1:
                return None
            if root(step.target) is not variable or _assigns(node.body, variable):
                return None
            return variable, range(int(begin.value.value), int(b.value), int(by.operands[1].value))

        return self._fact("counted", node, find)  # type: ignore[no-any-return]


def _assigns(node: Any, variable: ir.Variable) -> bool:
    if isinstance(node, ir.Assign) and root(node.target) is variable:
        return True
    if isinstance(node, ir.Call):
        pairs = zip(node.arguments, node.function.parameters, strict=True)
        if any(p.kind != "in" and root(a) is variable for a, p in pairs):
            return True
    return any(_assigns(child, variable) for child in children(node))
