"""What a compute shader needs of a driver, found in its source, and its compilation by a driver that has that.

GLSL says little of a shader that needs too much: drivers refuse it in words of their own, or draw nothing. So limits
are compared before a driver with less than `AMPLE` compiles. What a shader declares and does not use does not count.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import prod
from typing import Any

from clusterviz.errors import DeviceError, InputError
from clusterviz.gl.context import compile_compute
from clusterviz.spmd.analysis import children
from clusterviz.spmd.ir import Call, Declare, Expression, Function, Memory, Name, Program, Statement
from clusterviz.spmd.parser import parse
from clusterviz.spmd.source import ShaderSource
from clusterviz.spmd.types import Type

DOUBLES = "GL_ARB_gpu_shader_fp64"
Node = Expression | Statement


@dataclass(frozen=True)
class Needs:
    """What a compute shader needs, or what a driver has.

    Attributes
    ----------
    storage_blocks, uniform_blocks, samplers : that it uses
    invocations : of a work group
    doubles : it computes with double precision
    """

    storage_blocks: int
    uniform_blocks: int
    samplers: int
    invocations: int
    doubles: bool

    def beyond(self, has: Needs) -> list[str]:
        """Return what is needed and not there, one text each."""
        found = []
        for what, name in NAMES.items():
            needed, there = getattr(self, name), getattr(has, name)
            if needed > there:
                found.append(f"{needed} {what} (it has {there})")
        return found + [f"double precision ({DOUBLES})"] * (self.doubles and not has.doubles)


NAMES = {
    "storage blocks in a compute shader": "storage_blocks",
    "uniform blocks in a compute shader": "uniform_blocks",
    "textures in a compute shader": "samplers",
    "invocations in a work group": "invocations",
}
LIMITS = {
    "GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS": 8,
    "GL_MAX_COMPUTE_UNIFORM_BLOCKS": 12,
    "GL_MAX_COMPUTE_TEXTURE_IMAGE_UNITS": 16,
    "GL_MAX_COMPUTE_WORK_GROUP_INVOCATIONS": 1024,
}
"""What a driver says of itself, in the order of `Needs`, and what OpenGL 4.3 guarantees."""
KINDS = {"buffer": "storage_blocks", "uniform": "uniform_blocks", "sampler": "samplers"}
AMPLE = Needs(16, 8, 16, 64, True)
"""A driver with that much compiles without a look at the source, which takes longer; it is looked at if that fails."""


def compile_checked(context: Any, source: ShaderSource) -> Any:
    """Compile a compute shader for an OpenGL context, see `compile_compute`.

    Raises
    ------
    DeviceError
        The driver lacks what the shader needs, all of which is named, or refuses the source.
    """
    if hasattr(context, "compiled"):  # a draw that is recorded is not compiled by a driver
        return compile_compute(context, source)
    has, renderer = limits_of(context), str(context.info["GL_RENDERER"])
    if AMPLE.beyond(has):
        _check(source, has, renderer)
    try:
        return compile_compute(context, source)
    except DeviceError:
        _check(source, has, renderer)
        raise


def limits_of(context: Any) -> Needs:
    """Return what a driver has; of what it does not say, what OpenGL guarantees."""
    blocks, uniforms, samplers, invocations = (int(context.info.get(name, least)) for name, least in LIMITS.items())
    return Needs(blocks, uniforms, samplers, invocations, DOUBLES in context.extensions)


def needs_of(program: Program) -> Needs:
    """Return what a parsed compute shader needs."""
    used, doubles = set[int](), False
    for node in _reached(program):
        kind = node.type if isinstance(node, Expression) else node.variable.type if isinstance(node, Declare) else None
        doubles = doubles or (kind is not None and "d" in _elements(kind))
        block = node.block if isinstance(node, Memory) else node.variable if isinstance(node, Name) else None
        used |= {id(block)}
    counts = dict.fromkeys(KINDS.values(), 0)
    for each in program.blocks:
        counts[KINDS[each.kind]] += id(each) in used
    return Needs(**counts, invocations=prod(program.local_size), doubles=doubles)


def _check(source: ShaderSource, has: Needs, renderer: str) -> None:
    """Refuse a shader that needs more than a driver has; one that cannot be parsed is left to the driver."""
    try:
        lacking = needs_of(parse(source)).beyond(has)
    except InputError:
        return
    if lacking:
        advice = "draw on the CPU (--device cpu) or on another device; clusterviz doctor --gl says what this one can"
        raise DeviceError(f"{renderer} lacks what {source.names[0]} needs: {', '.join(lacking)}; {advice}")


def _elements(kind: Type) -> set[str]:
    """Return the elements of a type, and of its parts."""
    inner = [each for _, each in kind.fields] + ([kind.of] if kind.of else [])
    return {kind.element}.union(*map(_elements, inner))


def _reached(program: Program) -> Iterator[Node]:
    """Yield all expressions and statements that `main` reaches, and those of global variables."""
    waiting: list[Any] = [*program.globals]
    seen = set[int]()

    def wait(function: Function) -> None:
        if id(function) not in seen and function.body is not None:
            seen.add(id(function))
            waiting.append(function.body)

    for main in program.functions.get("main", []):
        wait(main)
    while waiting:
        node = waiting.pop()
        yield node
        if isinstance(node, Call):
            wait(node.function)
        waiting += children(node)
