"""The code of a kernel: tiles of the picture, packets of pixels, rays, and what the look makes of them."""

from __future__ import annotations

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import I32, I64, Value
from clusterviz.render.cpu.blending.classified import GradientShading, Optics
from clusterviz.render.cpu.blending.composite import Composite
from clusterviz.render.cpu.blending.light import Lights
from clusterviz.render.cpu.blending.multi_volume import MultiVolume, Sampled, VolumeLayer
from clusterviz.render.cpu.blending.preintegrated import Preintegrated, Ramped, SummedRamps
from clusterviz.render.cpu.blending.projections import Extreme, FirstHit, LocalMaximum, Sum
from clusterviz.render.cpu.blending.samples import Samples
from clusterviz.render.cpu.blending.surfaces import Surfaces
from clusterviz.render.cpu.fields.cubic import CubicField, CubicGradient
from clusterviz.render.cpu.fields.field import BrickPitch, Field, Pitch
from clusterviz.render.cpu.fields.gradient import CentralGradient, Gradient, NearestGradient
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.kernel import Kernel
from clusterviz.render.cpu.marching.adaptive_step import Stretch
from clusterviz.render.cpu.marching.clip import Cut
from clusterviz.render.cpu.marching.march import BlendMode, March
from clusterviz.render.cpu.marching.sample_positions import Places
from clusterviz.render.cpu.marching.split import SplitMarch
from clusterviz.render.cpu.marching.starts import Starts
from clusterviz.render.cpu.marching.tile import Tile
from clusterviz.render.cpu.marching.volume_bounds import Bodies, Body, MixedPlaces
from clusterviz.render.cpu.transfer.classify import Classifier
from clusterviz.render.cpu.transfer.grading import Fading, Table
from clusterviz.render.cpu.transfer.pieces import PieceClassifier
from clusterviz.render.cpu.transfer.preintegrated_segments import Ramps


def program_of(kernel: Kernel) -> str:
    """The code, as LLVM reads it."""
    code = Code(kernel.name, kernel.lanes)
    job = Job(code, kernel.wide)
    tile = Variable(code.number(I64, 0))
    samples = Variable(code.number(I64, 0))
    starts = Starts(code, job) if kernel.frame_coherence else None
    march = _mixed_march(kernel, code, job, starts) if kernel.volumes else _march(kernel, code, job, starts)
    tiles = Tile(code, job, march, starts)

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


def _field(kernel: Kernel, code: Code, job: Job, pitch: Pitch) -> Field:
    kind = CubicField if kernel.filter == "cubic" else Field
    return kind(code, job, kernel.kind, kernel.filter == "nearest", pitch)


def _mixed_march(kernel: Kernel, code: Code, job: Job, starts: Starts | None) -> March:
    """Of several volumes, each with code of its own."""
    volume_layers: list[VolumeLayer] = []
    bodies = []
    for number, volume in enumerate(kernel.volumes):
        own = job.volume(number)
        field, ramped = _field(volume, code, own, Pitch(code, own)), volume.preintegrated
        body, samples = Body(code, own, number, volume.filter == "nearest", ramped), Samples(code, own, field)
        if ramped:
            ramps = Preintegrated(
                code, own, samples, SummedRamps(code, own), _relief(volume, code, own, field), volume.kind == "f32"
            )
            volume_layers.append(Ramped(code, own, body, samples, ramps))
        else:
            volume_layers.append(Sampled(code, own, body, samples, _optics(volume, code, own, field)))
        bodies.append(body)
    blend_mode, places = MultiVolume(code, job, volume_layers, starts), MixedPlaces(code, job, bodies)
    return March(code, job, places, blend_mode, kernel.jittered, starts=starts, bodies=Bodies(bodies))


def _march(kernel: Kernel, code: Code, job: Job, starts: Starts | None) -> March | SplitMarch:
    pitch = BrickPitch(code, job) if kernel.pitched else Pitch(code, job)
    field = _field(kernel, code, job, pitch)
    samples = Samples(code, job, field, starts)
    if kernel.split:
        return SplitMarch(code, job, _preintegrated(kernel, code, job, field, samples), kernel.jittered, pitch)
    stretch = Stretch(code) if kernel.adaptive else None
    cut = Cut(code) if kernel.surfaces else None
    blend_mode = _blend_mode(kernel, code, job, field, samples, (stretch, cut))
    places = Places(code, job, kernel.filter == "nearest", pitch, stretch)
    return March(code, job, places, blend_mode, kernel.jittered, stretch, cut, starts)


def _preintegrated(kernel: Kernel, code: Code, job: Job, field: Field, samples: Samples) -> Preintegrated:
    relief = _relief(kernel, code, job, field)
    return Preintegrated(code, job, samples, Ramps(code, job), relief, kernel.kind == "f32")


def _blend_mode(
    kernel: Kernel, code: Code, job: Job, field: Field, samples: Samples, extras: tuple[Stretch | None, Cut | None]
) -> BlendMode:
    stretch, cut = extras
    if kernel.preintegrated:
        return _preintegrated(kernel, code, job, field, samples)
    if kernel.blending == "local-maximum":
        return LocalMaximum(code, job, samples)
    if kernel.blending == "first-hit":
        return FirstHit(code, job, samples)
    if kernel.blending in ("maximum", "minimum"):
        return Extreme(code, samples, kernel.blending == "maximum")
    if cut and kernel.blending == "isosurface":
        return Surfaces(code, job, field, samples, _relief(kernel, code, job, field), cut)
    if kernel.blending == "average":
        return Sum(code, samples, _classifier(kernel, code, job))
    optics = _optics(kernel, code, job, field)
    if cut:
        return Surfaces(code, job, field, samples, optics.relief, cut, optics)
    return Composite(code, job, samples, optics, stretch)


def _classifier(kernel: Kernel, code: Code, job: Job) -> Classifier:
    if kernel.pieces == "many":
        return Classifier(code, job)
    return PieceClassifier(code, job, kernel.capacity, kernel.pieces == "fitted")


def _optics(kernel: Kernel, code: Code, job: Job, field: Field) -> Optics:
    classifier, holds_colour = _classifier(kernel, code, job), kernel.graded == "colours"
    table = Table(code, job, classifier, holds_colour) if kernel.graded in ("opacities", "colours") else None
    return Optics(code, classifier, _relief(kernel, code, job, field), table)


def _relief(kernel: Kernel, code: Code, job: Job, field: Field) -> GradientShading:
    if not (kernel.light or kernel.graded):
        return GradientShading(code)
    lights = Lights(code, job, kernel.light == "near") if kernel.light else None
    fading = Fading(code, job) if kernel.graded == "faded" else None
    return GradientShading(code, _gradient(kernel, code, job, field), lights, fading)


def _gradient(kernel: Kernel, code: Code, job: Job, field: Field) -> Gradient:
    if kernel.smooth or kernel.filter == "cubic":
        return CubicGradient(code, field)
    return (NearestGradient if kernel.filter == "nearest" else CentralGradient)(code, job, field)
