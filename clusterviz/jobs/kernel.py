"""Kernels: a GLSL function `kernel(ivec3 at)` that runs once for each point of a grid, on a GPU or on CPU vectors.

The text is in the subset that `spmd/` compiles. What it may call is made from the Python function's parameters. For an
array `src`, of 1 to 3 axes in NumPy's order (z, y, x):

    ivec3 src_size()                 points along x, y, z; missing axes have 1
    float src_at(ivec3 at)           the value at an index, which must be in the array
    int src_index(ivec3 at)          the number of an index in C order, for
    float src_flat(int index)        the value at a number
    void src_set(ivec3 at, float v)  only for arrays in `writes`; a write outside is counted, and the launch fails

Elements are float (float32), int (int32), uint (uint32), double (float64), and vec2, vec4 (float32, a last axis of 2
or 4) for arrays in `vectors`. Other parameters are uniforms of the same name: a number is a float or an int, a tuple of
2 to 4 numbers a vec or an ivec. An annotation decides: `weight: float` makes 1 a float.

Example
-------
    @jobs.kernel("smooth.glsl", writes=("dst",))
    def smooth(src, dst, weight: float):
        '''Mean of a voxel and its neighbours.'''

    smooth[dst.shape](src, dst, 0.5)

Notes
-----
OpenGL on llvmpipe leaves the loops of an invocation after 65535 iterations in total, without a message.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from operator import index
from pathlib import Path
from struct import pack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.gl.shader import assemble, shader_file
from clusterviz.input_files import require_regular_file
from clusterviz.jobs.device import MOST_WORDS, Arguments, GridXyz, Program, launch
from clusterviz.spmd.source import ShaderSource

ELEMENTS = {
    np.dtype(name): glsl
    for name, glsl in {"float32": "float", "int32": "int", "uint32": "uint", "float64": "double"}.items()
}
VECTORS = {2: "vec2", 4: "vec4"}
STATE_WORDS = 6  # of LaunchStateBlock in launch.glsl


class KernelError(InputError):
    """Kernel that does not compile, gets wrong arguments, or writes outside of an array."""


@dataclass(frozen=True)
class Parameter:
    """Parameter of a kernel, with the type of an argument.

    Attributes
    ----------
    glsl : type of an element of an array, or of a uniform
    is_array, is_written : whether it is an array, and whether the kernel changes it
    """

    name: str
    glsl: str
    is_array: bool = False
    is_written: bool = False


@dataclass(frozen=True)
class Kernel:
    """Kernel; `kernel[grid](*arguments)` launches it, and returns when it is done.

    Attributes
    ----------
    name : of the Python function
    files : GLSL files, in order; the last one defines `void kernel(ivec3 at)`
    parameters : names and annotations of the function's parameters
    writes : arrays that it changes
    vectors : arrays whose elements are vectors
    """

    name: str
    files: tuple[Path, ...]
    parameters: tuple[tuple[str, str], ...]
    writes: tuple[str, ...]
    vectors: tuple[str, ...]

    def __getitem__(self, grid: int | Sequence[int]) -> Callable[..., None]:
        """Return a function that launches the kernel.

        Parameters
        ----------
        grid : number of points along (z, y, x), (y, x) or x
        """
        sides = (grid,) if isinstance(grid, int | np.integer) else tuple(grid)
        if not 1 <= len(sides) <= 3 or not all(0 <= index(side) < 2**31 for side in sides):
            raise self.error("wrong grid", found=sides, allowed="1 to 3 numbers of points along (z, y, x)")
        z, y, x = (1, 1, *(index(side) for side in sides))[-3:]
        return partial(self._launch, (x, y, z))

    def error(self, what: str, found: object = None, allowed: object = None) -> KernelError:
        """Return an error of this kernel."""
        return KernelError(what, where=f"kernel {self.name}", found=found, allowed=allowed)

    def _launch(self, grid: GridXyz, *arguments: Any) -> None:
        if len(arguments) != len(self.parameters):
            raise self.error("wrong number of arguments", len(arguments), len(self.parameters))
        given = [self._parameter(*each) for each in zip(self.parameters, arguments, strict=True)]
        arrays = {each.name: value for each, value in zip(given, arguments, strict=True) if each.is_array}
        self._check_overlaps(arrays)
        if 0 in grid:
            return
        # Binding 0 is the state of the launch; arrays follow in the order of the parameters.
        used = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        state = np.zeros(STATE_WORDS, np.uint32)
        buffers = {0: state} | {n: used[name] for n, name in enumerate(used, start=1)}
        written = [n for n, name in enumerate(used, start=1) if name in self.writes]
        uniforms = _uniform_block(given, arguments, grid)
        make = partial(_program, self, tuple(given))
        try:
            launch(make, grid, Arguments(uniforms, buffers, written))
        except KernelError:
            raise
        except InputError as error:
            raise KernelError(str(error), where=f"kernel {self.name}") from None
        for name in self.writes:
            if used[name] is not arrays[name]:
                arrays[name][...] = used[name]
        # The shader has counted writes outside, and kept the place of one.
        if state[1]:
            name, at = [*arrays][int(state[2]) - 1], tuple(int(n) for n in state[:2:-1].view(np.int32))
            text = f"{state[1]} writes outside, one at (z, y, x) = {at}"
            raise self.error(
                f"wrote outside of the array {name}", text, f"below {_size_zyx(arrays[name], name in self.vectors)}"
            )

    def _parameter(self, declared: tuple[str, str], value: Any) -> Parameter:
        name, annotation = declared
        if isinstance(value, np.ndarray):
            return self._array(name, value)
        if name in (*self.writes, *self.vectors):
            raise self.error(f"{name} is no array", type(value).__name__, "a NumPy array")
        numbers = value if isinstance(value, tuple | list) else (value,)
        kinds = int | np.integer if annotation != "float" else ()
        whole = all(isinstance(number, kinds) for number in numbers)
        if not 1 <= len(numbers) <= 4 or not all(
            isinstance(n, int | float | np.integer | np.floating) for n in numbers
        ):
            raise self.error(
                f"{name} is of a wrong type", repr(value), "an array, a number, or a tuple of 2 to 4 numbers"
            )
        if whole and not all(-(2**31) <= number < 2**31 for number in numbers):
            raise self.error(f"{name} is too large", value, "int32")
        scalar, vector = ("int", "ivec") if whole else ("float", "vec")
        return Parameter(name, scalar if len(numbers) == 1 else f"{vector}{len(numbers)}")

    def _array(self, name: str, array: NDArray[Any]) -> Parameter:
        glsl = ELEMENTS.get(array.dtype)
        if glsl is None:
            raise self.error(f"{name} has elements of a wrong type", array.dtype, ", ".join(map(str, ELEMENTS)))
        axes, is_vector = array.ndim, name in self.vectors
        if is_vector:
            axes, glsl = axes - 1, VECTORS.get(array.shape[-1] if array.ndim else 0, "")
            if not glsl or array.dtype != np.float32:
                raise self.error(
                    f"{name} has no vectors", f"{array.dtype} {array.shape}", "float32 with a last axis of 2 or 4"
                )
        if not 1 <= axes <= 3:
            raise self.error(f"{name} has a wrong number of axes", array.shape, "1 to 3, (z, y, x)")
        if array.nbytes // 4 > MOST_WORDS:
            raise self.error(f"{name} is too large", f"{array.nbytes} bytes", f"{4 * MOST_WORDS}; smaller blocks")
        if name in self.writes and not array.flags.writeable:
            raise self.error(f"{name} is read-only", "an array that may not be written", "a writeable array")
        return Parameter(name, glsl, True, name in self.writes)

    def _check_overlaps(self, arrays: dict[str, NDArray[Any]]) -> None:
        for name in self.writes:
            for other, array in arrays.items():
                if other != name and np.may_share_memory(arrays[name], array):
                    raise self.error(
                        f"{name} is written, and shares memory with {other}", allowed="arrays of their own"
                    )


def kernel(
    *files: str | Path, writes: Sequence[str] = (), vectors: Sequence[str] = ()
) -> Callable[[Callable[..., Any]], Kernel]:
    """Return a decorator that makes a kernel of a function, whose body is not run.

    Parameters
    ----------
    files : GLSL files, joined in this order: absolute, beside the calling Python file, or in the package's shaders
    writes : parameters that are arrays and are written
    vectors : parameters that are arrays of vectors, with the components in a last axis

    Raises
    ------
    KernelError
        A file is missing or has no function `kernel`, or a name is no parameter.
    """

    def make(function: Callable[..., Any]) -> Kernel:
        folder = Path(inspect.getfile(function)).parent
        name = function.__name__
        found = [(str(p.name), str(p.annotation)) for p in inspect.signature(function).parameters.values()]
        parameters = tuple((each, kind.removeprefix("<class '").removesuffix("'>")) for each, kind in found)
        made = Kernel(
            name, tuple(_file(each, folder, name) for each in files), parameters, tuple(writes), tuple(vectors)
        )
        names = [each for each, _ in parameters]
        for each in (*writes, *vectors):
            if each not in names:
                raise made.error("no such parameter", each, ", ".join(names))
        if not writes:
            raise made.error("writes no array", "writes=()", f"some of {', '.join(names)}")
        return made

    return make


def _file(file: str | Path, folder: Path, name: str) -> Path:
    path = Path(file)
    if not path.is_absolute():
        path = folder / path if (folder / path).is_file() else shader_file(str(file))
    if not path.is_file():
        allowed = f"an absolute path, a file in {folder}, or a shader of the package"
        raise KernelError("the file is missing", where=f"kernel {name}", found=file, allowed=allowed)
    return path


@cache
def _program(kernel: Kernel, parameters: tuple[Parameter, ...], group: tuple[int, int], on_cpu: bool) -> Program:
    """Assemble a kernel for the types of its arguments.

    Raises
    ------
    KernelError
        A file cannot be read, or there is no function `kernel`.
    """
    for path in kernel.files:
        require_regular_file(path)
    try:
        texts = [path.read_text(encoding="utf-8").rstrip() + "\n\n" for path in kernel.files]
    except (OSError, UnicodeDecodeError) as error:
        raise kernel.error(f"a file cannot be read: {error}") from None
    if "void kernel(ivec3 " not in " ".join(" ".join(texts).split()):
        raise kernel.error("no main function", f"none in {kernel.files[-1]}", "void kernel(ivec3 at) { … }")
    x, y = group
    slots: dict[str, str | tuple[str, ...]] = {
        "CONSTANTS": f"layout(local_size_x = {x}, local_size_y = {y}) in;\nconst int GROUP_X = {x}, GROUP_Y = {y};\n",
        "ARGUMENTS": _declarations(parameters),
        "KERNEL": tuple(texts),
        "MAIN": "launch_threads.glsl" if on_cpu else "launch_invocations.glsl",
    }
    source = assemble("launch.glsl", slots)
    paths = iter(kernel.files)
    names = tuple(str(next(paths)) if each == "<KERNEL>" else each for each in source.names)
    return Program(kernel.name, ShaderSource(source.text, names), group)


def _declarations(parameters: Sequence[Parameter]) -> str:
    """Return the GLSL text of the arguments: the uniform block, the buffers and the functions of arrays."""
    members = [
        "ivec4 launch_grid; ivec4 launch_piece;",
        *(f"{_uniform(each)[0]} {_uniform(each)[1]};" for each in parameters),
    ]
    lines = [f"layout(std140, binding = 0) uniform LaunchBlock {{ {' '.join(members)} }};"]
    arrays = [each for each in parameters if each.is_array]
    for number, each in enumerate(arrays, start=1):
        name, kind, access = each.name, each.glsl, "" if each.is_written else "readonly "
        index = f"(at.z * {name}_extent.y + at.y) * {name}_extent.x + at.x"
        lines += [
            f"layout(std430, binding = {number}) {access}buffer {name}_Block {{ {kind} {name}_values[]; }};",
            f"ivec3 {name}_size() {{ return {name}_extent.xyz; }}",
            f"int {name}_index(ivec3 at) {{ return {index}; }}",
            f"{kind} {name}_flat(int index) {{ return {name}_values[index]; }}",
            f"{kind} {name}_at(ivec3 at) {{ return {name}_values[{index}]; }}",
        ]
        if each.is_written:
            outside = f"any(lessThan(at, ivec3(0))) || any(greaterThanEqual(at, {name}_extent.xyz))"
            lines += [
                f"void {name}_set(ivec3 at, {kind} value) {{",
                f"    if ({outside}) count_outside({number}, at);",
                f"    else {name}_values[{index}] = value;",
                "}",
            ]
    return "\n".join([*lines, ""])


def _uniform(parameter: Parameter) -> tuple[str, str]:
    """Return the type and the name of a parameter's uniform: the extent of an array."""
    return ("ivec4", f"{parameter.name}_extent") if parameter.is_array else (parameter.glsl, parameter.name)


def _uniform_block(parameters: Sequence[Parameter], values: Sequence[Any], grid: GridXyz) -> NDArray[np.uint8]:
    """Return the bytes of the uniform block, uint8 (bytes,), as std140 places its members."""
    members: list[tuple[str, Any]] = [("ivec4", (*grid, 0)), ("ivec4", (0, 0, 0, 0))]
    for each, value in zip(parameters, values, strict=True):
        if each.is_array:
            value = (*_size_zyx(value, each.glsl.startswith("vec"))[::-1], 0)
        members.append((_uniform(each)[0], value))
    block = bytearray()
    for kind, value in members:
        numbers = value if isinstance(value, tuple | list) else (value,)
        block += bytes(-len(block) % (4, 8, 16, 16)[len(numbers) - 1])
        block += pack(f"{len(numbers)}{'i' if kind.startswith('i') else 'f'}", *numbers)
    block += bytes(-len(block) % 16)
    return np.frombuffer(block, np.uint8)


def _size_zyx(array: NDArray[Any], is_vector: bool) -> tuple[int, int, int]:
    """Return the points of an array along z, y, x."""
    shape = array.shape[:-1] if is_vector else array.shape
    z, y, x = (1, 1, *shape)[-3:]
    return z, y, x
