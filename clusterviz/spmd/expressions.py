"""Code of expressions."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from contextlib import nullcontext

from clusterviz.spmd import ir
from clusterviz.spmd.analysis import ATOMIC, COSTLY, SEPARATE, Facts
from clusterviz.spmd.built_in import BUILT_INS, dot, least, most
from clusterviz.spmd.checker import OPERATORS
from clusterviz.spmd.emitter import Part, constant
from clusterviz.spmd.types import SAMPLERS, elements_of
from clusterviz.spmd.variables import Cell, Parts, Variables


class Expressions(Variables):
    """Values of expressions, and assignments."""

    def __init__(self, program: ir.Program, lanes: int, facts: Facts) -> None:
        super().__init__(program, lanes)
        self._facts = facts

    @abstractmethod
    def _call(self, call: ir.Call) -> Parts:
        """Return the value of a call."""

    @property
    @abstractmethod
    def _path(self) -> int:
        """Number of the call that is being generated."""

    def value(self, node: ir.Expression) -> Parts:
        """Return the scalars of a value."""
        match node:
            case ir.Constant():
                return [constant(node.type.element, node.value)]
            case ir.Name() | ir.Pick():
                return self._picked(node, range(node.type.parts))
            case ir.Memory():
                return self._fetch(node, range(node.type.parts))
            case ir.Operation():
                return self._operation(node)
            case ir.BuiltIn():
                return self._built_in(node)
            case ir.Construct():
                return self._construct(node)
            case ir.Call():
                return self._call(node)
            case ir.Assign():
                return self._assign(node)
            case ir.Either():
                return self._either(node)
            case ir.Element():
                return self._element(node)
        raise TypeError(type(node))

    def _picked(self, node: ir.Expression, numbers: Sequence[int]) -> Parts:
        if isinstance(node, ir.Pick):
            return self._picked(node.base, [node.numbers[n] for n in numbers])
        if isinstance(node, ir.Name):
            if node.variable.kind == "system":
                return [self._system(node.variable.name, n) for n in numbers]
            binding = self._bindings[id(node.variable)]
            return [self._load(one) if isinstance(one, Cell) else one for one in (binding[n] for n in numbers)]
        if isinstance(node, ir.Memory):
            return self._fetch(node, numbers)
        parts = self.value(node)
        return [parts[n] for n in numbers]

    def _system(self, name: str, number: int) -> Part:
        emit, offset = self.emit, {"gl_WorkGroupID": 0, "gl_NumWorkGroups": 3, "gl_LocalInvocationIndex": 6}[name]
        block = emit.new(f"load ptr, ptr {emit.new(f'getelementptr ptr, ptr %blocks, i64 {ir.SYSTEM_BLOCK}')}")
        place = emit.new(f"getelementptr i32, ptr {block}, i64 {offset + number}")
        found = emit.part(f"load i32, ptr {place}", "u", False)
        return self._binary("+", found, self.lane_numbers("u")) if offset == 6 else found

    def _element(self, node: ir.Element) -> Parts:
        (index,) = self.value(node.index)
        if node.base.type.is_array:
            assert isinstance(node.base, ir.Name)
            index = self._inside(index, node.base.type.size)
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
                # It may not have been written.
                found[-1] = emit.part(f"freeze {emit.of(found[-1])}", cell.element, found[-1].varying)
            return found
        parts, width = self.value(node.base), node.type.parts
        found = parts[:width]
        for n in range(1, node.base.type.size):
            here = self._compare("==", index, constant("i", n))
            found = [self.emit.select(here, parts[n * width + k], found[k]) for k in range(width)]
        return found

    def _operation(self, node: ir.Operation) -> Parts:
        if node.operator in "+-" and node.type.element == "f":
            for product, other in (node.operands, node.operands[::-1]):
                if isinstance(product, ir.Operation) and product.operator == "*":
                    return self._fused(node, product, other)
        given = [self.value(one) for one in node.operands]
        operator = node.operator
        if operator == "transform":
            matrix, vector = given
            return [dot(self.emit, matrix[row::3], vector) for row in range(3)]
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

    def _fused(self, node: ir.Operation, product: ir.Operation, other: ir.Expression) -> Parts:
        """Return a product plus or less something as one operation, wherever the expression is used."""
        (x, y), z = (self.value(one) for one in product.operands), self.value(other)
        if node.operator == "-":
            x, z = (
                (x, [self._negative(one) for one in z])
                if product is node.operands[0]
                else ([self._negative(one) for one in x], z)
            )
        size = node.type.parts
        return [self.emit.call("fmuladd", "f", *(one[n % len(one)] for one in (x, y, z))) for n in range(size)]

    def _joined(self, sign: str, parts: Parts) -> Part:
        found = parts[0]
        for part in parts[1:]:
            found = self.emit.binary(sign, found, part)
        return found

    def _negative(self, part: Part) -> Part:
        if part.element in "fd":
            return self.emit.part(f"fneg {self.emit.flags}{self.emit.of(part)}", part.element, part.varying)
        return self._binary("-", constant(part.element, 0), part)

    def _compare(self, sign: str, a: Part, b: Part) -> Part:
        if a.constant is not None and b.constant is not None:
            return constant("b", OPERATORS[sign](a.constant, b.constant))
        return self.emit.compare(sign, a, b)

    def _either(self, node: ir.Either) -> Parts:
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
        fixed = ir.Constant(node.type, node.at, stops)
        if self._facts.price(a) < COSTLY or not stops:
            taken = self.emit.inverse(condition) if stops else condition
            if self._facts.price(a) < SEPARATE:
                with (
                    self._within(self.emit.both(self.mask, taken)) if self._facts.price(a) >= COSTLY else nullcontext()
                ):
                    (found,) = self.value(a)
                return [self.emit.binary("|" if stops else "&", condition, found)]
        return self._chosen(condition, fixed, a) if stops else self._chosen(condition, a, fixed)

    def _chosen(self, condition: Part, a: ir.Expression, b: ir.Expression) -> Parts:
        emit = self.emit
        if self._facts.price(a) + self._facts.price(b) < COSTLY:
            return [emit.select(condition, x, y) for x, y in zip(self.value(a), self.value(b), strict=True)]
        key = (self._path, "either", a.at, b.at)
        cells = self._room(elements_of(a.type), key)
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
            with self._for_lanes(emit.both(self.mask, taken), self._facts.price(one) >= SEPARATE):
                for cell, part in zip(cells, self.value(one), strict=True):
                    self._store(cell, part)
        return [self._load(cell) for cell in cells]

    def _construct(self, node: ir.Construct) -> Parts:
        elements, first = elements_of(node.type), node.arguments[0]
        if isinstance(first, ir.BuiltIn) and first.name == "round" and first.type.element == "f" and elements[0] == "i":
            return [self.emit.nearest(part) for part in self.value(first.arguments[0])]
        given = [part for one in node.arguments for part in self.value(one)]
        if len(given) == 1:
            given *= len(elements)
        return [self.emit.convert(part, element) for part, element in zip(given, elements, strict=False)]

    def _built_in(self, node: ir.BuiltIn) -> Parts:
        if node.name in ("texelFetch", "textureSize"):
            return self._texel(node)
        given = [self.value(one) for one in node.arguments]
        if node.name == "barrier":
            return []
        if node.name == "clock2x32ARB":
            return self.emit.clock()
        if node.name in ATOMIC:
            return self._atomic(node.name == "atomicAdd", node.arguments[0], given[1][0])
        return BUILT_INS[node.name](self.emit, given)

    def _texel(self, node: ir.BuiltIn) -> Parts:
        """Return a texel, of those in the texture the nearest one, or the texture's size."""
        emit, (sampler, *arguments) = self.emit, node.arguments
        assert isinstance(sampler, ir.Name)
        base, sides = self._addresses[id(sampler.variable)], range(2 if sampler.type is SAMPLERS[2] else 3)
        places = [emit.new(f"getelementptr i32, ptr {base}, i32 {n}") for n in sides]
        size = [emit.part(f"load i32, ptr {place}, align 4", "i", False) for place in places]
        if node.name == "textureSize":
            return size
        texel = constant("i", 0)
        for at, side in reversed(list(zip(self.value(arguments[0]), size, strict=True))):
            last = self._binary("-", side, constant("i", 1))
            at = most(emit, least(emit, at, last), constant("i", 0))
            texel = self._binary("+", self._binary("*", texel, side), at)
        words = self._binary("+", self._binary("*", texel, constant("i", 4)), constant("i", 4))
        return self._load_numbers("ffff", base, words)

    def _atomic(self, adds: bool, target: ir.Expression, more: Part) -> Parts:
        emit, prefix = self.emit, "" if adds else {"i": "s", "u": "u"}[more.element]
        neutral = 0 if adds else (1 << 32) - 1 if more.element == "u" else (1 << 31) - 1
        chosen = emit.spread(emit.select(self._full(), more, constant(more.element, neutral)))
        total = emit.reduced("add" if adds else f"{prefix}min", chosen)
        if isinstance(target, ir.Name):
            # A work group is one thread.
            (cell,) = self._bindings[id(target.variable)]
            assert isinstance(cell, Cell)
            old = self._load(cell)
            new = emit.binary("+", old, total) if adds else least(emit, old, total)
            emit.line(f"store {emit.of(new)}, ptr {cell.address}")
        else:
            assert isinstance(target, ir.Memory)
            place, words = self._place(target)
            address = emit.new(f"getelementptr i32, ptr {place}, {emit.of(words)}")
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

    def _assign(self, node: ir.Assign) -> Parts:
        before = self.value(node.target) if node.gives_old else []
        parts = self.value(node.value)
        self._assign_to(node.target, parts)
        return before or parts

    def _assign_to(self, target: ir.Expression, parts: Parts) -> None:
        numbers = range(target.type.parts) if not target.type.is_array else range(0)
        while isinstance(target, ir.Pick):
            numbers = [target.numbers[n] for n in numbers]  # type: ignore[assignment]
            target = target.base
        if isinstance(target, ir.Memory):
            self._put(target, numbers, parts)
        elif isinstance(target, ir.Element):
            self._assign_element(target, numbers, parts)
        else:
            assert isinstance(target, ir.Name)
            cells = self._bindings[id(target.variable)]
            for n, part in zip(numbers, parts, strict=True):
                cell = cells[n]
                assert isinstance(cell, Cell)
                self._store(cell, part)

    def _assign_element(self, target: ir.Element, numbers: Sequence[int], parts: Parts) -> None:
        (index,), emit = self.value(target.index), self.emit
        assert isinstance(target.base, ir.Name), "the checker has seen to that"
        index = self._inside(index, target.base.type.size)
        cells = self._bindings[id(target.base.variable)]
        for number, part in zip(numbers, parts, strict=True):
            cell = cells[number]
            assert isinstance(cell, Cell)
            if index.varying:
                if not cell.varying:
                    self._vary(cell)
                self._scatter(emit.spread(part), cell.address, self._own_words(cell, index))
            else:
                kind = emit.kind(cell.element, cell.varying)
                self._store(cell, part, emit.new(f"getelementptr {kind}, ptr {cell.address}, {emit.of(index)}"))
