"""Shader files that sample a volume; of several volumes the files, constants and block, too.

A shader file handles one volume. For several, the files that sample a volume are included once for each, without a
loop, and every name that belongs to one volume is a macro that ends in its number.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.layout import glsl_array, glsl_rows
from clusterviz.gl.shader import defined_names
from clusterviz.plan.blend_mode import BlendMode, Lattice
from clusterviz.plan.content import Content, Filter, VolumeLayer
from clusterviz.plan.plan import Plan
from clusterviz.plan.preintegration import SUM_ROWS
from clusterviz.plan.segments import BUCKETS, Segments, make_segments
from clusterviz.plan.shading import LOOK_ROWS, Table
from clusterviz.render.sizes import COUNTS, OCCLUSION_ROWS
from clusterviz.render.storage import HEADER_WORDS, LEVEL_WORDS, Slot
from clusterviz.scene.transfer import TransferFunction

if TYPE_CHECKING:
    from clusterviz.spmd.look import Look

EXACT: dict[Filter, Filter] = {"hardware": "linear", "cubic-hardware": "cubic"}
"""Filters of the texture unit, and what they approximate."""
LATTICES: dict[Lattice, str] = {"rays": "unjittered.glsl", "jittered": "jitter.glsl", "slices": "slices.glsl"}
"""Files that say where slabs begin."""


def voxel_files(slot: Slot, on_cpu: bool = False) -> tuple[str, ...]:
    """Return the files that fetch voxels."""
    if on_cpu:
        return "cells_in_words.glsl", f"cells_{slot.kind}.glsl", "units.glsl"
    files = ("atlas.glsl" if slot.textured else f"voxel_{slot.kind}.glsl",)
    rows = () if slot.kind == "u8" and not slot.textured else ("rows.glsl",)
    return *files, *rows, "cells.glsl", "units.glsl"


def field_file(filter: Filter, on_cpu: bool = False) -> str:
    """Return the file that interpolates between them."""
    return "linear_cells.glsl" if filter == "linear" and on_cpu else f"{filter.replace('-', '_')}.glsl"


def cell_files(filter: Filter) -> tuple[str, ...]:
    """Return the files of the cells in which the field is one polynomial."""
    kernel = EXACT.get(filter, filter)
    return (*(("extremes.glsl",) if kernel == "linear" else ()), f"cell_{kernel}.glsl")


def gradient_file(filter: Filter, smooth: bool) -> str:
    """Return the file of the gradient; a smooth one is that of cubic B-splines, with any interpolation."""
    if smooth:
        return "gradient_cubic.glsl"
    files = {"linear": "gradient.glsl", "nearest": "gradient_nearest.glsl", "hardware": "gradient_differences.glsl"}
    return files.get(filter, "gradient_cubic.glsl")


OWN_BINDING = 10  # on CPUs, the first of blocks with the rows of one volume
MOST_ROWS = 1 << 12  # of a block whose size is not known when CPUs compile
TABLES_BINDING = 1  # the first volume's texture
VOLUME = np.dtype(
    [
        ("x", "f8", 4),  # rows of the matrix that takes the domain's index space to the volume's
        ("y", "f8", 4),
        ("z", "f8", 4),
        ("last", "f8", 4),  # sample in x, y, z
        ("scalar", "f4", 4),  # as in the frame's block
        ("buckets", "f4", 4),
        ("optics", "f4", 4),  # a slab in opacity unit distances
        ("last_segment", "i4"),
        ("base", "i4"),
        ("unused", "i4"),
        ("unused_too", "i4"),
    ]
)
GIVEN = "lighting", "grading", "surface", "transfer_table", "users_look", "brick_begin", "level_gradient"
"""Names of each volume that its files do not define: of blocks, a texture and a look, and those of `VolumeVariant`."""
COMPONENT = ("scalar_at", "here")
"""Names of a volume of components that its LIC volume uses."""
CHAINED = {
    "face": "ray",
    "begin": "position, brick",
    "take": "mixed, next, k, at, middle, length, both",
    "slope": "volume, offset",
}
"""Functions that call those of the volumes before, with their parameters."""


@dataclass(frozen=True)
class VolumeVariant:
    """Constants and files of a volume.

    Attributes
    ----------
    filter : reconstruction filter
    slot : layout of the volume's samples in a brick of the domain
    further_starts : that of its segments
    lights : number of lights; 0: it is not lit
    caps : number of planes that cut it, including its own faces, if it is lit
    near : some lights have a place
    smooth : its gradients are those of cubic B-splines
    fading, table : as in `Variant`
    surfaces : number of isosurfaces
    in_volume : the volume itself is drawn, too
    preintegrated : its slabs are classified between their ends, not at their midpoints
    look : as in `Variant`
    occlusion : as in `Variant`
    of_lines : as in `BlendMode`
    """

    filter: Filter
    slot: Slot
    further_starts: int
    lights: int = 0
    caps: int = 0
    near: bool = False
    smooth: bool = False
    fading: int = 0
    table: Table = ""
    surfaces: int = 0
    in_volume: bool = True
    preintegrated: bool = False
    look: Look | None = None
    occlusion: int = 0
    of_lines: bool = False

    @property
    def rows(self) -> dict[str, int]:
        """Number of rows of its lighting, grading and isosurfaces, in the order of `rows_of`."""
        found = {"lighting": 7 + self.light_rows * self.lights + 2 * self.caps + self.occlusion} if self.lights else {}
        if self.fading or self.table or self.look:
            found["grading"] = 4 + self.fading + LOOK_ROWS * bool(self.look)
        return found | ({"surface": 2 * self.surfaces} if self.surfaces else {})

    @property
    def is_graded(self) -> bool:
        """Whether samples need the gradient."""
        return bool(self.lights or self.fading or self.table or (self.look and self.look.uses_gradient))

    @property
    def light_rows(self) -> int:
        """Rows for each light."""
        return 5 if self.near else 2

    @property
    def further_iterations(self) -> int:
        """Most iterations of loops in a slab beyond those of one sample, except those of surfaces that are hit."""
        return 2 * self.further_starts.bit_length() * self.preintegrated + self.surfaces

    def files(self, graded: bool, on_cpu: bool) -> dict[str, tuple[str, ...]]:
        """Return the files that sample and light the volume, by what they do: those that it shares with a lone one.

        Parameters
        ----------
        graded : samples need the gradient
        """
        gradient = gradient_file(self.filter, self.smooth) if graded else "gradient_none.glsl"
        lit = "lights.glsl", *light_files(self.near, bool(self.occlusion), self.of_lines)
        return {
            "VOXEL": voxel_files(self.slot, on_cpu),
            "SPLINE": ("spline.glsl",) if "cubic" in self.filter + gradient else (),
            "SCALAR": (field_file(self.filter, on_cpu),),
            "GRADIENT": (gradient,),
            "MAGNITUDE": ("magnitude.glsl",) if self.fading or self.table else (),
            "FADE": ("faded.glsl" if self.fading else "unfaded.glsl",),
            "LIGHT": lit if self.lights else ("unlit.glsl",),
            "CELL": cell_files(self.filter) if self.surfaces else (),
        }

    def parts(self, number: int, crossing: bool, on_cpu: bool, pieces: int) -> tuple[str, ...]:
        """Return the files that sample the volume, between the definitions of its macros.

        Parameters
        ----------
        number : number of the volume
        crossing : as in `Variant`
        pieces : as in `Lanes`
        """
        macros, chain = self._macros(number) | (self._sizes_on_cpu(number) if on_cpu else {}), chain_of(number)
        of = self.files(crossing or (self.is_graded and not self.of_lines), on_cpu)
        source = "table.glsl" if self.table else "look.glsl" if self.look else "classified.glsl"
        classified: tuple[str, ...] = ("segment.glsl", source, "absorbing.glsl")
        if pieces:
            macros |= {"PIECES": str(pieces), "PIECES_BEFORE": str(number), "FITTED": "true"}
            classified = ("segment.glsl", "pieces.glsl", "classified_pieces.glsl", "absorbing.glsl")
        absorbing = ("ramp.glsl", "ramp_slab.glsl", "absorbing_ramp.glsl") if self.preintegrated else classified
        met = (*of["CELL"], "root.glsl", "met.glsl") if self.surfaces else ("met_none.glsl",)
        if self.of_lines:
            parts = {f"{name}_{axis}": f"{name}_{number - 3 + n}" for n, axis in enumerate("xyz") for name in COMPONENT}
            macros |= parts
            absorbing = define({"gradient_at": f"vector_at_{number}"}), "vector.glsl", *absorbing
        density = density_files(self.preintegrated) if self.occlusion else ()
        slope = of["GRADIENT"]
        if self.slot.has_levels:
            own = define({"gradient_at": f"level_gradient_{number}"})
            slope = own, *slope, define({"gradient_at": f"gradient_at_{number}"}), "level_gradient.glsl"
        levels = "levels.glsl" if self.slot.has_levels else "levels_none.glsl"
        files = ("transfer.glsl", levels, *of["VOXEL"], *of["SPLINE"], *of["SCALAR"], *slope, *of["LIGHT"])
        files = (*files, *of["MAGNITUDE"], *of["FADE"], "volume_layer.glsl", *absorbing, *density, *met)
        names = {*defined_names(*(file for file in files if "\n" not in file)), *GIVEN} - {
            f"{name}_all" for name in CHAINED
        }
        macros = {name: f"{name}_{number}" for name in sorted(names)} | macros
        begin = define(macros | chain) + "ivec3 brick_begin; // the first cell that is stored of the run's brick\n"
        return begin, *files, undefine([*macros, *(name for name in chain if "_before" in name)])

    def _macros(self, number: int) -> dict[str, str]:
        z, y, x = self.slot.cells_zyx
        frame = f"volume[{number}]"
        of_level = {"TO_LEVEL": "to_level", "FROM_LEVEL": "from_level"}
        of_level |= {"RAY_STRIDE": "ray_stride", "last_cell": "last_of_level"}
        levels = {name: f"{of}_{number}" for name, of in of_level.items()}
        return {
            "frame": frame,
            "scalar": f"{frame}.scalar",
            "buckets": f"{frame}.buckets",
            "last_cell": f"(ivec3({frame}.last.xyz) - 1)",
            "NUMBER": str(number),
            "FIRST_BUCKET": str(BUCKETS * number),
            "FURTHER_STARTS": str(self.further_starts),
            "SLOT_CELLS": f"ivec3({x}, {y}, {z})",
            "MARGIN": str(self.slot.margin),
            # Beyond the cells, which include the reach of slabs, and one sample more for gradients.
            "REACH": str(self.slot.margin - 1 if self.occlusion else 0),
            "ROW_WORDS": str(self.slot.row_words),
            "SLICE_WORDS": str(self.slot.slice_words),
            "MAY_BE_INVALID": str(self.slot.kind == "f32").lower(),
            "LIGHTS": str(self.lights),
            "CAPS": str(self.caps),
            "LIGHT_ROWS": str(self.light_rows),
            "OCCLUSION_PLANES": str(self.occlusion - OCCLUSION_ROWS),
            "FADING_PIECES": str(self.fading),
            "TABLE_BINDING": str(TABLES_BINDING + number),
            "TABLE_HAS_COLOUR": str(self.table == "colour and opacity").lower(),
            "SURFACES": str(self.surfaces),
            "IN_VOLUME": str(self.in_volume).lower(),
            "IN_ORDER": "false",  # the order of absorption in a slab is ignored
            "RAY_STRIDE": f"stride_{number}",
        } | (levels if self.slot.has_levels else {})

    def _sizes_on_cpu(self, number: int) -> dict[str, str]:
        """Return the macros of a volume's sizes and numbers, which are no constants on CPUs."""
        own = f"sizes[{number + 1}]"
        of_level = {"SLOT_CELLS": "cells", "ROW_WORDS": "row", "SLICE_WORDS": "slice", "FIRST_WORD": "first"}
        levels = {name: f"level_{of}_{number}" for name, of in of_level.items()}
        return (
            {name: f"{own}.{of}" for name, of in COUNTS.items()}
            | {
                "SLOT_CELLS": f"{own}.cells.xyz",
                "REACH": f"({own}.first.y - 1)" if self.occlusion else "0",
                "MARGIN": f"{own}.first.y",
                "FIRST_WORD": f"{own}.first.x",
                "ROW_WORDS": f"{own}.words.x",
                "SLICE_WORDS": f"{own}.words.y",
            }
            | (levels if self.slot.has_levels else {})
        )


def chain_of(number: int) -> dict[str, str]:
    """Return the macros of the chained functions, which stay defined for the next volume, and of those they call."""
    if not number:
        return {f"{name}_all": f"{name}_all_0" for name in CHAINED} | {
            f"{name}_before({given})": "" for name, given in CHAINED.items()
        }
    both = [(f"{name}_all", f"{name}_before") for name in CHAINED]
    return {own: f"{own}_{number}" for own, _ in both} | {before: f"{own}_{number - 1}" for own, before in both}


def define(macros: dict[str, str]) -> str:
    """Return GLSL that defines macros, which may be defined."""
    return undefine(macros) + "".join(f"#define {name} {value}\n" for name, value in macros.items())


def undefine(names: Iterable[str]) -> str:
    """Return GLSL that undefines macros, with parameters or without."""
    return "".join(f"#undef {name.partition('(')[0]}\n" for name in names)


def volume_variants(content: Content, slot: Slot) -> tuple[VolumeVariant, ...]:
    """Return the variant of each volume."""
    return tuple(
        volume_variant(part, own, content.mixed)
        for part, own in zip(content.volume_layers, slot.parts or (slot,), strict=False)
    )


def volume_variant(volume: VolumeLayer, slot: Slot, mixed: bool) -> VolumeVariant:
    """Return the variant of a volume; one that is alone and shows only surfaces has at least one of them."""
    mode, shading, grading = volume.blend_mode, volume.blend_mode.shading, volume.blend_mode.grading
    return VolumeVariant(
        volume.filter,
        slot,
        volume.segments.further_starts,
        lights=len(shading.lights) if shading else 0,
        caps=len(shading.caps) if shading else 0,
        near=bool(shading and shading.has_places),
        smooth=mode.smooth,
        fading=grading.fading if grading else 0,
        table=grading.table_holds if grading else "",
        surfaces=max(len(mode.surfaces), int(mode.traits.only_surfaces and not mixed)),
        in_volume=mode.traits.absorbs,
        preintegrated=volume.preintegrated,
        look=grading.look if grading else None,
        occlusion=len(shading.occlusion) if shading else 0,
        of_lines=mode.of_lines,
    )


def light_files(near: bool, occluded: bool, of_lines: bool = False) -> tuple[str, str, str]:
    """Return the files of lights' places, of ambient light, and of what surfaces or lines reflect."""
    places, ambient = "lights_near.glsl" if near else "lights_far.glsl", "ambient_occlusion.glsl"
    return places, ambient if occluded else "ambient.glsl", "lines.glsl" if of_lines else "phong.glsl"


def density_files(preintegrated: bool) -> tuple[str, ...]:
    """Return the file of the optical depth that ambient occlusion gathers."""
    return ("density_ramp.glsl",) if preintegrated else ("density.glsl",)


def content_files(
    volumes: tuple[VolumeVariant, ...],
    crossing: bool = False,
    pieces: Sequence[int] | None = None,
    geometry: tuple[str, ...] = (),
    cells: tuple[str, ...] = (),
) -> tuple[str, ...]:
    """Return the files that sample a slab of several volumes, or of one or none with geometry.

    Parameters
    ----------
    pieces : on CPUs, as `Lanes.volumes`
    geometry : files of geometry, which are the last in the chain
    cells : files of unstructured grids
    """
    on_cpu, pieces = pieces is not None, pieces or [0] * len(volumes)
    looks = [volume.look.glsl(f"_{number}") for number, volume in enumerate(volumes) if volume.look]
    each = [
        part for number, volume in enumerate(volumes) for part in volume.parts(number, crossing, on_cpu, pieces[number])
    ]
    rows = {f"{name}_{number}": n for number, volume in enumerate(volumes) for name, n in volume.rows.items()}
    blocks = [glsl_rows("Rows", 7, rows)] if rows else []
    if on_cpu:
        # Where a block of all would be divided is not known.
        blocks = [glsl_rows(f"Rows{n}", OWN_BINDING + n, {name: MOST_ROWS}) for n, name in enumerate(rows)]
    sums = ("sums.glsl",) if any(volume.preintegrated for volume in volumes) or len(cells) > 1 else ()
    layers: tuple[str, ...] = ("layers_none.glsl",)
    if geometry or any(volume.surfaces for volume in volumes):
        layers = "surface_list.glsl", "layers_fragments.glsl" if geometry else "layers.glsl"
    words = HEADER_WORDS + LEVEL_WORDS * any(volume.slot.has_levels for volume in volumes)
    header = f"const int HEADER_WORDS = {words}; // of a brick, for each volume\n"
    whole = (header, glsl_array("volume", 6, VOLUME, len(volumes))) if volumes else ()
    each += geometry
    rows_of_pieces = ("piece_rows.glsl",) if any(pieces) else ()
    return (
        *whole,
        *blocks,
        *sums,
        *rows_of_pieces,
        "densest.glsl",
        *cells,
        *layers,
        *looks,
        *each,
        "multi_volume.glsl",
    )


def volume_blocks(content: Content, on_cpu: bool = False) -> dict[str, NDArray[Any]]:
    """Return the uniform blocks of all volumes, by name.

    Parameters
    ----------
    on_cpu : of mixed content each volume has blocks of its own, since where one of all would be divided is not known
    """
    if not content.mixed:
        mode = content.volume_layers[0].blend_mode
        parts = {"lights": mode.shading, "grading": mode.grading, "surfaces": mode.surfaces}
        return dict(zip((name for name, part in parts.items() if part), rows_of(mode), strict=True))
    if not content.volume_layers and not on_cpu:
        return {}
    found, rows = {"volume": volumes_block(content)}, [rows_of(part.blend_mode) for part in content.volume_layers]
    each = [one for own in rows for one in own]
    if on_cpu:
        return found | {f"rows{number}": one for number, one in enumerate(each)}
    return found | ({"rows": np.concatenate(each)} if each else {})


def rows_of(blend_mode: BlendMode) -> list[NDArray[np.float32]]:
    """Return the rows of a volume's lighting, grading and isosurfaces, as in `VolumeVariant.rows`: float32 (n, 4)."""
    surfaces = [blend_mode.surface_block()] if blend_mode.surfaces else []
    return [part.block() for part in (blend_mode.shading, blend_mode.grading) if part] + surfaces


def content_tables(content: Content) -> dict[str, NDArray[np.float32]]:
    """Return the 2-D transfer functions, by the names of their textures."""
    gradings = [part.blend_mode.grading for part in content.volume_layers]
    tables = {number: one.table for number, one in enumerate(gradings) if one and one.table is not None}
    return {f"transfer_table_{n}" if content.mixed else "transfer_table": table for n, table in tables.items()}


def volumes_block(content: Content) -> NDArray[np.void]:
    """Return the block of all volumes, `VOLUME` (n,)."""
    blocks, first = np.zeros(len(content.volume_layers), VOLUME), 0
    for block, part in zip(blocks, content.volume_layers, strict=True):
        segments = part.segments
        for name, row in zip("xyz", part.cut.index_from_domain, strict=True):
            block[name] = row
        block["last"][:3] = np.array(part.cut.shape_zyx[::-1]) - 1
        block["scalar"][:2] = part.encoding.scale, part.encoding.bias
        block["buckets"] = segments.low, segments.per_unit, BUCKETS - 1, segments.transparent_below
        block["optics"][0] = part.slab_units
        block["last_segment"], block["base"] = first + len(segments.records) - 1, part.encoding.base
        first += len(segments.records)
    return blocks


def all_segments(plan: Plan) -> tuple[NDArray[np.void], NDArray[Any], NDArray[np.float64] | None]:
    """Return buckets, records and sums; of volumes and grids concatenated, and buckets refer to the joined records.

    Records of several are bytes, since there are two types of one size; sums are None if no volume has any.
    """
    volumes, grids = plan.content.volume_layers, plan.content.cells
    each = [*(part.segments for part in volumes), *(part.segments for part in grids)] or [_nothing()]
    if len(each) == 1:
        return each[0].buckets, each[0].records, each[0].sums
    buckets, sums, first = [], [], 0
    for segments in each:
        own = segments.buckets.copy()
        own["first"] += first
        buckets.append(own)
        count = len(segments.records)
        sums.append(np.zeros((count, SUM_ROWS)) if segments.sums is None else segments.sums)
        first += count
    records = np.concatenate([segments.records.view(np.uint8) for segments in each])
    has_sums = any(segments.sums is not None for segments in each)
    return np.concatenate(buckets), records, np.concatenate(sums) if has_sums else None


@cache
def _nothing() -> Segments:
    """Return what shaders without a transfer function are given."""
    return make_segments(
        TransferFunction(np.zeros(1), np.zeros((1, 3)), np.zeros(1), np.zeros(1), 1.0, (0.0, 1.0)), 1.0
    )
