"""Lines of vector fields, compiled by numba: Runge-Kutta steps through trilinear samples, tetrahedra or formulas.

Positions are indices of samples, float64. The parameter of a streamline is its length in the world, that of a pathline
is time. What happens to a particle depends on its state and on the vectors alone, not on the block that holds them.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types

from clusterviz.codec.intrinsics import intrinsic, lane_indices
from clusterviz.data.vector_field import abc, hill_vortex, rotation
from clusterviz.flow.state import (
    CELL,
    CELLS,
    CLOSED,
    DIRECTION,
    END_OF_INTERVAL,
    FORMULAS,
    FULL,
    GRID,
    HANDED_OVER,
    LEFT,
    LENGTH,
    LONGEST,
    LOOP,
    MOST_STEPS,
    NEW,
    NEXT_REFERENCE,
    NO_VECTORS,
    NOT_LOADED,
    POSITION,
    REFERENCE,
    RUNNING,
    SEED,
    SLOW,
    SPEED,
    STATUS,
    STEP,
    STEPS,
    TIME,
    TRAVELLED,
)

_OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "_nrt": False,
    "forceinline": True,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}
_jit = numba.njit(**_OPTIONS)
STAGE_LIMIT = 2.0  # of a step's length, which no stage may exceed
_REJECTIONS = 1024.0  # a step may shrink by this before the line ends
_LEAST_STEP = 1e-4  # of the longest; RK45 accepts what is shorter
_FIRST_REFERENCE = 64.0  # steps
_MOST_CELLS = 100_000  # of a walk from one tetrahedron to another
_INSIDE = 1e-9  # of a barycentric weight, by which a place may lie outside


@_jit
def _sample(field, numbers, floats, state, x, y, z, t):  # type: ignore[no-untyped-def]
    """Return status and vector at a place and time; see `trace_particles` for the field."""
    kind = numbers[19]
    if kind == GRID:
        return _grid_sample(field[0], field[1], numbers, floats, x, y, z, t)
    if kind == CELLS:
        return _cells_sample(field, numbers, floats, state, x, y, z, t)
    if not (-1 <= x <= 1 and -1 <= y <= 1 and -1 <= z <= 1):
        return LEFT, 0.0, 0.0, 0.0
    if kind == FORMULAS:
        vx, vy, vz = _rotation(x, y, z, t)
    elif kind == FORMULAS + 1:
        vx, vy, vz = _hill_vortex(x, y, z, t)
    else:
        vx, vy, vz = _abc(x, y, z, t)
    return RUNNING, vx, vy, vz


@_jit
def _grid_sample(first, second, numbers, floats, x, y, z, t):  # type: ignore[no-untyped-def]
    """Return status and trilinear vector; positions are indices of samples."""
    nx, ny, nz = numbers[6], numbers[7], numbers[8]
    # Along an axis of one sample the vectors are constant, half a sample to both sides.
    if not (
        (0 <= x <= nx - 1 if nx > 1 else -0.5 <= x <= 0.5)
        and (0 <= y <= ny - 1 if ny > 1 else -0.5 <= y <= 0.5)
        and (0 <= z <= nz - 1 if nz > 1 else -0.5 <= z <= 0.5)
    ):
        return LEFT, 0.0, 0.0, 0.0
    i, j, k = max(0, min(int(x), nx - 2)), max(0, min(int(y), ny - 2)), max(0, min(int(z), nz - 2))
    u, v, w = (x - i if nx > 1 else 0.0), (y - j if ny > 1 else 0.0), (z - k if nz > 1 else 0.0)
    i, j, k = i - numbers[3], j - numbers[4], k - numbers[5]
    di, dj, dk = min(1, nx - 1), min(1, ny - 1), min(1, nz - 1)
    bx, by, bz = numbers[16], numbers[17], numbers[18]
    if i < 0 or j < 0 or k < 0 or i + di >= bx or j + dj >= by or k + dk >= bz:
        return NOT_LOADED, 0.0, 0.0, 0.0
    at, di, dj, dk = 4 * ((k * by + j) * bx + i), 4 * di, 4 * dj * bx, 4 * dk * by * bx
    vx, vy, vz, _ = _trilinear(first, at, di, dj, dk, u, v, w)
    if numbers[9]:
        weight = (t - floats[6]) * floats[7]
        wx, wy, wz, _ = _trilinear(second, at, di, dj, dk, u, v, w)
        vx, vy, vz = vx + weight * (wx - vx), vy + weight * (wy - vy), vz + weight * (wz - vz)
    if (vx + vy + vz) * 0 != 0:  # not finite
        return NO_VECTORS, 0.0, 0.0, 0.0
    return RUNNING, vx, vy, vz


@intrinsic
def _trilinear(context, vectors, at, di, dj, dk, u, v, w):  # type: ignore[no-untyped-def]
    """Return the vector between the corner at a place of the array and those that lie `di`, `dj` and `dk` further.

    The three components and what lies behind them are one vector of the CPU.
    """
    signature = types.UniTuple(types.float64, 4)(vectors, at, di, dj, dk, u, v, w)  # type: ignore[no-untyped-call]

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        _, at, di, dj, dk, *weights = arguments
        narrow, wide = (ir.VectorType(kind, 4) for kind in (ir.FloatType(), ir.DoubleType()))
        nothing = ir.Constant(wide, ir.Undefined)
        u, v, w = (
            builder.shuffle_vector(
                builder.insert_element(nothing, weight, ir.IntType(32)(0)), nothing, lane_indices([0] * 4)
            )
            for weight in weights
        )

        def corner(place: Any) -> Any:
            loaded = builder.load(builder.bitcast(builder.gep(data, [place]), narrow.as_pointer()))
            loaded.align = 4
            return builder.fpext(loaded, wide)

        def between(low: Any, high: Any, weight: Any) -> Any:
            return builder.fadd(low, builder.fmul(weight, builder.fsub(high, low)))

        def row(place: Any) -> Any:
            return between(corner(place), corner(builder.add(place, di)), u)

        def layer(place: Any) -> Any:
            return between(row(place), row(builder.add(place, dj)), v)

        found = between(layer(at), layer(builder.add(at, dk)), w)
        parts = [builder.extract_element(found, ir.IntType(32)(n)) for n in range(4)]
        return context.make_tuple(builder, signature.return_type, parts)

    return signature, generate


_formulas = numba.njit(rotation, **_OPTIONS), numba.njit(hill_vortex, **_OPTIONS), numba.njit(abc, **_OPTIONS)
_rotation, _hill_vortex, _abc = _formulas


@_jit
def _cells_sample(field, numbers, floats, state, x, y, z, t):  # type: ignore[no-untyped-def]
    """Return status and vector, linear in the tetrahedron that holds a place, or constant; positions are of the world.

    The search walks from the particle's last tetrahedron through faces. Where it meets the border it looks among the
    tetrahedra of the place's bin: the border may be bent inwards.
    """
    first, second, places, corners, neighbours, begins, members = field
    cell = numba.int64(state[CELL])
    a, b, c, d, found = 0.0, 0.0, 0.0, 0.0, False
    for _ in range(_MOST_CELLS):
        if cell < 0:
            break
        worst, least, a, b, c, d = _weights(places, corners, cell, x, y, z)
        if least >= -_INSIDE:
            found = True
            break
        cell = neighbours[4 * cell + worst]
    if not found:
        i = numba.int64(np.floor((x - floats[17]) * floats[20]))
        j = numba.int64(np.floor((y - floats[18]) * floats[21]))
        k = numba.int64(np.floor((z - floats[19]) * floats[22]))
        nx, ny, nz = numbers[6], numbers[7], numbers[8]
        if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz:
            return LEFT, 0.0, 0.0, 0.0
        bin_number = (k * ny + j) * nx + i
        for n in range(begins[bin_number], begins[bin_number + 1]):
            cell = members[n]
            worst, least, a, b, c, d = _weights(places, corners, cell, x, y, z)
            if least >= -_INSIDE:
                found = True
                break
    if not found:
        return LEFT, 0.0, 0.0, 0.0
    state[CELL] = cell
    weight = (t - floats[6]) * floats[7] if numbers[9] else 0.0
    if numbers[20]:
        vx, vy, vz = _between(first, second, numbers[9], weight, cell)
    else:
        ax, ay, az = _between(first, second, numbers[9], weight, corners[4 * cell])
        bx, by, bz = _between(first, second, numbers[9], weight, corners[4 * cell + 1])
        cx, cy, cz = _between(first, second, numbers[9], weight, corners[4 * cell + 2])
        dx, dy, dz = _between(first, second, numbers[9], weight, corners[4 * cell + 3])
        vx = a * ax + b * bx + c * cx + d * dx
        vy = a * ay + b * by + c * cy + d * dy
        vz = a * az + b * bz + c * cz + d * dz
    if (vx + vy + vz) * 0 != 0:  # not finite
        return NO_VECTORS, 0.0, 0.0, 0.0
    return RUNNING, vx, vy, vz


@_jit
def _weights(places, corners, cell, x, y, z):  # type: ignore[no-untyped-def]
    """Return the corner with the least barycentric weight of a place in a tetrahedron, that weight, and all four."""
    o, p, q, r = 3 * corners[4 * cell], 3 * corners[4 * cell + 1], 3 * corners[4 * cell + 2], 3 * corners[4 * cell + 3]
    ox, oy, oz = places[o], places[o + 1], places[o + 2]
    ax, ay, az = places[p] - ox, places[p + 1] - oy, places[p + 2] - oz
    bx, by, bz = places[q] - ox, places[q + 1] - oy, places[q + 2] - oz
    cx, cy, cz = places[r] - ox, places[r + 1] - oy, places[r + 2] - oz
    x, y, z = x - ox, y - oy, z - oz
    whole = _volume(ax, ay, az, bx, by, bz, cx, cy, cz)
    b = _volume(x, y, z, bx, by, bz, cx, cy, cz) / whole
    c = _volume(ax, ay, az, x, y, z, cx, cy, cz) / whole
    d = _volume(ax, ay, az, bx, by, bz, x, y, z) / whole
    a = 1 - b - c - d
    worst, least = 0, a
    if b < least:
        worst, least = 1, b
    if c < least:
        worst, least = 2, c
    if d < least:
        worst, least = 3, d
    return worst, least, a, b, c, d


@_jit
def _volume(ax, ay, az, bx, by, bz, cx, cy, cz):  # type: ignore[no-untyped-def]
    return ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)


@_jit
def _between(first, second, changes, weight, row):  # type: ignore[no-untyped-def]
    x, y, z = np.float64(first[4 * row]), np.float64(first[4 * row + 1]), np.float64(first[4 * row + 2])
    if changes:
        x, y, z = (
            x + weight * (second[4 * row] - x),
            y + weight * (second[4 * row + 1] - y),
            z + weight * (second[4 * row + 2] - z),
        )
    return x, y, z


@_jit
def _dot(floats, ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Product of two index-space vectors by the metric of the world."""
    return (
        ax * (floats[0] * bx + floats[3] * by + floats[4] * bz)
        + ay * (floats[3] * bx + floats[1] * by + floats[5] * bz)
        + az * (floats[4] * bx + floats[5] * by + floats[2] * bz)
    )


@_jit
def _rate(field, numbers, floats, state, direction, x, y, z, t):  # type: ignore[no-untyped-def]
    """Return status, derivatives of x, y, z and time by the parameter, and the speed."""
    status, vx, vy, vz = _sample(field, numbers, floats, state, x, y, z, t)
    if status != RUNNING:
        return status, 0.0, 0.0, 0.0, 0.0, 0.0
    speed = np.sqrt(_dot(floats, vx, vy, vz, vx, vy, vz))
    if numbers[1]:
        if not (speed > 0 and speed >= floats[12]):
            return SLOW, 0.0, 0.0, 0.0, 0.0, speed
        factor = direction / speed
    else:
        factor = direction
    return RUNNING, factor * vx, factor * vy, factor * vz, factor, speed


@_jit
def _attempt(field, numbers, floats, tableau, slopes, state, direction, x, y, z, t, h):  # type: ignore[no-untyped-def]
    """Compute the slopes of one step from a place, where the first one is known; the last one is at its end.

    Returns
    -------
    status : RUNNING, or that of the stage that failed; LONGEST for a stage that goes too far
    dx, dy, dz, dt : displacement
    speed : at the end
    error : of the displacement, estimated, in the world
    """
    far, last = (STAGE_LIMIT * floats[9]) ** 2, len(tableau) - 1
    dx, dy, dz, dt, speed = 0.0, 0.0, 0.0, 0.0, 0.0
    for stage in range(last):
        dx, dy, dz, dt = _combined(tableau, slopes, stage, stage + 1, h)
        if _dot(floats, dx, dy, dz, dx, dy, dz) > far:
            return LONGEST, dx, dy, dz, dt, speed, 0.0
        status, ax, ay, az, at, speed = _rate(field, numbers, floats, state, direction, x + dx, y + dy, z + dz, t + dt)
        if status != RUNNING:
            return status, dx, dy, dz, dt, speed, 0.0
        _set(slopes, stage + 1, ax, ay, az, at)
    if not numbers[0]:
        return RUNNING, dx, dy, dz, dt, speed, 0.0
    ex, ey, ez, _ = _combined(tableau, slopes, last, last + 1, h)
    return RUNNING, dx, dy, dz, dt, speed, np.sqrt(_dot(floats, ex, ey, ez, ex, ey, ez))


@_jit
def _combined(tableau, slopes, row, count, h):  # type: ignore[no-untyped-def]
    """Return a step's length times the sum of the first slopes, weighted by a row of the tableau."""
    x, y, z, t = 0.0, 0.0, 0.0, 0.0
    for n in range(count):
        f = h * tableau[row, n]
        if f != 0:
            x, y, z, t = x + f * slopes[n, 0], y + f * slopes[n, 1], z + f * slopes[n, 2], t + f * slopes[n, 3]
    return x, y, z, t


@_jit
def _set(slopes, row, x, y, z, t):  # type: ignore[no-untyped-def]
    slopes[row, 0], slopes[row, 1], slopes[row, 2], slopes[row, 3] = x, y, z, t


@_jit
def _refer(state, at, x, y, z, ax, ay, az):  # type: ignore[no-untyped-def]
    """Keep a place and its tangent, to find out whether the line comes back."""
    state[at], state[at + 1], state[at + 2] = x, y, z
    state[at + 3], state[at + 4], state[at + 5] = ax, ay, az


@_jit
def _return(floats, state, at, x, y, z, dx, dy, dz, ax, ay, az, bx, by, bz, h, close):  # type: ignore[no-untyped-def]
    """Return the part of a step after which it is back at a place of the line, in its direction; -1: it is not."""
    rx, ry, rz = state[at], state[at + 1], state[at + 2]
    ex, ey, ez = state[at + 3], state[at + 4], state[at + 5]
    before = _dot(floats, x - rx, y - ry, z - rz, ex, ey, ez)
    after = _dot(floats, x + dx - rx, y + dy - ry, z + dz - rz, ex, ey, ez)
    if not before < 0 <= after:
        return -1.0
    s = before / (before - after)
    # Cubic Hermite interpolation between both ends of the step.
    p, q, o = s * s * (3 - 2 * s), s * (1 - s) * (1 - s) * h, s * s * (s - 1) * h
    gx = x + p * dx + q * ax + o * bx - rx
    gy = y + p * dy + q * ay + o * by - ry
    gz = z + p * dz + q * az + o * bz - rz
    return s if _dot(floats, gx, gy, gz, gx, gy, gz) < close * close else -1.0


@_jit
def _line(field, numbers, floats, tableau, slopes, state, points):  # type: ignore[no-untyped-def]
    """Advance a particle until it ends, leaves its block or the interval, or has filled `points`.

    Returns
    -------
    count : points that were written
    samples : steps that were attempted
    """
    adapts, by_length, stores = numbers[0], numbers[1], numbers[2]
    nominal, longest, tolerance, max_length, close = floats[8], floats[9], floats[10], floats[11], floats[13]
    direction, x, y, z, t = state[DIRECTION], state[POSITION], state[POSITION + 1], state[POSITION + 2], state[TIME]
    travelled, step, steps = state[TRAVELLED], state[STEP], state[STEPS]
    end, last = floats[15] if direction > 0 else floats[14], len(tableau) - 1
    count, attempts = 0, 0
    status, ax, ay, az, at, speed = _rate(field, numbers, floats, state, direction, x, y, z, t)
    _set(slopes, 0, ax, ay, az, at)
    if state[STATUS] == NEW:
        if stores:
            points[0, 0], points[0, 1], points[0, 2], points[0, 3], points[0, 4] = x, y, z, t, speed
            count = 1
        _refer(state, SEED, x, y, z, ax, ay, az)
        state[NEXT_REFERENCE] = _FIRST_REFERENCE
    while status == RUNNING:
        if steps >= floats[16]:
            status = MOST_STEPS
            break
        if travelled >= max_length:
            status = LONGEST
            break
        if stores and count == len(points):
            status = FULL
            break
        if not by_length and (end - t) * direction <= 0:
            status = END_OF_INTERVAL
            break
        if not (numbers[10] <= x < numbers[13] and numbers[11] <= y < numbers[14] and numbers[12] <= z < numbers[15]):
            status = HANDED_OVER
            break
        # The step by the parameter; `limit` is the longest.
        rest = max_length - travelled
        if by_length:
            limit = longest
            h = min(step, limit, rest)
        else:
            limit = longest / speed if speed > 0 else np.inf
            wanted = step / speed if speed > 0 else np.inf
            h = min(wanted, limit, rest / speed if speed > 0 else np.inf)
            h = min(h, (end - t) * direction)
            if h == np.inf:  # at rest for ever
                status = SLOW
                break
        first, failed = h, RUNNING
        unit = limit if limit < np.inf else h
        while True:
            attempts += 1
            result, dx, dy, dz, dt, there, error = _attempt(
                field, numbers, floats, tableau, slopes, state, direction, x, y, z, t, h
            )
            if result == RUNNING:
                length = np.sqrt(_dot(floats, dx, dy, dz, dx, dy, dz))
                if error > tolerance * length and h > _LEAST_STEP * unit:
                    h *= max(0.2, 0.9 * (tolerance * length / error) ** 0.25)
                    continue
                bx, by, bz, bt = slopes[last, 0], slopes[last, 1], slopes[last, 2], slopes[last, 3]
                if not (by_length and _dot(floats, ax, ay, az, bx, by, bz) < 0):
                    break
                result = SLOW  # it passed a place where the vectors vanish
            failed = result
            if result == NOT_LOADED or h * _REJECTIONS <= unit:
                break
            h *= 0.5
        if result != RUNNING:
            status = failed
            break
        nt = end if not by_length and h == (end - t) * direction else t + dt
        place, s = SEED, -1.0
        if close > 0 and by_length:
            if travelled > 4 * longest:
                s = _return(floats, state, SEED, x, y, z, dx, dy, dz, ax, ay, az, bx, by, bz, h, close)
            if s < 0 and state[NEXT_REFERENCE] > _FIRST_REFERENCE and travelled - state[LENGTH] > 4 * longest:
                place = REFERENCE
                s = _return(floats, state, REFERENCE, x, y, z, dx, dy, dz, ax, ay, az, bx, by, bz, h, close)
        if s >= 0:
            status = CLOSED if place == SEED else LOOP
            dx, dy, dz = state[place] - x, state[place + 1] - y, state[place + 2] - z
            length = np.sqrt(_dot(floats, dx, dy, dz, dx, dy, dz))
            nt = t + s * dt
        x, y, z, t = x + dx, y + dy, z + dz, nt
        if s >= 0:
            x, y, z = state[place], state[place + 1], state[place + 2]
        ax, ay, az, speed = bx, by, bz, there
        _set(slopes, 0, bx, by, bz, bt)
        travelled += h if by_length and s < 0 else length
        steps += 1
        if adapts:
            grown = 5.0 if error == 0 else min(5.0, max(0.2, 0.9 * (tolerance * length / error) ** 0.25))
            step = min(longest, max(grown, 1.0) * length if h == first else length)
        elif h == first:
            step = nominal
        else:
            step = min(nominal, 2 * length)
        if stores:
            points[count, 0], points[count, 1], points[count, 2] = x, y, z
            points[count, 3], points[count, 4] = t, speed
            count += 1
        if steps >= state[NEXT_REFERENCE]:
            state[NEXT_REFERENCE] *= 2
            state[LENGTH] = travelled
            _refer(state, REFERENCE, x, y, z, ax, ay, az)
    state[POSITION], state[POSITION + 1], state[POSITION + 2], state[TIME] = x, y, z, t
    state[TRAVELLED], state[STEP], state[STEPS], state[STATUS] = travelled, step, steps, status
    state[SPEED] = speed
    return count, attempts


def trace_particles(  # type: ignore[no-untyped-def]
    first,
    second,
    places,
    corners,
    neighbours,
    begins,
    members,
    numbers,
    floats,
    tableau,
    slopes,
    states,
    points,
    counts,
):
    """Advance particles through vectors; return how many it advanced, and the number of attempted steps.

    It ends early when `points` is full; the last particle that it advanced has the status FULL then.

    Vectors are those of a block of a regular grid, of tetrahedra, or a formula over the world box [-1, 1]³. Positions
    are indices of samples in the first case, and positions in the world in the others.

    Parameters
    ----------
    first, second : float32 (4 · n,), vectors and a zero at both ends of the interval of time: at the samples of a block
        (z, y, x), in samples per unit of time; or of the points of tetrahedra, or of tetrahedra, in world units
    places : float64 (3 · n,), points of tetrahedra
    corners, neighbours : int64 (4 · m,), points of each tetrahedron, and the one behind the face without that point;
        -1: there is none
    begins, members : int64; the tetrahedra that each bin meets
    numbers : int64 (21,): whether steps adapt to the error, whether the parameter is length, whether points are stored;
        the first sample of the block (x, y, z); samples of the grid, or bins of tetrahedra (x, y, z); whether the
        vectors change; first cell that the block advances, and the end of its cells (x, y, z); samples of the block
        (x, y, z); kind: `GRID`, `CELLS`, or `FORMULAS` and further; whether vectors are those of tetrahedra
    floats : float64 (23,): metric of the world (xx, yy, zz, xy, xz, yz); begin of the interval of the vectors, and 1
        by its length; the step and the longest one; tolerance; largest length; least speed; distance at which a loop is
        closed; times at which particles stop, backwards and forwards; most steps; the corner of the bins, and 1 by
        their sides (x, y, z)
    tableau : float64 (s + 1, s + 1), of a Runge-Kutta method: row n has the weights of the slopes that lead to slope
        n + 1; row s - 1 leads to the end of the step, and row s to its error
    slopes : float64 (s + 1, 4), working memory
    states : float64 (n, `STATE`), see `clusterviz.flow.state`
    points : float64 (room, 5): x, y, z, time and speed, one particle after another; written where points are stored
    counts : int64 (n,), points that were written for each particle
    """
    total, used, done = 0, 0, 0
    field = (first, second, places, corners, neighbours, begins, members)
    for n in range(len(states)):
        if numbers[2] and used == len(points):
            break
        counts[n], attempts = _line(field, numbers, floats, tableau, slopes, states[n], points[used:])
        total, used, done = total + attempts, used + counts[n], n + 1
    return done, total
