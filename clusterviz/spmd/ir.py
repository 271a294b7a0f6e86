"""Typed program: what the checker makes of a shader, and the code generators read."""

from __future__ import annotations

from dataclasses import dataclass, field

from clusterviz.spmd.tokens import Places
from clusterviz.spmd.types import Type

Number = float | int | bool


BUFFERS, TEXTURES, SYSTEM_BLOCK, PROFILE_BLOCK = 40, 64, 74, 75
"""Numbers of the first storage buffer and texture in the table of addresses, behind the uniform blocks; and of a block
of uint32 (7,): number of the group, numbers of groups, and the first invocation's number in its group. A texture is its
size, int32 (4,), and its texels, float32 (z, y, x, 4). Last, counters of profiles: int64 (sites, len(COUNTERS))."""


@dataclass(eq=False, slots=True)
class Variable:
    """Variable, parameter, constant, or block of a shader."""

    name: str
    type: Type
    kind: str  # "local", "in", "out", "inout", "const", "global", "shared", "uniform", "buffer" or "sampler"
    at: int
    binding: int = 0  # of a block or sampler
    is_assigned: bool = False  # it changes after its declaration
    is_read_only: bool = False  # a buffer that the shader does not write
    is_precise: bool = False  # operations that give its value are neither contracted nor put in another order
    constant: Number | None = None  # the value of a scalar constant


@dataclass(eq=False, slots=True)
class Expression:
    """Part of an expression; `at` is its position in the assembled text."""

    type: Type
    at: int


@dataclass(eq=False, slots=True)
class Constant(Expression):
    value: Number


@dataclass(eq=False, slots=True)
class Name(Expression):
    variable: Variable


@dataclass(eq=False, slots=True)
class Pick(Expression):
    """Some of the scalars of a value: a swizzle, a member of a struct, or an element at a constant index."""

    base: Expression
    numbers: tuple[int, ...]


@dataclass(eq=False, slots=True)
class Element(Expression):
    """Element of a vector, matrix or array at an index."""

    base: Expression
    index: Expression


@dataclass(eq=False, slots=True)
class Memory(Expression):
    """Value in a block: `offset` bytes from its begin, plus indices times bytes.

    `component_of` is the vector of which an index that is not constant takes a component.
    """

    block: Variable
    offset: int
    terms: tuple[tuple[Expression, int], ...]
    component_of: Type | None = None


Names = dict[str, Variable | Memory]
"""What names mean in a scope: variables, and members of blocks."""


@dataclass(eq=False, slots=True)
class Operation(Expression):
    """Operator of one or two operands of one element type; a scalar operand counts for every component.

    Operators are those of GLSL, "neg" for a sign, and "transform" for a matrix times a vector. "==" and "!=" compare
    whole values.
    """

    operator: str
    operands: tuple[Expression, ...]


@dataclass(eq=False, slots=True)
class Either(Expression):
    """`a && b`, `a || b` or `condition ? a : b`: what is not needed is not evaluated."""

    operator: str
    condition: Expression
    a: Expression
    b: Expression | None = None


@dataclass(eq=False, slots=True)
class Construct(Expression):
    """Constructor: scalars one after the other, converted; one scalar counts for every component of a vector."""

    arguments: tuple[Expression, ...]


@dataclass(eq=False, slots=True)
class BuiltIn(Expression):
    """Call of a built-in function."""

    name: str
    arguments: tuple[Expression, ...]


@dataclass(eq=False, slots=True)
class Call(Expression):
    function: Function
    arguments: tuple[Expression, ...]


@dataclass(eq=False, slots=True)
class Assign(Expression):
    """Assignment; `gives_old`: its value is that before it (`x++`)."""

    target: Expression
    value: Expression
    gives_old: bool = False


@dataclass(eq=False, slots=True)
class Statement:
    """Statement; `at` is its position in the assembled text."""

    at: int


@dataclass(eq=False, slots=True)
class Declare(Statement):
    """Declaration of a variable, with or without a value."""

    variable: Variable
    value: Expression | None


@dataclass(eq=False, slots=True)
class Evaluate(Statement):
    expression: Expression


@dataclass(eq=False, slots=True)
class Block(Statement):
    statements: list[Statement]


@dataclass(eq=False, slots=True)
class If(Statement):
    condition: Expression
    then: Statement
    otherwise: Statement | None


@dataclass(eq=False, slots=True)
class Loop(Statement):
    """`for` or `while`: no condition is one that always holds."""

    begin: Statement | None
    condition: Expression | None
    step: Expression | None
    body: Statement


@dataclass(eq=False, slots=True)
class Leave(Statement):
    kind: str
    value: Expression | None = None


@dataclass(eq=False, slots=True)
class Function:
    """Function; one without a body has only been declared."""

    name: str
    result: Type
    parameters: list[Variable]
    at: int
    body: Block | None = None
    calls: list[tuple[Function, int]] = field(default_factory=list)


@dataclass(eq=False, slots=True)
class Program:
    globals: list[Declare]  # variables of each invocation with their values, in order
    blocks: list[Variable]  # uniform blocks, storage buffers and samplers
    functions: dict[str, list[Function]]  # by name, those of one name with different parameters
    places: Places  # files, lines and columns of the positions `at`
    local_size: tuple[int, int, int] = (1, 1, 1)  # invocations of a work group along x, y, z
    names: Names = field(default_factory=dict)  # meaning of the names that all functions know
    types: dict[str, Type] = field(default_factory=dict)  # by name, with the structs
