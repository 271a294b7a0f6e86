"""Variants of the ray caster's shader, by name: every file of `shaders/` is in one of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from itertools import product
from typing import Any

from clusterviz.plan.content import Filter
from clusterviz.render.storage import Slot
from clusterviz.render.variant import Lanes, Variant
from clusterviz.render.volume_layers import VolumeVariant
from clusterviz.scene.blend_modes import BLEND_MODES, Blending
from clusterviz.spmd.look_checks import make_look

LOOKS = {
    "loops": make_look(
        "struct A { int n; vec3 c; };\nconst float F = 0.5;\n"
        "void grow(out A a, float x) { a.n = int(x); a.c[1] = x; }\n"
        "vec4 look(float value, vec3 gradient, vec3 position) {\n    A a;\n    float w[3];\n    grow(a, value);\n"
        "    for (float x = F; x < length(gradient); x *= 2.0) { w[a.n] += x; while (a.n > 3) a.n /= 2; }\n"
        "    return vec4(a.c, w[a.n]);\n}\n",
        "loops.glsl",
    ),
    "simple": make_look(
        "vec4 look(float value, vec3 gradient, vec3 frame) { return vec4(frame, 1.0); }", "simple.glsl"
    ),
}
KINDS = "u8", "u16", "f32"
CELLS = 15, 16, 33


def alone(
    filter: Filter,
    slot: Slot,
    brick: int,
    further_starts: int,
    block_bytes: int,
    blending: Blending = "composite",
    lights: int = 0,
    planes: int = 0,
    surfaces: int = 0,
    **keys: Any,
) -> Variant:
    """The variant of a volume alone; other keys are its own or those of the program."""
    own = {field.name: keys.pop(field.name) for field in fields(VolumeVariant) if field.name in keys}
    volume = VolumeVariant(filter, slot, further_starts, lights, surfaces=surfaces, **own)
    return Variant(slot, brick, block_bytes, (volume,), blending, planes, **keys)


def _looks() -> Iterator[tuple[str, Variant]]:
    for filter, kind, further, block in product(("linear", "nearest", "hardware"), KINDS, (0, 1, 512), (0, 16384)):
        slot = Slot(CELLS, kind, filter == "hardware")
        yield f"{filter} {kind}, {further} further, {block} bytes", alone(filter, slot, 33, further, block)
    for filter, kind, n, lights in product(("linear", "nearest", "cubic", "hardware"), KINDS, (0, 1, 16), (0, 1, 16)):
        slot = Slot(CELLS, kind, filter == "hardware", 2, min(n, 1), 2)
        for blending in ("composite", "isosurface") if n else ("composite",):
            name = f"{filter} {kind}, {blending}, {n} surfaces, {lights} lights"
            yield name, alone(filter, slot, 33, 0, 16384, blending, lights, 2, n)
    for filter, kind, lights in product(("linear", "cubic-hardware", "hardware"), KINDS, (0, 16)):
        slot = Slot(CELLS, kind, "hardware" in filter, 2, 1, 2)
        for planes, block in ((0, 0), (2, 16384)):
            variant = alone(filter, slot, 33, 1, block, "composite", lights, planes, preintegrated=True)
            yield f"{filter} {kind}, pre-integrated, {planes} planes, {lights} lights", variant
    gradings = (1, ""), (63, ""), (0, "opacity"), (0, "colour and opacity")
    for filter, n, (fading, table) in product(("linear", "nearest", "cubic", "cubic-hardware"), (0, 1), gradings):
        slot, smooth = Slot(CELLS, "u8", "hardware" in filter, 2, n, 2), filter != "nearest"
        look = {"fading": fading, "table": table, "smooth": smooth}
        name = f"{filter}, {n} surfaces, {fading} pieces of gradient opacity, table of {table or 'nothing'}"
        yield name, alone(filter, slot, 33, 0, 16384, "composite", 1, 0, n, near=True, **look)
        if fading and smooth and not n:
            variant = alone(filter, slot, 33, 0, 0, "composite", 0, 0, preintegrated=True, fading=fading)
            yield f"{name}, pre-integrated", variant
    for blending, kind, planes in product(
        [name for name, mode in BLEND_MODES.items() if not mode.only_surfaces], ("u8", "f32"), (0, 16)
    ):
        variant = alone("linear", Slot(CELLS, kind, False), 33, 1, 0, blending, 0, planes)
        yield f"{blending}, {kind}, {planes} planes", variant


def _rays() -> Iterator[tuple[str, Variant]]:
    """Variants of where samples lie, and of several volumes."""
    slot = Slot(CELLS, "u8", False, 2, 1, 2)
    lattices = (*product(("rays", "jittered"), (False, True), (False, True)), ("slices", False, False))
    for lattice, split, coherent in lattices:
        ways = {"lattice": lattice, "split": split, "preintegrated": split, "frame_coherence": coherent}
        yield f"{lattice}, split {split}, coherent {coherent}", alone("linear", slot, 33, 0, 0, **ways)
    adaptive = Slot(CELLS, "u8", False, adaptive=True)
    yield "adaptive step", alone("linear", adaptive, 33, 0, 0)
    for profile, split in product(("counts", "clock"), (False, True)):
        ways = {"split": split, "preintegrated": split, "profile": profile}
        yield f"profile of {profile}, split {split}", alone("linear", slot, 33, 0, 0, **ways)
    for name, ways in (("", {}), (", pre-integrated", {"preintegrated": True}), (", surfaces", {"surfaces": 2})):
        yield f"layers{name}", alone("linear", slot, 33, 0, 0, crossing=True, **ways)
        yield f"occlusion{name}", alone("linear", slot, 33, 0, 0, lights=1, planes=1, occlusion=5, **ways)
    for name, look in LOOKS.items():
        yield f"a user's look: {name}", alone("cubic", slot, 33, 0, 0, lights=1, planes=2, look=look)
    parts = (
        VolumeVariant("linear", slot, 1, lights=2, caps=3),
        VolumeVariant("cubic", slot, 0, preintegrated=True, lights=1, occlusion=5),
        VolumeVariant("nearest", slot, 0, surfaces=2, fading=3, look=LOOKS["loops"]),
        VolumeVariant("linear", slot, 0, surfaces=1, in_volume=False, lights=1, near=True, table="opacity"),
    )
    for name, volumes in (("two volumes", parts[:2]), ("four volumes", parts)):
        whole = Slot(CELLS, "f32", False, parts=tuple(volume.slot for volume in volumes), mixed=True)
        yield name, Variant(whole, 33, 0, volumes, planes=2)
        yield f"{name}, layers", Variant(whole, 33, 0, volumes, planes=2, crossing=True)


def _on_cpu() -> Iterator[tuple[str, Variant]]:
    """Variants that only the compiler for CPUs reads."""
    cpu = Lanes(16, 8, True)
    for filter, kind in product(("linear", "nearest", "cubic"), KINDS):
        yield f"CPU, {filter} {kind}", alone(filter, Slot(CELLS, kind, False, 2, 1, 2), 33, 0, 0, cpu=cpu)
    slot = Slot(CELLS, "u8", False, 2, 1, 2)
    for name, own in (("wide", Lanes(8, wide=True)), ("pitched", Lanes(4, pitched=True)), ("any size", cpu)):
        yield f"CPU, {name}", alone("linear", slot, 0 if name == "any size" else 33, 0, 0, cpu=own)
    for profile in ("counts", "clock"):
        yield f"CPU, profile of {profile}", alone("linear", slot, 33, 0, 0, cpu=cpu, profile=profile)
    yield "CPU, coherent", alone("linear", slot, 33, 0, 0, frame_coherence=True, cpu=cpu)
    volumes = VolumeVariant("linear", slot, 1, lights=2, surfaces=1), VolumeVariant("cubic", slot, 0, table="opacity")
    whole = Slot(CELLS, "f32", False, parts=(slot, slot), mixed=True)
    yield "CPU, two volumes", Variant(whole, 0, 0, volumes, cpu=Lanes(16, volumes=(8, 0)))


VARIANTS = {**dict(_looks()), **dict(_rays())}
CPU_VARIANTS = dict(_on_cpu())
