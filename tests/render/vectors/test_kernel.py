"""Kernels hold what their scenes need, and nothing else."""

from __future__ import annotations

from typing import Any

from render.scenes import camera_at, noise, prepare, scene_of
from render.test_shading import LIGHTS, LIT, places

from clusterviz.data.grid import Grid
from clusterviz.render.vectors.kernel import kernel_of

SHAPE = (5, 6, 7)
VOXELS = noise(SHAPE, "uint8")


def code_of(lights: Any = (), **look: Any) -> str:
    """The kernel of a scene, as text."""
    scene = scene_of(VOXELS, camera_at("outside", Grid(SHAPE)), look=look, parts={"lights": lights})
    return kernel_of(prepare(scene, VOXELS).plan, 8, None).write()


def test_an_unlit_kernel_holds_no_light_whatever_shines() -> None:
    unlit = code_of(LIGHTS)
    assert unlit == code_of()
    # Nothing but lengths of normals needs roots of float32.
    assert "llvm.sqrt.v8f32" not in unlit
    assert "llvm.sqrt.v8f32" in code_of(**LIT)


def test_lights_without_places_share_a_kernel() -> None:
    lit = code_of(**LIT)
    assert code_of(LIGHTS * 5, **LIT) == lit
    assert len(code_of(places(Grid(SHAPE)), **LIT)) > len(lit)
