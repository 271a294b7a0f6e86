"""One setting on all ranks: the same frame drawn several times, as an animation would draw it, and its picture.

Reading, uploading and compiling are done once, before; what is timed is drawing, reading back, compositing and bringing
the pieces together. The first frame is not counted: drivers and kernels finish compiling in it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel
from clusterviz.composite import compile_kernels
from clusterviz.composite.compositor import Compositor
from clusterviz.errors import SceneError
from clusterviz.frame import Options, Run, Share, prepare
from clusterviz.gl.context import open_context
from clusterviz.image.merge import merge_partials
from clusterviz.image.partial import PartialImage, blank
from clusterviz.plan.plan import Plan
from clusterviz.render.projection import finish_projection
from clusterviz.render.raycast import Raycaster
from clusterviz.report.statistics import peak_memory_bytes
from clusterviz.scene.values import Scene

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Cost:
    """What a frame costs, of all ranks.

    Attributes
    ----------
    render_seconds : drawing on the slowest rank; the median frame
    total_seconds : from a barrier until the picture is whole on rank 0; reading, uploading and writing apart; likewise
    total_seconds_min, total_seconds_max : of the fastest and the slowest frame
    samples : field samples of one frame, all ranks
    voxel_bytes : GPU memory for voxels, all ranks
    peak_memory_bytes : resident size of the largest rank's process, at its largest
    bytes_sent, messages_sent : of compositing one frame, all ranks, the final gather apart
    """

    render_seconds: float
    total_seconds: float
    total_seconds_min: float
    total_seconds_max: float
    samples: int
    voxel_bytes: int
    peak_memory_bytes: int
    bytes_sent: int
    messages_sent: int

    def as_json(self) -> dict[str, Any]:
        """Its attributes by name."""
        return asdict(self)


def cost_from_json(data: dict[str, Any]) -> Cost:
    """The cost that `as_json` gave."""
    return Cost(**{field.name: data[field.name] for field in fields(Cost)})


@dataclass(frozen=True)
class Measured:
    """A setting's cost, and its picture on rank 0.

    Attributes
    ----------
    image : float32 (h, w, 4), premultiplied; None on other ranks
    scene : completed
    renderer : OpenGL's name of what drew; "" where nothing was visible
    """

    cost: Cost
    image: Image | None
    scene: Scene
    renderer: str


@dataclass(frozen=True)
class Frame:
    """One frame on one rank."""

    render_seconds: float
    total_seconds: float
    samples: int
    bytes_sent: int
    messages_sent: int


def measure(scene: Scene, channel: Channel, frames: int, warm_up: int = 1) -> Measured:
    """Draw a scene several times; collective.

    Parameters
    ----------
    scene : with a volume
    frames, warm_up : how many are timed, after how many that are not

    Raises
    ------
    SceneError, RankError
        On every rank: nothing to draw, or a rank failed.
    """
    run = Run(channel, Options())
    share = prepare(run, scene)
    if share.plan is None:
        raise SceneError("nothing to measure", where="volumes", allowed="a scene with a volume")
    caster = _caster(run, share)
    with run.together("kernels", "kernels"):
        compile_kernels(channel)
        compositor = _compositor(run, share)
    drawn = [_frame(run, share, caster, compositor) for _ in range(warm_up + frames)]
    per_rank = channel.allgather([frame for frame, _ in drawn[warm_up:]])
    memory = channel.allgather((caster.voxel_bytes if caster else 0, peak_memory_bytes()))
    names = channel.allgather(caster.renderer if caster else "")
    compositor.close()
    return Measured(_cost(per_rank, memory), drawn[-1][1], share.scene, next(filter(None, names), ""))


def _caster(run: Run, share: Share) -> Raycaster | None:
    """This rank's bricks, ready to be drawn; None where it has none."""
    with run.together("context", "context"):
        place = run.channel.place()
    with run.alone("context", "context"):
        if not share.bricks or share.plan is None or share.tree is None:
            return None
        context = open_context(place.local_rank)
        caster = Raycaster(context, share.plan, share.tree.leaves[run.channel.rank].trimmed)
        caster.load(share.plan, share.bricks)
        return caster


def _compositor(run: Run, share: Share) -> Compositor:
    cluster, size = share.scene.cluster, share.scene.image.size
    return Compositor(
        run.channel, size, algorithm=cluster.compositing, codec=cluster.codec, transport=cluster.transport
    )  # fmt: skip


def _frame(run: Run, share: Share, caster: Raycaster | None, compositor: Compositor) -> tuple[Frame, Image | None]:
    """Draw, composite and collect once, all ranks together from a barrier on."""
    with run.together("barrier", "exchange"):
        run.channel.barrier()
    started = perf_counter()
    partial: PartialImage = blank()
    picture: NDArray[Any] | None
    seconds, samples = 0.0, 0
    with run.alone("render", "render"):
        if caster and share.plan:
            drawn = caster.draw(share.plan)
            partial, seconds, samples = drawn.partial, drawn.seconds_render, drawn.samples
    with run.together("composite", "exchange"):
        if share.plan and share.plan.look.operator != "over":
            picture, sent = _project(run, share, share.plan, partial), (0, 0)
        else:
            picture, counters = compositor.composite(partial, share.order)
            sent = (counters.total.bytes_sent, counters.total.messages_sent)
    spent = perf_counter() - started
    # The picture may lie in memory that the next frame changes.
    kept = None if picture is None else np.array(picture, np.float32)
    return Frame(seconds, spent, samples, *sent), kept


def _project(run: Run, share: Share, plan: Plan, partial: PartialImage) -> Image | None:
    """A picture that is not composited: its parts are merged on rank 0, as `frame` does it."""
    parts = run.channel.gather(partial)
    if parts is None:
        return None
    ordered = (parts[rank] for rank in share.order)
    return finish_projection(plan, merge_partials(ordered, share.scene.image.size, plan.look.operator))


def _cost(per_rank: list[list[Frame]], memory: list[tuple[int, int]]) -> Cost:
    """Times are of the slowest rank in each frame; counts are of the last frame, and the same in each."""
    frames = list(zip(*per_rank, strict=True))
    totals = [max(rank.total_seconds for rank in frame) for frame in frames]
    last = frames[-1]
    return Cost(
        median(max(rank.render_seconds for rank in frame) for frame in frames),
        median(totals),
        min(totals),
        max(totals),
        sum(rank.samples for rank in last),
        sum(voxel_bytes for voxel_bytes, _ in memory),
        max(peak for _, peak in memory),
        sum(rank.bytes_sent for rank in last),
        sum(rank.messages_sent for rank in last),
    )
