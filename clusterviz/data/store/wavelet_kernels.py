"""Lifting of linear spline wavelets on a brick, in a closed loop, compiled by numba.

Every second sample along each axis makes the next coarser level. The other samples of a level are predicted from their
neighbours along the axes of their odd indices, by linear interpolation: the mean of two, four or six neighbours.
A level is processed plane by plane. In a row of a plane, samples with even x come first, then the last of these again,
then those with odd x, so that vectors of neighbours are contiguous.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types

from clusterviz.codec.intrinsics import LONG, address, intrinsic, jit, lane_indices, vector

VECTOR_BITS = 256


def transform(encoding, residuals, z, y, x, step, samples, restored, space):  # type: ignore[no-untyped-def]
    """Make samples of residuals; or residuals of samples, and the samples that are made of them.

    Parameters
    ----------
    encoding : 1: `residuals` and `restored` are written; 0: `restored` is
    residuals : uint8 to uint64 (n,), coarsest level first
    z, y, x : sides of the brick; n = z · y · x
    step : 1: residuals are modulo the range of the type; above, for up to 32 bits: they count steps, and samples are
        clamped to the range
    samples, restored : of the same type (n,); `samples` is read to encode only
    space : of the same type, for the next two coarser levels and 3 · y · (x + 1) samples; at least 2
    """
    depth = 0
    while max(z, y, x) > 1 << depth:
        depth += 1
    edge, done = 3 * y * (x + 1), 0
    for level in range(depth, -1, -1):
        apart = 1 << level
        nz, ny, nx = (z - 1) // apart + 1, (y - 1) // apart + 1, (x - 1) // apart + 1
        size = nz * ny * nx
        # Levels alternate between both ends of the space behind the rows.
        fine = restored if level == 0 else space[edge : edge + size] if level & 1 == 1 else space[space.size - size :]
        below = space[space.size - done :] if level & 1 == 1 else space[edge : edge + done]
        if level < depth:
            _level(encoding, residuals, done, nz, ny, nx, step, fine, below, samples, apart, y, x, space)
        else:
            if encoding == 1:
                residuals[0] = samples[0]
            fine[0] = residuals[0]
        done = size


@jit
def _level(encoding, residuals, done, nz, ny, nx, step, fine, below, samples, apart, y, x, rows):  # type: ignore[no-untyped-def]
    """Code a level, whose samples are `apart` in the brick, from the next coarser one, `below`."""
    ey, ex, wide = (ny + 1) // 2, (nx + 1) // 2, nx + 1
    back, front, between = 0, ny * wide, 2 * ny * wide
    for turn in range(nz + 1):
        # Plane 0; then 2 and 1, 4 and 3 …: an odd one lies between two that are done.
        odd = 1 - (turn & 1) if turn > 0 else 0
        z = turn - odd + (turn & 1)
        if z >= nz:
            continue
        plane = between
        if odd == 0:
            back, front = front, back
            plane = front
            for j in range(ey):
                row, source = rows[front + 2 * j * wide :], below[(z // 2 * ey + j) * ex :]
                for k in range(ex):
                    row[k] = source[k]
                row[ex] = row[ex - 1]
        near = back if z + 1 < nz else front
        line = samples[z * apart * y * x :]
        # Residuals of samples with the same parities follow each other.
        at = done if odd == 0 else done + (nz + 1) // 2 * (ny * nx - ey * ex)
        for kind in range(1 - odd, 4):
            py, px = kind & 1, kind >> 1
            size = ((ny + 1 - py) // 2) * ((nx + 1 - px) // 2)
            here = at + z // 2 * size
            _plane(encoding, odd, py, px, near, plane, front, ny, nx, step, rows, residuals, here, line, apart, x)
            at += (nz + 1 - odd) // 2 * size
        for j in range(ny):
            _join(rows, plane + j * wide, nx, fine, (z * ny + j) * nx)


@jit
def _plane(encoding, pz, py, px, back, plane, front, ny, nx, step, rows, residuals, at, samples, apart, x):  # type: ignore[no-untyped-def]
    ex, wide, last = (nx + 1) // 2, nx + 1, (ny - 1) // 2 * 2
    count, begin = (nx // 2, ex + 1) if px == 1 else (ex, 0)
    for y in range(py, ny, 2):
        here = y * wide + begin
        if encoding == 1:
            line, row = samples[(y * x + px) * apart :], rows[plane + here :]
            for k in range(count):
                row[k] = line[2 * apart * k]
        # Pairs of neighbours along z, y and x; those that the parities ask for come first.
        a, b = back + here, front + here
        c, d = plane + here - wide, plane + min(y + 1, last) * wide + begin
        e, f = plane + y * wide, plane + y * wide + 1
        if pz == 0:
            a, b = (c, d) if py == 1 else (e, f)
        if pz == 0 or py == 0:
            c, d = e, f
        if pz + py + px == 1:
            _code_1(encoding, rows, plane + here, count, a, b, c, d, e, f, residuals, at, step)
        elif pz + py + px == 2:
            _code_2(encoding, rows, plane + here, count, a, b, c, d, e, f, residuals, at, step)
        else:
            _code_3(encoding, rows, plane + here, count, a, b, c, d, e, f, residuals, at, step)
        at += count
        if px == 0:
            rows[plane + here + ex] = rows[plane + here + ex - 1]


def _coder(pairs: int) -> Any:
    """Return a numba intrinsic: code `count` samples of a row, each predicted from pairs of neighbours.

    The samples to encode are in the row, which gets the decoded ones.
    """

    @intrinsic
    def code(typing_context, encoding, rows, target, count, a, b, c, d, e, f, residuals, at, step):  # type: ignore[no-untyped-def]
        def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
            kind, folded_kind = signature.args[1], signature.args[10]
            row, residual = args[1], args[10]
            bits = kind.dtype.bitwidth

            def place(kind: Any, array: Any, index: Any, k: Any, lanes: int) -> Any:
                pointer = address(context, builder, kind, array, builder.add(index, k))
                return builder.bitcast(pointer, vector(bits, lanes).as_pointer())

            def block(k: Any, lanes: int, encodes: bool, exact: bool) -> None:
                def load(index: Any) -> Any:
                    return builder.load(place(kind, row, index, k, lanes), align=1)

                lanes_of = _Lanes(builder, bits, lanes)
                mean = lanes_of.prediction([load(index) for index in args[4 : 4 + 2 * pairs]])
                target, folded = place(kind, row, args[2], k, lanes), place(folded_kind, residual, args[11], k, lanes)
                value = builder.load(target if encodes else folded, align=1)
                coded, decoded = (
                    lanes_of.exact(mean, value, encodes)
                    if exact
                    else lanes_of.quantized(mean, value, encodes, args[12])
                )
                if encodes:
                    builder.store(coded, folded, align=1)
                builder.store(decoded, target, align=1)

            def run(encodes: bool, exact: bool) -> None:
                _for_vectors(builder, args[3], bits, lambda k, lanes: block(k, lanes, encodes, exact))

            with builder.if_else(builder.icmp_signed("==", args[0], LONG(1))) as (encodes, decodes):
                for branch, encoding in ((encodes, True), (decodes, False)):
                    with branch:
                        if bits == 64:
                            run(encoding, True)
                            continue
                        with builder.if_else(builder.icmp_signed("==", args[12], LONG(1))) as (one, more):
                            for choice, exact in ((one, True), (more, False)):
                                with choice:
                                    run(encoding, exact)
            return context.get_dummy_value()

        long = types.int64
        return types.void(long, rows, *[long] * 8, residuals, long, long), generate

    return code


_code_1, _code_2, _code_3 = _coder(1), _coder(2), _coder(3)


class _Lanes:
    """Arithmetic of vectors of unsigned numbers."""

    def __init__(self, builder: Any, bits: int, lanes: int) -> None:
        self.builder, self.bits, self.lanes = builder, bits, lanes
        self.kind = vector(bits, lanes)

    def all(self, number: int, bits: int = 0) -> Any:
        kind = vector(bits or self.bits, self.lanes)
        return ir.Constant(kind, [number] * self.lanes)

    def prediction(self, numbers: list[Any]) -> Any:
        """Return the mean of pairs: rounded up for each, then down."""
        if len(numbers) == 2:
            return self.mean(numbers[0], numbers[1], up=False)
        pairs = [self.mean(numbers[n], numbers[n + 1], up=True) for n in range(0, len(numbers), 2)]
        while len(pairs) > 1:
            pairs.append(self.mean(pairs.pop(), pairs.pop(), up=False))
        return pairs[0]

    def mean(self, a: Any, b: Any, up: bool) -> Any:
        builder = self.builder
        half = builder.lshr(builder.xor(a, b), self.all(1))
        return builder.sub(builder.or_(a, b), half) if up else builder.add(builder.and_(a, b), half)

    def fold(self, number: Any, bits: int) -> Any:
        """Fold 0, −1, 1, −2 … to 0, 1, 2, 3 …"""
        builder = self.builder
        return builder.xor(builder.shl(number, self.all(1, bits)), builder.ashr(number, self.all(bits - 1, bits)))

    def unfold(self, folded: Any) -> Any:
        builder = self.builder
        sign = builder.sub(self.all(0), builder.and_(folded, self.all(1)))
        return builder.xor(builder.lshr(folded, self.all(1)), sign)

    def exact(self, mean: Any, value: Any, encodes: bool) -> tuple[Any, Any]:
        """Return the residual and the sample of one of them, `value`, modulo the range."""
        if encodes:
            return self.fold(self.builder.sub(value, mean), self.bits), value
        return value, self.builder.add(mean, self.unfold(value))

    def quantized(self, mean: Any, value: Any, encodes: bool, step: Any) -> tuple[Any, Any]:
        """Return the residual in steps and the clamped sample of one of them, `value`."""
        builder, bits = self.builder, 2 * self.bits
        wide = vector(bits, self.lanes)
        steps = self.spread(builder.trunc(step, ir.IntType(bits)) if bits < 64 else step, wide)
        middle, zero = builder.zext(mean, wide), self.all(0, bits)
        if encodes:
            far = builder.sub(builder.zext(value, wide), middle)
            negative = builder.icmp_signed("<", far, zero)
            size = builder.select(negative, builder.sub(zero, far), far)
            size = builder.add(size, builder.lshr(steps, self.all(1, bits)))
            # The quotient of whole numbers below 2^17 in float32, or 2^34 in float64, is rounded down exactly.
            real = ir.VectorType(ir.FloatType() if bits < 64 else ir.DoubleType(), self.lanes)
            count = builder.fptosi(builder.fdiv(builder.sitofp(size, real), builder.sitofp(steps, real)), wide)
            count = builder.select(negative, builder.sub(zero, count), count)
            value = builder.trunc(self.fold(count, bits), self.kind)
        else:
            count = builder.sext(self.unfold(value), wide)
        number = builder.add(middle, builder.mul(count, steps))
        top = self.all((1 << self.bits) - 1, bits)
        number = builder.select(builder.icmp_signed("<", number, zero), zero, number)
        number = builder.select(builder.icmp_signed(">", number, top), top, number)
        return value, builder.trunc(number, self.kind)

    def spread(self, number: Any, kind: Any) -> Any:
        first = self.builder.insert_element(ir.Constant(kind, ir.Undefined), number, ir.IntType(32)(0))
        return self.builder.shuffle_vector(first, first, lane_indices([0] * self.lanes))


def _for_vectors(builder: Any, count: Any, bits: int, block: Callable[[Any, int], None]) -> None:
    """Generate blocks for `count` numbers: of as many as a vector has, of a fourth of them, and single ones."""
    alloca: Callable[..., Any] = cgutils.alloca_once_value
    done = alloca(builder, LONG(0))
    most = VECTOR_BITS // bits
    for lanes in (most, most // 4, 1):
        test, body, end = (builder.append_basic_block() for _ in range(3))
        builder.branch(test)
        builder.position_at_end(test)
        k = builder.load(done)
        following = builder.add(k, LONG(lanes))
        builder.cbranch(builder.icmp_signed("<=", following, count), body, end)
        builder.position_at_end(body)
        block(k, lanes)
        builder.store(following, done)
        builder.branch(test)
        builder.position_at_end(end)


@intrinsic
def _join(typing_context, rows, source, count, target, at):  # type: ignore[no-untyped-def]
    """Write a row of `count` samples in order."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        bits = signature.args[0].dtype.bitwidth
        evens = builder.lshr(builder.add(args[2], LONG(1)), LONG(1))
        odds = builder.add(builder.add(args[1], evens), LONG(1))

        def place(n: int, index: Any, lanes: int) -> Any:
            return builder.bitcast(
                address(context, builder, signature.args[n], args[n], index), vector(bits, lanes).as_pointer()
            )

        def block(k: Any, lanes: int) -> None:
            even, odd = (builder.load(place(0, builder.add(begin, k), lanes), align=1) for begin in (args[1], odds))
            order = lane_indices([n // 2 + lanes * (n % 2) for n in range(2 * lanes)])
            joined = builder.shuffle_vector(even, odd, order)
            builder.store(joined, place(3, builder.add(args[4], builder.shl(k, LONG(1))), 2 * lanes), align=1)

        _for_vectors(builder, builder.lshr(args[2], LONG(1)), bits, block)
        with builder.if_then(builder.trunc(args[2], ir.IntType(1))):
            last = builder.load(place(0, builder.add(args[1], builder.sub(evens, LONG(1))), 1), align=1)
            builder.store(last, place(3, builder.add(args[4], builder.sub(args[2], LONG(1))), 1), align=1)
        return context.get_dummy_value()

    long = types.int64
    return types.void(rows, long, long, target, long), generate
