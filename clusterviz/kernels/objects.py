"""Object files of machine code: compiled once, loaded by later runs.

Importing numba and loading from its cache takes each rank half a second; loading an object file takes a few
hundredths. The name of a file contains a hash of the sources, the compilers and the CPU, and its first bytes are a
checksum of its name and its code. Files and folders that other users may write are neither read nor used.

CLUSTERVIZ_CPU=generic makes code for every CPU of this kind, on x86 that is SSE2 without AVX. CLUSTERVIZ_OPTIMIZE=0
compiles shaders with one pass of LLVM, in half the time; their code finds the same bits and is up to an eighth slower.
"""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
from collections.abc import Callable, Iterable
from functools import cache
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

from clusterviz.errors import InputError

CPU_VARIABLE = "CLUSTERVIZ_CPU"
OPTIMIZE_VARIABLE = "CLUSTERVIZ_OPTIMIZE"
_DIGEST_BYTES = 32
# Loaded code is valid as long as its engine exists.
_ENGINES: list[Any] = []


def _ignore(name: str) -> None:
    """Ignore that a kernel is compiled."""


on_compiling: Callable[[str], None] = _ignore
"""Called with the name of a kernel before it is compiled; commands may set it."""


@cache
def _llvm() -> Any:
    """Return LLVM; what compiles and loads nothing need not wait for it, a tenth of a second."""
    return import_module("llvmlite.binding")


def function_address(name: str, sources: Iterable[bytes], make: Callable[[], bytes]) -> int:
    """Return the address of a function, from its object file.

    `name`: name of the function, and of its file. `sources`: sources of the code. `make`: compiles an object file with
    the function; called only if no file is found.
    """

    def compile_it() -> bytes:
        on_compiling(name)
        return make()

    return load_function(kept(_file_of(name, sources), compile_it), name)


def kept(file: str, make: Callable[[], bytes]) -> bytes:
    """Return what is kept in a file of this name, in one of `folders`; `make` returns it if there is no such file."""
    path, content = _find(file)
    if content is None:
        content = make()
        _save(path, content)
    return content


def load_function(code: bytes, name: str) -> int:
    """Load an object file for the life of the process; return the address of one of its functions."""
    llvm = _llvm()
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _ENGINES.append(engine)
    address: int = engine.get_function_address(name)
    return address


def optimized_object(text: str) -> bytes:
    """Return an object file for this CPU from LLVM IR as text."""
    llvm = _llvm()
    target = machine(3 if optimizes() else 0)
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = target.triple, str(target.target_data)
    builder = llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options(speed_level=3))
    if optimizes():
        passes = builder.getModulePassManager()
    else:
        passes = llvm.create_new_module_pass_manager()
        passes.add_sroa_pass()
    passes.run(module, builder)
    code: bytes = target.emit_object(module)
    return code


def optimizes() -> bool:
    """Return whether shaders are compiled with all passes of LLVM, as they are unless CLUSTERVIZ_OPTIMIZE is 0."""
    asked = os.environ.get(OPTIMIZE_VARIABLE, "").strip()
    if asked not in ("", "0", "1"):
        raise InputError("neither 0 nor 1", where=OPTIMIZE_VARIABLE, found=asked, allowed="0, 1")
    return asked != "0"


@cache
def machine(effort: int = 3) -> Any:
    """Return the LLVM target machine of this CPU, for code of an effort from 0, soon compiled, to 3, fast."""
    llvm = _llvm()
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    name, features = cpu()
    # Code and the C library's functions may lie anywhere in the address space.
    return target.create_target_machine(name, features, opt=effort, reloc="static", codemodel="large")


def cpu() -> tuple[str, str]:
    """Return LLVM's name and features of the CPU for which code is made.

    Raises InputError: CLUSTERVIZ_CPU is neither "generic", nor "native" or empty.
    """
    llvm = _llvm()
    asked = os.environ.get(CPU_VARIABLE, "").strip()
    if asked == "generic":
        return asked, ""
    if asked not in ("", "native"):
        raise InputError("no such CPU", where=CPU_VARIABLE, found=asked, allowed="generic, native")
    return llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


def has_features(*names: str) -> bool:
    """Return whether the CPU for which code is made has all of these features, by LLVM's names."""
    features = cpu()[1].split(",")
    return all(f"+{name}" in features for name in names)


def object_path(name: str, sources: Iterable[bytes]) -> Path:
    """Return the path of a function's object file, which need not exist."""
    return _find(_file_of(name, sources))[0]


def _file_of(name: str, sources: Iterable[bytes]) -> str:
    return f"{name}-{fingerprint(sources)}.o"


def _find(file: str) -> tuple[Path, bytes | None]:
    for each in folders():
        content = read_code(each / file)
        if content is not None:
            return each / file, content
    return folder() / file, None


def folders() -> tuple[Path, ...]:
    """Return the folders of object files: beside Python's compiled files, and the user's cache."""
    cache_home = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return Path(__file__).with_name("__pycache__"), cache_home / "clusterviz"


def folder() -> Path:
    """Return the folder for new object files: the first of `folders` that is writeable, else the last."""
    *first, last = folders()
    return next((each for each in first if _can_keep(each)), last)


def _can_keep(folder: Path) -> bool:
    return (
        is_trusted(folder) if os.access(folder, os.W_OK) else not folder.exists() and os.access(folder.parent, os.W_OK)
    )


def is_trusted(path: Path) -> bool:
    """Return whether nobody but this user, root, or the owner of this package may have written a file or folder."""
    try:
        status = path.stat()
    except OSError:
        return False
    owners = os.getuid(), 0, Path(__file__).stat().st_uid
    return status.st_uid in owners and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _engine() -> Any:
    llvm = _llvm()
    module = llvm.parse_assembly("")
    module.triple = machine().triple
    return llvm.create_mcjit_compiler(module, machine())


def fingerprint(sources: Iterable[bytes]) -> str:
    """Return a hash of the sources, the compiler's version and the CPU."""
    made_from = [version("numba"), version("llvmlite"), *cpu()]
    digest = hashlib.sha256("\n".join(made_from).encode())
    for source in sources:
        digest.update(source)
    return digest.hexdigest()[:24]


def read_code(path: Path) -> bytes | None:
    """Return the code of a file; None if it is missing, damaged, renamed, or another user may have written it."""
    if not (is_trusted(path) and is_trusted(path.parent)):
        return None
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, code = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    return code if _digest(path, code) == digest else None


def _digest(path: Path, code: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + b"\0" + code).digest()


def _save(path: Path, code: bytes) -> None:
    """Save the code for later processes; if that is not possible, each process compiles its own."""
    own = path.parent == folders()[-1]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if own:
            path.parent.chmod(0o700)
        handle, temporary = tempfile.mkstemp(prefix=".", dir=path.parent)
        try:
            with open(handle, "wb") as file:
                file.write(_digest(path, code) + code)
                os.fchmod(handle, 0o600 if own else 0o644)
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError:
        return
