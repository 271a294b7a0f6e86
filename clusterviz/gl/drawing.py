"""Draw calls without attributes and without attachments: what shaders find is written to storage buffers.

References
----------
OpenGL 4.3 specification, 9.2.1 (framebuffers without attachments).
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import moderngl

from clusterviz.errors import DeviceError
from clusterviz.gl.compute import gl_function
from clusterviz.spmd.source import ShaderSource

DRAW_FRAMEBUFFER, TRIANGLES = 0x8CA9, 4
DEFAULT_SIDES = 0x9310, 0x9311
"""Parameters of a framebuffer: its width and height while nothing is attached."""


def compile_program(context: moderngl.Context, vertices: ShaderSource, fragments: ShaderSource) -> moderngl.Program:
    """Compile a vertex and a fragment shader; error messages name the shaders' files and lines.

    Raises
    ------
    DeviceError
        The driver refuses a source.
    """
    try:
        return context.program(vertex_shader=vertices.text, fragment_shader=fragments.text)
    except moderngl.Error as error:
        raise DeviceError(fragments.explain(vertices.explain(str(error)))) from None


class EmptyTarget:
    """A framebuffer without attachments, and vertices without attributes, of the current context."""

    def __init__(self) -> None:
        self._framebuffer, self._vertices = ctypes.c_uint(), ctypes.c_uint()
        _call("glGenFramebuffers", 1, ctypes.byref(self._framebuffer))
        _call("glGenVertexArrays", 1, ctypes.byref(self._vertices))

    def queue_draw(self, program: moderngl.Program, vertices: int, size: tuple[int, int]) -> None:
        """Queue triangles of a program for `size` pixels, whose rows are counted from below; the lock is released."""
        _call("glBindFramebuffer", DRAW_FRAMEBUFFER, self._framebuffer)
        for name, side in zip(DEFAULT_SIDES, size, strict=True):
            _call("glFramebufferParameteri", DRAW_FRAMEBUFFER, name, side)
        _call("glViewport", 0, 0, *size)
        _call("glBindVertexArray", self._vertices)
        _call("glUseProgram", program.glo)
        _call("glDrawArrays", TRIANGLES, 0, vertices)
        _call("glBindVertexArray", 0)
        _call("glBindFramebuffer", DRAW_FRAMEBUFFER, 0)

    def release(self) -> None:
        """Free both."""
        _call("glDeleteFramebuffers", 1, ctypes.byref(self._framebuffer))
        _call("glDeleteVertexArrays", 1, ctypes.byref(self._vertices))


_NUMBER, _POINTER = ctypes.c_uint, ctypes.c_void_p
_TYPES: dict[str, tuple[Any, ...]] = {
    "glGenFramebuffers": (_NUMBER, _POINTER),
    "glGenVertexArrays": (_NUMBER, _POINTER),
    "glDeleteFramebuffers": (_NUMBER, _POINTER),
    "glDeleteVertexArrays": (_NUMBER, _POINTER),
    "glBindFramebuffer": (_NUMBER, _NUMBER),
    "glFramebufferParameteri": (_NUMBER, _NUMBER, _NUMBER),
    "glViewport": (_NUMBER,) * 4,
    "glBindVertexArray": (_NUMBER,),
    "glUseProgram": (_NUMBER,),
    "glDrawArrays": (_NUMBER,) * 3,
}


def _call(name: str, *arguments: Any) -> None:
    _function(name)(*arguments)


@cache
def _function(name: str) -> Any:
    return gl_function(name, *_TYPES[name])
