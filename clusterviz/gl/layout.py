"""GLSL blocks generated from NumPy dtypes, so that both have one layout.

Members are 16-byte or 32-byte columns (vec4, dvec4, ivec4, uvec4), or 4-byte scalars at the end of the block, so that
std140 agrees with a packed C struct and needs no padding.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

COLUMNS = {("f", 4): "vec4", ("f", 8): "dvec4", ("i", 4): "ivec4", ("u", 4): "uvec4"}
Constant = bool | int | tuple[int, int, int]
"""Value of a constant of GLSL."""
SCALARS = {("f", 4): "float", ("i", 4): "int", ("u", 4): "uint"}


def glsl_block(name: str, binding: int, dtype: np.dtype[np.void]) -> str:
    """Return the GLSL text of a std140 uniform block with the members of a structured dtype.

    Raises
    ------
    ValueError
        A member that GLSL would place elsewhere than NumPy does.
    """
    lines = [f"layout(std140, binding = {binding}) uniform {name}Block {{"]
    for member in dtype.names or ():
        kind, offset = dtype.fields[member][:2]  # type: ignore[index]
        lines.append(f"    {_glsl_type(member, kind, offset)} {member};")
    return "\n".join([*lines, f"}} {name};", ""])


def glsl_rows(name: str, binding: int, rows: Mapping[str, int]) -> str:
    """Return the GLSL text of a std140 uniform block whose members are arrays of `rows` vec4s."""
    members = " ".join(f"vec4 {member}[{count}];" for member, count in rows.items())
    return f"layout(std140, binding = {binding}) uniform {name}Block {{ {members} }};\n"


def glsl_array(name: str, binding: int, dtype: np.dtype[np.void], count: int) -> str:
    """Return the GLSL text of a std140 uniform block that is an array of records.

    Raises
    ------
    ValueError
        A member that GLSL would place elsewhere than NumPy does, or records that it would pad.
    """
    if dtype.itemsize % 32:
        raise ValueError(f"records of {dtype.itemsize} bytes would be padded; allowed: multiples of 32")
    lines = [f"struct {name}Record {{"]
    for member in dtype.names or ():
        kind, offset = dtype.fields[member][:2]  # type: ignore[index]
        lines.append(f"    {_glsl_type(member, kind, offset)} {member};")
    block = f"layout(std140, binding = {binding}) uniform {name}Block {{ {name}Record {name}[{count}]; }};"
    return "\n".join([*lines, "};", block, ""])


def glsl_constants(values: Mapping[str, Constant]) -> str:
    """Return the GLSL text of constants: of type bool, int or ivec3, as in Python."""
    lines = []
    for name, value in values.items():
        if isinstance(value, tuple):
            lines.append(f"const ivec3 {name} = ivec3{value};\n")
        elif isinstance(value, bool):
            lines.append(f"const bool {name} = {str(value).lower()};\n")
        else:
            lines.append(f"const int {name} = {value};\n")
    return "".join(lines)


def _glsl_type(member: str, kind: np.dtype[np.generic], offset: int) -> str:
    """Return the GLSL type of one member; its offset is checked against std140."""
    key = (kind.base.kind, kind.base.itemsize)
    if kind.shape == (4,) and key in COLUMNS and offset % kind.itemsize == 0:
        return COLUMNS[key]
    if kind.shape == () and key in SCALARS:
        return SCALARS[key]
    raise ValueError(
        f"member {member}: {kind} at byte {offset} has no GLSL twin; allowed: 4-columns on their own size, scalars"
    )
