"""One OpenGL context for all tests, and a way to call one GLSL function: what the tests of gl/ and render/ share."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    import moderngl

# Every rank of a test imports this file: what draws is imported where a test asks for it.
HERE = Path(__file__).parent
Probe = Callable[..., np.ndarray]


@pytest.fixture(scope="session")
def shared_context() -> Iterator[moderngl.Context]:
    from clusterviz.gl.context import open_context

    made = open_context()
    yield made
    made.release()


@pytest.fixture
def context(shared_context: moderngl.Context) -> Iterator[moderngl.Context]:
    """A current context; other tests may have made their own one current."""
    with shared_context:
        yield shared_context


@pytest.fixture
def shaders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the shader folder, with the tests' own shaders in it, that a test may add to."""
    from clusterviz.gl import shader

    folder = tmp_path / "shaders"
    shutil.copytree(shader.shader_folder(), folder)
    for path in HERE.glob("*.glsl"):
        shutil.copy(path, folder)
    monkeypatch.setattr(shader, "shader_folder", lambda: folder)
    return folder


@pytest.fixture
def probe(context: moderngl.Context, shaders: Path) -> Probe:
    """`probe(body, given, functions=…, declarations=…)`: what a GLSL body returns for each x, float32 (n, 4)."""

    from clusterviz.gl import shader
    from clusterviz.gl.context import compile_compute

    def call(body: str, given: np.ndarray, functions: str = "\n", declarations: str = "\n") -> np.ndarray:
        points = np.zeros((len(given), 4), np.float32)
        points[:, : given.reshape(len(given), -1).shape[1]] = given.reshape(len(given), -1)
        slots = {"DECLARATIONS": declarations, "FUNCTIONS": functions, "PROBE": f"vec4 probe(vec4 x) {{\n{body}\n}}\n"}
        program = compile_compute(context, shader.assemble("probe.glsl", slots))
        source, target = context.buffer(points.tobytes()), context.buffer(reserve=points.nbytes)
        source.bind_to_storage_buffer(8)
        target.bind_to_storage_buffer(9)
        program.run(-(-len(points) // 64))
        context.finish()
        found = np.frombuffer(target.read(), np.float32).reshape(-1, 4)
        for made in (source, target, program):
            made.release()
        return found

    return call


def text_of(*names: str) -> str:
    """The shader files of these names, one after another: what a slot takes."""
    from clusterviz.gl import shader

    return "\n".join(shader.shader_file(name).read_text() for name in names) + "\n"
