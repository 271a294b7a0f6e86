"""The samples of runs, one at the midpoint of each slab: the twin of samples.glsl; and what all looks do with sums."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.render.cpu.fields.field import Field, Spot
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.march import Four, Variables
from clusterviz.render.cpu.marching.starts import Starts

AHEAD = 4.0  # slabs; what is asked for now should be there by then
ABREAST = 2  # slabs that are sampled at once, so that the CPU need not wait for one of them
Sample = tuple[Value, Value, Spot]


class Samples:
    """The samples of a kernel.

    Parameters
    ----------
    starts : where rays start; None: at their first slab
    """

    def __init__(self, code: Code, job: Job, field: Field, starts: Starts | None = None) -> None:
        self._code, self._field, self._far, self._starts = code, field, job["far"].equals(1), starts

    @contextmanager
    def along(self, spot: Spot, slab: Vector, most: Variable, abreast: int = 1) -> Iterator[list[Sample]]:
        """For each slab of a run, `most` of them: the scalars at its midpoints, its number, and these midpoints.

        So many slabs are sampled at once; those behind the run have to be left out.
        """
        code, number = self._code, Variable(self._code.number(I32, 0))
        with code.loop(lambda: number.now < most.now):
            numbers = [number.now + later for later in range(abreast)]
            along = [code.splat(one.to(F32)) for one in numbers]
            for one in along:
                self.ask_ahead(spot, slab, one)
            spots = [self.moved(spot, slab, one) for one in along]
            yield [(self._field.at(here), one, here) for here, one in zip(spots, numbers, strict=True)]
            number.set(number.now + abreast)

    def note(self, found: Value, number: Value) -> None:
        """Behind which slab of a run something has been found in it: the next frame may want to know where."""
        if self._starts:
            self._starts.note(found, number)

    def at(self, spot: Spot) -> Value:
        """The scalars at spots."""
        return self._field.at(spot)

    def on_the_way(self, spot: Spot, slab: Vector, along: Value) -> Value:
        """The scalars so many slabs on, of rays that go on from there."""
        s = self._field.at(self.moved(spot, slab, along))
        self.ask_ahead(spot, slab, along)
        return s

    def later(self, spot: Spot, along: float) -> Spot:
        """The same spots, slabs being counted from so many slabs on."""
        return replace(spot, begin=self._code.same(F32, along) if spot.begin is None else spot.begin + along)

    def moved(self, spot: Spot, slab: Vector, along: Value) -> Spot:
        """Spots so many slabs on."""
        along = along if spot.begin is None else spot.begin + along
        x, y, z = (self._code.fma(along, by, at) for by, at in zip(slab, spot.beyond, strict=True))
        return replace(spot, beyond=(x, y, z), begin=None)

    def ask_ahead(self, spot: Spot, slab: Vector, along: Value) -> None:
        """Let the CPU bring the voxels of later samples nearer, of rays that are so many slabs on."""
        with self._code.when(self._far):
            self._field.ask_for(self.moved(spot, slab, along + AHEAD))


def zeros(code: Code) -> Variables:
    """Four sums that begin with 0."""
    return [Variable(code.same(F32, 0.0)) for _ in range(4)]


def four(sums: Variables) -> Four:
    """What they have come to."""
    a, b, c, d = (part.now for part in sums)
    return a, b, c, d


def add_exactly(code: Code, kept: Variables, more: Four, drawn: Value) -> None:
    """Add to sums where a run is drawn, with compensation (Kahan), so that 10⁶ faint slabs add up.

    A ray that has no part in a run keeps its last bit, whichever other rays its packet has.
    """
    for place, lost, part in zip(kept[:4], kept[4:], more, strict=True):
        term = part - lost.now
        total = place.now + term
        lost.set(code.select(drawn, (total - place.now) - term, lost.now))
        place.set(code.select(drawn, total, place.now))
