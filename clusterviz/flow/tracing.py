"""Streamlines, pathlines and streaklines of vectors, over all ranks.

A streamline follows the vectors of one time step; its parameter is its length, so a step is as long in slow flow as in
fast flow. A pathline is where a particle goes while the vectors change: they are linear in time between two steps. A
streakline joins particles that were released at one seed, one after another.

There are two ways over ranks. Over seeds, each rank holds all vectors and traces every n-th line. Over data, each rank
holds a block of the cells and the samples around it that a step can need, and a particle that leaves the block is
handed over. A step depends on the state of its particle alone, so both ways give the same bits. `choose` estimates
which is faster, and takes the second one where the vectors do not fit into memory.

References
----------
J. R. Dormand, P. J. Prince: A family of embedded Runge-Kutta formulae, Journal of Computational and Applied Mathematics
6, 1980. (RK45.)
D. Pugmire et al.: Scalable computation of streamlines on very large datasets, SC 2009. (Over seeds and over blocks.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from math import ceil, inf, prod
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec import intrinsics
from clusterviz.comm.agree import abort_on_failure, agree
from clusterviz.comm.channel import Channel, all_to_all
from clusterviz.comm.loopback import LoopbackChannel
from clusterviz.content.flow.section import Seeds, Trace
from clusterviz.data import field as fields
from clusterviz.data.geometry import Lines
from clusterviz.data.source import Index
from clusterviz.data.vectors import VectorSource
from clusterviz.errors import ClustervizError, InputError
from clusterviz.flow import state as key
from clusterviz.flow import trace_kernel
from clusterviz.flow.cells import Cells
from clusterviz.flow.domain import Positions, cells_domain, formula_domain, grid_domain, split_box
from clusterviz.flow.seeds import make_seeds
from clusterviz.kernels.compiled import CompiledKernel
from clusterviz.report.machine import memory

LineKind = Literal["streamlines", "pathlines", "streaklines"]
TABLEAUS = {
    "euler": ((1.0,),),
    "rk4": ((1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
    "rk45": (
        (1 / 5,),
        (3 / 40, 9 / 40),
        (44 / 45, -56 / 15, 32 / 9),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
        (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40),
    ),
}
"""Weights of the slopes in each stage of the Runge-Kutta methods; the last row of rk45 gives the error."""
CLOSE = 0.02
"""Voxels from a place of a streamline, within which it is closed when it comes back."""
LONGEST_STEP = 2.0
"""Of `Trace.step`, that RK45 may grow to."""
ROOM = 1 << 15
"""Points that the kernel writes at a time."""
BATCH = 256
"""Particles of a task."""
MOST_RELEASES = 1 << 20
MEMORY_SHARE = 0.25
"""Of a rank's share of the free memory, that vectors may take on each rank."""
BYTES_PER_SECOND, STEPS_PER_SECOND, SECONDS_PER_ROUND = 5e8, 1e6, 2e-3
"""Costs by which the way over ranks is chosen: reading, steps, and a round of handing over."""
_TAG = 7400


@cache
def kernel() -> CompiledKernel:
    """Return the kernel that advances particles."""
    sources = [Path(str(module.__file__)) for module in (trace_kernel, intrinsics, key, fields)]
    mesh = "float64[::1]; int64[::1]; int64[::1]; int64[::1]; int64[::1]"
    rest = "int64[::1]; float64[::1]; float64[:,::1]; float64[:,::1]; float64[:,::1]; float64[:,::1]; int64[::1]"
    arguments = f"float32[::1]; float32[::1]; {mesh}; {rest}"
    return CompiledKernel(trace_kernel.__name__, "trace_particles", arguments, sources, 2)


def tableau_of(integrator: str) -> NDArray[np.float64]:
    """Return the weights of a Runge-Kutta method as the kernel takes them, float64 (s + 1, s + 1)."""
    rows = TABLEAUS[integrator]
    stages = max(map(len, rows)) if integrator == "rk45" else len(rows)
    found = np.zeros((stages + 1 - (integrator == "rk45"),) * 2)
    for row, weights in zip(found, rows, strict=False):
        row[: len(weights)] = weights
    return found


@dataclass(frozen=True)
class Traced:
    """Lines of a flow.

    Attributes
    ----------
    lines : with arrays `speed` and `time` of points, and `seed` and `end` of lines: numbers of the seed and of what
        ended the line, by `clusterviz.flow.state`. Seeds whose line has one point have none here.
    ends : number of lines, or of halves of them, that ended in each way
    seeds, seeds_outside : number of seeds, and of those outside the data
    steps : attempted, of all ranks
    bytes_handed_over : between ranks
    rounds : in which particles were handed over
    over : "data" or "seeds"
    """

    lines: Lines
    ends: Mapping[str, int]
    seeds: int
    seeds_outside: int
    steps: int
    bytes_handed_over: int
    rounds: int
    over: str

    @property
    def summary(self) -> str:
        """What became of the seeds, in one sentence."""
        parts = [f"{count} {name}" for name, count in self.ends.items()]
        outside = [f"{self.seeds_outside} of {self.seeds} seeds lie outside the data"] if self.seeds_outside else []
        return "; ".join([f"{len(self.lines.offsets) - 1} lines", *parts, *outside])


def trace(
    vectors: VectorSource | Cells,
    seeds: Seeds | NDArray[Any] | Sequence[Sequence[float]],
    settings: Trace | None = None,
    kind: LineKind = "streamlines",
    *,
    channel: Channel | None = None,
    first_step: int | None = None,
    over: Literal["auto", "data", "seeds"] = "auto",
    exact: bool = False,
    close: float = CLOSE,
    memory_limit: int | None = None,
    threads: int | None = None,
) -> Traced:
    """Trace lines of vectors; collective, with the result on every rank.

    Parameters
    ----------
    vectors : on a regular grid, or in tetrahedra
    seeds : a rule, or positions (n, 3) in the world
    settings : of the integration; default: `Trace()`
    kind : of lines
    channel : to all ranks; None: this process alone
    first_step : time step of streamlines, and the first one of other lines; None: that of the source
    over : whether ranks share the data or the seeds
    exact : take the vectors of a formula at each position, not between samples
    close : voxels; see `CLOSE`; 0: loops are not looked for
    memory_limit : bytes that vectors may take on each rank
    threads : of each rank; None: as many as it has cores

    Raises
    ------
    DataError
        The vectors cannot be read, or have no such time steps.
    InputError
        Impossible settings: no duration of a steady flow, or the data ends before it.
    """
    channel = channel or LoopbackChannel()
    with abort_on_failure(channel, stage="tracing lines"):
        with agree(channel, 0, "preparing to trace lines"):
            settings = settings or Trace()
            span = _span(vectors, settings, kind, first_step)
            if channel.placement().local_rank == 0:
                kernel().prepare()
        with agree(channel, 0, "preparing to trace lines"):
            kernel().prepare()
        way = over if over != "auto" else choose(vectors, seeds, span, channel, memory_limit)
        workers = threads or channel.placement().cores
        with ThreadPoolExecutor(workers) as pool:
            run = _Run(vectors, settings, kind, channel, span, way, exact, close, pool)
            return run.trace(seeds)


@dataclass(frozen=True)
class Span:
    """Time of a run.

    Attributes
    ----------
    begin, end : of the particles
    intervals : step at the begin and at the end of each interval of vectors, and their times; one, with the same step
        twice, for vectors that do not change
    """

    begin: float
    end: float
    intervals: tuple[tuple[int, int, float, float], ...]


def _span(vectors: VectorSource | Cells, settings: Trace, kind: LineKind, first_step: int | None) -> Span:
    times: tuple[float, ...] = getattr(vectors, "times", ())
    where = vectors.name
    first = getattr(vectors, "step", 0) if first_step is None else first_step
    if not isinstance(vectors, Cells):
        vectors.at_time(first)
    if kind == "streamlines" or len(times) < 2:
        begin = times[first] if times else 0.0
        end = inf if settings.duration is None or kind == "streamlines" else begin + settings.duration
        if kind == "streaklines" and end == inf:
            raise InputError("a steady flow has no end of time", where=where, allowed="trace.duration: a time")
        return Span(begin, end, ((first, first, begin, end),))
    begin, last = float(times[first]), float(times[-1])
    end = last if settings.duration is None else begin + settings.duration
    if first == len(times) - 1 or end > last + 1e-12 * max(abs(begin), abs(last)):
        found, allowed = f"a duration of {end - begin:g} from {begin:g} on", f"at most {last - begin:g}"
        raise InputError("the time steps end before", where=where, found=found, allowed=allowed)
    used = [n for n in range(first, len(times) - 1) if times[n] < end]
    return Span(begin, end, tuple((n, n + 1, times[n], times[n + 1]) for n in used))


def choose(
    vectors: VectorSource | Cells, seeds: Any, span: Span, channel: Channel, memory_limit: int | None = None
) -> Literal["data", "seeds"]:
    """Return the way over ranks whose estimated time is less; over data where the vectors do not fit; collective."""
    if isinstance(vectors, Cells) or channel.size == 1:
        return "seeds"
    steps = 1 if len(span.intervals) == 1 else 2
    whole = 16 * steps * prod(vectors.grid.shape_zyx)
    limit = memory_limit or int(MEMORY_SHARE * memory().available_bytes / channel.placement().local_size)
    if channel.maximum(whole > limit):
        return "data"
    lines = (seeds.count or 200) if isinstance(seeds, Seeds) else len(seeds)
    work = 2 * lines * sum(vectors.grid.shape_zyx) / STEPS_PER_SECOND / channel.size
    reading = whole * len(span.intervals) / BYTES_PER_SECOND
    rounds = 2 * channel.size * len(span.intervals) * SECONDS_PER_ROUND
    return "data" if reading / channel.size + 2 * work + rounds < reading + work else "seeds"


@dataclass
class _Pieces:
    """Points of parts of lines, as the kernel wrote them.

    Attributes
    ----------
    headers : int64 (m, 3) each: 2 · number, one more for a line backwards; steps before the part; its points
    points : float64 (k, 5) each: the kernel's position, time, speed
    """

    headers: list[NDArray[np.int64]] = field(default_factory=list)
    points: list[NDArray[np.float64]] = field(default_factory=list)

    def add(self, rows: NDArray[np.float64], before: NDArray[np.float64], found: Any, counts: Any) -> None:
        some = counts > 0
        keys = 2 * rows[:, key.NUMBER] + (rows[:, key.DIRECTION] < 0)
        self.headers.append(np.stack([keys, before, counts], axis=1)[some].astype(np.int64))
        self.points.append(found[: counts.sum()].copy())


class _Run:
    """One tracing of lines on this rank."""

    def __init__(
        self,
        vectors: VectorSource | Cells,
        settings: Trace,
        kind: LineKind,
        channel: Channel,
        span: Span,
        over: str,
        exact: bool,
        close: float,
        pool: ThreadPoolExecutor,
    ) -> None:
        self.vectors, self.settings, self.kind, self.channel = vectors, settings, kind, channel
        self.span, self.over, self.pool = span, over, pool
        self.stores = kind != "streaklines"
        self.boxes: list[tuple[Index, Index]] = []
        longest = LONGEST_STEP * settings.step
        # What this rank holds: everything, or its block with as many cells around as a step may need.
        if isinstance(vectors, Cells):
            self.domain = cells_domain(vectors)
        elif exact:
            self.domain = formula_domain(vectors)
        elif over == "data":
            cells = np.maximum(np.array(vectors.grid.shape_zyx[::-1]) - 1, 1)
            self.boxes = split_box(cells.tolist(), channel.size)
            halo = ceil(trace_kernel.STAGE_LIMIT * longest) + 1
            self.domain = grid_domain(vectors, self.boxes[channel.rank], halo)
            self.cells = cells
        else:
            self.domain = grid_domain(vectors)
        self.pieces = _Pieces()
        self.steps = self.bytes_sent = self.rounds = 0
        self.numbers, self.floats = np.zeros(key.NUMBERS, np.int64), np.zeros(key.FLOATS)
        # What the kernel knows of the run; `state.py` names the places.
        domain, numbers, floats = self.domain, self.numbers, self.floats
        numbers[key.ADAPTS], numbers[key.BY_LENGTH] = settings.integrator == "rk45", kind == "streamlines"
        numbers[key.STORES], numbers[key.KIND], numbers[key.ON_CELLS] = self.stores, domain.kind, domain.on_cells
        self.tableau = tableau_of(settings.integrator)
        for at, values in (
            (key.FIRST_SAMPLE, domain.begin),
            (key.SAMPLES, domain.samples),
            (key.FIRST_CELL, domain.first_cell),
            (key.END_CELL, domain.end_cell),
            (key.SHAPE, domain.shape),
        ):
            numbers[at : at + 3] = values
        floats[key.METRIC : key.METRIC + 6], floats[key.BINS : key.BINS + 6] = domain.metric, domain.bins
        floats[key.NOMINAL], floats[key.LONGEST_STEP] = settings.step * domain.unit, longest * domain.unit
        floats[key.TOLERANCE], floats[key.LEAST_SPEED] = settings.tolerance, settings.min_speed
        floats[key.MOST_LENGTH] = inf if settings.max_length is None else settings.max_length
        floats[key.CLOSE], floats[key.STEPS_ALLOWED] = close * domain.unit, settings.max_steps

    def trace(self, seeds: Any) -> Traced:
        interval = self.span.intervals[0]
        self._load(interval)
        with agree(self.channel, 0, "seeds of lines"):
            positions = self._positions(seeds)
        inside = self.domain.contains(self.domain.from_world(positions))
        waiting = self._new_states(positions, np.flatnonzero(inside))
        ended: list[NDArray[np.float64]] = []
        active = np.empty((0, key.STATE))
        for number, interval in enumerate(self.span.intervals):
            if number:
                self._load(interval)
            stop = min(interval[3], self.span.end)
            begins = (waiting[:, key.TIME] < stop) | (interval == self.span.intervals[-1])
            active = np.concatenate([active, waiting[begins]])
            waiting = waiting[~begins]
            active, done = self._advance_all(active)
            ended.append(done)
            active[active[:, key.STATUS] == key.END_OF_INTERVAL, key.STATUS] = key.RUNNING
        active[:, key.STATUS] = key.END_OF_INTERVAL
        ended.append(active)
        return self._gathered(np.concatenate(ended), len(positions), int((~inside).sum()))

    def _positions(self, seeds: Any) -> Positions:
        if not isinstance(seeds, Seeds):
            found = np.atleast_2d(np.asarray(seeds, np.float64))
            if found.ndim != 2 or found.shape[1] != 3 or not np.isfinite(found).all():
                raise InputError("impossible seeds", where="trace", found=found.shape, allowed="finite numbers (n, 3)")
            return found
        low, high = self._bounds()
        return make_seeds(seeds, low, high, self._speed_at)

    def _bounds(self) -> tuple[Positions, Positions]:
        points = self.vectors.places.reshape(-1, 3) if isinstance(self.vectors, Cells) else self.vectors.grid.corners
        low: Positions = points.min(axis=0)
        high: Positions = points.max(axis=0)
        return low, high

    def _speed_at(self, places: Positions) -> NDArray[np.float64]:
        """Return the speeds at places in the world, NaN outside; collective."""
        positions = self.domain.from_world(places)
        found = np.full(len(places), -1.0)
        mine = np.flatnonzero(self.domain.contains(positions))
        if self.boxes:
            mine = mine[self._owners(positions[mine]) == self.channel.rank]
        if self.boxes or self.channel.rank == 0:
            rows = self._rows(positions[mine], mine, 1.0)
            floats, numbers = self.floats.copy(), self.numbers.copy()
            floats[key.STEPS_ALLOWED], numbers[key.STORES] = 0, 0
            self._kernel(numbers, floats, rows, np.empty((0, 5)), np.zeros(len(rows), np.int64))
            found[mine] = rows[:, key.SPEED]
        speeds = np.max(all_to_all(self.channel, [found] * self.channel.size, _TAG), axis=0)
        return np.where(speeds < 0, np.nan, speeds)

    def _rows(self, positions: Positions, numbers: NDArray[Any], direction: float) -> NDArray[np.float64]:
        rows = np.zeros((len(positions), key.STATE))
        rows[:, key.NUMBER], rows[:, key.DIRECTION], rows[:, key.STATUS] = numbers, direction, key.NEW
        rows[:, key.POSITION : key.POSITION + 3], rows[:, key.STEP] = positions, self.floats[key.NOMINAL]
        rows[:, key.TIME], rows[:, key.CELL] = self.span.begin, -1
        return rows

    def _new_states(self, positions: Positions, inside: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return this rank's particles."""
        places = self.domain.from_world(positions[inside])
        if self.kind == "streamlines":
            way = self.settings.direction or "both"
            ways = {"both": (1.0, -1.0), "forward": (1.0,), "backward": (-1.0,)}[way]
            rows = np.concatenate([self._rows(places, inside, each) for each in ways])
        elif self.kind == "pathlines":
            rows = self._rows(places, inside, 1.0)
        else:
            release = self.settings.release or 1.0
            count = self.releases
            if count > MOST_RELEASES:
                found = f"{count} from each seed"
                raise InputError("too many particles", where="trace.release", found=found, allowed=MOST_RELEASES)
            rows = np.repeat(self._rows(places, inside * count, 1.0), count, axis=0)
            number = np.tile(np.arange(count), len(places))
            # One particle after the other is released from the same seed.
            rows[:, key.NUMBER] += number
            rows[:, key.TIME] = self.span.begin + release * number
        # Over data a particle belongs to the rank of its cell, else to each rank in turn.
        rank = self.channel.rank
        here = rows[:, key.NUMBER] % self.channel.size == rank
        if self.boxes:
            here = self._owners(rows[:, key.POSITION : key.POSITION + 3]) == rank
        mine: NDArray[np.float64] = rows[here]
        return mine

    @property
    def releases(self) -> int:
        """Particles of a streakline."""
        return int((self.span.end - self.span.begin) / (self.settings.release or 1.0) * (1 + 1e-12)) + 1

    def _owners(self, positions: Positions) -> NDArray[np.int64]:
        """Return the rank of each position's cell."""
        cells = np.clip(np.floor(positions), 0, self.cells - 1)
        found = np.zeros(len(cells), np.int64)
        for rank, (begin, end) in enumerate(self.boxes):
            found[((cells >= begin) & (cells < end)).all(axis=1)] = rank
        return found

    def _load(self, interval: tuple[int, int, float, float]) -> None:
        """Read the vectors at both ends of an interval of time; the last ones may be known."""
        before, after, begin, end = interval
        with agree(self.channel, 0, "reading vectors"):
            known = getattr(self, "_loaded", (-1, None))
            self.first = known[1] if known[0] == before else self.domain.load(before)
            self.second = self.domain.load(after) if after != before else self.first
            self._loaded = after, self.second
        self.numbers[key.CHANGES] = after != before
        self.floats[key.BEGIN], self.floats[key.RATE] = begin, 1 / (end - begin) if after != before else 0.0
        self.floats[key.STOP_BACKWARDS], self.floats[key.STOP_FORWARDS] = self.span.begin, min(end, self.span.end)

    def _kernel(self, numbers: Any, floats: Any, rows: Any, points: Any, counts: Any) -> tuple[int, int]:
        mesh, slopes = self.domain.mesh, np.empty((len(self.tableau), 4))
        done, steps = kernel()(
            self.first, self.second, *mesh, numbers, floats, self.tableau, slopes, rows, points, counts
        )
        return done, steps

    def _advance_all(self, active: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Advance particles of all ranks until each has ended or waits for the next interval; return both kinds."""
        waiting, ended = [np.empty((0, key.STATE))], [np.empty((0, key.STATE))]
        while True:
            active = self._advance(active)
            status = active[:, key.STATUS]
            leaves, waits = status == key.HANDED_OVER, status == key.END_OF_INTERVAL
            waiting.append(active[waits])
            ended.append(active[~leaves & ~waits])
            if not self.boxes or not self.channel.maximum(int(leaves.any())):
                return np.concatenate(waiting), np.concatenate(ended)
            leaving = active[leaves]
            leaving[:, key.STATUS] = key.RUNNING
            owners = self._owners(leaving[:, key.POSITION : key.POSITION + 3])
            sent = [np.ascontiguousarray(leaving[owners == rank]).reshape(-1) for rank in range(self.channel.size)]
            self.bytes_sent += leaving.nbytes
            self.rounds += 1
            active = np.concatenate(all_to_all(self.channel, sent, _TAG)).reshape(-1, key.STATE)

    def _advance(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Advance particles until none has filled its room; keep what they wrote."""
        parts = [rows[at : at + BATCH] for at in range(0, len(rows), BATCH)]
        for pieces, steps in self.pool.map(self._advance_batch, parts):
            self.pieces.headers += pieces.headers
            self.pieces.points += pieces.points
            self.steps += steps
        lost = rows[rows[:, key.STATUS] == key.NOT_LOADED]
        if len(lost):
            place = self.domain.to_world(lost[:1, key.POSITION : key.POSITION + 3])[0]
            raise ClustervizError(f"a line left the vectors that its rank holds, near {place.tolist()}")
        return rows

    def _advance_batch(self, rows: NDArray[np.float64]) -> tuple[_Pieces, int]:
        pieces, steps, begin = _Pieces(), 0, 0
        room = np.empty((min(ROOM, len(rows) * (self.settings.max_steps + 1)) if self.stores else 0, 5))
        while begin < len(rows):
            own, counts = rows[begin:], np.zeros(len(rows) - begin, np.int64)
            before = np.where(own[:, key.STATUS] == key.NEW, -1, own[:, key.STEPS])
            done, attempts = self._kernel(self.numbers, self.floats, own, room, counts)
            steps += attempts
            pieces.add(own, before, room, counts)
            begin += done
            if rows[begin - 1, key.STATUS] == key.FULL:
                begin -= 1
                rows[begin, key.STATUS] = key.RUNNING
        return pieces, steps

    def _gathered(self, ended: NDArray[np.float64], seeds: int, outside: int) -> Traced:
        """Return the lines of all ranks."""
        channel = self.channel
        heads = np.concatenate([np.empty((0, 3), np.int64), *self.pieces.headers]).reshape(-1)
        points = np.concatenate([np.empty((0, 5)), *self.pieces.points]).reshape(-1)
        headers = np.concatenate(all_to_all(channel, [heads] * channel.size, _TAG)).reshape(-1, 3)
        whole = np.concatenate(all_to_all(channel, [points] * channel.size, _TAG)).reshape(-1, 5)
        rows = np.concatenate(all_to_all(channel, [np.ascontiguousarray(ended).reshape(-1)] * channel.size, _TAG))
        states = rows.reshape(-1, key.STATE)
        states = states[np.lexsort((states[:, key.DIRECTION], states[:, key.NUMBER]))]
        counted = channel.allgather_numbers([self.steps, self.bytes_sent]).sum(axis=0).tolist()
        numbers, counts = np.unique(states[:, key.STATUS], return_counts=True)
        ends = {key.ENDS[int(n)]: int(count) for n, count in zip(numbers, counts, strict=True)}
        lines = self._streaklines(states) if self.kind == "streaklines" else self._lines(headers, whole, states)
        return Traced(lines, ends, seeds, outside, counted[0], counted[1], self.rounds, self.over)

    def _lines(self, headers: NDArray[np.int64], points: Any, states: NDArray[np.float64]) -> Lines:
        """Join parts of lines in their order, and the two halves of each line."""
        half, step, count = headers.T
        number, backward, begin = half // 2, half % 2, np.cumsum(count) - count
        lines, status = (states[:, each].astype(int) for each in (key.NUMBER, key.STATUS))
        forward = states[:, key.DIRECTION] > 0
        has_forward, ends = np.zeros(lines.max(initial=-1) + 1, bool), np.zeros(lines.max(initial=-1) + 1, int)
        has_forward[lines[forward]] = True
        ends[lines[~forward]] = status[~forward]
        ends[lines[forward]] = status[forward]
        kept = (backward == 0) | (ends != key.CLOSED)[number] | ~has_forward[number]
        # The seed is the first point of both halves.
        twice = (backward == 1) & (step < 0) & has_forward[number]
        begin, count = begin + twice, count - twice
        order = np.lexsort((np.where(backward, -step, step), -backward, number))
        order = order[kept[order]]
        number, count, way = number[order], count[order], 1 - 2 * backward[order]
        first = begin[order] + np.where(way < 0, count - 1, 0)
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        along = np.repeat(first, count) + within * np.repeat(way, count)
        sizes = np.bincount(number, count, len(ends)).astype(int)
        long = sizes > 1
        along = along[np.repeat(long[number], count)]
        numbers, offsets = np.flatnonzero(long), np.cumsum([0, *sizes[long].tolist()])
        return self._as_lines(points[along], offsets, numbers.tolist(), ends[long].tolist())

    def _streaklines(self, states: NDArray[np.float64]) -> Lines:
        """Join the particles of each seed that are still there, from the last released on; gaps end a line."""
        count = self.releases
        rows = states[states[:, key.STATUS] == key.END_OF_INTERVAL]
        rows = rows[np.lexsort((-rows[:, key.NUMBER], rows[:, key.NUMBER] // count))]
        seed, release = np.divmod(rows[:, key.NUMBER].astype(np.int64), count)
        cut = np.flatnonzero((np.diff(seed) != 0) | (np.diff(release) != -1)) + 1
        parts = [part for part in np.split(np.arange(len(rows)), cut) if len(part) > 1]
        order = np.concatenate([np.empty(0, np.int64), *parts])
        released = self.span.begin + release * (self.settings.release or 1.0)
        points = np.column_stack([rows[:, key.POSITION : key.POSITION + 3], released, rows[:, key.SPEED]])
        first = [int(seed[part[0]]) for part in parts]
        return self._as_lines(
            points[order], np.cumsum([0, *map(len, parts)]), first, [key.END_OF_INTERVAL] * len(parts)
        )

    def _as_lines(self, points: Any, offsets: NDArray[np.int64], numbers: list[int], ends: list[int]) -> Lines:
        name = f"{self.vectors.name}: {self.kind}"
        places = self.domain.to_world(np.ascontiguousarray(points[:, :3]))
        of_points = {"speed": points[:, 4].copy(), "time": points[:, 3].copy()}
        of_lines = {"seed": np.array(numbers, np.int64), "end": np.array(ends, np.int64)}
        return Lines(name, places, offsets.astype(np.int64), of_points, of_lines)
