"""What a compute shader needs of a driver, found in its source, and its compilation by a driver that has that.

GLSL says little of a shader that needs too much: drivers refuse it in words of their own, or draw nothing. So limits
are compared before a driver with less than `AMPLE` compiles. What a shader declares and does not use does not count.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import Any

from clusterviz.errors import DeviceError, InputError
from clusterviz.gl.context import compile_compute
from clusterviz.spmd.analysis import walk
from clusterviz.spmd.ir import Declare, Expression, Memory, Name, Program
from clusterviz.spmd.parser import parse
from clusterviz.spmd.source import ShaderSource
from clusterviz.spmd.types import elements_of

DOUBLES = "GL_ARB_gpu_shader_fp64"


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
    mains = [function.body for function in program.functions.get("main", []) if function.body is not None]
    for node in walk(*program.globals, *mains, calls=True):
        kind = node.type if isinstance(node, Expression) else node.variable.type if isinstance(node, Declare) else None
        doubles = doubles or (kind is not None and "d" in elements_of(kind))
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
