"""One rank count: the same frame drawn several times on all ranks, what it sent counted, its picture kept.

Reading and planning are done once, as in a movie. What is timed is drawing, reading back, compositing and bringing the
pieces together, from a barrier on. The first frame is not counted: drivers and kernels finish compiling in it. After
the timed frames one more is composited by messages and raw pixels, whatever the scene asks for: it is not timed, and
its messages are those that theory can count.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from time import perf_counter, process_time
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, abort_on_failure, agree
from clusterviz.comm.place import granted_cores
from clusterviz.composite import CompositeCounters, Compositor, compile_kernels
from clusterviz.errors import SceneError
from clusterviz.frame import Options, Run, prepare
from clusterviz.frame.share import Share
from clusterviz.gl.devices import choose_device, egl_devices
from clusterviz.image.partial import PartialImage, blank
from clusterviz.plan.plan import Plan
from clusterviz.render.choice import make_caster, on_processor
from clusterviz.render.projection import finish_projection
from clusterviz.render.raycast import Raycaster
from clusterviz.render.vectors.caster import VectorCaster
from clusterviz.report.statistics import STAGES, Clock, RankFrame, peak_memory_bytes
from clusterviz.scene.values import Scene

Image = NDArray[np.float32]
Write = Callable[[Image, Scene], None]


@dataclass(frozen=True)
class Seat:
    """Where a rank sat, and what it shared.

    Attributes
    ----------
    host : the node's name
    cores : numbers of the cores on which the system let it run
    gpu : EGL index of the GPU that it drew on; None for software, and where it drew nothing
    """

    host: str
    cores: tuple[int, ...]
    gpu: int | None


@dataclass(frozen=True)
class Measured:
    """One rank count; all lists by rank.

    Attributes
    ----------
    frames : by frame, then rank; `seconds` has the stages of a frame, `total`, and `cpu`, the process's CPU time
    once : seconds of what is done once a job: `plan`, `load` (reading, summarising, uploading), `context`, `shaders`
    finish_seconds : writing the picture
    seats : where the ranks sat
    order : the ranks from front to back
    rects : what each rank's image covers: (x_begin, y_begin, x_end, y_end), empty where nothing was drawn
    algorithm : of the counted frame
    counted : of that frame, by rank, then round: messages and pixels sent
    size, step : width and height of the picture, and the step in voxels that was drawn with
    bytes_per_pixel : of partial images
    """

    frames: list[list[RankFrame]]
    once: list[dict[str, float]]
    finish_seconds: float
    seats: list[Seat]
    order: list[int]
    rects: list[tuple[int, int, int, int]]
    algorithm: str
    counted: list[list[tuple[int, int]]]
    size: tuple[int, int]
    step: float
    bytes_per_pixel: int

    def as_json(self) -> dict[str, Any]:
        """Its attributes by name."""
        return asdict(self)


def measured_from_json(data: dict[str, Any]) -> Measured:
    """What `as_json` gave, after a walk through a file."""
    seats = [Seat(seat["host"], tuple(seat["cores"]), seat["gpu"]) for seat in data["seats"]]
    return Measured(
        **data
        | {
            "frames": [[RankFrame(**rank) for rank in frame] for frame in data["frames"]],
            "seats": seats,
            "rects": [tuple(rect) for rect in data["rects"]],
            "counted": [[tuple(sent) for sent in rank] for rank in data["counted"]],
            "size": tuple(data["size"]),
        }
    )


def measure(scene: Scene, channel: Channel, frames: int, write: Write, warm_up: int = 1) -> Measured:
    """Draw a scene several times; collective.

    Parameters
    ----------
    scene : with a volume
    frames, warm_up : how many are timed, after how many that are not
    write : called on rank 0 with the last picture

    Raises
    ------
    SceneError, RankError
        On every rank: nothing to draw, or a rank failed.
    """
    run = Run(channel, Options())
    work, seat = _prepare(run, scene)
    drawn = [_frame(work) for _ in range(warm_up + frames)]
    _, partials, picture = drawn[-1]
    algorithm, counted = _count(work, partials)
    with run.alone("write", "finish"):
        if picture is not None:
            write(picture, work.share.scene)
    # The coherent distribution: one image a rank, or none.
    seconds, partial = run.clock.seconds, partials[0] if partials else blank()
    rect = partial.rect
    sides = (rect.x_begin, rect.y_begin, rect.x_end, rect.y_end)
    every = channel.allgather(([frame for frame, _, _ in drawn[warm_up:]], seconds, seat, counted, sides))
    work.compositor.close()
    return Measured(
        frames=[list(frame) for frame in zip(*(rank[0] for rank in every), strict=True)],
        once=[{name: rank[1].get(name, 0.0) for name in ("plan", "load", "context", "shaders")} for rank in every],
        finish_seconds=every[0][1]["finish"],
        seats=[rank[2] for rank in every],
        order=work.share.order,
        rects=[rank[4] for rank in every],
        algorithm=algorithm,
        counted=[rank[3] for rank in every],
        size=work.share.scene.image.size,
        step=work.share.scene.quality.step,
        bytes_per_pixel=4 * partial.rgba.dtype.itemsize,
    )


@dataclass(frozen=True)
class Work:
    """What lasts from frame to frame on one rank.

    Attributes
    ----------
    held : its bricks and voxels, counted
    caster : None on a rank without bricks
    """

    channel: Channel
    share: Share
    plan: Plan
    held: RankFrame
    caster: Raycaster | VectorCaster | None
    compositor: Compositor


def _prepare(run: Run, scene: Scene) -> tuple[Work, Seat]:
    """Read, plan, and bring this rank's bricks to where they are drawn; one without any starts no OpenGL."""
    share, bricks = prepare(run, scene)
    plan = share.plan
    if plan is None:
        raise SceneError("nothing to measure", where="volumes", allowed="a scene with a volume")
    if len(set(share.order)) < len(share.order):
        found = share.scene.cluster.distribution
        raise SceneError("gives a rank several images", where="cluster.distribution", found=found, allowed="coherent")
    held = RankFrame({}, bricks=len(bricks), voxels=sum(voxels.size for voxels in bricks.values()))
    with run.together("context", "context"):
        place = run.channel.place()
    seat, caster = Seat(place.host, tuple(sorted(granted_cores())), None), None
    with run.alone("context", "context"):
        if bricks and not on_processor(plan):
            devices = egl_devices()
            chosen = choose_device(devices, place.local_rank)
            seat = replace(seat, gpu=None if devices[chosen].software else chosen)
    with run.alone("shaders", "shaders"):
        if bricks:
            caster = make_caster(plan, None, place.local_rank)
    with run.alone("upload", "load"):
        if caster:
            caster.load(plan, bricks)
    with run.together("kernels", "kernels"):
        compile_kernels(run.channel)
        cluster = share.scene.cluster
        compositor = _compositor(run.channel, share.scene, plan, cluster.codec, cluster.transport)
    return Work(run.channel, share, plan, held, caster, compositor), seat


def _compositor(channel: Channel, scene: Scene, plan: Plan, codec: str, transport: str) -> Compositor:
    algorithm, operator = scene.cluster.compositing, plan.look.operator
    size = scene.image.size
    return Compositor(channel, size, algorithm=algorithm, codec=codec, transport=transport, operator=operator)


def _frame(work: Work) -> tuple[RankFrame, list[PartialImage], Image | None]:
    """Draw, composite and collect once, all ranks together from a barrier on."""
    channel, clock = work.channel, Clock(dict.fromkeys(STAGES, 0.0))
    with abort_on_failure(channel, 0, "barrier"):
        channel.barrier()
    started, cpu = perf_counter(), process_time()
    with agree(channel, 0, "render"):
        partials, counts = _draw(work, clock)
    with abort_on_failure(channel, 0, "composite"):
        composed, counters = work.compositor.composite(partials, work.share.order)
        counts = _with_counters(counts, clock, counters)
        with clock.stage("finish"):
            picture = None if composed is None else finish_projection(work.plan, cast(Image, composed))
    clock.add("total", perf_counter() - started)
    clock.add("cpu", process_time() - cpu)
    # The picture may lie in memory that the next frame changes.
    kept = None if picture is None else np.array(picture, np.float32)
    return replace(counts, seconds=clock.seconds, peak_memory_bytes=peak_memory_bytes()), partials, kept


def _draw(work: Work, clock: Clock) -> tuple[list[PartialImage], RankFrame]:
    """This rank's partial images."""
    if work.caster is None:
        return [], work.held
    drawn = work.caster.draw(work.plan, work.share.pieces_of(work.channel.rank))
    clock.add("render", sum(each.seconds_render for each in drawn))
    clock.add("readback", sum(each.seconds_readback for each in drawn))
    bricks, samples = sum(each.bricks for each in drawn), sum(each.samples for each in drawn)
    counts = replace(work.held, bricks_drawn=bricks, samples=samples, voxel_bytes=work.caster.voxel_bytes)
    return [each.partial for each in drawn], replace(counts, renderer=work.caster.renderer)


def _with_counters(counts: RankFrame, clock: Clock, counters: CompositeCounters) -> RankFrame:
    """The frame's numbers with those of compositing, and the clock's stages."""
    total = counters.total
    clock.add("encode", total.seconds_encode)
    clock.add("exchange", total.seconds_wait + counters.seconds_agree)
    clock.add("blend", total.seconds_blend)
    clock.add("collect", counters.seconds_collect)
    return replace(
        counts,
        bytes_raw=total.bytes_raw,
        bytes_sent=total.bytes_sent,
        messages_sent=total.messages_sent,
        compositing={**asdict(counters), "seconds": counters.seconds},
    )


def _count(work: Work, partials: list[PartialImage]) -> tuple[str, list[tuple[int, int]]]:
    """The algorithm by messages, and what this rank sends in each round of it."""
    with abort_on_failure(work.channel, 0, "count"):
        compositor = _compositor(work.channel, work.share.scene, work.plan, "raw", "messages")
        _, counters = compositor.composite(partials, work.share.order)
        compositor.close()
    return counters.algorithm, [(stage.messages_sent, stage.pixels_sent) for stage in counters.stages]
