"""Interpreter of the typed program with NumPy arrays: an invocation a lane, all lanes in step.

It stops before every statement, so that a debugger can look at all invocations at once. A value is a list of its
scalars, arrays of one number or of one a lane. Lanes that part take the branches one after the other, under masks. Like
OpenGL it computes in float32; `fma` of float32 rounds once.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.spmd import ir
from clusterviz.spmd.built_in import BUILT_INS
from clusterviz.spmd.checker import OPERATORS
from clusterviz.spmd.emitter import Part
from clusterviz.spmd.source import ShaderSource
from clusterviz.spmd.types import layout

Array = NDArray[Any]
Mask = NDArray[np.bool_]
Value = list[Array]
Evaluation = Generator[ir.Statement, None, Value]
Execution = Generator[ir.Statement, None, Mask]

DTYPES = {"f": np.float32, "d": np.float64, "i": np.int32, "u": np.uint32, "b": np.bool_}
STORED = DTYPES | {"b": np.uint32}


@dataclass(frozen=True)
class Texture:
    texels: NDArray[np.float32]  # float32 (…, height, width, components)
    linear: bool  # the texture unit interpolates
    stored: str = "f4"  # moderngl's name of their type in memory


@dataclass(frozen=True)
class Dispatch:
    """Dispatch of a compute shader, with all that is bound."""

    source: ShaderSource  # of the shader
    groups: tuple[int, int, int]  # number of work groups along x, y, z
    # uint8, contents of the blocks by binding; buffers change
    uniforms: Mapping[int, NDArray[np.uint8]]
    buffers: Mapping[int, NDArray[np.uint8]]
    textures: Mapping[int, Texture] = field(default_factory=dict)  # by binding


@dataclass(eq=False)
class Repetition:
    """Loop that is running: the lanes that entered it, those still in it, and the number of the iteration."""

    loop: ir.Loop
    entered: Mask
    inside: Mask
    iteration: int = 0
    continued: Mask | None = None


@dataclass(eq=False)
class Frame:
    """Call of a function."""

    function: ir.Function
    # lanes
    entered: Mask
    returned: Mask
    variables: dict[ir.Variable, Value] = field(default_factory=dict)
    result: Value | None = None
    loops: list[Repetition] = field(default_factory=list)
    statement: ir.Statement | None = None  # that is being executed


class Interpreter:
    """Execution of a dispatch.

    `program`: of the dispatch's source. `groups`: int (g, 3), the work groups to execute; None: all.

    Attributes
    ----------
    lanes : number of invocations; lane 64 · k + i is invocation i of the k-th group, if groups have 64
    frames : call stack, the innermost last
    mask : lanes that execute the next statement
    faults : position of an access outside of a block or array: the first lane and the index; the last element is
        accessed
    """

    def __init__(self, program: ir.Program, dispatch: Dispatch, groups: NDArray[np.int64] | None = None) -> None:
        self.program, self.dispatch = program, dispatch
        if groups is None:
            x, y, z = dispatch.groups
            groups = np.stack(np.meshgrid(range(x), range(y), range(z), indexing="ij"), -1).reshape(-1, 3, order="F")
            groups = groups[np.lexsort(groups.T)]
        self.groups = groups
        each = int(np.prod(program.local_size))
        self.lanes = each * len(groups)
        self.frames: list[Frame] = []
        self.mask: Mask = np.ones(self.lanes, bool)
        self.faults: dict[int, tuple[int, int]] = {}
        self._group = np.repeat(np.arange(len(groups)), each)
        self._globals: dict[ir.Variable, Value] = {}
        self._system = self._system_values(each)
        self._blocks = {"uniform": dispatch.uniforms, "buffer": dispatch.buffers}
        self._views: dict[tuple[str, int, str], Array] = {}
        self._steps = self._run()

    def advance(self) -> ir.Statement | None:
        """Execute up to the next statement, and return it; None at the end."""
        with np.errstate(all="ignore"):
            return next(self._steps, None)

    def finish(self) -> None:
        with np.errstate(all="ignore"):
            for _ in self._steps:
                pass

    def value(self, expression: ir.Expression, mask: Mask | None = None) -> Value:
        """Return what an expression without calls gives in the present frame: an array (lanes,) of each scalar."""
        faults, found = dict(self.faults), list[Value]()

        def evaluate() -> Generator[ir.Statement, None, None]:
            found.append((yield from self._value(expression, self.mask if mask is None else mask)))

        with np.errstate(all="ignore"):
            for _ in evaluate():
                raise AssertionError("the expression has a call")
        self.faults = faults
        return [np.broadcast_to(part, self.lanes) for part in found[0]]

    @property
    def ended(self) -> Mask:
        """Lanes that have left a call or a loop in which the others still are."""
        found = np.zeros(self.lanes, bool)
        for frame in self.frames:
            found |= frame.returned
            for loop in frame.loops:
                found |= loop.entered & ~loop.inside
        return found

    # Statements: each gives the lanes that go on behind it

    def _run(self) -> Generator[ir.Statement, None, None]:
        everything = np.ones(self.lanes, bool)
        for declare in self.program.globals:
            variable = declare.variable
            if variable.kind == "shared":
                self._globals[variable] = [np.zeros(len(self.groups), DTYPES[e]) for e, _ in layout(variable.type)]
            else:
                yield from self._declare(declare, everything)
        yield from self._call(self.program.functions["main"][0], [], everything)
        self.mask = np.zeros(self.lanes, bool)

    def _execute(self, statement: ir.Statement, mask: Mask) -> Execution:
        if isinstance(statement, ir.Block):
            for one in statement.statements:
                if not mask.any():
                    break
                mask = yield from self._execute(one, mask)
            return mask
        frame = self.frames[-1]
        frame.statement = statement
        if isinstance(statement, ir.Loop):
            return (yield from self._repeat(statement, mask, frame))
        self.mask = mask
        yield statement
        if isinstance(statement, ir.Declare):
            yield from self._declare(statement, mask)
        elif isinstance(statement, ir.Evaluate):
            yield from self._value(statement.expression, mask)
        elif isinstance(statement, ir.If):
            (condition,) = yield from self._value(statement.condition, mask)
            then, otherwise = mask & condition, mask & ~condition
            if then.any():
                then = yield from self._execute(statement.then, then)
            if statement.otherwise and otherwise.any():
                otherwise = yield from self._execute(statement.otherwise, otherwise)
            return then | otherwise
        else:
            assert isinstance(statement, ir.Leave)
            yield from self._leave(statement, mask, frame)
            return np.zeros(self.lanes, bool)
        return mask

    def _declare(self, statement: ir.Declare, mask: Mask) -> Execution:
        variable = statement.variable
        if statement.value is None:
            value: Value = [np.zeros(1, DTYPES[element]) for element, _ in layout(variable.type)]
        else:
            value = yield from self._value(statement.value, mask)
        (self.frames[-1].variables if self.frames else self._globals)[variable] = value
        return mask

    def _repeat(self, statement: ir.Loop, mask: Mask, frame: Frame) -> Execution:
        if statement.begin:
            yield from self._execute(statement.begin, mask)
        loop = Repetition(statement, mask, mask)
        frame.loops.append(loop)
        active = mask
        while True:
            loop.inside = self.mask = active
            frame.statement = statement
            yield statement
            if statement.condition:
                (condition,) = yield from self._value(statement.condition, active)
                active = active & condition
            if not active.any():
                break
            loop.inside, loop.continued = active, np.zeros(self.lanes, bool)
            active = yield from self._execute(statement.body, active)
            active = active | loop.continued
            loop.iteration += 1
            if not active.any():
                break
            if statement.step:
                loop.inside = active
                yield from self._value(statement.step, active)
        frame.loops.pop()
        return mask & ~frame.returned

    def _leave(self, statement: ir.Leave, mask: Mask, frame: Frame) -> Generator[ir.Statement, None, None]:
        if statement.kind == "return":
            if statement.value:
                value = yield from self._value(statement.value, mask)
                frame.result = value if frame.result is None else _merged(mask, value, frame.result)
            frame.returned = frame.returned | mask
            for loop in frame.loops:
                loop.inside = loop.inside & ~mask
        elif statement.kind == "continue":
            loop = frame.loops[-1]
            assert loop.continued is not None
            loop.continued = loop.continued | mask
        else:
            frame.loops[-1].inside = frame.loops[-1].inside & ~mask

    def _call(self, function: ir.Function, arguments: list[Value], mask: Mask) -> Generator[ir.Statement, None, Frame]:
        frame = Frame(function, mask, np.zeros(self.lanes, bool))
        frame.variables = dict(zip(function.parameters, arguments, strict=True))
        self.frames.append(frame)
        assert function.body, "the parser has seen to that"
        yield from self._execute(function.body, mask)
        return self.frames.pop()

    # Expressions

    def _value(self, node: ir.Expression, mask: Mask) -> Evaluation:
        if isinstance(node, ir.Name):
            return self._variable(node.variable)
        if isinstance(node, ir.Constant):
            return [np.full(1, node.value, DTYPES[node.type.element])]
        if isinstance(node, ir.Pick):
            base = yield from self._value(node.base, mask)
            return [base[number] for number in node.numbers]
        if isinstance(node, ir.Operation):
            return _operated(node.operator, (yield from self._values(node.operands, mask)))
        if isinstance(node, ir.Memory):
            return (yield from self._loaded(node, mask))
        if isinstance(node, ir.BuiltIn):
            return (yield from self._built_in(node, mask))
        if isinstance(node, ir.Construct):
            parts = [part for one in (yield from self._values(node.arguments, mask)) for part in one]
            if node.type.fields:
                return parts
            kind = DTYPES[node.type.element]
            return [part.astype(kind, copy=False) for part in (parts * node.type.parts)[: node.type.parts]]
        if isinstance(node, ir.Call):
            return (yield from self._called(node, mask))
        if isinstance(node, ir.Assign):
            old = (yield from self._value(node.target, mask)) if node.gives_old else None
            value = yield from self._value(node.value, mask)
            yield from self._store(node.target, value, mask)
            return old or value
        if isinstance(node, ir.Either):
            return (yield from self._either(node, mask))
        assert isinstance(node, ir.Element), "there is no other expression"
        base, index, size = yield from self._elements(node, mask)
        # Arrays have up to a thousand elements, of which the lanes read a few.
        first, *others = np.unique(index).tolist()
        found = base[first::size]
        for number in others:
            found = [np.where(index == number, a, b) for a, b in zip(base[number::size], found, strict=True)]
        return found

    def _values(self, nodes: tuple[ir.Expression, ...], mask: Mask) -> Generator[ir.Statement, None, list[Value]]:
        found = list[Value]()
        for node in nodes:
            found += [(yield from self._value(node, mask))]
        return found

    def _elements(self, node: ir.Element, mask: Mask) -> Generator[ir.Statement, None, tuple[Value, Array, int]]:
        """The scalars of an array, ordered by scalar of an element, then by element; the index, and the elements."""
        base = yield from self._value(node.base, mask)
        (index,) = yield from self._value(node.index, mask)
        each = node.type.parts
        ordered = [part for n in range(each) for part in base[n::each]]
        return ordered, self._inside(node.at, index, len(base) // each, mask), len(base) // each

    def _variable(self, variable: ir.Variable) -> Value:
        if variable.kind == "shared":
            return [part[self._group] for part in self._globals[variable]]
        if variable.kind == "system":
            return self._system[variable.name]
        if self.frames and (found := self.frames[-1].variables.get(variable)) is not None:
            return found
        return self._globals[variable]

    def _either(self, node: ir.Either, mask: Mask) -> Evaluation:
        (condition,) = yield from self._value(node.condition, mask)
        first, second = mask & condition, mask & ~condition
        if node.operator == "&&":
            return [condition & (yield from self._value(node.a, first))[0]] if first.any() else [condition]
        if node.operator == "||":
            return [condition | (yield from self._value(node.a, second))[0]] if second.any() else [condition]
        assert node.b, "a choice has two"
        a = (yield from self._value(node.a, first)) if first.any() or not second.any() else None
        b = (yield from self._value(node.b, second)) if second.any() else None
        if a is None or b is None:
            return a or b or []
        return [np.where(condition, x, y) for x, y in zip(a, b, strict=True)]

    def _called(self, node: ir.Call, mask: Mask) -> Evaluation:
        arguments, parameters = [], node.function.parameters
        for argument, parameter in zip(node.arguments, parameters, strict=True):
            given = parameter.kind != "out"
            zeros: Value = [np.zeros(1, DTYPES[element]) for element, _ in layout(parameter.type)]
            arguments.append((yield from self._value(argument, mask)) if given else zeros)
        frame = yield from self._call(node.function, arguments, mask)
        for argument, parameter in zip(node.arguments, parameters, strict=True):
            if parameter.kind != "in":
                yield from self._store(argument, frame.variables[parameter], mask)
        return frame.result or []

    def _store(self, target: ir.Expression, value: Value, mask: Mask) -> Generator[ir.Statement, None, None]:
        if isinstance(target, ir.Memory):
            address = yield from self._address(target, mask)
            for part, (element, offset) in zip(value, layout(target.type), strict=True):
                view, index = self._place(target, address, element, offset, mask)
                view[np.broadcast_to(index, self.lanes)[mask]] = np.broadcast_to(part, self.lanes)[mask]
        elif isinstance(target, ir.Name):
            variable = target.variable
            if variable.kind == "shared":
                for stored, part in zip(self._globals[variable], value, strict=True):
                    stored[self._group[mask]] = np.broadcast_to(part, self.lanes)[mask]
                return
            local = variable in self.frames[-1].variables if self.frames else False
            variables = self.frames[-1].variables if local else self._globals
            variables[variable] = _merged(mask, value, variables[variable])
        elif isinstance(target, ir.Pick):
            parts = list((yield from self._value(target.base, mask)))
            for number, part in zip(target.numbers, value, strict=True):
                parts[number] = part
            yield from self._store(target.base, parts, mask)
        else:
            assert isinstance(target, ir.Element), "the checker has seen to that"
            parts, index, size = yield from self._elements(target, mask)
            for n in np.unique(index).tolist():
                for begin, part in zip(range(0, len(parts), size), value, strict=True):
                    parts[begin + n] = np.where(index == n, part, parts[begin + n])
            yield from self._store(target.base, [part for n in range(size) for part in parts[n::size]], mask)

    # Memory

    def _address(self, node: ir.Memory, mask: Mask) -> Generator[ir.Statement, None, Array]:
        address: Array = np.full(1, node.offset, np.int64)
        for term, stride in node.terms:
            (index,) = yield from self._value(term, mask)
            address = address + index.astype(np.int64) * stride
        return address

    def _loaded(self, node: ir.Memory, mask: Mask) -> Evaluation:
        address, found = (yield from self._address(node, mask)), []
        for element, offset in layout(node.type, node.block.kind == "uniform"):
            view, index = self._place(node, address, element, offset, mask)
            found.append(view[index] != 0 if element == "b" else view[index])
        return found

    def _place(self, node: ir.Memory, address: Array, element: str, offset: int, mask: Mask) -> tuple[Array, Array]:
        """A block as an array of an element, and the index in it."""
        key = node.block.kind, node.block.binding, element
        if (view := self._views.get(key)) is None:
            block, size = self._blocks[key[0]].get(key[1], np.zeros(0, np.uint8)), STORED[element]().itemsize
            view = self._views[key] = block[: len(block) // size * size].view(STORED[element])
        if not len(view):
            view = np.zeros(1, view.dtype)
        return view, self._inside(node.at, (address + offset) // view.itemsize, len(view), mask)

    def _inside(self, at: int, index: Array, size: int, mask: Mask) -> Array:
        if index.min() >= 0 and index.max() < size:
            return index
        wrong = np.flatnonzero(mask & ((index < 0) | (index >= size)))
        if len(wrong):
            self.faults.setdefault(at, (int(wrong[0]), int(np.broadcast_to(index, self.lanes)[wrong[0]])))
        return np.where((index < 0) | (index >= size), size - 1, index)

    # Built-in functions and variables

    def _built_in(self, node: ir.BuiltIn, mask: Mask) -> Evaluation:
        if node.name in ATOMIC:
            return (yield from self._atomic(node, mask))
        if node.name in ("texture", "texelFetch", "textureSize"):
            sampler, at = node.arguments[0], (yield from self._value(node.arguments[1], mask))
            assert isinstance(sampler, ir.Name), "samplers are variables"
            return _fetched(self.dispatch.textures[sampler.variable.binding], node.name, at)
        if node.name == "barrier":
            return []
        given = yield from self._values(node.arguments, mask)
        if node.name == "unpackDouble2x32":
            return list(np.ascontiguousarray(given[0][0]).view(np.uint32).reshape(-1, 2).T)
        if node.name in EXACT:
            size = max(map(len, given))
            return [EXACT[node.name](*(one[n % len(one)] for one in given)) for n in range(size)]
        found = BUILT_INS[node.name](ARITHMETIC, [[_Lanes(part) for part in one] for one in given])  # type: ignore[misc]
        return [_array(part) for part in found]

    def _atomic(self, node: ir.BuiltIn, mask: Mask) -> Evaluation:
        (value,) = yield from self._value(node.arguments[1], mask)
        target, function = node.arguments[0], ATOMIC[node.name]
        if isinstance(target, ir.Memory):
            address = yield from self._address(target, mask)
            storage, index = self._place(target, address, target.type.element, 0, mask)
            index = np.broadcast_to(index, self.lanes)
        else:
            assert isinstance(target, ir.Name), "the checker has seen to that"
            (storage,), index = self._globals[target.variable], self._group
        old, value = np.zeros(self.lanes, storage.dtype), np.broadcast_to(value, self.lanes)
        for lane in np.flatnonzero(mask):
            old[lane] = storage[index[lane]]
            storage[index[lane]] = function(old[lane], value[lane])
        return [old]

    def _system_values(self, each: int) -> dict[str, Value]:
        index = np.tile(np.arange(each, dtype=np.uint32), len(self.groups))
        x, y, _ = self.program.local_size
        inside = [index % x, index // x % y, index // (x * y)]
        group = [self.groups[self._group, axis].astype(np.uint32) for axis in range(3)]
        return {
            "gl_LocalInvocationIndex": [index],
            "gl_LocalInvocationID": inside,
            "gl_WorkGroupID": group,
            "gl_NumWorkGroups": [np.full(1, count, np.uint32) for count in self.dispatch.groups],
            "gl_GlobalInvocationID": [
                g * np.uint32(size) + i for g, i, size in zip(group, inside, self.program.local_size, strict=True)
            ],
        }


def _merged(mask: Mask, value: Value, old: Value) -> Value:
    return [a if a is b else np.where(mask, a, b) for a, b in zip(value, old, strict=True)]


UNARY: dict[str, Callable[[Array], Array]] = {"neg": np.negative, "!": np.logical_not, "~": np.invert}


def _operated(operator: str, given: list[Value]) -> Value:
    if operator in UNARY:
        return [UNARY[operator](part) for part in given[0]]
    a, b = given
    if operator in ("==", "!="):
        equal = np.logical_and.reduce(np.broadcast_arrays(*(x == y for x, y in zip(a, b, strict=True))))
        return [equal if operator == "==" else ~equal]
    if operator == "transform":
        return [a[n] * b[0] + a[n + 3] * b[1] + a[n + 6] * b[2] for n in range(3)]
    size = max(len(a), len(b))
    return [_binary(operator, a[n % len(a)], b[n % len(b)]) for n in range(size)]


def _binary(sign: str, a: Array, b: Array) -> Array:
    if sign in ("<", "<=", ">", ">="):
        return np.asarray(OPERATORS[sign](a, b))
    if sign == "/" and a.dtype.kind == "f":
        return a / b
    return np.asarray(OPERATORS[sign](a, b)).astype(a.dtype, copy=False)


def _fma(a: Array, b: Array, c: Array) -> Array:
    if a.dtype == np.float64:
        return a * b + c
    return (a.astype(np.float64) * b + c).astype(np.float32)


@dataclass(frozen=True, slots=True)
class _Lanes:
    values: Array
    varying = False
    constant = None

    @property
    def element(self) -> str:
        return ELEMENTS[self.values.dtype]


class _Arithmetic:
    """What the functions of `built_in.py` ask of an emitter, done at once."""

    lanes = 1

    def binary(self, sign: str, a: Any, b: Any) -> _Lanes:
        return _Lanes(_binary(sign, _array(a), _array(b)))

    def compare(self, sign: str, a: Any, b: Any) -> _Lanes:
        return _Lanes(np.asarray(OPERATORS[sign](_array(a), _array(b))))

    def select(self, mask: Any, a: Any, b: Any) -> _Lanes:
        return _Lanes(np.where(_array(mask), _array(a), _array(b)))

    def inverse(self, a: Any) -> _Lanes:
        return _Lanes(~_array(a))

    def bits(self, a: Any, element: str) -> _Lanes:
        return _Lanes(np.ascontiguousarray(_array(a)).view(DTYPES[element]))

    def call(self, name: str, result: str, *parts: Any) -> _Lanes:
        given = [_array(part) for part in parts]
        if name == "fmuladd":
            return _Lanes(given[0] * given[1] + given[2])
        return _Lanes(getattr(np, name)(*given))


def _array(part: Part | _Lanes) -> Array:
    if isinstance(part, _Lanes):
        return part.values
    return np.full(1, part.constant, DTYPES[part.element])


ELEMENTS = {np.dtype(kind): element for element, kind in DTYPES.items()}
ARITHMETIC: Any = _Arithmetic()
EXACT: dict[str, Callable[..., Array]] = {
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": lambda a, b=None: np.arctan(a) if b is None else np.arctan2(a, b),
    "pow": np.power,
    "fma": _fma,
}
"""Functions of each component for which generated code has instructions or a library of its own."""
ATOMIC: dict[str, Callable[[Any, Any], Any]] = {"atomicAdd": np.add, "atomicMin": np.minimum}


def _fetched(texture: Texture, name: str, at: Value) -> Value:
    """Texels at coordinates (x, y, …), clamped to the edge."""
    texels = texture.texels
    sizes = texels.shape[-2::-1]
    if name == "textureSize":
        return [np.full(1, size, np.int32) for size in sizes]
    if name == "texelFetch":
        index = tuple(np.clip(part, 0, size - 1) for part, size in zip(at, sizes, strict=False))
        return _components(texels[index[::-1]])
    places = [part * np.float32(size) - np.float32(0.5) for part, size in zip(at, sizes, strict=True)]
    if not texture.linear:
        index = tuple(np.clip(np.rint(p), 0, size - 1).astype(np.int64) for p, size in zip(places, sizes, strict=True))
        return _components(texels[index[::-1]])
    first = [np.floor(place) for place in places]
    weights = [place - begin for place, begin in zip(places, first, strict=True)]
    found: Any = 0.0
    for corner in np.ndindex(*(2,) * len(sizes)):
        index = tuple(
            np.clip(begin.astype(np.int64) + n, 0, size - 1)
            for begin, n, size in zip(first, corner, sizes, strict=True)
        )
        weight: Any = np.float32(1)
        for w, n in zip(weights, corner, strict=True):
            weight = weight * (w if n else 1 - w)
        found = found + texels[index[::-1]] * weight[..., None]
    return _components(found)


def _components(texels: NDArray[np.float32]) -> Value:
    """The four components of texels (…, c); those that a texture lacks are 0, the last one is 1."""
    present = [np.ascontiguousarray(texels[..., n]) for n in range(texels.shape[-1])]
    return present + [np.full(1, n == 3, np.float32) for n in range(len(present), 4)]
