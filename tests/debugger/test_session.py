"""Session of the debugger: steps, breakpoints, the call stack, what pixels do, and watches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from data.grid_writers import vtu

from clusterviz.data import open_scene
from clusterviz.debugger.draws import Frame, by_interpreter, look
from clusterviz.debugger.session import Session, State
from clusterviz.errors import InputError
from clusterviz.gl.shader import shader_file
from clusterviz.scene import scene_of_data
from clusterviz.spmd.interpreter import Dispatch, Interpreter
from clusterviz.spmd.probe import Shader, taken_by
from clusterviz.spmd.source import ShaderSource

KEYS = ["image.size=[12,10]", "cluster.brick=8", "quality.step=2", "camera.view_angle=40", "volumes.0.opacity=0.3"]
SCENE = scene_of_data("field:marschner-lobb:16", KEYS)
CENTRE = (6, 5)


def line_of(file: str, text: str) -> str:
    """FILE:LINE of the first line of a shader that begins with a text."""
    lines = shader_file(file).read_text().splitlines()
    return f"{file}:{next(n for n, line in enumerate(lines, 1) if line.strip().startswith(text))}"


RUN = line_of("march.glsl", "take_run(batch")


@pytest.fixture(scope="module")
def frame() -> Frame:
    return Frame.of(SCENE, 2)


@pytest.fixture
def session(frame: Frame) -> Session:
    found = Session(frame.draws(0))
    found.focus = CENTRE
    return found


def test_steps_go_into_over_and_out_of_calls(session: Session) -> None:
    assert [level.function for level in session.stack] == ["main"]
    session.go_to(RUN)
    assert [level.function for level in session.stack] == ["main", "go_on", "march"]
    session.step()
    while session.stack[-1].function != "take_run":  # calls in its arguments come before
        session.out()
    assert session.stack[2].line == int(RUN.rpartition(":")[2])
    session.out()
    assert session.stack[-1].function == "march"
    session.out()
    session.over()
    assert session.stack[-1].function in ("go_on", "main")


def test_pixels_are_active_passive_or_ended(session: Session) -> None:
    assert session.states[CENTRE[::-1]] == State.ACTIVE
    assert State.ENDED not in session.states
    session.go_to(RUN)
    states = session.states
    assert states[CENTRE[::-1]] == State.ACTIVE
    assert {State.ACTIVE, State.ENDED} <= set(np.unique(states)) <= set(State)
    session.go()
    assert session.place is None
    assert set(np.unique(session.states)) <= {State.NOT_DRAWN, State.ENDED}
    with pytest.raises(InputError, match="the draw has ended"):
        session.watch("k")


def test_breakpoints_have_conditions_and_visits(session: Session) -> None:
    condition = session.stop_at(RUN, "k > 0")
    visits = session.stop_at(RUN, "", 3)
    session.focus = None
    session.go()
    assert condition.hit.any()
    assert not visits.hit.any()
    session.breakpoints.remove(condition)
    session.go()
    assert visits.hit.any()
    assert session.stack[-1].iterations == (2,)
    assert session.watch("k").values.max() > 0


def test_watches_are_pictures_histograms_and_differences(session: Session) -> None:
    session.focus = None
    session.go_to(RUN)
    first = session.watch("k")
    assert first.type == "int"
    assert first.at(*CENTRE) == {"": first.values[CENTRE[1], CENTRE[0], 0]}
    session.over()
    session.go_to(RUN)
    later = session.watch("k")
    assert (later.minus(first).values[later.reached] > 0).all()
    (counts,) = later.histogram(4)
    assert sum(counts["counts"]) == later.reached.sum()
    picture = later.picture((0.0, 10.0), "gray")
    assert (picture[..., 3] == later.reached).all()
    assert np.allclose(picture[later.reached][:, 0], np.clip(later.values[later.reached, 0] / 10, 0, 1), atol=1e-6)
    batch = session.watch("batch")
    assert np.array_equal(batch.picture()[batch.reached], batch.values[batch.reached].astype(np.float32))
    with pytest.raises(InputError, match=r"neither a number nor a colour; found Place; allowed place\.brick"):
        session.watch("place").picture()


def test_probes_look_into_the_shaders_of_grids(tmp_path: Path) -> None:
    scene = open_scene(vtu(tmp_path / "a.vtu"), ["image.size=[12,10]", "array=f"])

    def probes(shader: Shader) -> list[object]:
        return [shader.probe(line_of("cell_segment.glsl", "known[g] = back"), ("front.s", "back.s"))]

    (front, back), *_ = look(Frame.of(scene, 1).draws(0), probes, by_interpreter)  # type: ignore[arg-type]
    assert front.reached.sum() > 10
    some = back.values[back.reached]
    assert (some >= 0).all()
    assert (some <= 1).all()
    assert np.ptp(some) > 0.1


def test_ranks_that_share_a_pixel_differ(frame: Frame) -> None:
    def probes(shader: Shader) -> list[object]:
        return [shader.probe(RUN, ("k", "sum"))]

    (first,), (second,) = (look(frame.draws(rank), probes, by_interpreter) for rank in (0, 1))  # type: ignore[arg-type]
    differences = first[0].minus(second[0])
    assert differences.reached.any()
    assert np.abs(differences.values[differences.reached]).max() > 0
    with pytest.raises(InputError, match="the rank draws nothing; found 2; allowed 0, 1"):
        next(frame.draws(2))


MISTAKES = {
    ("b", "marhc.glsl:3", ""): "no code of this scene's shader; found marhc.glsl; allowed adaptive",
    ("b", "march.glsl", ""): "not a place in a shader; found march.glsl; allowed FILE:LINE",
    ("b", "march.glsl:1", ""): "--break march.glsl: no statement begins in this line; found 1; allowed ",
    ("b", RUN, "k > "): "--if:1:5: expected an expression; found the end",
    ("b", RUN, "k + 1"): "--if: the condition has another type; found int; allowed bool",
    ("w", RUN, "summ"): "watch:1:1: summ is not declared; allowed ",
    ("w", RUN, "place + batch"): "watch:1:7: operator + has no such operands; found Place and vec4",
    ("w", RUN, "k++"): "watch:1:1: an assignment",
    ("w", RUN, "is_done(sum)"): "watch:1:1: is_done is not declared, or outside of the subset",
    ("w", RUN, "k k"): "watch:1:3: expected the end of the expression; found k",
}


@pytest.mark.cover
@pytest.mark.parametrize(("given", "message"), MISTAKES.items(), ids=map(str, MISTAKES.values()))
def test_a_mistake_is_one_message(session: Session, given: tuple[str, str, str], message: str) -> None:
    command, where, text = given
    if command == "w":
        session.go_to(where)
    with pytest.raises(InputError) as error:
        session.watch(text) if command == "w" else session.stop_at(where, text)
    assert str(error.value).replace("--break: ", "").startswith(message.split("adaptive")[0])


SHADER = """layout(local_size_x = 4) in;
layout(std430, binding = 0) buffer FoundBlock { int found[]; };
int of(int n) { return n + 1; }
void main() {
  int lane = int(gl_LocalInvocationIndex), sum = 0;
  for (int k = 0; k < lane; ++k)
    sum += of(k);
  if (lane > 2) sum = 0; else
    sum *= 2;
  found[lane + 2] = sum;
}
"""


def shader() -> tuple[Shader, Interpreter, Dispatch]:
    found = Shader(ShaderSource(SHADER, ("a.glsl",)))
    dispatch = Dispatch(found.source, (1, 1, 1), {}, {0: np.zeros(16, np.uint8)})
    return found, Interpreter(found.program, dispatch), dispatch


def test_an_access_outside_of_a_buffer_is_noted() -> None:
    found, interpreter, dispatch = shader()
    interpreter.finish()
    assert [(found.where(at), fault) for at, fault in interpreter.faults.items()] == [(("a.glsl", 10), (2, 4))]
    assert dispatch.buffers[0].view(np.int32).tolist()[2] == 0


@pytest.mark.parametrize(
    ("line", "watch", "visit", "reached", "values"),
    [
        (6, "k", 3, [2, 3], [2, 2]),
        (7, "sum", 2, [2, 3], [1, 1]),
        (3, "n", 2, [2, 3], [1, 1]),
        (9, "sum", 1, [0, 1, 2], [0, 1, 3]),
    ],
    ids=["condition of a loop", "body without braces", "call", "else without braces"],
)
def test_a_probe_looks_where_it_should(
    line: int, watch: str, visit: int, reached: list[int], values: list[int]
) -> None:
    found, interpreter, _ = shader()
    probe = found.probe(f"a.glsl:{line}", (watch,), "", visit)
    (taken,) = taken_by(interpreter, [probe])
    assert (np.flatnonzero(taken.reached).tolist(), taken.values[0][taken.reached].tolist()) == (reached, values)
    # The instrumented text is a shader with the same statements and a call more.
    again = Shader(found.instrumented([probe], 1))
    lines = {again.where(each.at)[1] for each in again.places if again.where(each.at)[0] == "a.glsl"}
    assert lines == {found.where(each.at)[1] for each in found.places}
