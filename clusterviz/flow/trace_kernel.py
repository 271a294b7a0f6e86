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
from clusterviz.data.field import abc, hill_vortex, rotation
from clusterviz.flow import state as key

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


_NOWHERE = (0.0, 0.0, 0.0)


@_jit
def _three(row, at):  # type: ignore[no-untyped-def]
    return row[at], row[at + 1], row[at + 2]


@_jit
def _moved(a, s, b):  # type: ignore[no-untyped-def]
    """Return a + s · b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


@_jit
def _less(a, b):  # type: ignore[no-untyped-def]
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@_jit
def _sample(field, numbers, floats, state, at, t):  # type: ignore[no-untyped-def]
    """Return status and vector at a place and time; see `trace_particles` for the field."""
    kind = numbers[key.KIND]
    if kind == key.GRID:
        return _grid_sample(field[0], field[1], numbers, floats, at, t)
    if kind == key.CELLS:
        return _cells_sample(field, numbers, floats, state, at, t)
    x, y, z = at
    if not (-1 <= x <= 1 and -1 <= y <= 1 and -1 <= z <= 1):
        return key.LEFT, _NOWHERE
    if kind == key.FORMULAS:
        return key.RUNNING, _rotation(x, y, z, t)
    if kind == key.FORMULAS + 1:
        return key.RUNNING, _hill_vortex(x, y, z, t)
    return key.RUNNING, _abc(x, y, z, t)


@_jit
def _grid_sample(first, second, numbers, floats, at, t):  # type: ignore[no-untyped-def]
    """Return status and trilinear vector; positions are indices of samples."""
    (x, y, z), (nx, ny, nz) = at, _three(numbers, key.SAMPLES)
    # Along an axis of one sample the vectors are constant, half a sample to both sides.
    if not (
        (0 <= x <= nx - 1 if nx > 1 else -0.5 <= x <= 0.5)
        and (0 <= y <= ny - 1 if ny > 1 else -0.5 <= y <= 0.5)
        and (0 <= z <= nz - 1 if nz > 1 else -0.5 <= z <= 0.5)
    ):
        return key.LEFT, _NOWHERE
    i, j, k = max(0, min(int(x), nx - 2)), max(0, min(int(y), ny - 2)), max(0, min(int(z), nz - 2))
    u, v, w = (x - i if nx > 1 else 0.0), (y - j if ny > 1 else 0.0), (z - k if nz > 1 else 0.0)
    i, j, k = _less((i, j, k), _three(numbers, key.FIRST_SAMPLE))
    di, dj, dk = min(1, nx - 1), min(1, ny - 1), min(1, nz - 1)
    bx, by, bz = _three(numbers, key.SHAPE)
    if i < 0 or j < 0 or k < 0 or i + di >= bx or j + dj >= by or k + dk >= bz:
        return key.NOT_LOADED, _NOWHERE
    place, di, dj, dk = 4 * ((k * by + j) * bx + i), 4 * di, 4 * dj * bx, 4 * dk * by * bx
    vx, vy, vz, _ = _trilinear(first, place, di, dj, dk, u, v, w)
    vector = (vx, vy, vz)
    if numbers[key.CHANGES]:
        wx, wy, wz, _ = _trilinear(second, place, di, dj, dk, u, v, w)
        vector = _moved(vector, (t - floats[key.BEGIN]) * floats[key.RATE], _less((wx, wy, wz), vector))
    return _finite(vector)


@_jit
def _finite(vector):  # type: ignore[no-untyped-def]
    """Return a vector with its status."""
    if (vector[0] + vector[1] + vector[2]) * 0 != 0:
        return key.NO_VECTORS, _NOWHERE
    return key.RUNNING, vector


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

        # Linear between corners along x, rows along y, and layers along z.
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
def _cells_sample(field, numbers, floats, state, at, t):  # type: ignore[no-untyped-def]
    """Return status and vector, linear in the tetrahedron that holds a place, or constant; positions are of the world.

    The search walks from the particle's last tetrahedron through faces. Where it meets the border it looks among the
    tetrahedra of the place's bin: the border may be bent inwards.
    """
    first, second, places, corners, neighbours, begins, members = field
    cell = numba.int64(state[key.CELL])
    weights, found = (0.0, 0.0, 0.0, 0.0), False
    # Walk from the last tetrahedron, each time through the face that the place is farthest behind.
    for _ in range(_MOST_CELLS):
        if cell < 0:
            break
        worst, least, weights = _weights(places, corners, cell, at)
        if least >= -_INSIDE:
            found = True
            break
        cell = neighbours[4 * cell + worst]
    # Else search the bin of the place.
    if not found:
        place = _less(at, _three(floats, key.BINS))
        i = numba.int64(np.floor(place[0] * floats[key.BINS + 3]))
        j = numba.int64(np.floor(place[1] * floats[key.BINS + 4]))
        k = numba.int64(np.floor(place[2] * floats[key.BINS + 5]))
        nx, ny, nz = _three(numbers, key.SAMPLES)
        if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz:
            return key.LEFT, _NOWHERE
        bin_number = (k * ny + j) * nx + i
        for n in range(begins[bin_number], begins[bin_number + 1]):
            cell = members[n]
            worst, least, weights = _weights(places, corners, cell, at)
            if least >= -_INSIDE:
                found = True
                break
    if not found:
        return key.LEFT, _NOWHERE
    state[key.CELL] = cell
    share = (t - floats[key.BEGIN]) * floats[key.RATE] if numbers[key.CHANGES] else 0.0
    if numbers[key.ON_CELLS]:
        return _finite(_between(first, second, numbers[key.CHANGES], share, cell))
    a = _between(first, second, numbers[key.CHANGES], share, corners[4 * cell])
    b = _between(first, second, numbers[key.CHANGES], share, corners[4 * cell + 1])
    c = _between(first, second, numbers[key.CHANGES], share, corners[4 * cell + 2])
    d = _between(first, second, numbers[key.CHANGES], share, corners[4 * cell + 3])
    vector = weights[0] * a[0], weights[0] * a[1], weights[0] * a[2]
    return _finite(_moved(_moved(_moved(vector, weights[1], b), weights[2], c), weights[3], d))


@_jit
def _weights(places, corners, cell, at):  # type: ignore[no-untyped-def]
    """Return the corner with the least barycentric weight of a place in a tetrahedron, that weight, and all four."""
    origin = _three(places, 3 * corners[4 * cell])
    p = _less(_three(places, 3 * corners[4 * cell + 1]), origin)
    q = _less(_three(places, 3 * corners[4 * cell + 2]), origin)
    r = _less(_three(places, 3 * corners[4 * cell + 3]), origin)
    place, whole = _less(at, origin), _volume(p, q, r)
    b, c, d = _volume(place, q, r) / whole, _volume(p, place, r) / whole, _volume(p, q, place) / whole
    a = 1 - b - c - d
    worst, least = 0, a
    if b < least:
        worst, least = 1, b
    if c < least:
        worst, least = 2, c
    if d < least:
        worst, least = 3, d
    return worst, least, (a, b, c, d)


@_jit
def _volume(a, b, c):  # type: ignore[no-untyped-def]
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = a, b, c
    return ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)


@_jit
def _between(first, second, changes, share, row):  # type: ignore[no-untyped-def]
    x, y, z = np.float64(first[4 * row]), np.float64(first[4 * row + 1]), np.float64(first[4 * row + 2])
    return _moved((x, y, z), share, _less(_three(second, 4 * row), (x, y, z))) if changes else (x, y, z)


@_jit
def _dot(floats, a, b):  # type: ignore[no-untyped-def]
    """Product of two index-space vectors by the metric of the world."""
    xx, yy, zz = _three(floats, key.METRIC)
    xy, xz, yz = _three(floats, key.METRIC + 3)
    return (
        a[0] * (xx * b[0] + xy * b[1] + xz * b[2])
        + a[1] * (xy * b[0] + yy * b[1] + yz * b[2])
        + a[2] * (xz * b[0] + yz * b[1] + zz * b[2])
    )


@_jit
def _rate(field, numbers, floats, state, at, t):  # type: ignore[no-untyped-def]
    """Return status, derivatives of place and time by the parameter, and the speed."""
    status, vector = _sample(field, numbers, floats, state, at, t)
    if status != key.RUNNING:
        return status, _NOWHERE, 0.0, 0.0
    speed, factor = np.sqrt(_dot(floats, vector, vector)), state[key.DIRECTION]
    if numbers[key.BY_LENGTH]:
        if not (speed > 0 and speed >= floats[key.LEAST_SPEED]):
            return key.SLOW, _NOWHERE, 0.0, speed
        factor = factor / speed
    return key.RUNNING, (factor * vector[0], factor * vector[1], factor * vector[2]), factor, speed


@_jit
def _attempt(field, numbers, floats, tableau, slopes, state, at, t, h):  # type: ignore[no-untyped-def]
    """Compute the slopes of one step from a place, where the first one is known; the last one is at its end.

    Returns
    -------
    status : RUNNING, or that of the stage that failed; LONGEST for a stage that goes too far
    way, dt : displacement
    speed : at the end
    error : of the displacement, estimated, in the world
    """
    far, last = (STAGE_LIMIT * floats[key.LONGEST_STEP]) ** 2, len(tableau) - 1
    way, dt, speed = _NOWHERE, 0.0, 0.0
    for stage in range(last):
        way, dt = _combined(tableau, slopes, stage, stage + 1, h)
        if _dot(floats, way, way) > far:
            return key.LONGEST, way, dt, speed, 0.0
        status, slope, rate, speed = _rate(field, numbers, floats, state, _moved(at, 1.0, way), t + dt)
        if status != key.RUNNING:
            return status, way, dt, speed, 0.0
        _set(slopes, stage + 1, slope, rate)
    if not numbers[key.ADAPTS]:
        return key.RUNNING, way, dt, speed, 0.0
    wrong, _ = _combined(tableau, slopes, last, last + 1, h)
    return key.RUNNING, way, dt, speed, np.sqrt(_dot(floats, wrong, wrong))


@_jit
def _combined(tableau, slopes, row, count, h):  # type: ignore[no-untyped-def]
    """Return a step's length times the sum of the first slopes, weighted by a row of the tableau."""
    way, t = _NOWHERE, 0.0
    for n in range(count):
        f = h * tableau[row, n]
        if f != 0:
            way, t = _moved(way, f, _three(slopes[n], 0)), t + f * slopes[n, 3]
    return way, t


@_jit
def _set(row, number, a, t):  # type: ignore[no-untyped-def]
    row[number, 0], row[number, 1], row[number, 2], row[number, 3] = a[0], a[1], a[2], t


@_jit
def _refer(state, number, at, slope):  # type: ignore[no-untyped-def]
    """Keep a place and its tangent, to find out whether the line comes back."""
    state[number], state[number + 1], state[number + 2] = at
    state[number + 3], state[number + 4], state[number + 5] = slope


@_jit
def _return(floats, state, number, at, way, begin, end, h):  # type: ignore[no-untyped-def]
    """Return the part of a step after which it is back at a place of the line, in its direction; -1: it is not.

    `begin` and `end` are its slopes.
    """
    place, tangent = _three(state, number), _three(state, number + 3)
    before = _dot(floats, _less(at, place), tangent)
    after = _dot(floats, _less(_moved(at, 1.0, way), place), tangent)
    if not before < 0 <= after:
        return -1.0
    s = before / (before - after)
    # Cubic Hermite interpolation between both ends of the step.
    p, q, o = s * s * (3 - 2 * s), s * (1 - s) * (1 - s) * h, s * s * (s - 1) * h
    gap = _less(_moved(_moved(_moved(at, p, way), q, begin), o, end), place)
    return s if _dot(floats, gap, gap) < floats[key.CLOSE] * floats[key.CLOSE] else -1.0


@_jit
def _looped(numbers, floats, state, at, way, begin, end, h, travelled):  # type: ignore[no-untyped-def]
    """Return the place of the line to which a step comes back, `SEED` or `REFERENCE`, and after which part of it."""
    longest, place, s = floats[key.LONGEST_STEP], key.SEED, -1.0
    if floats[key.CLOSE] > 0 and numbers[key.BY_LENGTH]:
        if travelled > 4 * longest:
            s = _return(floats, state, key.SEED, at, way, begin, end, h)
        if s < 0 and state[key.NEXT_REFERENCE] > _FIRST_REFERENCE and travelled - state[key.LENGTH] > 4 * longest:
            place = key.REFERENCE
            s = _return(floats, state, key.REFERENCE, at, way, begin, end, h)
    return place, s


@_jit
def _first_length(numbers, floats, step, speed, rest, left):  # type: ignore[no-untyped-def]
    """Return the length of the next step by the parameter, infinite at rest for ever, and that of the longest one.

    `rest` is the length that the line may still have, and `left` the time of the interval.
    """
    longest = floats[key.LONGEST_STEP]
    if numbers[key.BY_LENGTH]:
        return min(step, longest, rest), longest
    if not speed > 0:
        return left, np.inf
    return min(step / speed, longest / speed, rest / speed, left), longest / speed


@_jit
def _accepted(field, numbers, floats, tableau, slopes, state, at, t, slope, h, unit):  # type: ignore[no-untyped-def]
    """Attempt a step, shorter and shorter until it is accepted; `slope` is the one at its begin.

    Returns
    -------
    status : RUNNING, or why no step is short enough
    h : its length by the parameter
    way, dt, speed, error : as of `_attempt`
    attempts : number of them
    """
    failed, attempts = key.RUNNING, 0
    while True:
        attempts += 1
        result, way, dt, speed, error = _attempt(field, numbers, floats, tableau, slopes, state, at, t, h)
        if result == key.RUNNING:
            length = np.sqrt(_dot(floats, way, way))
            if error > floats[key.TOLERANCE] * length and h > _LEAST_STEP * unit:
                h *= max(0.2, 0.9 * (floats[key.TOLERANCE] * length / error) ** 0.25)
                continue
            if not (numbers[key.BY_LENGTH] and _dot(floats, slope, _three(slopes[len(tableau) - 1], 0)) < 0):
                return key.RUNNING, h, way, dt, speed, error, attempts
            result = key.SLOW  # it passed a place where the vectors vanish
        failed = result
        if result == key.NOT_LOADED or h * _REJECTIONS <= unit:
            return failed, h, way, dt, speed, error, attempts
        h *= 0.5


@_jit
def _pause(numbers, floats, at, t, state, travelled, steps, is_full):  # type: ignore[no-untyped-def]
    """Return why a particle does not go on from a place; RUNNING if it does."""
    if steps >= floats[key.STEPS_ALLOWED]:
        return key.MOST_STEPS
    if travelled >= floats[key.MOST_LENGTH]:
        return key.LONGEST
    if is_full:
        return key.FULL
    if not numbers[key.BY_LENGTH] and _time_left(floats, state, t) <= 0:
        return key.END_OF_INTERVAL
    (x, y, z), (x_0, y_0, z_0), (x_1, y_1, z_1) = at, _three(numbers, key.FIRST_CELL), _three(numbers, key.END_CELL)
    return key.RUNNING if x_0 <= x < x_1 and y_0 <= y < y_1 and z_0 <= z < z_1 else key.HANDED_OVER


@_jit
def _time_left(floats, state, t):  # type: ignore[no-untyped-def]
    end = floats[key.STOP_FORWARDS] if state[key.DIRECTION] > 0 else floats[key.STOP_BACKWARDS]
    return (end - t) * state[key.DIRECTION]


@_jit
def _next_step(numbers, floats, length, error, is_first):  # type: ignore[no-untyped-def]
    """Return the length in the world of the step behind one of a length; `is_first`: it was accepted at once."""
    if numbers[key.ADAPTS]:
        grown = 5.0 if error == 0 else min(5.0, max(0.2, 0.9 * (floats[key.TOLERANCE] * length / error) ** 0.25))
        return min(floats[key.LONGEST_STEP], max(grown, 1.0) * length if is_first else length)
    return floats[key.NOMINAL] if is_first else min(floats[key.NOMINAL], 2 * length)


@_jit
def _line(field, numbers, floats, tableau, slopes, state, points):  # type: ignore[no-untyped-def]
    """Advance a particle until it ends, leaves its block or the interval, or has filled `points`.

    Returns
    -------
    count : points that were written
    samples : steps that were attempted
    """
    at, t, last = _three(state, key.POSITION), state[key.TIME], len(tableau) - 1
    travelled, step, steps = state[key.TRAVELLED], state[key.STEP], state[key.STEPS]
    end = floats[key.STOP_FORWARDS] if state[key.DIRECTION] > 0 else floats[key.STOP_BACKWARDS]
    count, attempts = 0, 0
    status, slope, rate, speed = _rate(field, numbers, floats, state, at, t)
    _set(slopes, 0, slope, rate)
    # A new line begins with its seed, to which it may come back.
    if state[key.STATUS] == key.NEW:
        if numbers[key.STORES]:
            _set(points, 0, at, t)
            points[0, 4] = speed
            count = 1
        _refer(state, key.SEED, at, slope)
        state[key.NEXT_REFERENCE] = _FIRST_REFERENCE
    while status == key.RUNNING:
        status = _pause(numbers, floats, at, t, state, travelled, steps, numbers[key.STORES] and count == len(points))
        if status != key.RUNNING:
            break
        # One step, shorter and shorter until its error is allowed.
        left = _time_left(floats, state, t)
        first, limit = _first_length(numbers, floats, step, speed, floats[key.MOST_LENGTH] - travelled, left)
        if first == np.inf:
            status = key.SLOW
            break
        unit = limit if limit < np.inf else first
        status, h, way, dt, there, error, more = _accepted(
            field, numbers, floats, tableau, slopes, state, at, t, slope, first, unit
        )
        attempts += more
        if status != key.RUNNING:
            break
        # Does it come back to the seed or to the place it was compared with last?
        ahead, rate = _three(slopes[last], 0), slopes[last, 3]
        place, s = _looped(numbers, floats, state, at, way, slope, ahead, h, travelled)
        t_next = end if not numbers[key.BY_LENGTH] and h == left else t + dt
        if s >= 0:
            status, t_next = key.CLOSED if place == key.SEED else key.LOOP, t + s * dt
            way = _less(_three(state, place), at)
        length = np.sqrt(_dot(floats, way, way))
        at = _three(state, place) if s >= 0 else _moved(at, 1.0, way)
        # Go on; the last slope of a step is the first of the next one.
        t, slope, speed = t_next, ahead, there
        _set(slopes, 0, slope, rate)
        travelled += h if numbers[key.BY_LENGTH] and s < 0 else length
        steps += 1
        step = _next_step(numbers, floats, length, error, h == first)
        if numbers[key.STORES]:
            _set(points, count, at, t)
            points[count, 4] = speed
            count += 1
        # The place of comparison moves on after 64, 128, 256, … steps.
        if steps >= state[key.NEXT_REFERENCE]:
            state[key.NEXT_REFERENCE] *= 2
            state[key.LENGTH] = travelled
            _refer(state, key.REFERENCE, at, slope)
    state[key.POSITION], state[key.POSITION + 1], state[key.POSITION + 2] = at
    state[key.TIME], state[key.TRAVELLED], state[key.STEP], state[key.STEPS] = t, travelled, step, steps
    state[key.STATUS], state[key.SPEED] = status, speed
    return count, attempts


def trace_particles(  # type: ignore[no-untyped-def]
    first, second, places, corners, neighbours, begins, members,
    numbers, floats, tableau, slopes, states, points, counts,
):  # fmt: skip
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
    numbers, floats : int64 (`NUMBERS`,), float64 (`FLOATS`,), see `clusterviz.flow.state`
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
        if numbers[key.STORES] and used == len(points):
            break
        counts[n], attempts = _line(field, numbers, floats, tableau, slopes, states[n], points[used:])
        total, used, done = total + attempts, used + counts[n], n + 1
    return done, total
