"""Compiled kernels as object files: numba compiles them once, later runs load them without numba.

Importing numba and loading from its own cache takes each rank a quarter of a second, all ranks of a node at once;
loading an object file takes a few hundredths. numba's cache would also keep code whose imported parts have changed:
here a file's name tells the sources, the compilers and the processor that it was made from, and its first bytes whether
it is whole.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

from clusterviz.errors import OutputError
from clusterviz.image.replace import replacing

Kernel = Callable[[int], int]

# What kernels are made from.
_PARTS = ("job_layout", "vector_code", "merge_code", "instructions", "places", "merging_pixels", "sums")
SOURCES = (*_PARTS, "layer_kernels", "pair_kernels", "depth_kernels")
_DIGEST_BYTES = 32
# Loaded code lives as long as its engine.
_ENGINES: list[Any] = []


@cache
def kernel(module: str, name: str) -> Kernel:
    """A function of a module of this room, compiled: it takes the address of a job and writes its answer there.

    Made by the first process that needs it, where a file can be kept, and loaded from then on. It needs no lock of
    Python's, so threads run it at once.
    """
    path = _folder() / f"{name}-{_fingerprint()}.o"
    code = _read(path)
    if code is None:
        code = _compile(module, name)
        _keep(path, code)
    engine = _engine()
    import llvmlite.binding as llvm  # type: ignore[import-untyped]

    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _ENGINES.append(engine)
    function = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_int64] * 3)(engine.get_function_address(name))
    # numba's way to call: where the result goes, where an exception would go (there is none), and the job.
    return lambda job: function(job, job + 8, job)


@cache
def _machine() -> Any:
    """The compiler for this processor."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    features = llvm.get_host_cpu_features().flatten()
    # Code and the C library's functions may lie anywhere, so addresses have all their 64 bits.
    return target.create_target_machine(llvm.get_host_cpu_name(), features, opt=3, reloc="static", codemodel="large")


def _engine() -> Any:
    import llvmlite.binding as llvm

    machine = _machine()
    module = llvm.parse_assembly("")
    module.triple = machine.triple
    return llvm.create_mcjit_compiler(module, machine)


def _compile(module: str, name: str) -> bytes:
    """An object file with one function of this name."""
    import llvmlite.binding as llvm
    from numba import int64, njit

    function = getattr(import_module(f"clusterviz.composite.over.{module}"), name)
    # Nothing in the file may call Python, so numba shall not write the functions by which Python would call it.
    options: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiled = njit(error_model="numpy", **options)(function)
    compiled.compile((int64,))
    text = compiled.inspect_llvm((int64,))
    unit = llvm.parse_assembly(text)
    mangled = compiled.overloads[int64,].fndesc.llvm_func_name
    unit.get_function(mangled).name = name
    code: bytes = _machine().emit_object(unit)
    return code


@cache
def _fingerprint() -> str:
    import llvmlite.binding as llvm

    made_from = [
        version("numba"),
        version("llvmlite"),
        llvm.get_host_cpu_name(),
        llvm.get_host_cpu_features().flatten(),
    ]
    digest = hashlib.sha256("\n".join(made_from).encode())
    for source in SOURCES:
        digest.update(Path(__file__).with_name(f"{source}.py").read_bytes())
    return digest.hexdigest()[:24]


def _folder() -> Path:
    """Where object files are kept: beside Python's own compiled files, or in the user's cache."""
    beside = Path(__file__).with_name("__pycache__")
    if os.access(beside if beside.is_dir() else beside.parent, os.W_OK):
        return beside
    return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "clusterviz"


def _read(path: Path) -> bytes | None:
    """A file's code, None where there is none or it is damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, code = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    return code if hashlib.sha256(code).digest() == digest else None


def _keep(path: Path, code: bytes) -> None:
    """Write the code for the next process; where nothing can be kept, each process compiles for itself."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_bytes(hashlib.sha256(code).digest() + code)
    except (OSError, OutputError):
        return
