"""Shader files and constants of geometry: programs that find fragments, and what the volumes' program adds.

In the volumes' program geometry is the last link of the chain of volumes (`volume_layers.py`), with its own names of
the functions that light it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from clusterviz.content.grid.section import KBuffer
from clusterviz.data.primitives import Kind
from clusterviz.gl.layout import Constant, glsl_array, glsl_constants, glsl_rows
from clusterviz.gl.shader import assemble, defined_names
from clusterviz.plan.blend_mode import Lattice
from clusterviz.plan.geometry import GeometryLayer
from clusterviz.plan.plan import Plan
from clusterviz.plan.shading import Shading
from clusterviz.render.abuffer.fills import EARLY, PASSES, Pass
from clusterviz.render.abuffer.resolves import SMALLEST, is_sorted
from clusterviz.render.abuffer.tiles import CPU_TILE, GEOMETRY_BLOCK, GPU_TILE
from clusterviz.render.cells.table import GRID
from clusterviz.render.frame_block import FRAME_BLOCK
from clusterviz.render.sizes import PACKETS, SIZES
from clusterviz.render.volume_layers import LATTICES, MOST_ROWS, chain_of, define, light_files, undefine
from clusterviz.spmd.source import ShaderSource

MOST_SORTED = 256
"""Fragments of a pixel that a GPU's program sorts: llvmpipe leaves loops after 65535 iterations in total."""
STORES: dict[Pass, str] = {
    "count": "dynamic_count.glsl",
    "fill": "dynamic_fill.glsl",
    "fixed": "fixed.glsl",
    "pages": "pages.glsl",
}


@dataclass(frozen=True)
class GeometryVariant:
    """What the program of the volumes draws of geometry.

    Attributes
    ----------
    lights : rows of the block of lights; 0: nothing is lit
    near : some lights have a place
    kinds : of primitives, in alphabetical order
    size : fragments of a pixel that are sorted at a time; 0: all are stored in order
    discards : what should be hidden is left out
    grids : number of unstructured grids
    kbuffer : brings the faces of the only grid in order; nothing else is drawn
    whole_cells : there is nothing but one grid, whose tetrahedra are not cut where rays go on in another brick
    lit_cells : a grid is lit
    """

    lights: int
    near: bool
    kinds: tuple[Kind, ...]
    size: int
    discards: bool = False
    grids: int = 0
    kbuffer: KBuffer | None = None
    whole_cells: bool = False
    lit_cells: bool = False

    @property
    def files(self) -> tuple[str, ...]:
        """Files that bring the fragments of a pixel in order."""
        resolve = "peeled.glsl" if self.size else "sorted.glsl"
        kept = "hidden.glsl" if self.discards else "all_stored.glsl"
        return (GEOMETRY_BLOCK, "primitives.glsl", "stored.glsl", resolve, "fragments.glsl", kept)

    @property
    def constants(self) -> str:
        """GLSL declarations, in front of all files."""
        own: dict[str, Constant] = {"SIZE": self.size, "GRIDS": self.grids, "WHOLE_CELLS": self.whole_cells}
        return f"#define STORED readonly\n{glsl_constants(own | kind_constants(self.kinds))}"

    def cells(self, on_cpu: bool, planes: int) -> tuple[str, ...]:
        """Return the files of unstructured grids.

        Parameters
        ----------
        planes : of numbers of each pixel, in front of those that are kept of walks
        """
        if not self.grids:
            return ("no_cells.glsl",)
        grid = f"grid[{'own_grid' if self.grids > 1 else 0}]"
        integrate: tuple[str, ...] = ("transfer.glsl", "front_to_back.glsl", "ramp.glsl")
        if self.kbuffer and self.kbuffer.integration == "table":
            integrate = ("integration_table.glsl",)
        macros = {name: f"{name}_of_cells" for name in (*defined_names(*integrate), "is_valid")} | {
            "frame": grid,
            "buckets": f"{grid}.buckets",
            "FIRST_BUCKET": f"{grid}.first_bucket",
            "FURTHER_STARTS": f"{grid}.further_starts",
        }
        # A tetrahedron that is cut has to look as if it were not.
        macros["AS_ONE"] = "0.125LF"
        begin = glsl_array("grid", 4, GRID, self.grids) + "int own_grid = 0;\n"
        begin += "bool is_valid_of_cells(float s) { return true; }\n"
        ramp = (begin + define(macros), *integrate, undefine(macros))
        walk: tuple[str, ...]
        kept = () if planes else ("planes.glsl",)
        walk = "walk.glsl", "run.glsl", *kept, f"const int WALKS_PLANE = {planes};\n", "walks_kept.glsl"
        if on_cpu:
            walk = "walk.glsl", "run.glsl", "walks_whole.glsl"
        if self.kbuffer:
            walk = ("no_cells.glsl",)
        unlit = () if self.lit_cells else ("cells_unlit.glsl",)
        classes = {name: macros[name] for name in ("Class", "class_at", "integrated")}
        segment = (define(classes), "cell_segment.glsl", *walk, *unlit, undefine(classes))
        return (*ramp, "strict_side.glsl", *segment)

    @property
    def whole_rays(self) -> dict[str, str | tuple[str, ...]]:
        """Slots of files with which a k-buffer draws rays from end to end, in place of the march; else empty."""
        if self.kbuffer is None:
            return {}
        k, march = f"const int K = {self.kbuffer.k};\n", {"go_on": "march_on"}
        entries = f"kbuffer_{self.kbuffer.entries}.glsl"
        return {
            "STARTS": (GEOMETRY_BLOCK, "primitives.glsl", "whole_rays.glsl", "unnoted.glsl", "entries.glsl"),
            "RUN": ("sums.glsl", *self.cells(True, 0)),
            "BORDERS": (define(march), "unsplit.glsl", undefine(march), k, "faces.glsl", entries),
        }

    def parts(self, number: int, on_cpu: bool) -> tuple[str, ...]:
        """Return the files behind those of `number` volumes."""
        files: tuple[str, ...] = ("unlit.glsl",)
        if self.lights:
            files = ("lights.glsl", *light_files(self.near, False))
        names = *defined_names(*files), "lighting", "material", "brick_begin", "classified"
        macros = {name: f"{name}_of_geometry" for name in names} | {
            "LIGHTS": "geometry.counts.w",
            "CAPS": "0",
            "LIGHT_ROWS": "5" if self.near else "2",
            "last_cell": "(frame.cells.xyz - 1)",
        }
        chain = chain_of(number)
        begin = define(macros | chain) + "ivec3 brick_begin;\n"
        if self.lights:
            rows = MOST_ROWS if on_cpu else self.lights
            begin = glsl_rows("Lights", 2, {"lighting_of_geometry": rows}) + begin
        else:
            begin += "vec4 material;\n"
        end = undefine([*macros, *(name for name in chain if "_before" in name)])
        cells = ("cells_lit.glsl",) if self.lit_cells else ()
        return (begin, *files, "shaded.glsl", *cells, end)


def kinds_of(plan: Plan) -> tuple[Kind, ...]:
    """Return the kinds of a plan's primitives, in alphabetical order."""
    return tuple(sorted({layer.kind for layer in plan.content.geometry}))


def kind_constants(kinds: tuple[Kind, ...]) -> dict[str, Constant]:
    """Return constants that say which kinds of primitives there are."""
    return {"PRIMITIVES": bool(kinds), "TRIANGLES": "triangle" in kinds, "TUBES": "tube" in kinds}


def lit_layer(plan: Plan) -> Shading | None:
    """Return the shading of the first layer that is lit; the lights of all are the same."""
    return next((layer.shading for layer in plan.content.layers if layer.shading), None)


def geometry_variant(plan: Plan, on_cpu: bool = False) -> GeometryVariant | None:
    """Return what a plan needs; None without geometry and unstructured grids."""
    if not plan.content.layers:
        return None
    shading = lit_layer(plan)
    rows = 0 if shading is None else 7 + shading.light_rows * len(shading.lights)
    near = bool(shading and shading.has_places)
    size, discards = 0 if is_sorted(plan.content) else SMALLEST, plan.march.discard_margin is not None
    kinds, grids, kbuffer = kinds_of(plan), len(plan.content.cells), plan.content.kbuffer
    whole = grids == 1 and not kinds and not plan.content.volume_layers
    return GeometryVariant(
        lights=min(1, rows) if on_cpu else rows,
        near=near,
        kinds=kinds,
        size=size,
        discards=discards,
        grids=grids,
        kbuffer=kbuffer,
        whole_cells=whole,
        lit_cells=any(layer.shading for layer in plan.content.cells),
    )


def find_variants(plan: Plan, lanes: int = 0) -> list[FindVariant]:
    """Return the programs that find a plan's fragments, in the order in which they run; none without any layers."""
    layers = plan.content.layers
    if not layers or plan.content.kbuffer:
        return []
    opaque = {isinstance(layer, GeometryLayer) and layer.opaque for layer in layers}
    common = FindVariant(
        step="count",
        lattice=plan.march.lattice,
        planes=min(1, len(plan.clip)) if lanes else len(plan.clip),
        kinds=kinds_of(plan),
        opaque="all" if opaque == {True} else "some" if True in opaque else "no",
        brick=0 if lanes else plan.layout.brick,
        in_order=is_sorted(plan.content),
        lanes=lanes,
        discards=plan.march.discard_margin is not None,
        grids=bool(plan.content.cells),
    )
    return [replace(common, step=step) for step in PASSES[plan.content.fill]]


@dataclass(frozen=True)
class FindVariant:
    """Program that finds fragments.

    Attributes
    ----------
    step : what is done with them
    lattice, planes : as in `Variant`
    kinds : as in `GeometryVariant`
    opaque : which layers are opaque
    brick : cells along the side of a brick; on a CPU a variable
    in_order : the fragments of a pixel are sorted where they lie
    lanes : of a CPU's vectors; 0 for a GPU
    discards : as in `GeometryVariant`
    grids : there are faces by which rays enter unstructured grids
    most_sorted : fragments of a pixel that a GPU's program sorts, at most; 0: any number
    """

    step: Pass
    lattice: Lattice
    planes: int
    kinds: tuple[Kind, ...]
    opaque: Literal["no", "some", "all"]
    brick: int
    in_order: bool
    lanes: int = 0
    discards: bool = False
    grids: bool = False
    most_sorted: int = MOST_SORTED

    @property
    def name(self) -> str:
        """Name of its function on a CPU."""
        return f"find_{self.step}_{self.lanes}"

    @property
    def source(self) -> ShaderSource:
        """Assembled shader."""
        return assemble("abuffer.glsl", self.slots)

    @property
    def slots(self) -> dict[str, str | tuple[str, ...]]:
        """Files and constants of all shaders that find fragments."""
        width, height = PACKETS[self.lanes] if self.lanes else (0, 0)
        values: dict[str, Constant] = {
            "LIST_TILE": CPU_TILE if self.lanes else GPU_TILE,
            "EARLY": EARLY,
            "PACKET_WIDTH": width,
            "PACKET_HEIGHT": height,
            "SOME_OPAQUE": self.opaque != "no",
            "ALL_OPAQUE": self.opaque == "all",
            "SORTED": self.in_order,
            "ENTRIES": self.grids,
            "MOST_SORTED": 0 if self.lanes else self.most_sorted,
            "MOST_PLANES": MOST_ROWS if self.lanes else self.planes,
        }
        sizes = glsl_constants({"BRICK": self.brick, "PLANES": self.planes})
        if self.lanes:
            sizes = glsl_array("sizes", 9, SIZES, 1) + "int BRICK = sizes[0].cells.w, PLANES = sizes[0].counts.z;\n"
        return {
            "CONSTANTS": f"#define STORED\n{glsl_constants(values | kind_constants(self.kinds))}{sizes}",
            "RAYS": (
                *("reals_double.glsl", FRAME_BLOCK, "vectors_double.glsl", "reals.glsl", "own_box.glsl"),
                *(LATTICES[self.lattice], "numbers.glsl", "ray.glsl"),
            ),
            "CLIP": ("kept.glsl", "clip.glsl" if self.planes else "unclipped.glsl"),
            "GEOMETRY": (GEOMETRY_BLOCK, "strict_side.glsl"),
            "STORE": ("sort.glsl", STORES[self.step]),
            "KEEP": ("hidden.glsl", "discard.glsl") if self.discards else "keep_all.glsl",
            "MAIN": "find_tiles.glsl" if self.lanes else "find_pixels.glsl",
        }
