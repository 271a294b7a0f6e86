"""Machine code of a shader for this CPU."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.kernels.objects import function_address, has_features, load_function, optimized_object, optimizes
from clusterviz.spmd.ir import BUFFERS, PROFILE_BLOCK, SYSTEM_BLOCK, TEXTURES, Program
from clusterviz.spmd.source import ShaderSource

if TYPE_CHECKING:
    from clusterviz.spmd.codegen import Generator

Blocks = Mapping[int, NDArray[Any]]
Make = Callable[[Program, int, dict[str, Any]], "Generator"]
ONE_GROUP = np.zeros(7, np.uint32)
"""The system block, if a thread is a work group."""


ADVERSARY_VARIABLE = "CLUSTERVIZ_ADVERSARY"


def chosen_driver() -> str:
    """Return the name of the adversarial driver that the environment asks for, see `adversary.py`; "" for none.

    Raises InputError: there is no such driver.
    """
    if asked := os.environ.get(ADVERSARY_VARIABLE, "").strip():
        from clusterviz.spmd.adversary import DRIVERS

        if asked not in DRIVERS:
            raise InputError("no such driver", where=ADVERSARY_VARIABLE, found=asked, allowed=", ".join(DRIVERS))
    return asked


def object_code(source: ShaderSource, name: str, lanes: int, intrinsics: bool = True) -> bytes:
    """Return an object file with a shader's `main` under another name; see `code_of`."""
    return optimized_object(code_of(source, name, lanes, intrinsics))


def code_of(source: ShaderSource, name: str, lanes: int, intrinsics: bool = True, make: Make | None = None) -> str:
    """Return the LLVM code of a shader's `main` under another name.

    Raises InputError: the shader has a mistake.

    Parameters
    ----------
    lanes : of a vector: 4, 8 or 16; more than this CPU's registers hold are divided
    intrinsics : use the CPU's own ways (`intrinsics.py`), as far as this CPU has them
    make : makes the generator of a program, the lanes and the intrinsics; None: `Generator`
    """
    # Most processes find the object file.
    from clusterviz.spmd.codegen import Generator
    from clusterviz.spmd.intrinsics import INTRINSICS
    from clusterviz.spmd.parser import parse

    used = dict(INTRINSICS) if intrinsics else {}
    if "words_wide.glsl" not in source.names:
        used.pop("word_at", None)
    if lanes != 16 or not has_features("avx512f"):
        used.pop("piece_row", None)
    if make is None and (driver := chosen_driver()):
        from clusterviz.spmd.adversary import AdversarialGenerator

        make = partial(AdversarialGenerator, driver=driver)
    text: str = (make or Generator)(parse(source), lanes, used).text(name)
    return text


_COMPILING = Lock()
"""Threads that stand for ranks ask for the same code at once."""


def compiled(source: ShaderSource, name: str, lanes: int, intrinsics: bool = True) -> Callable[[int], None]:
    """Return a shader's `main`, from its object file; see `function_of` and `kernels/objects.py`.

    `name`: of the function and, but for a hash, of the file. `intrinsics`: as of `code_of`; not for text of users,
    whose functions may have the same names.
    """
    with _COMPILING:
        return _compiled(source, name, lanes, intrinsics, chosen_driver())


@cache
def _compiled(source: ShaderSource, name: str, lanes: int, intrinsics: bool, driver: str) -> Callable[[int], None]:
    def make() -> bytes:
        return object_code(source, name, lanes, intrinsics)

    address = function_address(name, code_sources(source, lanes), make)
    return ctypes.CFUNCTYPE(None, ctypes.c_void_p)(address)


def code_sources(source: ShaderSource, lanes: int) -> tuple[bytes, ...]:
    """Return what decides which machine code a shader becomes: the shader, the passes and the compiler's files."""
    return (source.text.encode(), f"{lanes} {optimizes()} {chosen_driver()}".encode(), *compiler_files())


@cache
def compiler_files() -> tuple[bytes, ...]:
    """Return the contents of the compiler's files."""
    folders = Path(__file__).parent, Path(__file__).parent.parent / "kernels"
    return tuple(path.read_bytes() for folder in folders for path in sorted(folder.glob("*.py")))


def function_of(code: bytes, name: str) -> Callable[[int], None]:
    """Return a function of an object file; it takes the address of the table that `addresses` returns."""
    return ctypes.CFUNCTYPE(None, ctypes.c_void_p)(load_function(code, name))


def texture_block(texels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a texture, for the table of addresses. `texels`: float32 (y, x, 4) or (z, y, x, 4)."""
    size = np.zeros(4, np.int32)
    size[: texels.ndim - 1] = texels.shape[-2::-1]
    return np.concatenate([size.view(np.float32), texels.reshape(-1)])


def bound(source: ShaderSource, blocks: Mapping[str, NDArray[Any]]) -> NDArray[np.uint64]:
    """Return the table of the addresses of those blocks and textures, by name, that a shader declares.

    A work group is a thread. The arrays must outlive the use of the table.
    """
    each: dict[str, dict[int, NDArray[Any]]] = {"uniform": {}, "buffer": {}, "texture": {}}
    for name, binding in source.blocks.items():
        if name in blocks:
            each[binding.kind][binding.number] = blocks[name]
    return addresses(each["uniform"], each["buffer"], ONE_GROUP, each["texture"])


def addresses(
    uniforms: Blocks, buffers: Blocks, system: NDArray[np.uint32], textures: Blocks | None = None
) -> NDArray[np.uint64]:
    """Return the table of the blocks' addresses, by their bindings; the arrays must outlive its use.

    `system`: uint32 (7,), see `ir.SYSTEM_BLOCK`; `textures`: see `texture_block`. Returns uint64 (PROFILE_BLOCK + 1,).
    """
    table = np.zeros(PROFILE_BLOCK + 1, np.uint64)
    for first, blocks in ((0, uniforms), (BUFFERS, buffers), (TEXTURES, textures or {})):
        for binding, block in blocks.items():
            table[first + binding] = block.__array_interface__["data"][0]
    table[SYSTEM_BLOCK] = system.__array_interface__["data"][0]
    return table
