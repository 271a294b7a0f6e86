"""Cache of one rank's ray caster from frame to frame: it compiles and loads only for plans that need it.

Programs belong to a variant, stored bricks to an encoding, for OpenGL or for the CPU. Another camera needs nothing new;
another transfer function may need another program, or bricks that were hidden before.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, MutableMapping, Sequence
from dataclasses import asdict
from functools import wraps
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.devices import Device, egl_device, preferred_renderer
from clusterviz.image.partial import blank
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.caster import Caster
from clusterviz.render.choice import check_opengl
from clusterviz.render.cpu.device import cpu_caster
from clusterviz.render.crossing import Crossing, Planes
from clusterviz.render.passes import Passes
from clusterviz.render.render_result import Progress, RenderResult, no_progress
from clusterviz.render.storage import slot_of
from clusterviz.render.stored_brick import Stored

if TYPE_CHECKING:
    import moderngl

Index = tuple[int, int, int]
Method = TypeVar("Method", bound=Callable[..., Any])


def _on_own_context(method: Method) -> Method:
    """Return a method that has the rank's OpenGL context current, if there is one, whatever other code made current."""

    @wraps(method)
    def run(self: RendererCache, *args: Any, **keys: Any) -> Any:
        if self._context is None:
            return method(self, *args, **keys)
        from clusterviz.gl.context import own_context

        with own_context(self._context):
            return method(self, *args, **keys)

    return cast("Method", run)


class RendererCache:
    """A rank's OpenGL context, if it needs one, and the ray caster of its last plan.

    Parameters
    ----------
    limit_bytes : as in `OpenGL`
    """

    def __init__(self, limit_bytes: int | None = None) -> None:
        self._limit_bytes = limit_bytes
        self._context: moderngl.Context | None = None
        self._caster: Caster | None = None
        self._preferred = ""
        self._calls: dict[str, int] = {}
        self._stored: tuple[object, int] = (), 0
        self._levels: dict[Index, tuple[bytes, ...]] = {}

    def missing(self, plan: Plan, wanted: Collection[Index]) -> set[Index]:
        """Return the bricks that have to be loaded, or loaded again, before the plan can be drawn."""
        if self._caster is None or self._stored != _stored_of(plan) or not self._suits(plan):
            return set(wanted)
        held = self._caster.pool.bricks
        return {
            index
            for index in wanted
            if index not in held or self._levels.get(index, ()) != plan.content.levels_around(index)
        }

    def is_compiled(self, plan: Plan) -> bool:
        """Return True if there is a program for the plan."""
        return self._caster is not None and self._suits(plan) and self._caster.can_draw(plan)

    def open(self, plan: Plan, local_rank: int, device: Device) -> None:
        """Choose the ray caster, and make its context unless there is one or none is needed."""
        self._preferred = self._preferred or preferred_renderer(device)
        if self._context is None and not self._prefers_cpu:
            from clusterviz.gl.context import current_context_kept, open_context

            with current_context_kept():
                self._context = open_context(local_rank, egl_device(device))

    @_on_own_context
    def compile(self, plan: Plan) -> None:
        """Compile the program unless the last one suits; bricks that fit the plan's slots stay."""
        if self._caster is not None and not self._suits(plan):
            self._drop()
        if self._caster is None:
            self._caster = self._made(plan)
        elif not self._caster.can_draw(plan):
            self._caster.compile(plan)

    @_on_own_context
    def load(self, plan: Plan, bricks: MutableMapping[Index, Any]) -> None:
        """Upload bricks, removed from the mapping as they are stored; they replace those of the same indices."""
        if self._caster is not None:
            self._caster.drop(bricks)
            self._note(plan, bricks)
            self._caster.load(plan, bricks)

    @_on_own_context
    def put(self, plan: Plan, bricks: MutableMapping[Index, Stored]) -> None:
        """Add bricks that another rank has stored for the same plan."""
        if self._caster is not None:
            self._caster.drop(bricks)
            self._note(plan, bricks)
            self._caster.pool.put(bricks, lambda _, stored: stored)

    @property
    def bricks(self) -> set[Index]:
        """Indices of the stored bricks."""
        return set(self._caster.pool.bricks) if self._caster is not None else set()

    @_on_own_context
    def keep(self, wanted: Collection[Index]) -> None:
        """Drop all other bricks."""
        if self._caster is not None:
            self._caster.drop(self._caster.pool.bricks - set(wanted))

    @_on_own_context
    def drop(self, bricks: Collection[Index]) -> None:
        """Drop bricks."""
        if self._caster is not None:
            self._caster.drop(bricks)

    def forget(self) -> None:
        """Forget what the last frame has found, so that the next one is drawn as a first one."""
        if self._caster is not None:
            self._caster.forget()

    @_on_own_context
    def reserve(self, bricks: int) -> None:
        """Allocate GPU memory for so many bricks in all, at once; what was there is dropped if it is less."""
        if self._caster is not None:
            self._caster.pool.reserve(bricks)

    @_on_own_context
    def stored(self, bricks: Collection[Index]) -> dict[Index, Stored]:
        """Read bricks back."""
        return {} if self._caster is None else dict(self._caster.pool.stored(bricks))

    @_on_own_context
    def draw(
        self,
        plan: Plan,
        pieces: Iterable[Piece],
        progress: Progress = no_progress,
        passes: Passes | None = None,
        pixel: str = "float32",
    ) -> list[RenderResult]:
        """Draw this rank's pieces of a frame; they are blank if it never had a brick. See `Caster.draw`.

        Partial images have the format `pixel` only if nothing but compositing is done with them.
        """
        if self._caster is None:
            return [RenderResult(blank()) for _ in pieces]
        caster, before = self._caster, self._counts
        if plan.spectrum or plan.lens:
            from clusterviz.render.tall_picture import draw_tall_picture

            drawn = draw_tall_picture(caster.draw, plan, pieces, progress, passes)
        else:
            kept = plan.layers or plan.refraction or plan.march.frame_coherence is not None
            drawn = caster.draw(plan, pieces, progress, passes=passes, pixel="float32" if kept else pixel)
        self._calls = {name: count - before.get(name, 0) for name, count in self._counts.items()}
        return drawn

    @_on_own_context
    def find_layers(
        self,
        plan: Plan,
        pieces: Sequence[Piece],
        fronts: Sequence[NDArray[np.float32]],
        passes: Passes | None = None,
    ) -> list[Planes]:
        """Find where the opacity of pixels passes one half, in pieces that have been drawn.

        Parameters
        ----------
        plan, pieces : as drawn
        fronts : float32 (rows, columns), the opacity in front of each piece, in its footprint
        passes : as in `draw`

        Returns
        -------
        found : float32 (8, rows, columns) of each piece, see `Crossing.found`
        """
        crossings = [Crossing.behind(front) for front in fronts]
        if self._caster is not None:
            self._caster.draw(plan.crossing, pieces, carried=crossings, passes=passes)
        return [one.found for one in crossings]

    @property
    def held(self) -> dict[str, Any]:
        """Return what `RankFrame` says of the renderer and of its bricks."""
        if self._caster is None:
            return {}
        pool = self._caster.pool
        counted = {"bricks": len(pool.bricks), "voxels": pool.voxels, "voxel_bytes": pool.bytes}
        device = self._caster.device
        named = {"renderer": device.renderer, "driver": device.driver, "calls": self._calls}
        return {**named, "choices": {"renderer": self._preferred, **device.choices}, **counted}

    @_on_own_context
    def release(self) -> None:
        """Free all resources."""
        self._drop()
        if self._context is not None:
            self._context.release()
            self._context = None

    @property
    def _counts(self) -> dict[str, int]:
        """Calls of OpenGL so far; empty on a CPU."""
        counts = self._caster.counts if self._caster else None
        return asdict(counts) if counts else {}

    @property
    def _prefers_cpu(self) -> bool:
        return self._preferred.startswith("CPU")

    def _made(self, plan: Plan) -> Caster:
        if self._prefers_cpu:
            return cpu_caster(plan)
        check_opengl(plan)
        if self._context is None:
            raise ValueError("there is no context yet")
        from clusterviz.render.opengl import opengl_caster

        return opengl_caster(self._context, plan, limit_bytes=self._limit_bytes)

    def _note(self, plan: Plan, bricks: Iterable[Index]) -> None:
        """Note how bricks are stored."""
        self._stored = _stored_of(plan)
        if any(part.levels for part in plan.content.volume_layers):
            self._levels |= {index: plan.content.levels_around(index) for index in bricks}

    def _suits(self, plan: Plan) -> bool:
        """Return True if the caster's bricks suit the plan."""
        return self._caster is not None and self._caster.slot == slot_of(plan)

    def _drop(self) -> None:
        if self._caster is not None:
            self._caster.release()
            self._caster = None


def _stored_of(plan: Plan) -> tuple[object, int]:
    """Return the encodings of the stored bricks, and the surfaces' reach."""
    return plan.content.encodings, plan.content.reach
