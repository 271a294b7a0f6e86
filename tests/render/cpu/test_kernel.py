"""Kernels hold what their scenes need, and nothing else."""

from __future__ import annotations

from typing import Any

import pytest
from render.scenes import LIGHTS, LIT, WrittenError, camera_at, lights_in, noise, prepare, refuse, scene_of

from clusterviz.data.source import Grid
from clusterviz.render.cpu import program
from clusterviz.render.cpu.kernel import Kernel, kernel_of
from clusterviz.render.cpu.marching import rays
from clusterviz.render.cpu.program import program_of

SHAPE = (5, 6, 7)
VOXELS = noise(SHAPE, "uint8")
EXTRAS: dict[str, tuple[dict[str, Any], Any, str]] = {
    "pre-integrated": ({"classification": "pre-integrated"}, program, "Preintegrated"),
    "jittered": ({"jitter": True}, rays, "shift_of"),
    "adaptive": ({"adaptive": 1 / 64}, program, "Stretch"),
    "isosurfaces": ({"isosurfaces": (100.0,)}, program, "Cut"),
    "isosurfaces alone": ({"blending": "isosurface", "isosurfaces": (100.0,)}, program, "Surfaces"),
    "split": ({"classification": "pre-integrated", "borders": "split"}, program, "SplitMarch"),
    "local maximum": ({"blending": "local-maximum"}, program, "LocalMaximum"),
}


def kernel_with(**keys: Any) -> Kernel:
    """The kernel of a scene."""
    return kernel_of(prepare(scene_of(VOXELS, camera_at("outside", Grid(SHAPE)), **keys), VOXELS).plan, 8, None)


def code_of(lights: Any = (), **look: Any) -> str:
    """The kernel of a scene, as text."""
    return program_of(kernel_with(lights=lights, **look))


def test_an_unlit_kernel_holds_no_light_whatever_shines() -> None:
    unlit = code_of(LIGHTS)
    assert unlit == code_of()
    # Nothing but lengths of gradients needs roots of float32.
    assert "llvm.sqrt.v8f32" not in unlit
    assert "llvm.sqrt.v8f32" in code_of(**LIT)
    assert "llvm.sqrt.v8f32" in code_of(gradient_opacity=((0.0, 0.5), (1.0, 1.0)))


def test_lights_without_places_share_a_kernel() -> None:
    lit = code_of(**LIT)
    assert code_of(LIGHTS * 5, **LIT) == lit
    assert len(code_of(lights_in(Grid(SHAPE)), **LIT)) > len(lit)


@pytest.mark.parametrize("name", EXTRAS)
def test_only_plans_that_need_it_have_it_in_their_kernel(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    keys, module, part = EXTRAS[name]
    monkeypatch.setattr(module, part, refuse)
    plain, special = kernel_with(), kernel_with(**keys)
    assert program_of(plain)
    with pytest.raises(WrittenError):
        program_of(special)
    assert plain.name != special.name
