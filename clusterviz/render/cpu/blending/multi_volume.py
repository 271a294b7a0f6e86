"""Several volumes, mixed slab by slab: the twin of multi_volume.glsl, absorbing.glsl and layers_none.glsl.

Extinctions add up, and a slab's colour is their mean, weighted by them. A volume is sampled only where a ray of the
packet is in it; there is no loop over volumes, since each has code of its own.

References
----------
N. Max: Optical models for direct volume rendering, IEEE TVCG 1(2), 1995, sections 2 and 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Protocol

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.render.cpu.blending.classified import Optics
from clusterviz.render.cpu.blending.composite import put_behind, take_sample, too_little_left
from clusterviz.render.cpu.blending.samples import ABREAST, Samples, four, zeros
from clusterviz.render.cpu.fields.field import Spot
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.march import Four, Variables
from clusterviz.render.cpu.marching.starts import Starts
from clusterviz.render.cpu.marching.volume_bounds import Body, RankWork, Spots
from clusterviz.render.cpu.transfer.classify import absorbed

THINNEST = 1e-37
"""Less absorbs nothing: a colour cannot be told from it."""


@dataclass(frozen=True)
class Slabs:
    """Some slabs of each ray.

    Attributes
    ----------
    numbers : int32, from those on that are taken now
    wanted : where they matter
    length : of each, in that of a whole one
    """

    numbers: Sequence[Value]
    wanted: Sequence[Value]
    length: Value


class VolumeLayer(Protocol):
    """What one volume adds to slabs."""

    def begin(self) -> None:
        """A run begins."""

    def add(self, mixed: Sequence[Variables], share: RankWork, slabs: Slabs) -> None:
        """Add to the depths of slabs, and to their colours times that.

        Parameters
        ----------
        mixed : of each slab, colours and depth
        share : where they are in the volume
        """


class Sampled:
    """A volume that is sampled at the midpoints of slabs; an `VolumeLayer`.

    Parameters
    ----------
    job : the volume's own
    body : where rays are in it
    """

    def __init__(self, code: Code, job: Job, body: Body, samples: Samples, optics: Optics) -> None:
        self._code, self._body, self._samples, self._optics = code, body, samples, optics
        self._units = code.splat(job["optics"])

    def begin(self) -> None:
        """A run begins; nothing has to be known of it."""

    def add(self, mixed: Sequence[Variables], share: RankWork, slabs: Slabs) -> None:
        """What their midpoints come to, where these lie in the volume."""
        numbers, wanted = slabs.numbers, slabs.wanted
        code, body = self._code, self._body
        inside = [here & share.there & body.holds(number) for number, here in zip(numbers, wanted, strict=True)]
        with code.when(code.any(reduce(or_, inside))):
            along = [number.to(F32) for number in numbers]
            spots = [self._samples.moved(share.spot, body.stride, one) for one in along]
            scalars = [self._samples.on_the_way(share.spot, body.stride, one) for one in along]
            # NaN compares false.
            seen = [here & (s >= self._optics.visible_from) for s, here in zip(scalars, inside, strict=True)]
            with code.when(code.any(reduce(or_, seen))):
                for sums, s, spot, here in zip(mixed, scalars, spots, seen, strict=True):
                    unit, colour = self._optics.of_unit(s, spot, body.stride)
                    depth = code.select(here, unit * self._units * slabs.length, 0.0)
                    for part, channel in zip(sums, colour, strict=False):
                        part.set(code.select(here, code.fma(depth, channel, part.now), part.now))
                    sums[3].set(sums[3].now + depth)


class MultiVolume:
    """Several volumes; a `BlendMode`.

    Parameters
    ----------
    starts : where rays start; None: at their first slab
    """

    def __init__(
        self, code: Code, job: Job, volume_layers: Sequence[VolumeLayer], starts: Starts | None = None
    ) -> None:
        self._code, self._ingredients, self._starts = code, volume_layers, starts
        self._stops = job.part("optics", 1) > 0.0
        self._residual = code.splat(job.part("optics", 1))

    def run(self, kept: Variables, sums: Variables, spot: Spot, slab: Vector, slabs: Value, first: Value) -> Value:
        """The sum of the run's slabs."""
        code, end, rest = self._code, Variable(slabs), 1.0 - kept[3].now
        most, number = Variable(code.largest(slabs)), Variable(code.number(I32, 0))
        self._begin()
        with code.loop(lambda: number.now < most.now):
            numbers = [code.splat(number.now + later) for later in range(ABREAST)]
            mixed = self._mixed(spot, Slabs(numbers, [one < end.now for one in numbers], code.same(F32, 1.0)))
            for one, found in zip(numbers, mixed, strict=True):
                seen = (found[3].now > THINNEST) & (one < end.now)
                with code.when(code.any(seen)):
                    self._take(sums, found, seen)
                    if self._starts:
                        self._starts.note(seen, one)
                    with code.when(self._stops):
                        # A ray ends with the slab that leaves too little light, not with its run.
                        ended = seen & (rest * (1.0 - sums[3].now) <= self._residual)
                        end.set(code.select(ended, one + 1, end.now))
                        with code.when(code.any(ended)):
                            most.set(code.largest(end.now))
            number.set(number.now + ABREAST)
        return end.now

    def last(self, spot: Spot, slab: Vector, share: Value, drawn: Value, only: Value) -> Four:
        """A share of a slab, sampled at its midpoint."""
        slabs, sums = Slabs([self._code.same(I32, 0)], [drawn], share), zeros(self._code)
        self._begin()
        (found,) = self._mixed(spot, slabs)
        self._take(sums, found, drawn & (found[3].now > THINNEST))
        return four(sums)

    def add(self, kept: Variables, run: Four, drawn: Value) -> None:
        """Behind what is there."""
        put_behind(self._code, kept, run, drawn)

    def is_done(self, kept: Variables) -> Value:
        """Where so little light is left that the scene allows to stop."""
        return too_little_left(kept, self._residual)

    def _begin(self) -> None:
        for volume_layer in self._ingredients:
            volume_layer.begin()

    def _mixed(self, spot: Spot, slabs: Slabs) -> list[Variables]:
        """What all volumes come to in slabs: colours times depths, and depths."""
        assert isinstance(spot, Spots), "places of a mixture are in all volumes"
        mixed = [zeros(self._code) for _ in slabs.numbers]
        for volume_layer, share in zip(self._ingredients, spot.shares, strict=True):
            volume_layer.add(mixed, share, slabs)
        return mixed

    def _take(self, sums: Variables, mixed: Variables, seen: Value) -> None:
        """Put slabs behind those of their run."""
        code, depth = self._code, mixed[3].now
        per_depth = 1.0 / code.select(seen, depth, 1.0)
        r, g, b = (part.now * per_depth for part in mixed[:3])
        take_sample(code, sums, seen, absorbed(code, depth), (r, g, b))
