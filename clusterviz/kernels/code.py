"""Code generation of functions: variables, constants, memory access, loops and branches."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]

from clusterviz.kernels.lanes import (
    BYTES,
    F32,
    F64,
    I1,
    I8,
    I16,
    I32,
    I64,
    POINTER,
    Number,
    Operand,
    Value,
    kind_of,
    splat,
    unify,
)


class Variable:
    """A mutable variable in generated code."""

    def __init__(self, value: Value) -> None:
        self._builder = value.builder
        with value.builder.goto_entry_block():
            self._place = value.builder.alloca(value.raw.type)
        self.set(value)

    def set(self, value: Value) -> None:
        """Assign a value."""
        self._builder.store(value.raw, self._place)

    @property
    def now(self) -> Value:
        """Current value."""
        return Value(self._builder, self._builder.load(self._place))


class Code:
    """A function that is being generated; it takes an address and returns nothing.

    Parameters
    ----------
    name : name of the function
    lanes : lanes of its vectors
    """

    def __init__(self, name: str, lanes: int) -> None:
        self.lanes = lanes
        self.module = ir.Module(name)
        self.function = ir.Function(self.module, ir.FunctionType(ir.VoidType(), [I64]), name)
        self.function.attributes.add("nounwind")
        # The entry block only allocates variables; code begins behind it.
        entry, first = (self.function.append_basic_block(label) for label in ("entry", "first"))
        self.builder = ir.IRBuilder(entry)
        self.builder.branch(first)
        self.builder.position_at_end(first)

    @property
    def argument(self) -> Value:
        """Argument of the function, an address."""
        return Value(self.builder, self.function.args[0])

    def text(self) -> str:
        """Finish the function, and return the module's text."""
        self.builder.ret_void()
        return str(self.module)

    def number(self, element: Any, value: Number) -> Value:
        """Return a constant."""
        return Value(self.builder, ir.Constant(element, float(value) if element in (F32, F64) else int(value)))

    def vector(self, element: Any, values: Sequence[Number]) -> Value:
        """Return a constant vector."""
        return Value(self.builder, ir.Constant(kind_of(element, len(values)), list(values)))

    def same(self, element: Any, value: Number) -> Value:
        """Return a constant vector of equal lanes."""
        return self.vector(element, [float(value) if element in (F32, F64) else int(value)] * self.lanes)

    def splat(self, value: Value) -> Value:
        """Return a vector with a number in all lanes."""
        return splat(value, self.lanes)

    def select(self, mask: Value, a: Operand, b: Operand) -> Value:
        """Return `a` where the mask is set, else `b`."""
        first, second = unify(a, b)
        if mask.lanes and not first.lanes:
            first, second = (splat(value, mask.lanes) for value in (first, second))
        return Value(self.builder, self.builder.select(mask.raw, first.raw, second.raw))

    def least(self, a: Operand, b: Operand) -> Value:
        """Return the minimum; `b` where one is NaN."""
        a, b = unify(a, b)
        return self.select(a < b, a, b)

    def most(self, a: Operand, b: Operand) -> Value:
        """Return the maximum; `b` where one is NaN."""
        a, b = unify(a, b)
        return self.select(a > b, a, b)

    def within(self, value: Value, low: Operand, high: Operand) -> Value:
        """Return the value clamped to a closed range; `high` for NaN."""
        return self.most(self.least(value, high), low)

    def call(self, name: str, *operands: Value) -> Value:
        """Call an LLVM intrinsic with operands of one type; `name` is without the type."""
        kind, lanes, element = operands[0].raw.type, operands[0].lanes, operands[0].element
        letter = ("f" if operands[0].is_real else "i") + str(8 * BYTES[element])
        return self._intrinsic(f"llvm.{name}.{f'v{lanes}' if lanes else ''}{letter}", kind, *operands)

    def fma(self, a: Operand, b: Operand, c: Operand) -> Value:
        """Return a · b + c, rounded once if the CPU can."""
        a, b = unify(a, b)
        a, c = unify(a, c)
        a, b = unify(a, b)
        return self.call("fmuladd", a, b, c)

    def size(self, value: Value) -> Value:
        """Return the absolute value of floats."""
        return self.call("fabs", value)

    def any(self, mask: Value) -> Value:
        """Return whether any lane of a mask is set."""
        bits = self.builder.bitcast(mask.raw, ir.IntType(mask.lanes))
        return Value(self.builder, self.builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0)))

    def largest(self, value: Value) -> Value:
        """Of the lanes of integers."""
        return self._intrinsic(f"llvm.vector.reduce.smax.v{value.lanes}i32", I32, value)

    def smallest(self, value: Value) -> Value:
        """Of the lanes of integers."""
        return self._intrinsic(f"llvm.vector.reduce.smin.v{value.lanes}i32", I32, value)

    def total(self, value: Value) -> Value:
        """Return the sum of the lanes of int64."""
        return self._intrinsic(f"llvm.vector.reduce.add.v{value.lanes}i64", I64, value)

    def shuffle(self, a: Value, b: Value, numbers: Sequence[int]) -> Value:
        """Return lanes of two concatenated vectors, by index."""
        mask = ir.Constant(kind_of(I32, len(numbers)), list(numbers))
        return Value(self.builder, self.builder.shuffle_vector(a.raw, b.raw, mask))

    def packed(self, values: Sequence[Value]) -> Value:
        """Return numbers as the lanes of a vector."""
        kind = kind_of(values[0].element, len(values))
        found = Value(self.builder, ir.Constant(kind, ir.Undefined))
        for lane, value in enumerate(values):
            found = found.with_lane(lane, value)
        return found

    def permuted(self, table: Value, numbers: Value) -> Value:
        """Return a table of 16 floats at the indices of 16 lanes; only if `HAS_PERMUTATIONS`."""
        return self._intrinsic("llvm.x86.avx512.permvar.sf.512", table.raw.type, table, numbers)

    def join(self, a: Value, b: Value) -> Value:
        """Return two vectors concatenated."""
        return self.shuffle(a, b, range(2 * a.lanes))

    def load(self, element: Any, address: Value, lanes: int = 0) -> Value:
        """Load a number or a vector at an address that is aligned to its element's size."""
        kind = kind_of(element, lanes)
        place = self.builder.inttoptr(address.raw, POINTER)
        return Value(self.builder, self.builder.load(place, align=min(BYTES[element], 4), typ=kind))

    def store(self, value: Value, address: Value) -> None:
        """Store a number or a vector at an address."""
        self.builder.store(value.raw, self.builder.inttoptr(address.raw, POINTER), align=4)

    def gather(self, element: Any, address: Value, index: Value, scale: int) -> Value:
        """Load the elements at address + scale · index of each lane."""
        unit = {1: I8, 2: I16, 4: I32, 8: I64}[scale]
        place = splat(Value(self.builder, self.builder.inttoptr(address.raw, POINTER)), index.lanes)
        return self._gathered(element, self.builder.gep(place.raw, [index.raw], source_etype=unit), index.lanes)

    def prefetch(self, addresses: Iterable[Value]) -> None:
        """Prefetch the cache lines at addresses."""
        kinds = [POINTER, I32, I32, I32]
        fetch = self._declared("llvm.prefetch.p0", ir.FunctionType(ir.VoidType(), kinds))
        for address in addresses:
            place = self.builder.inttoptr(address.raw, POINTER)
            # For reading, into the L1 data cache.
            self.builder.call(fetch, [place, I32(0), I32(3), I32(1)])

    def _gathered(self, element: Any, pointers: Any, lanes: int) -> Value:
        kind, spots = kind_of(element, lanes), kind_of(POINTER, lanes)
        every = ir.Constant(kind_of(I1, lanes), [1] * lanes)
        letter = ("f" if element in (F32, F64) else "i") + str(8 * BYTES[element])
        form = ir.FunctionType(kind, [spots, I32, every.type, kind])
        load = self._declared(f"llvm.masked.gather.v{lanes}{letter}.v{lanes}p0", form)
        return Value(self.builder, self.builder.call(load, [pointers, I32(4), every, ir.Constant(kind, ir.Undefined)]))

    def add_atomically(self, address: Value, more: Value) -> Value:
        """Add to an int64 atomically; return the value before."""
        place = self.builder.inttoptr(address.raw, ir.PointerType(I64))
        return Value(self.builder, self.builder.atomic_rmw("add", place, more.raw, "monotonic"))

    def scratch(self, bytes_: int) -> Value:
        """Return the address of `bytes_` bytes on the function's stack, aligned to a cache line."""
        with self.builder.goto_entry_block():
            place = self.builder.alloca(ir.ArrayType(ir.VectorType(F32, 16), -(-bytes_ // 64)))
            place.align = 64
            return Value(self.builder, self.builder.ptrtoint(place, I64))

    @contextmanager
    def loop(self, condition: Callable[[], Value]) -> Iterator[None]:
        """Loop while the lowest bit of `condition()` is set; it generates its code in the loop's head."""
        head, body, behind = (self.function.append_basic_block(label) for label in ("while", "do", "done"))
        self.builder.branch(head)
        self.builder.position_at_end(head)
        self.builder.cbranch(condition().raw, body, behind)
        self.builder.position_at_end(body)
        yield
        self.builder.branch(head)
        self.builder.position_at_end(behind)

    @contextmanager
    def when(self, condition: Value, likely: bool | None = None) -> Iterator[None]:
        """Branch: only if the lowest bit of a number is set."""
        with self.builder.if_then(condition.raw, likely):
            yield

    def _intrinsic(self, name: str, result: Any, *operands: Value) -> Value:
        form = ir.FunctionType(result, [operand.raw.type for operand in operands])
        return Value(self.builder, self.builder.call(self._declared(name, form), [operand.raw for operand in operands]))

    def _declared(self, name: str, form: Any) -> Any:
        found = self.module.globals.get(name)
        return found if found is not None else ir.Function(self.module, form, name)
