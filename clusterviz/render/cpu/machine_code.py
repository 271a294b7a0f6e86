"""Kernels as machine code, kept on disk by what their code is made of."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from pathlib import Path

from clusterviz.kernels.objects import function_address, optimized_object
from clusterviz.render.cpu.kernel import Kernel


@cache
def compiled(kernel: Kernel) -> Callable[[int], None]:
    """A kernel as a function of its job's address; it needs no lock of Python's, so threads run it at once."""
    address = function_address(kernel.name, sources(), lambda: _object(kernel))
    return ctypes.CFUNCTYPE(None, ctypes.c_int64)(address)


def sources() -> list[bytes]:
    """What the files hold that kernels are made from."""
    here = Path(__file__).parent
    paths = [
        *sorted(here.rglob("*.py")),
        *sorted((here.parent.parent / "kernels").glob("*.py")),
        here.parent / "frame_block.py",
    ]
    return [path.read_bytes() for path in paths]


def _object(kernel: Kernel) -> bytes:
    # What writes a kernel's code is needed only where no file holds it.
    from clusterviz.render.cpu.program import program_of

    return optimized_object(program_of(kernel))
