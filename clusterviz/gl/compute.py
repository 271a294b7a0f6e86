"""Compute shader dispatch without Python's lock, so that other threads of the rank can work.

moderngl holds the lock in all its calls, and a software driver draws the whole picture inside one of them. Here the
three long calls go to the driver through ctypes, which releases the lock.

References
----------
EGL 1.5 specification, 3.12 (eglGetProcAddress returns functions of OpenGL, too).
"""

from __future__ import annotations

import ctypes
from ctypes.util import find_library
from functools import cache
from typing import Any

import moderngl


def run_compute(program: moderngl.ComputeShader, groups: tuple[int, ...]) -> None:
    """Run `groups` work groups of a program of the thread's current context, and wait until they are done."""
    queue_compute(program, groups)
    if isinstance(program, moderngl.ComputeShader):
        _functions()[2]()


def queue_compute(program: moderngl.ComputeShader, groups: tuple[int, ...]) -> None:
    """Queue `groups` work groups of a program of the thread's current context."""
    if not isinstance(program, moderngl.ComputeShader):  # the draw is recorded
        program.run(*groups)
        return
    use, dispatch, _ = _functions()
    use(program.glo)
    dispatch(*(*groups, 1, 1)[:3])


def finish(context: moderngl.Context) -> None:
    """Wait until all that a current context has queued is done."""
    if isinstance(context, moderngl.Context):  # a draw that is recorded does not queue
        _functions()[2]()


def gl_function(name: str, *arguments: Any, result: Any = None) -> Any:
    """Return an OpenGL function, given the ctypes types of its arguments and its result; calls release the lock."""
    egl = ctypes.CDLL(find_library("EGL") or "libEGL.so.1")
    address = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_char_p)(("eglGetProcAddress", egl))
    return ctypes.CFUNCTYPE(result, *arguments)(address(name.encode()))


@cache
def _functions() -> tuple[Any, Any, Any]:
    """Return glUseProgram, glDispatchCompute, glFinish."""
    number = ctypes.c_uint
    return gl_function("glUseProgram", number), gl_function("glDispatchCompute", *[number] * 3), gl_function("glFinish")
