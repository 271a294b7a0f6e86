"""Machine code as object files: compiled once, loaded by later runs.

Importing numba and loading from its own cache takes each rank a quarter of a second, all ranks of a node at once;
loading an object file takes a few hundredths. A file's name tells the sources, the compilers and the processor that it
was made from, and its first bytes whether it is whole.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from clusterviz.errors import OutputError
from clusterviz.image.replace import replacing

_DIGEST_BYTES = 32
# Loaded code lives as long as its engine.
_ENGINES: list[Any] = []


def _untold(name: str) -> None:
    """Where nobody wants to know."""


on_compiling: Callable[[str], None] = _untold
"""Called with the name of a kernel that no file holds, before it is compiled; commands may set it."""


def function_address(name: str, sources: Iterable[bytes], make: Callable[[], bytes]) -> int:
    """Where a function lies in memory.

    Parameters
    ----------
    name : of the function, and of its file
    sources : what the code is made from
    make : compiles an object file that holds the function; called only where no file is found
    """
    import llvmlite.binding as llvm  # type: ignore[import-untyped]

    path, code = _find(name, sources)
    if code is None:
        on_compiling(name)
        code = make()
        _keep(path, code)
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _ENGINES.append(engine)
    address: int = engine.get_function_address(name)
    return address


@cache
def machine() -> Any:
    """The compiler for this processor."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    features = llvm.get_host_cpu_features().flatten()
    # Code and the C library's functions may lie anywhere, so addresses have all their 64 bits.
    return target.create_target_machine(llvm.get_host_cpu_name(), features, opt=3, reloc="static", codemodel="large")


def kept_path(name: str, sources: Iterable[bytes]) -> Path:
    """The file of a function's object code, be it there or not."""
    return _find(name, sources)[0]


def _find(name: str, sources: Iterable[bytes]) -> tuple[Path, bytes | None]:
    """Where a function's code is, and the code; where it would be kept, and None."""
    file = f"{name}-{fingerprint(sources)}.o"
    for each in folders():
        code = read_code(each / file)
        if code is not None:
            return each / file, code
    return folder() / file, None


def folders() -> tuple[Path, ...]:
    """Where object files are looked for: beside Python's own compiled files, and in the user's cache."""
    cache_home = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return Path(__file__).with_name("__pycache__"), cache_home / "clusterviz"


def folder() -> Path:
    """Where new object files are kept: the first of `folders` that can be written, else the last."""
    *first, last = folders()
    return next((each for each in first if os.access(each if each.is_dir() else each.parent, os.W_OK)), last)


def _engine() -> Any:
    import llvmlite.binding as llvm

    module = llvm.parse_assembly("")
    module.triple = machine().triple
    return llvm.create_mcjit_compiler(module, machine())


def fingerprint(sources: Iterable[bytes]) -> str:
    """What tells code apart that was made from other sources, by another compiler, or for another processor."""
    import llvmlite.binding as llvm

    made_from = [
        version("numba"),
        version("llvmlite"),
        llvm.get_host_cpu_name(),
        llvm.get_host_cpu_features().flatten(),
    ]
    digest = hashlib.sha256("\n".join(made_from).encode())
    for source in sources:
        digest.update(source)
    return digest.hexdigest()[:24]


def read_code(path: Path) -> bytes | None:
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
