"""The kernel of a variant: tiles of the picture, packets of pixels, rays, and what the look makes of them."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import I32, I64, Value
from clusterviz.kernels.objects import function_address, machine
from clusterviz.plan.encoding import VoxelKind
from clusterviz.plan.grading import Table as TableHolds
from clusterviz.plan.look import Blending
from clusterviz.plan.plan import Filter, Plan
from clusterviz.render.vectors.classify import Classifier
from clusterviz.render.vectors.composite import Composite
from clusterviz.render.vectors.cubic import CubicField, CubicGradient
from clusterviz.render.vectors.field import Field
from clusterviz.render.vectors.gradient import CentralGradient, Gradient, NearestGradient
from clusterviz.render.vectors.grading import Fading, Table
from clusterviz.render.vectors.job import Job
from clusterviz.render.vectors.light import Light, Lights
from clusterviz.render.vectors.local_maximum import LocalMaximum
from clusterviz.render.vectors.march import Look, March
from clusterviz.render.vectors.optics import Optics
from clusterviz.render.vectors.pieces import MOST, PieceClassifier, Pieces
from clusterviz.render.vectors.place import Places
from clusterviz.render.vectors.preintegrated import Preintegrated
from clusterviz.render.vectors.projections import Extreme, Sum
from clusterviz.render.vectors.ramps import Ramps
from clusterviz.render.vectors.relief import Relief
from clusterviz.render.vectors.samples import Samples
from clusterviz.render.vectors.stretch import Stretch
from clusterviz.render.vectors.tile import Tile

Held = Literal["many", "few", "fitted"]
Graded = Literal["", "faded", "opacities", "colours"]
"""It does nothing; extinction is multiplied; a table holds opacities, or colours, too."""
PROJECTIONS: tuple[Blending, ...] = ("maximum", "minimum", "local-maximum", "average", "additive")


@dataclass(frozen=True)
class Kernel:
    """What a kernel is made for; its fields are constants of its code.

    Attributes
    ----------
    kind : how voxels are stored
    filter : how the field is reconstructed
    blending : what becomes of samples; sums are averages, too
    pieces : the transfer function's are many; or few, held in registers; or few, and fitted by polynomials
    lanes : pixels of a packet
    preintegrated : slabs are classified between their ends
    light : what shines on the volume
    graded : what the gradient's magnitude does to opacity
    smooth : gradients are those of cubic B-splines, whatever the field is
    jittered : every pixel has a lattice of slabs of its own
    stretched : slabs are longer where groups of cells allow it
    """

    kind: VoxelKind
    filter: Filter
    blending: Blending
    pieces: Held
    lanes: int
    preintegrated: bool = False
    light: Light = ""
    graded: Graded = ""
    smooth: bool = False
    jittered: bool = False
    stretched: bool = False

    @property
    def name(self) -> str:
        """Of the function."""
        parts = (
            self.kind,
            self.filter,
            self.blending,
            self.pieces,
            str(self.lanes),
            *(["preintegrated"] if self.preintegrated else []),
            *([self.light] if self.light else []),
            *([self.graded] if self.graded else []),
            *(["smooth"] if self.smooth else []),
            *(["jittered"] if self.jittered else []),
            *(["stretched"] if self.stretched else []),
        )
        return f"cast_{'_'.join(parts)}"

    def write(self) -> str:
        """The code, as LLVM reads it."""
        code = Code(self.name, self.lanes)
        job = Job(code)
        tile = Variable(code.number(I64, 0))
        samples = Variable(code.number(I64, 0))
        nearest = self.filter == "nearest"
        field = (CubicField if self.filter == "cubic" else Field)(code, job, self.kind, nearest)
        stretch = Stretch(code) if self.stretched else None
        look = self._look(code, job, field, stretch)
        places = Places(code, job, nearest, stretch)
        tiles = Tile(code, job, March(code, job, places, look, self.jittered, stretch))

        def next_tile() -> Value:
            tile.set(code.add_atomically(job.address("counter"), code.number(I64, 1)))
            return tile.now < job["tiles"].to(I64)

        with code.loop(next_tile):
            samples.set(samples.now + tiles.draw(tile.now.to(I32)))
        code.add_atomically(job.address("taken"), samples.now)
        return code.text()

    def _look(self, code: Code, job: Job, field: Field, stretch: Stretch | None) -> Look:
        samples = Samples(code, job, field)
        if self.preintegrated:
            relief = self._relief(code, job, field)
            return Preintegrated(code, job, samples, Ramps(code, job), relief, self.kind == "f32")
        if self.blending == "local-maximum":
            return LocalMaximum(code, job, samples)
        if self.blending in ("maximum", "minimum"):
            return Extreme(code, samples, self.blending == "maximum")
        many = self.pieces == "many"
        classifier = Classifier(code, job) if many else PieceClassifier(code, job, self.pieces == "fitted")
        if self.blending == "average":
            return Sum(code, samples, classifier)
        holds_colour = self.graded == "colours"
        table = Table(code, job, classifier, holds_colour) if self.graded in ("opacities", "colours") else None
        optics = Optics(code, classifier, self._relief(code, job, field), table)
        return Composite(code, job, samples, optics, stretch)

    def _relief(self, code: Code, job: Job, field: Field) -> Relief:
        if not (self.light or self.graded):
            return Relief(code)
        lights = Lights(code, job, self.light == "near") if self.light else None
        fading = Fading(code, job) if self.graded == "faded" else None
        return Relief(code, self._gradient(code, job, field), lights, fading)

    def _gradient(self, code: Code, job: Job, field: Field) -> Gradient:
        if self.smooth or self.filter == "cubic":
            return CubicGradient(code, field)
        return (NearestGradient if self.filter == "nearest" else CentralGradient)(code, job, field)


def kernel_of(plan: Plan, lanes: int, pieces: Pieces | None) -> Kernel:
    """The kernel that a plan needs.

    Parameters
    ----------
    pieces : the transfer function's, where they are few
    """
    blending = plan.look.blending
    preintegrated = plan.march.preintegrated
    apart = preintegrated or plan.look.grading is not None
    few = pieces is not None and lanes == MOST and blending == "composite" and not apart
    held: Held = "many" if pieces is None or not few else "fitted" if pieces.fitted else "few"
    blending = "average" if blending == "additive" else blending
    shading, smooth = plan.look.shading, plan.look.smooth
    light: Light = ("near" if shading.has_places else "far") if shading else ""
    kind, graded, jittered = plan.encoding.kind, graded_of(plan), plan.march.jittered
    stretched = plan.march.stretching is not None
    return Kernel(
        kind, plan.march.filter, blending, held, lanes, preintegrated, light, graded, smooth, jittered, stretched
    )


def graded_of(plan: Plan) -> Graded:
    """What the gradient's magnitude does to the opacity of a plan's volume."""
    grading = plan.look.grading
    if grading is None:
        return ""
    holds: dict[TableHolds, Graded] = {"": "faded", "opacity": "opacities", "colour and opacity": "colours"}
    return holds[grading.table_holds]


def can_draw(plan: Plan) -> bool:
    """Whether there is a kernel for a plan."""
    look, march = plan.look, plan.march
    special = plan.mixture or look.surfaces
    blending = look.blending == "composite" or look.blending in PROJECTIONS
    return blending and not (special or march.split) and march.filter in ("linear", "nearest", "cubic")


@cache
def compiled(kernel: Kernel) -> Callable[[int], None]:
    """A kernel as a function of its job's address; it needs no lock of Python's, so threads run it at once."""
    sources = [path.read_bytes() for path in _sources()]
    address = function_address(kernel.name, sources, lambda: _object(kernel))
    return ctypes.CFUNCTYPE(None, ctypes.c_int64)(address)


def _sources() -> list[Path]:
    here = Path(__file__).parent
    return [
        *sorted(here.glob("*.py")),
        *sorted((here.parent.parent / "kernels").glob("*.py")),
        here.parent / "frame_block.py",
    ]


def _object(kernel: Kernel) -> bytes:
    import llvmlite.binding as llvm  # type: ignore[import-untyped]

    target = machine()
    module = llvm.parse_assembly(kernel.write())
    module.triple, module.data_layout = target.triple, str(target.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    builder = llvm.create_pass_builder(target, options)
    builder.getModulePassManager().run(module, builder)
    code: bytes = target.emit_object(module)
    return code
