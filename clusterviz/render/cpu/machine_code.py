"""Kernels as machine code, kept on disk by what their code is made of."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from pathlib import Path

from clusterviz.kernels.objects import function_address, machine
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
    import llvmlite.binding as llvm  # type: ignore[import-untyped]

    # What writes a kernel's code is needed only where no file holds it.
    from clusterviz.render.cpu.program import program_of

    target = machine()
    module = llvm.parse_assembly(program_of(kernel))
    module.triple, module.data_layout = target.triple, str(target.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    builder = llvm.create_pass_builder(target, options)
    builder.getModulePassManager().run(module, builder)
    code: bytes = target.emit_object(module)
    return code
