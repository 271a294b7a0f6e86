"""Where rays start by what the last frame found: frame coherence, as a kernel does it.

A ray goes on from its start as if it had come to it by skipping what is empty: its slabs are where they would be
anyway, and where no start is too late, pictures are the same bit for bit. A ray whose very first slab adds something
may have started too late: it begins again at its entry. What is left to go wrong is a start behind something thin:
some rays are checked. They start at their entry, stop at what would have been their start, and tell what they
gathered.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 3.3.2
(empty space leaping: hit positions, and a small offset towards the viewer).
"""

from __future__ import annotations

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, F64, I32, I64, Value, Vector
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.rays import Rays, midpoint
from clusterviz.render.cpu.marching.state import BLOCKS, NEVER, Packet

NOTHING = 1e30  # view depth at which rays start that meet nothing
COUNTS = ("estimated", "left_out", "late")
"""Numbers of rays: with a start, not drawn at all, and begun again."""
NOT_YET = UNCHECKED = -1.0  # in place of what rays gathered before their starts


class Starts:
    """What a kernel knows of where rays start.

    Attributes
    ----------
    counts : by the names in `COUNTS`, so far
    found : by the run that is sampled: the number of the slab in which each ray found something
    """

    def __init__(self, code: Code, job: Job) -> None:
        self._code, self._job = code, job
        self.counts = {name: Variable(code.number(I64, 0)) for name in COUNTS}
        self.found = Variable(code.same(I32, NEVER))

    def note(self, found: Value, number: Value) -> None:
        """A slab of this run behind which something has been found."""
        code, new = self._code, found & self.found.now.equals(NEVER)
        self.found.set(code.select(new, number, self.found.now))

    def depths(self, packet: Packet, inside: Value, x: Value, y: Value) -> Value:
        """What the last frame says of a packet's rays, whose state begins with none of them; pixels as of the draw."""
        code = self._code
        depth = code.gather(F32, self._job["starts"], y * self._job["stride"] + x, 4)
        self.count("left_out", inside & ~self.meets(depth))
        packet.set("hit", code.same(I32, NEVER))
        packet.set("checked", code.same(I32, 0))
        return depth

    def meets(self, depth: Value) -> Value:
        """Rays that have to be drawn, by what the last frame says."""
        return depth < NOTHING

    def read(self, packet: Packet, rays: Rays, depth: Value) -> None:
        """Let the rays of a packet start where the last frame says."""
        code = self._code
        checked, nothing = depth < 0.0, code.size(depth) >= NOTHING
        first, by = (self._depth(place) for place in (rays.first, rays.slab))
        slabs = (code.size(depth).to(F64) - (first + self._job.part("depth", 3))) / by
        start = code.within(slabs, -1.0, 2.0**30).to(I32) - self._job["offset"]
        # The last slab is nobody's first: what is found there could not be looked at again.
        entry = packet.get("at")
        start = code.select(nothing, NEVER, code.most(code.least(start, rays.slabs - 2), entry))
        drawn = packet.get("done").equals(0)
        self.count("estimated", drawn & ~nothing & ~checked & (start > entry))
        packet.set("entry", entry)
        packet.set("at", code.select(checked | nothing, entry, start))
        packet.set("start", start)
        packet.set("checked", checked.to(I32))
        packet.set("missed", code.select(start > entry, code.same(F32, NOT_YET), code.same(F32, 0.0)))
        # A first slab that the entry cuts has been drawn already.
        packet.set("hit", code.select(packet.get("look", 3) > 0.0, code.same(I32, 0), NEVER))
        packet.set("done", (~drawn | (nothing & ~checked)).to(I32))

    def ahead(self, packet: Packet) -> Ahead:
        """Its state while a packet goes on."""
        return Ahead(self._code, self, packet)

    def end(self, packet: Packet, found: Value) -> None:
        """Rays that find something in their last slab."""
        new = found & packet.get("hit").equals(NEVER)
        packet.set("hit", self._code.select(new, packet.rays.slabs - 1, packet.get("hit")))

    def finish(self, packet: Packet, opacity: Value, x: Value, y: Value) -> None:
        """Write where the rays of a packet hit something, NaN where they did not, and what they would have missed."""
        code, job, rays, hit = self._code, self._job, packet.rays, packet.get("hit")
        nowhere = code.same(F32, float("nan"))
        place = [Variable(nowhere) for _ in range(3)]
        with code.when(code.any(hit < NEVER)):
            whole = midpoint(code, rays, code.least(hit, rays.slabs))
            last = hit >= rays.slabs - 1
            for axis in range(3):
                at = code.select(last, rays.last[axis], whole[axis]).to(F32)
                place[axis].set(code.select(hit < NEVER, at, nowhere))
        for axis in range(3):
            self._write(place[axis].now, job["hits"] + job["plane"] * axis, x, y)
        missed = packet.get("missed")
        missed = code.select(missed.equals(NOT_YET), opacity, missed)
        self._write(code.select(packet.mask("checked"), missed, code.same(F32, UNCHECKED)), job["starts"], x, y)

    def _write(self, values: Value, address: Value, x: Value, y: Value) -> None:
        """Store a number for each pixel."""
        code = self._code
        row = BLOCKS[code.lanes][0]
        for lane in range(0, code.lanes, row):
            place = (y * self._job["stride"] + x).lane(lane).to(I64) * 4
            code.store(code.shuffle(values, values, range(lane, lane + row)), address + place)

    def count(self, name: str, rays: Value) -> None:
        """Add so many rays to a number."""
        counted = self.counts[name]
        counted.set(counted.now + self._code.total(rays.to(I64)))

    def _depth(self, direction: Vector) -> Value:
        """How much deeper in the view something lies that is so much further on."""
        x, y, z = (by * self._job.part("depth", axis) for axis, by in enumerate(direction))
        return x + y + z


class Ahead:
    """Where the rays of a packet start, while they go on.

    Attributes
    ----------
    entry : the first slab that is this draw's
    """

    def __init__(self, code: Code, starts: Starts, packet: Packet) -> None:
        self._code, self._starts, self.entry = code, starts, packet.get("entry")
        self._start, self._hit, self._missed = (Variable(packet.get(name)) for name in ("start", "hit", "missed"))
        self._checked = packet.mask("checked")

    def reached(self, at: Value, step: Value, opacity: Value) -> Value:
        """Before runs of `step` slabs from slab `at`: shorter ones, where rays stop at what would be their start."""
        code, start = self._code, self._start.now
        self._missed.set(code.select(at.equals(start) & self._missed.now.equals(NOT_YET), opacity, self._missed.now))
        return code.select(at < start, code.least(step, start - at), step)

    def passed(self, at: Value, drawn: Value) -> Value:
        """After runs from slab `at`: which rays begin again at their entry, without what the run came to."""
        code, found = self._code, self._starts.found
        some = drawn & (found.now < NEVER)
        slab = at + found.now
        noticed = some & slab.equals(self._start.now) & (slab > self.entry)
        late = noticed & ~self._checked
        self._missed.set(code.select(noticed, code.same(F32, 0.0), self._missed.now))
        self._starts.count("late", late)
        self._hit.set(code.select(some & ~late & self._hit.now.equals(NEVER), slab, self._hit.now))
        self._start.set(code.select(late, self.entry, self._start.now))
        found.set(code.same(I32, NEVER))
        return late

    def keep(self, packet: Packet) -> None:
        """Write the state."""
        for name, variable in (("start", self._start), ("hit", self._hit), ("missed", self._missed)):
            packet.set(name, variable.now)
