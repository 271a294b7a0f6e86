"""Shader variant of a plan: its files, and the constants with which it is compiled.

Everything that stays the same while a volume is shown is a constant of the program, above all the layout of bricks,
which the compiler folds into the addresses of every fetch. Data that change from frame to frame are in the frame block.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from clusterviz.gl.layout import Constant, glsl_array, glsl_constants, glsl_rows
from clusterviz.gl.reals import Reals
from clusterviz.gl.shader import assemble
from clusterviz.plan.blend_mode import Lattice
from clusterviz.plan.plan import Plan
from clusterviz.plan.preintegration import SLAB_RECORD
from clusterviz.plan.segments import RECORD
from clusterviz.render.abuffer.program import GeometryVariant, geometry_variant
from clusterviz.render.crossing import PLANES
from clusterviz.render.frame_block import FRAME_BLOCKS
from clusterviz.render.frame_coherence import STARTS_BLOCK
from clusterviz.render.refraction import REFRACTION_BLOCK
from clusterviz.render.sizes import COUNTS, OCCLUSION_ROWS, PACKETS, SIZES
from clusterviz.render.storage import GROUP, Slot
from clusterviz.render.volume_layers import (
    EXACT,
    LATTICES,
    MOST_ROWS,
    TABLES_BINDING,
    VolumeVariant,
    cell_files,
    content_files,
    density_files,
    volume_variants,
)
from clusterviz.scene.blend_modes import BLEND_MODES, DEFAULT_BLENDING, Blending, BlendModeTraits
from clusterviz.spmd.source import ShaderSource

PART_BYTES = 16  # a vec4
USUAL_BRICK = 64  # cells along its side
MOST_MET = 21  # most intersections of one surface with a slab of two voxels, which lies in seven cells
MOST_IN_SLAB = 64  # most surfaces of all volumes in a slab
NO_VOLUME = VolumeVariant("linear", Slot((1, 1, 1), "f32", False), 0)
Files = str | tuple[str, ...]
SURFACES_FILES = ("root.glsl", "surfaces.glsl")
PREINTEGRATED_FILES = ("sums.glsl", "front_to_back.glsl", "ramp.glsl", "ramp_slab.glsl", "preintegrated.glsl")
"""Files that sample runs of slabs, where samples.glsl does not."""


LONE_BLOCKS = {"surface": ("Surfaces", 4), "grading": ("Grading", 5), "lighting": ("Lights", 2)}
"""Blocks of a volume alone by the rows in them: their names, and their bindings."""
Profile = Literal["", "counts", "clock"]
CLOCK = "#extension GL_ARB_shader_clock : require"


@dataclass(frozen=True)
class Lanes:
    """How a CPU draws.

    Attributes
    ----------
    lanes : of a vector
    pieces : most pieces of the transfer function in registers; 0: it is in memory
    volumes : the same of each of several volumes, whose pieces are all fitted
    fitted : a slab's opacity is a polynomial on each piece
    wide : 32 bits do not address all words of bricks
    pitched : bricks have several sizes
    far : samples are so far apart that voxels are fetched ahead
    """

    lanes: int
    pieces: int = 0
    fitted: bool = False
    wide: bool = False
    pitched: bool = False
    far: bool = False
    volumes: tuple[int, ...] = ()


@dataclass(frozen=True)
class Variant:
    """Constants and files of one program of the ray caster.

    Attributes
    ----------
    slot : layout of a stored brick
    brick : cells along the side of a brick; 0 on a CPU that draws bricks of any size
    block_bytes : size of the uniform block for the transfer functions' records; 0 if they are too many for one
    volumes : variants of the volumes
    blending : blend mode
    planes : number of clipping planes
    lattice : where slabs begin
    split : slabs are cut where they leave a brick
    frame_coherence : rays start by the hits of the last frame
    crossing : only where the opacity of a pixel passes one half is found
    cpu : how a CPU draws it; None: a GPU draws
    profile : what is found out about each pixel, besides its colour
    geometry : meshes, lines and points; None without any
    refraction : rays bend
    reals : form of the numbers that decide which slabs a box owns
    """

    slot: Slot
    brick: int
    block_bytes: int
    volumes: tuple[VolumeVariant, ...] = ()
    blending: Blending = DEFAULT_BLENDING
    planes: int = 0
    lattice: Lattice = "rays"
    split: bool = False
    frame_coherence: bool = False
    crossing: bool = False
    cpu: Lanes | None = None
    profile: Profile = ""
    geometry: GeometryVariant | None = None
    refraction: bool = False
    reals: Reals = "double"

    @property
    def is_mixed(self) -> bool:
        """Whether slabs are those of mixed content, and not of a volume alone."""
        return self.slot.mixed

    @property
    def volume(self) -> VolumeVariant:
        """Variant of the volume that is drawn alone; of mixed content one that shows nothing."""
        return NO_VOLUME if self.is_mixed else self.volumes[0]

    @property
    def name(self) -> str:
        """Name of its function on a CPU; those of variants that differ little are the same."""
        volumes = (
            f"{len(self.volumes)}_volumes"
            if self.is_mixed
            else f"{self.slot.kind}_{self.volume.filter}_{self.blending}"
        )
        return f"cast_{volumes}_{self.lanes}".replace("-", "_")

    @property
    def lanes(self) -> int:
        """Lanes of a CPU's vectors; 0 on a GPU."""
        return self.cpu.lanes if self.cpu else 0

    @property
    def needs_doubles(self) -> tuple[str, ...]:
        """What is shown that has only been written in double precision."""
        uses = {
            "several volumes, or geometry": self.is_mixed,
            "pre-integrated slabs": self.volume.preintegrated,
            "frame coherence": self.frame_coherence,
            "layers": self.crossing,
            "refraction": self.refraction,
        }
        return tuple(name for name, is_used in uses.items() if is_used)

    @property
    def fetches_ahead(self) -> bool:
        """Whether a program for CPUs brings voxels nearer before it samples them."""
        volume = self.volume
        return volume.filter == "linear" and not (self.is_mixed or volume.surfaces or volume.preintegrated)

    @property
    def source(self) -> ShaderSource:
        """Assembled shader."""
        volume = self.volume
        slots: dict[str, Files] = {
            "REALS": f"reals_{self.reals}.glsl",
            "FRAME": FRAME_BLOCKS[self.reals],
            "VECTORS": (f"vectors_{self.reals}.glsl", "reals.glsl", f"bricks_{self.reals}.glsl"),
            "CONSTANTS": self.constants,
            "RECORDS": "records_uniform.glsl" if self.block_bytes else "records_storage.glsl",
            "WORDS": "words.glsl",
            "PITCH": "pitch.glsl",
            "PREFETCH": "no_prefetch.glsl",
            "BEHIND": "over.glsl" if self._traits.composited else (),
            "BORDERS": (
                self._borders,
                *self._slope,
                *(density_files(volume.preintegrated) if volume.occlusion else ()),
            ),
            "STEP": "adaptive_step.glsl" if self.slot.adaptive else "fixed_step.glsl",
            "STARTS": self._starts,
            "LATTICE": LATTICES[self.lattice],
            "CLIP": ("kept.glsl", "clip.glsl") if self.planes else "unclipped.glsl",
            "PROFILE": f"profile_{self.profile}.glsl" if self.profile else "no_profile.glsl",
            "PACKETS": (),
            "MAIN": "pixels.glsl",
        }
        slots |= (self._content if self.is_mixed else self._alone) | (self._on_cpu if self.cpu else {})
        return assemble("raycast.glsl", slots | (self.geometry.whole_rays if self.geometry else {}))

    @property
    def _alone(self) -> dict[str, Files]:
        """Return the slots of files that sample a volume alone."""
        volume = self.volume
        run: Files = SURFACES_FILES if volume.surfaces else "samples.glsl"
        sample: Files = ("table.glsl", "composite_2d.glsl") if volume.table else self._traits.shader
        if volume.look:
            sample = (volume.look.glsl(), "look.glsl", "composite_2d.glsl")
        if volume.preintegrated:
            run, sample = PREINTEGRATED_FILES, ()
        graded = volume.is_graded or self.crossing or self.refraction
        return volume.files(graded, self.cpu is not None) | {
            "TRANSFER": "transfer.glsl",
            "SEGMENT": () if volume.preintegrated else ("segment.glsl", "whole_slab.glsl"),
            "RUN": run,
            "SAMPLE": sample,
            "GROUPS": ("groups.glsl", "groups_of_bricks.glsl"),
        }

    @property
    def _on_cpu(self) -> dict[str, Files]:
        """Return the slots of files that a CPU does in its own way."""
        assert self.cpu, "a GPU draws"
        packets: Files = "packets_fragments.glsl" if self.geometry else "packets.glsl", "drawn_once.glsl"
        packets = ("packets_cut.glsl", "drawn_once.glsl") if self.geometry and self.geometry.discards else packets
        packets = ("packets_crossing.glsl", "drawn_once.glsl") if self.crossing else packets
        packets = ("packets_paths.glsl", "drawn_once.glsl") if self.refraction else packets
        packets = "packets_starts.glsl" if self.frame_coherence and not self.crossing else packets
        found: dict[str, Files] = {"PACKETS": packets, "MAIN": "tiles.glsl"}
        if self.cpu.wide:
            found["WORDS"] = "words_wide.glsl"
        if self.cpu.pitched:
            found["PITCH"] = "pitches.glsl"
        if self.is_mixed:
            return found
        if not self.slot.adaptive:
            found["GROUPS"] = "skips.glsl", "groups_of_bricks.glsl"
        if self.volume.filter == "linear":  # linear_cells.glsl
            found["PREFETCH"] = ()
            if self.volume.surfaces and self.slot.kind != "f32":
                found["CELL"] = (f"extremes_{self.slot.kind}.glsl", *cell_files(self.volume.filter)[1:])
        if self.cpu.pieces:
            found["SEGMENT"] = ("segment.glsl", "piece_rows.glsl", "pieces.glsl")
        return found

    @property
    def _traits(self) -> BlendModeTraits:
        return BLEND_MODES[self.blending]

    @property
    def _borders(self) -> str:
        """Return the file by which rays go on from slab to slab."""
        straight = "split.glsl" if self.split else "unsplit.glsl"
        return "refraction.glsl" if self.refraction else straight

    @property
    def _starts(self) -> Files:
        """Return the files that choose where rays start, and look at what they find."""
        fragments = self.geometry.files if self.geometry else ("no_fragments.glsl",)
        if self.crossing:
            return (STARTS_BLOCK, "planes.glsl", *fragments, "crossing.glsl")
        if self.frame_coherence and not self.geometry:
            return (STARTS_BLOCK, "planes.glsl", *fragments, "starts.glsl")
        if self.refraction:
            return (REFRACTION_BLOCK, "planes.glsl", *fragments, "unnoted.glsl", "paths.glsl")
        return (*fragments, "unnoted.glsl", "cut.glsl" if self.geometry and self.geometry.discards else "entries.glsl")

    @property
    def _slope(self) -> tuple[str, ...]:
        if not self.crossing:
            return ()
        return ("slope_mixed.glsl",) if self.is_mixed else ("slope.glsl",)

    @property
    def _content(self) -> dict[str, Files]:
        """Return the slots of files that differ for several volumes."""
        names = "TRANSFER SEGMENT VOXEL CELL SCALAR SPLINE GRADIENT MAGNITUDE FADE LIGHT SAMPLE"
        none: dict[str, Files] = dict.fromkeys(names.split(), ())
        clip = "clip.glsl" if self.planes else "unclipped.glsl"
        pieces = self.cpu.volumes if self.cpu else None
        geometry = self.geometry.parts(len(self.volumes), self.cpu is not None) if self.geometry else ()
        planes = PLANES if self.crossing else 0
        cells = self.geometry.cells(self.cpu is not None, planes) if self.geometry else ()
        files = content_files(self.volumes, self.crossing, pieces, geometry, cells)
        return none | {"CLIP": ("kept.glsl", clip), "RUN": files, "GROUPS": "groups_of_domain.glsl"}

    @property
    def _record_bytes(self) -> int:
        return (SLAB_RECORD if self.volume.preintegrated else RECORD).itemsize

    @property
    def _sample_iterations(self) -> int:
        """Most iterations of loops in a sample."""
        each = [
            one.further_starts.bit_length()
            + one.lights
            + bool(one.lights) * one.caps
            + one.fading
            + (one.look.iterations if one.look else 0)
            + 14 * (one.occlusion + 4 * one.further_starts.bit_length()) * bool(one.occlusion)
            for one in self.volumes
        ]
        return 1 + sum(each) + self.is_mixed * sum(volume.further_iterations for volume in self.volumes)

    @property
    def _shows_surfaces(self) -> bool:
        return self.geometry is not None or any(volume.surfaces for volume in self.volumes)

    @property
    def constants(self) -> str:
        """GLSL declarations of the program's constants."""
        volume, mixed, geometry = self.volume, self.is_mixed, self.geometry
        rows = {name: self._rows(count) for name, count in volume.rows.items()}
        grids_alone = geometry is not None and geometry.grids > 0 and not self.volumes
        values: dict[str, Constant] = {
            "REACH": self.slot.reach,  # cells beyond a stored brick's in which the field is sampled
            "GROUP_SHIFT": GROUP.bit_length() - 1,  # of the side of groups of cells
            "PARTS": self._record_bytes // PART_BYTES,  # vec4s in a record of the transfer function
            "PARTS_IN_BLOCK": max(1, self.block_bytes // PART_BYTES),
            "FIRST_BUCKET": 0,
            "TWO_AT_ONCE": self.cpu is not None,  # samples
            "LONGEST_RUN": self._longest_run,  # slabs
            "LAYERS": self.crossing,  # what is found is that alone
            "MAY_BE_INVALID": self.slot.kind == "f32",  # a voxel may be NaN
            "WHOLE_SLABS": not self._shows_surfaces,  # in which volumes are cut
            "LAST_IN_RUN": bool(volume.surfaces),  # runs hold the last slab
            "SLABS_COUNT": not grids_alone,  # as samples
            "FADED": volume.fading > 0,  # extinction by the gradient's magnitude
        }
        if self.cpu:
            width, height = PACKETS[self.cpu.lanes]
            values |= {"PACKET_WIDTH": width, "PACKET_HEIGHT": height}
            values |= {"PIECES": self.cpu.pieces, "PIECES_BEFORE": 0, "FITTED": self.cpu.fitted}
        if mixed:
            # On CPUs the number of surfaces is no constant.
            each = MOST_IN_SLAB if self.cpu else MOST_MET
            most = min(each * sum(one.surfaces for one in self.volumes), MOST_IN_SLAB)
            values |= {"HAS_SURFACES": most > 0, "HAS_VOLUMES": bool(self.volumes), "MOST_SURFACES": max(1, most)}
        values |= {"VOLUMES": len(self.volumes)} if geometry else {}
        values |= {"IN_VOLUME": self._traits.absorbs} if "surface" in rows else {}
        values |= {"LIGHT_ROWS": volume.light_rows} if "lighting" in rows else {}
        values |= {"TABLE_HAS_COLOUR": volume.table == "colour and opacity"} if volume.table else {}
        clock = [CLOCK] if self.profile == "clock" and not self.cpu else []
        lines = [*clock, *(self._sizes_on_cpu if self.cpu else self._sizes), glsl_constants(values)]
        lines += [f"#define TABLE_BINDING {TABLES_BINDING}"] if volume.table else []
        lines += [glsl_rows(LONE_BLOCKS[name][0], LONE_BLOCKS[name][1], {name: count}) for name, count in rows.items()]
        lines += [geometry.constants] if geometry else []
        return "\n".join((*lines, *self._traits.constants)) + "\n"

    @property
    def _longest_run(self) -> int:
        """Most slabs of a run; unstructured grids have no use for slabs."""
        if self.is_mixed and not self.volumes:
            return 1 << 20
        return 64 if self.cpu else 16

    def _rows(self, count: int) -> int:
        """Return the number of rows of a block, which CPUs do not know when they compile."""
        return MOST_ROWS if self.cpu else count

    @property
    def _sizes(self) -> list[str]:
        """Constants for sizes and numbers, on GPUs."""
        volume = self.volume
        values: dict[str, Constant] = {
            "MARGIN": self.slot.margin,  # samples beyond the cells of a stored brick on every side
            "ROW_WORDS": self.slot.row_words,
            "SLICE_WORDS": self.slot.slice_words,
            "FURTHER_STARTS": volume.further_starts,
            "SAMPLE_ITERATIONS": self._sample_iterations,  # of loops, at most
        }
        values |= {"SURFACES": volume.surfaces} if volume.surfaces else {}
        if volume.lights:
            values |= {"LIGHTS": volume.lights, "CAPS": volume.caps}  # and planes that cut what is lit
            values |= {"OCCLUSION_PLANES": volume.occlusion - OCCLUSION_ROWS}
        values |= {"FADING_PIECES": volume.fading} if volume.fading or volume.table or volume.look else {}
        values |= {"PLANES": self.planes, "MOST_PLANES": self.planes} if self.planes else {}
        return [*self._brick_sizes, glsl_constants(values)]

    @property
    def _brick_sizes(self) -> list[str]:
        """Constants for the sizes of bricks."""
        per_cell = [f"const double BRICKS_PER_CELL = {1 / self.brick!r}LF;"] if self.reals == "double" else []
        (z, y, x), (gz, gy, gx) = self.slot.cells_zyx, self.slot.groups_zyx
        values: dict[str, Constant] = {
            "BRICK": self.brick,  # cells along its side
            "BRICK_SHIFT": self.brick.bit_length() - 1,
            "SLOT_CELLS": (x, y, z),  # of a stored brick
            "GROUPS": (gx, gy, gz),  # of cells, in a slot
            "VISIBILITY_WORDS": self.slot.visibility_words,  # of bits, one a group
            "GROUP_WORDS": self.slot.group_words,  # of all that is known of a brick's groups
        }
        return [glsl_constants(values), *per_cell]

    @property
    def _sizes_on_cpu(self) -> list[str]:
        """The same on CPUs, where most are variables, so that few programs serve all sizes."""
        assert self.cpu, "a GPU draws"
        # With several volumes, and where bricks cut slabs, ends of slabs lie on faces; lines that bend go beyond.
        within = not (self.split or self.slot.parts or self.refraction)
        values: dict[str, Constant] = {
            "FAR_APART": self.cpu.far,
            "WITHIN_CELLS": within,
            "SAMPLE_ITERATIONS": 1,
            "MOST_PLANES": MOST_ROWS,
        }
        lines = [
            glsl_array("sizes", 9, SIZES, 1 + len(self.slot.parts)),
            glsl_constants(values),
            "int PLANES = sizes[0].counts.z;",
            "int MARGIN = sizes[0].first.y, FIRST_WORD = sizes[0].first.x; // of a brick's first cell",
            "int ROW_WORDS = sizes[0].words.x, SLICE_WORDS = sizes[0].words.y;",
        ]
        if self.brick:
            lines += self._brick_sizes
        else:
            lines += [
                "int BRICK = sizes[0].cells.w;",
                "const int BRICK_SHIFT = 0;",
                "double BRICKS_PER_CELL = 1.0LF / double(BRICK);",
                "ivec3 SLOT_CELLS = sizes[0].cells.xyz, GROUPS = sizes[0].groups.xyz;",
                "int VISIBILITY_WORDS = sizes[0].words.z, GROUP_WORDS = sizes[0].groups.w;",
            ]
        return lines if self.is_mixed else [*lines, *(f"int {name} = sizes[0].{of};" for name, of in COUNTS.items())]


def of_size(variant: Variant, size: int) -> Variant:
    """Return a variant with another number of fragments that are sorted at a time."""
    assert variant.geometry, "there is geometry"
    return replace(variant, geometry=replace(variant.geometry, size=size))


def cpu_variant_of(plan: Plan, slot: Slot, cpu: Lanes) -> Variant:
    """Return the variant of a plan on a CPU; plans that differ only in numbers have the same."""
    given, slot = variant_of(plan, slot, 0), replace(slot, textured=False, margin=0, spread=0)
    # Constants are a little faster.
    whole = slot.cells_zyx == (USUAL_BRICK,) * 3 and plan.layout.brick == USUAL_BRICK
    usual = whole and not cpu.pitched and not given.is_mixed
    slot = slot if usual else _without_size(slot)
    volumes = tuple(
        replace(
            each,
            filter=EXACT.get(each.filter, each.filter),
            slot=_without_size(each.slot) if slot.mixed else slot,
            further_starts=0,
            lights=min(each.lights, 1),
            caps=0,
            fading=min(each.fading, 1),
            occlusion=min(each.occlusion, 1),
            surfaces=min(each.surfaces, 1),
        )
        for each in given.volumes
    )
    return replace(
        given,
        slot=slot,
        brick=USUAL_BRICK if usual else 0,
        volumes=volumes,
        blending="average" if given.blending == "additive" else given.blending,
        planes=min(given.planes, 1),
        cpu=cpu,
        geometry=geometry_variant(plan, True),
    )


def _without_size(slot: Slot) -> Slot:
    parts = tuple(map(_without_size, slot.parts))
    return replace(
        slot, cells_zyx=(1, 1, 1), textured=False, margin=0, spread=0, parts=parts, layout=None, group_box=None
    )


def variant_of(plan: Plan, slot: Slot, uniform_bytes: int, reals: Reals = "double") -> Variant:
    """Return the variant of a plan.

    Parameters
    ----------
    uniform_bytes : the driver's largest uniform block
    reals : form of numbers that the device prefers; what `needs_doubles` has none but double precision
    """
    fits = sum(part.segments.records.nbytes for part in plan.content.volume_layers) <= uniform_bytes
    slot, march = replace(slot, group_box=None), plan.march
    found = Variant(
        slot=slot,
        brick=plan.layout.brick,
        block_bytes=uniform_bytes if fits else 0,
        volumes=volume_variants(plan.content, slot),
        blending=plan.blend_mode.blending,
        planes=len(plan.clip),
        lattice=march.lattice,
        split=march.split,
        frame_coherence=march.frame_coherence is not None,
        crossing=march.crossing,
        geometry=geometry_variant(plan),
        refraction=plan.refraction is not None,
    )
    return found if found.needs_doubles else replace(found, reals=reals)
