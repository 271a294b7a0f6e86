"""Measurement of a profile: the pieces of all ranks are drawn in turn by one process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import open_channel
from clusterviz.errors import SceneError
from clusterviz.frame import Options, Run, prepare
from clusterviz.image.merge import merge_partials
from clusterviz.image.partial import Rect
from clusterviz.pages.profile.code import Code, code_of
from clusterviz.partition import Piece, build_tree, leaf_pieces
from clusterviz.plan.plan import Plan
from clusterviz.render.profiling import Maps, PieceProfile, Profiler
from clusterviz.render.render_result import finish_projection
from clusterviz.scene import Scene

Step = Callable[[str], None]
FOOTPRINTS = {"nearest": 1, "linear": 8, "hardware": 8, "cubic": 64, "cubic-hardware": 64}
"""Voxels that a sample reads, by filter; gradients read more."""
Numbers = dict[str, float]


@dataclass(frozen=True)
class RankProfile:
    """Profile of a rank, or of all.

    `maps`: (h, w) of the whole picture: those of `PieceProfile`, and "iterations" and "left_out", slabs behind the
    point where the ray was opaque.
    """

    maps: Maps
    bricks: int
    memory: Numbers  # bricks and blocks that were sampled, their bytes, and bytes fetched by samples

    @property
    def totals(self) -> dict[str, int]:
        """Sums of the maps."""
        return {name: round(float(values.sum(dtype=np.float64))) for name, values in self.maps.items()}


@dataclass(frozen=True)
class Report:
    """Contents of the page."""

    scene: Scene  # completed
    picture: NDArray[np.float32]  # float (h, w, 4), premultiplied
    renderer: str
    clock: str
    block_side: int  # cells; memory is counted in such blocks
    whole: RankProfile
    ranks: dict[int, RankProfile]
    code: Code | None  # None on GPUs


def measure(scene: Scene, ranks: int, on_cpu: bool, step: Step) -> Report:
    """Profile a scene.

    Parameters
    ----------
    ranks : number of ranks among which the bricks are divided
    on_cpu : the CPU draws, else OpenGL
    step : called with what is done next

    Raises
    ------
    SceneError
        There is nothing to draw, or the scene leaves settings to `render`.
    """
    from clusterviz.gl.context import open_context

    step("read")
    work, bricks = prepare(Run(open_channel(), Options("cpu" if on_cpu else None)), scene)
    plan = work.plan
    if plan is not None and plan.spectrum:
        plan = plan.at_wavelength(0)  # the others cost the same
    pieces: tuple[Piece, ...] = ()
    if plan is not None:
        pieces = leaf_pieces(build_tree(plan.cost, ranks), plan.cost, plan.eye_in_bricks(), plan.view.forward)
    if plan is None or not pieces:
        raise SceneError("nothing to draw", where="volumes", allowed="a scene of which something is visible")
    step("compile")
    context = None if on_cpu else open_context()
    profiler = Profiler(plan, bricks, context)
    drawn: list[tuple[int, PieceProfile]] = []
    for piece in pieces:
        step(f"rank {piece.rank}")
        if (found := profiler.profile(piece)) is not None:
            drawn.append((piece.rank, found))
    if not drawn:
        raise SceneError("nothing to draw", where="camera", allowed="a camera that sees the volume")
    renderer, voxel_bytes = profiler.renderer, profiler.voxel_bytes
    profiler.release()
    if context is not None:
        context.release()
    merged = merge_partials([each.result.partial for _, each in drawn], plan.view.size, plan.blend_mode.operator)
    profiles = {rank: _joined(plan, [each], voxel_bytes) for rank, each in sorted(drawn, key=lambda one: one[0])}
    each = [profile for _, profile in drawn]
    return Report(
        work.scene,
        finish_projection(plan, merged.astype(np.float32)),
        renderer,
        each[0].clock,
        each[0].block_side,
        _joined(plan, each, voxel_bytes),
        profiles,
        code_of([profile.code for profile in each if profile.code]),
    )


def _joined(plan: Plan, pieces: list[PieceProfile], voxel_bytes: int) -> RankProfile:
    whole = Rect(0, 0, *plan.view.size)
    maps: Maps = {}
    for piece in pieces:
        for name, values in piece.maps.items():
            kind = np.float64 if values.dtype.kind == "f" else np.int64
            into = maps.setdefault(name, np.zeros((whole.height, whole.width), kind))
            into[piece.rect.y_begin : piece.rect.y_end, piece.rect.x_begin : piece.rect.x_end] += values
    maps["iterations"] = maps["runs"] + maps["gaps"]
    maps["left_out"] = maps["slabs"] - maps["covered"] - maps["skipped"]
    side, sampled = pieces[0].block_side, np.logical_or.reduce([piece.sampled for piece in pieces])
    count, cell_bytes = int(sampled.sum()), side**3 * voxel_bytes
    corners = np.argwhere(sampled) * side // plan.layout.brick
    fetched = int(maps["samples"].sum()) * FOOTPRINTS[plan.filter] * voxel_bytes
    memory = {
        "bricks_sampled": len(np.unique(corners, axis=0)),
        "blocks_sampled": count,
        "bytes_sampled": count * cell_bytes,
        "bytes_fetched": fetched,
        "times_fetched": fetched / max(1, count * cell_bytes),
    }
    return RankProfile(maps, sum(piece.result.bricks for piece in pieces), memory)
