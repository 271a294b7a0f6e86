"""Kernels written in Python for numba: compiled to object files once, loaded and called without numba.

numba's own cache needs numba to be imported, which takes half a second, and does not notice when imported parts of a
kernel change.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.kernels.objects import function_address, machine, object_path

_Argument = tuple[np.dtype[Any] | None, int]
"""Type of an array and the number of its axes; None for an integer."""


class CompiledKernel:
    """A function of a module, compiled by numba, that is called with arrays and integers.

    Parameters
    ----------
    module : dotted name of the module, imported only to compile
    name : name of the function, and of the object file up to `-`; "subtract-int8" is `subtract` for one type
    arguments : "int64", and arrays in C order by numba's names, such as "uint8[::1]"; separated by "; "
    sources : files from which the kernel is made
    results : number of int64 that it returns
    """

    def __init__(self, module: str, name: str, arguments: str, sources: Iterable[Path], results: int = 0) -> None:
        self.module, self.name, self._sources, self._results = module, name, tuple(sources), results
        self._made_of = module, name, arguments, self._sources, results
        self._arguments = [_argument(each) for each in arguments.split("; ")]
        self._returned = ctypes.c_int64 * (results + 1)

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledKernel, self._made_of

    @property
    def path(self) -> Path:
        """Path of the object file, which need not exist."""
        return object_path(self.name, self._contents)

    @property
    def _contents(self) -> list[bytes]:
        return [path.read_bytes() for path in (*self._sources, Path(__file__))]

    def prepare(self) -> None:
        """Load the object file; the first process that needs it compiles it, and saves it if possible."""
        _ = self._function

    def __call__(self, *arguments: Any) -> Any:
        """Run without Python's lock; return an int for one result, a tuple for several.

        Raises TypeError: an array has not the type, the axes or the order of the kernel.
        """
        numbers: list[int] = []
        for (kind, axes), argument in zip(self._arguments, arguments, strict=True):
            if kind is None:
                numbers.append(argument)
                continue
            if argument.dtype != kind or argument.ndim != axes or not argument.flags.c_contiguous:
                found = f"{argument.dtype} {argument.shape}"
                raise TypeError(f"{self.name}: {found} instead of {kind} with {axes} axes in C order")
            numbers += (argument.ctypes.data, *argument.shape)
        # numba's calling convention: addresses of the results and of an exception, of which there is none.
        returned = self._returned()
        place = ctypes.addressof(returned)
        self._function(place, place + 8 * self._results, *numbers)
        return returned[0] if self._results == 1 else tuple(returned[: self._results])

    @cached_property
    def _function(self) -> Callable[..., int]:
        address = function_address(self.name, self._contents, lambda: compile_kernel(self))
        count = sum(1 + axes for _, axes in self._arguments)
        return ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_int64] * (2 + count))(address)

    def entry(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        """Return a function of addresses, sides and integers that numba can compile, and the types of its arguments."""
        from numba import carray, from_dtype, int64, njit, types  # type: ignore[attr-defined]

        function = getattr(import_module(self.module), self.name.partition("-")[0])
        # Without counts of references, which it does not need.
        options: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
        function = njit(**options)(getattr(function, "py_func", function))
        pointer: Any = types.CPointer
        names, values, kinds = list[str](), list[str](), list[Any]()
        for n, (kind, axes) in enumerate(self._arguments):
            sides = [f"side_{n}_{axis}" for axis in range(axes)]
            names += [f"argument_{n}", *sides]
            kinds += [int64 if kind is None else pointer(from_dtype(kind)), *[int64] * axes]
            values.append(f"argument_{n}" if kind is None else f"carray(argument_{n}, ({', '.join(sides)},))")
        space = {"carray": carray, "function": function}
        exec(f"def entry({', '.join(names)}): return function({', '.join(values)})", space)
        return space["entry"], tuple(kinds)


def compile_kernel(kernel: CompiledKernel) -> bytes:
    """Return an object file with one function of the kernel's name, which needs no Python."""
    import llvmlite.binding as llvm  # type: ignore[import-untyped]
    from numba import njit

    entry, kinds = kernel.entry()
    # The file may not call Python, so numba writes no wrappers for calls from Python.
    options: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiled = njit(error_model="numpy", **options)(entry)
    compiled.compile(kinds)
    unit = llvm.parse_assembly(compiled.inspect_llvm(kinds))
    unit.get_function(compiled.overloads[kinds].fndesc.llvm_func_name).name = kernel.name
    # What numba counts references with is not called, but would be looked for when the object file is loaded.
    unused = llvm.create_new_module_pass_manager()
    unused.add_global_dead_code_eliminate_pass()
    unused.run(unit, llvm.create_pass_builder(machine(), llvm.create_pipeline_tuning_options()))
    code: bytes = machine().emit_object(unit)
    return code


def _argument(kind: str) -> _Argument:
    name, _, order = kind.partition("[")
    return (np.dtype(name), order.count(",") + 1) if order else (None, 0)
