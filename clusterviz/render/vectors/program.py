"""The code of a kernel: tiles of the picture, packets of pixels, rays, and what the look makes of them."""

from __future__ import annotations

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import I32, I64, Value
from clusterviz.render.vectors.fields.cubic import CubicField, CubicGradient
from clusterviz.render.vectors.fields.field import Field
from clusterviz.render.vectors.fields.gradient import CentralGradient, Gradient, NearestGradient
from clusterviz.render.vectors.job import Job
from clusterviz.render.vectors.kernel import Kernel
from clusterviz.render.vectors.looks.composite import Composite
from clusterviz.render.vectors.looks.light import Lights
from clusterviz.render.vectors.looks.local_maximum import LocalMaximum
from clusterviz.render.vectors.looks.optics import Optics
from clusterviz.render.vectors.looks.preintegrated import Preintegrated
from clusterviz.render.vectors.looks.projections import Extreme, Sum
from clusterviz.render.vectors.looks.relief import Relief
from clusterviz.render.vectors.looks.samples import Samples
from clusterviz.render.vectors.looks.surfaces import Surfaces
from clusterviz.render.vectors.marching.clip import Cut
from clusterviz.render.vectors.marching.march import Look, March
from clusterviz.render.vectors.marching.place import Places
from clusterviz.render.vectors.marching.split import SplitMarch
from clusterviz.render.vectors.marching.starts import Starts
from clusterviz.render.vectors.marching.stretch import Stretch
from clusterviz.render.vectors.marching.tile import Tile
from clusterviz.render.vectors.transfer.classify import Classifier
from clusterviz.render.vectors.transfer.grading import Fading, Table
from clusterviz.render.vectors.transfer.pieces import PieceClassifier
from clusterviz.render.vectors.transfer.ramps import Ramps


def program_of(kernel: Kernel) -> str:
    """The code, as LLVM reads it."""
    code = Code(kernel.name, kernel.lanes)
    job = Job(code, kernel.wide)
    tile = Variable(code.number(I64, 0))
    samples = Variable(code.number(I64, 0))
    nearest = kernel.filter == "nearest"
    field = (CubicField if kernel.filter == "cubic" else Field)(code, job, kernel.kind, nearest)
    starts = Starts(code, job) if kernel.leaping else None
    tiles = Tile(code, job, _march(kernel, code, job, field, starts), starts)

    def next_tile() -> Value:
        tile.set(code.add_atomically(job.address("counter"), code.number(I64, 1)))
        return tile.now < job["tiles"].to(I64)

    with code.loop(next_tile):
        samples.set(samples.now + tiles.draw(tile.now.to(I32)))
    code.add_atomically(job.address("taken"), samples.now)
    if starts:
        for name, rays in starts.counts.items():
            code.add_atomically(job.address(name), rays.now)
    return code.text()


def _march(kernel: Kernel, code: Code, job: Job, field: Field, starts: Starts | None) -> March | SplitMarch:
    samples = Samples(code, job, field, starts)
    if kernel.split:
        return SplitMarch(code, job, _preintegrated(kernel, code, job, field, samples), kernel.jittered)
    stretch = Stretch(code) if kernel.stretched else None
    cut = Cut(code) if kernel.surfaces else None
    look = _look(kernel, code, job, field, samples, (stretch, cut))
    places = Places(code, job, kernel.filter == "nearest", stretch)
    return March(code, job, places, look, kernel.jittered, stretch, cut, starts)


def _preintegrated(kernel: Kernel, code: Code, job: Job, field: Field, samples: Samples) -> Preintegrated:
    relief = _relief(kernel, code, job, field)
    return Preintegrated(code, job, samples, Ramps(code, job), relief, kernel.kind == "f32")


def _look(
    kernel: Kernel, code: Code, job: Job, field: Field, samples: Samples, extras: tuple[Stretch | None, Cut | None]
) -> Look:
    stretch, cut = extras
    if kernel.preintegrated:
        return _preintegrated(kernel, code, job, field, samples)
    if kernel.blending == "local-maximum":
        return LocalMaximum(code, job, samples)
    if kernel.blending in ("maximum", "minimum"):
        return Extreme(code, samples, kernel.blending == "maximum")
    if cut and kernel.blending == "isosurface":
        return Surfaces(code, job, samples, _relief(kernel, code, job, field), cut)
    many = kernel.pieces == "many"
    fitted = kernel.pieces == "fitted"
    classifier = Classifier(code, job) if many else PieceClassifier(code, job, kernel.capacity, fitted)
    if kernel.blending == "average":
        return Sum(code, samples, classifier)
    holds_colour = kernel.graded == "colours"
    table = Table(code, job, classifier, holds_colour) if kernel.graded in ("opacities", "colours") else None
    relief = _relief(kernel, code, job, field)
    optics = Optics(code, classifier, relief, table)
    if cut:
        return Surfaces(code, job, samples, relief, cut, optics)
    return Composite(code, job, samples, optics, stretch)


def _relief(kernel: Kernel, code: Code, job: Job, field: Field) -> Relief:
    if not (kernel.light or kernel.graded):
        return Relief(code)
    lights = Lights(code, job, kernel.light == "near") if kernel.light else None
    fading = Fading(code, job) if kernel.graded == "faded" else None
    return Relief(code, _gradient(kernel, code, job, field), lights, fading)


def _gradient(kernel: Kernel, code: Code, job: Job, field: Field) -> Gradient:
    if kernel.smooth or kernel.filter == "cubic":
        return CubicGradient(code, field)
    return (NearestGradient if kernel.filter == "nearest" else CentralGradient)(code, job, field)
