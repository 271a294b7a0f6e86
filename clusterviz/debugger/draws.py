"""Draws of a scene that can be debugged: the dispatches of one rank, and the pixel of each lane."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import LoopbackChannel
from clusterviz.debugger.watches import Watched
from clusterviz.errors import InputError, SceneError
from clusterviz.frame import Options, Run, prepare
from clusterviz.partition import Piece, build_tree, leaf_pieces
from clusterviz.plan.plan import Plan
from clusterviz.render.frame_block import FRAME
from clusterviz.render.recording import recorded, run_on
from clusterviz.scene.values import Scene
from clusterviz.spmd.interpreter import Dispatch, Interpreter
from clusterviz.spmd.probe import Probe, Shader, Taken, probe_bytes, taken_by, taken_of_words
from clusterviz.spmd.source import ShaderSource

PIXEL = "inside"
"""Variable of `main` in pixels.glsl and find_pixels.glsl with an invocation's pixel, relative to what is drawn."""
PROBE_BINDING = 23
Pixel = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Draw:
    """Dispatch of a scene's draw.

    Attributes
    ----------
    dispatch : with the buffers as they are before
    shader : of the dispatch
    size : (width, height) of the picture
    groups : int (g, 3), the work groups to execute
    pixels : int (lanes, 2), x and y of each lane
    drawn : bool (lanes,), False for lanes beside the picture
    """

    dispatch: Dispatch
    shader: Shader
    size: Pixel
    groups: NDArray[np.int64]
    pixels: NDArray[np.int64]
    drawn: NDArray[np.bool_]

    @classmethod
    def of(cls, dispatch: Dispatch, shader: Shader, size: Pixel) -> Draw:
        """Return the draw of a dispatch; the shader itself says which lanes have which pixels."""
        interpreter = Interpreter(shader.program, dispatch)
        while (statement := interpreter.advance()) is not None:
            place = shader.places.get(statement)
            if place and PIXEL in place.names:
                break
        assert statement is not None, "main has the pixel of an invocation"
        rect = dispatch.uniforms[0].view(FRAME)["rect"][0]
        at = interpreter.value(shader.expression(shader.places[statement], PIXEL, PIXEL))
        inside = np.stack(at, axis=-1).astype(np.int64)
        drawn = (inside < rect[2:]).all(axis=-1)
        return cls(dispatch, shader, size, interpreter.groups, inside + rect[:2], drawn)

    @property
    def finds_fragments(self) -> bool:
        """Whether it finds the fragments of geometry, which a later draw composites."""
        return any(name.endswith("find_pixels.glsl") for name in self.dispatch.source.names)

    def only(self, pixels: Sequence[Pixel]) -> Draw:
        """Return the part of the draw that has some pixels: their work groups."""
        lanes = self.lanes_of(pixels)
        each = len(self.pixels) // len(self.groups)
        numbers = np.unique(np.flatnonzero(lanes) // each)
        kept = (numbers[:, None] * each + np.arange(each)).reshape(-1)
        return replace(self, groups=self.groups[numbers], pixels=self.pixels[kept], drawn=self.drawn[kept])

    def lanes_of(self, pixels: Sequence[Pixel]) -> NDArray[np.bool_]:
        """Return the lanes of some pixels: bool (lanes,)."""
        wanted = np.zeros(len(self.pixels), bool)
        for pixel in pixels:
            wanted |= (self.pixels == pixel).all(axis=-1) & self.drawn
        return wanted

    def started(self) -> Interpreter:
        """Return an execution of the draw, which changes its buffers."""
        return Interpreter(self.shader.program, self.dispatch, self.groups)

    def watched(self, taken: Taken, probe: Probe) -> list[Watched]:
        """Return the watches of a probe, as pictures."""
        found, begin = list[Watched](), 0
        for text, expression in zip(probe.watches, probe.points[0].watches, strict=True):
            values = taken.values[begin : begin + expression.type.parts]
            begin += expression.type.parts
            found.append(
                Watched.of_lanes(text, expression.type, values, taken.reached & self.drawn, self.pixels, self.size)
            )
        return found


@dataclass(frozen=True, eq=False)
class Frame:
    """Planned frame of a scene, with all its bricks."""

    plan: Plan
    pieces: tuple[Piece, ...]
    bricks: dict[Any, Any]

    @classmethod
    def of(cls, scene: Scene, ranks: int, options: Options | None = None) -> Frame:
        """Return the frame of a scene on so many ranks, in this process.

        Raises
        ------
        SceneError
            The scene shows nothing, or settings that only the frame loop can choose.
        """
        share, bricks = prepare(Run(LoopbackChannel(), options or Options()), scene)
        if share.plan is None:
            raise SceneError("nothing to draw", where="scene", allowed="a volume, a mesh, lines or points")
        plan = share.plan
        tree = build_tree(plan.cost, ranks)
        return cls(plan, leaf_pieces(tree, plan.cost, plan.eye_in_bricks(), plan.view.forward), bricks)

    @property
    def clim(self) -> tuple[float, float] | None:
        """Values of the data at which the field's scalars are 0 and 1; None if there is not one volume."""
        return None if self.plan.content.mixed else self.plan.volume.transfer.domain

    def draws(self, rank: int) -> Iterator[Draw]:
        """Yield the draws of a rank; each has to be executed on its own buffers before the next is asked for.

        Raises
        ------
        InputError
            The rank has no brick that can be seen.
        """
        pieces = [piece for piece in self.pieces if piece.rank == rank]
        if not pieces:
            allowed = ", ".join(str(number) for number in sorted(piece.rank for piece in self.pieces))
            raise InputError("the rank draws nothing", where="--rank", found=rank, allowed=allowed)
        shown = {tuple(index) for piece in pieces for index in piece.members(self.plan.cost > 0).tolist()}
        shaders: dict[ShaderSource, Shader] = {}
        for dispatch in recorded(self.plan, {index: self.bricks[index] for index in shown}, pieces):
            source = dispatch.source
            if source not in shaders:
                shaders[source] = Shader(source, self.clim)
            yield Draw.of(dispatch, shaders[source], self.plan.view.size)


Way = Callable[[Draw, Sequence[Probe], Sequence[Pixel]], list[list[Watched]]]
"""Execution of a draw: the watches of each probe. Only the given pixels matter, if there are any."""


def without_finding(draws: Iterable[Draw]) -> Iterator[Draw]:
    """Yield the draws that composite; those that find fragments are executed."""
    for draw in draws:
        if not draw.finds_fragments:
            yield draw
            continue
        interpreter = draw.started()
        while interpreter.advance() is not None:
            pass


def by_interpreter(draw: Draw, probes: Sequence[Probe], pixels: Sequence[Pixel]) -> list[list[Watched]]:
    """Execute a draw with the interpreter; of some pixels, only their work groups."""
    part = draw.only(pixels) if pixels else draw
    taken = taken_by(part.started(), probes, part.lanes_of(pixels) if pixels else None)
    return [part.watched(each, probe) for each, probe in zip(taken, probes, strict=True)]


def by_opengl(context: Any) -> Way:
    """Return the execution by OpenGL with an instrumented shader."""

    def run(draw: Draw, probes: Sequence[Probe], pixels: Sequence[Pixel]) -> list[list[Watched]]:
        if not probes:
            run_on(context, draw.dispatch, PROBE_BINDING, 0)
            return []
        instrumented = replace(draw.dispatch, source=draw.shader.instrumented(probes, PROBE_BINDING))
        words = run_on(context, instrumented, PROBE_BINDING, probe_bytes(probes) * len(draw.pixels))
        return [draw.watched(each, probe) for each, probe in zip(taken_of_words(words, probes), probes, strict=True)]

    return run


def look(
    draws: Iterable[Draw], probes: Callable[[Shader], Sequence[Probe]], way: Way, pixels: Sequence[Pixel] = ()
) -> list[list[Watched]]:
    """Return the watches of probes; of several draws, for each pixel of the first in which it came to the visit.

    Parameters
    ----------
    draws : of one rank
    probes : those of a shader
    pixels : that matter; none: all

    Raises
    ------
    InputError
        No shader has what the probes name.
    """
    found: list[list[Watched]] = []
    missing: InputError | None = None
    for draw in draws:
        try:
            wanted = probes(draw.shader)
        except InputError as error:  # another program may have it: fragments are found by programs of their own
            way(draw, (), pixels)
            missing = error
            continue
        new = way(draw, wanted, pixels)
        if found:
            pairs = zip(found, new, strict=True)
            new = [[old.filled(each) for old, each in zip(*pair, strict=True)] for pair in pairs]
        found = new
    if missing and not found:
        raise missing
    return [[each.only(pixels) for each in one] for one in found] if pixels else found
