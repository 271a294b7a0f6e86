"""Types of the subset, their conversions, and the signatures of the built-in functions."""

from __future__ import annotations

from functools import cache

ELEMENTS = {"f": "float", "d": "double", "i": "int", "u": "uint", "b": "bool"}
BYTES = {"f": 4, "d": 8, "i": 4, "u": 4, "b": 4}
CONVERTED = {"i": "iufd", "u": "ufd", "f": "fd", "d": "d", "b": "b"}
"""Elements to which each converts without being told."""


class Type:
    """Type of a value: a scalar, vector or matrix, a struct, an array, or what has no value.

    `name`: as in GLSL. `element`: key of `ELEMENTS` for scalars, vectors and matrices; else "". `size`: components of a
    scalar or vector, columns of a matrix, elements of an array (0: as many as the buffer holds). `fields`: names and
    types of a struct's members. `of`: type of an array's elements, or of a matrix's columns. `parts`: scalars in all.
    """

    __slots__ = ("element", "fields", "name", "of", "parts", "size")

    def __init__(
        self,
        name: str,
        element: str = "",
        size: int = 1,
        fields: tuple[tuple[str, Type], ...] = (),
        of: Type | None = None,
    ) -> None:
        self.name, self.element, self.size, self.fields, self.of = name, element, size, fields, of
        self.parts: int = sum(kind.parts for _, kind in fields) if fields else size * (of.parts if of else 1)

    @property
    def is_scalar(self) -> bool:
        """Whether it is one number."""
        return bool(self.element) and self.size == 1

    @property
    def is_vector(self) -> bool:
        """Whether it is several numbers in a row."""
        return bool(self.element) and self.size > 1 and self.of is None

    @property
    def is_array(self) -> bool:
        """Whether it is an array."""
        return not self.element and self.of is not None

    @property
    def alignment(self) -> int:
        """Bytes to a multiple of which a value is aligned in a storage buffer (std430)."""
        if self.fields:
            return max(kind.alignment for _, kind in self.fields)
        if self.of:
            return self.of.alignment
        return BYTES[self.element] * (4 if self.size == 3 else self.size)

    def stride(self, uniform: bool) -> int:
        """Bytes from element to element of an array of values, in a uniform block (std140) or a storage buffer."""
        least = 16 if uniform else 1
        alignment = -(-self.alignment // least) * least
        return -(-self.bytes(uniform) // alignment) * alignment

    def bytes(self, uniform: bool) -> int:
        """Bytes of a value."""
        if self.fields:
            return self.offset(self.fields[-1][0], uniform) + self.fields[-1][1].bytes(uniform)
        return self.size * self.of.stride(uniform) if self.of else BYTES[self.element] * self.size

    def offset(self, member: str, uniform: bool) -> int:
        """Bytes from the begin of a struct or block to a member."""
        at = 0
        for name, kind in self.fields:
            least = 16 if uniform and (kind.of or kind.fields) else 1
            alignment = -(-kind.alignment // least) * least
            at = -(-at // alignment) * alignment
            if name == member:
                return at
            at += kind.bytes(uniform)
        raise KeyError(member)


VOID = Type("void", size=0)
PREFIXES = {"f": "", "d": "d", "i": "i", "u": "u", "b": "b"}
NUMBERS = {(key, 1): Type(name, key) for key, name in ELEMENTS.items()} | {
    (key, n): Type(f"{prefix}vec{n}", key, n) for key, prefix in PREFIXES.items() for n in (2, 3, 4)
}
FLOAT, DOUBLE, INT, UINT, BOOL = (NUMBERS[key, 1] for key in "fdiub")
MAT3 = Type("mat3", "f", 3, of=NUMBERS["f", 3])
SAMPLERS = {2: Type("sampler2D", size=0), 3: Type("sampler3D", size=0)}
NAMED = {kind.name: kind for kind in (*NUMBERS.values(), MAT3, VOID, *SAMPLERS.values())}


@cache
def array_of(kind: Type, size: int) -> Type:
    """Return an array's type; `size` 0: as many as the buffer holds."""
    return Type(f"{kind.name}[{size or ''}]", size=size, of=kind)


@cache
def layout(kind: Type, uniform: bool = False) -> tuple[tuple[str, int], ...]:
    """Return the element, and the offset in bytes in a block, of each scalar of a type."""
    if kind.fields:
        parts = ((of, kind.offset(name, uniform)) for name, of in kind.fields)
        return tuple((element, begin + at) for of, begin in parts for element, at in layout(of, uniform))
    if kind.of:
        stride = kind.of.stride(uniform)
        return tuple((element, n * stride + at) for n in range(kind.size) for element, at in layout(kind.of, uniform))
    return tuple((kind.element, n * BYTES[kind.element]) for n in range(kind.size * bool(kind.element)))


def elements_of(kind: Type) -> str:
    """Return the element of each scalar of a value."""
    return "".join(element for element, _ in layout(kind))


def converts(given: Type, wanted: Type) -> bool:
    """Whether a value may stand for one of another type."""
    same_shape = given.size == wanted.size and given.of is None and wanted.of is None
    return given is wanted or bool(
        given.element and wanted.element and same_shape and wanted.element in CONVERTED[given.element]
    )


SIGNATURES = {
    "F>F": "floor ceil fract trunc round roundEven sqrt inversesqrt normalize",
    "R>R": "exp exp2 log log2 sin cos tan asin acos atan radians degrees",
    "G>G": "abs sign",
    "Gg>G": "min max",
    "Ggg>G": "clamp",
    "FFf>F": "mix",
    "FFF>F": "fma",
    "RR>R": "pow atan2",
    "FF>F": "cross reflect",
    "Ff>F": "mod",
    "fF>F": "step",
    "ffF>F": "smoothstep",
    "FF>1": "dot distance",
    "F>1": "length",
    "F>B": "isnan isinf",
    "GG>B": "lessThan lessThanEqual greaterThan greaterThanEqual equal notEqual",
    "B>1": "all any",
    "B>B": "not",
    "f>i": "floatBitsToInt",
    "f>u": "floatBitsToUint",
    "i>f": "intBitsToFloat",
    "u>f": "uintBitsToFloat",
}
"""Parameters > result: F floating point, R float, G any number, B bool; a small letter is a parameter that may be a
scalar; 1 a scalar of the same element. Those of bits are of any size. "atan2" is "atan" of two parameters."""
BUILT_IN = {name: signature for signature, names in SIGNATURES.items() for name in names.split()}
LETTERS = {"F": "fd", "R": "f", "G": "fdiu", "B": "b"}


def built_in(name: str, given: list[Type]) -> tuple[Type, list[Type]] | None:
    """Return the result's type of a built-in function, and the types to which its arguments are converted.

    None if it has no such parameters. Textures and atomic functions are not among these.
    """
    if name == "unpackDouble2x32":
        return (NUMBERS["u", 2], [DOUBLE]) if given == [DOUBLE] else None
    parameters, _, result = BUILT_IN["atan2" if (name, len(given)) == ("atan", 2) else name].partition(">")
    if len(given) != len(parameters) or not all(kind.element and kind.of is None for kind in given):
        return None
    size = given[-1].size if parameters[0].islower() else given[0].size
    if (name == "cross" and size != 3) or name == "atan2":
        return None
    if parameters in ELEMENTS:  # of bits
        return (NUMBERS[result, size], given) if given[0].element == parameters else None
    if name == "mix" and given[2].element == "b":
        kinds, last = given[:2], [NUMBERS["b", size]]
    else:
        kinds, last = given, []
    letter = parameters[0].upper()
    element = next((e for e in LETTERS[letter] if all(e in CONVERTED[kind.element] for kind in kinds)), "")
    element = _common(kinds) if letter == "G" else element
    sizes = [kind.size == size or (kind.size == 1 and p.islower()) for kind, p in zip(kinds, parameters, strict=False)]
    if not element or element not in LETTERS[letter] or not all(sizes) or (last and given[2] is not last[0]):
        return None
    results = {"1": NUMBERS[element, 1], "B": NUMBERS["b", size]}
    return results.get(result, NUMBERS[element, size]), [NUMBERS[element, kind.size] for kind in kinds] + last


def _common(kinds: list[Type]) -> str:
    return next((e for e in "biufd" if all(e in CONVERTED[kind.element] for kind in kinds)), "")


def common(a: Type, b: Type) -> Type | None:
    """Return the type in which an operator takes two operands, of which one may be a scalar; None if there is none."""
    if not (a.element and b.element) or a.of or b.of or not (element := _common([a, b])):
        return None
    return NUMBERS[element, max(a.size, b.size)] if a.size == b.size or 1 in (a.size, b.size) else None


def whole(element: str, value: float) -> int:
    """Return a number as a 32-bit integer: integers wrap, and floats are cut to the range."""
    low = 0 if element == "u" else -(1 << 31)
    if isinstance(value, float):
        return int(min(max(value, low), low + (1 << 32) - 1)) if value == value else 0
    return (value - low) % (1 << 32) + low
