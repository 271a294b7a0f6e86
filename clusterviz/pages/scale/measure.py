"""Measurement of one rank count: timed frames, messages sent, and the picture.

The frame loop draws as for an animation with a static camera or an orbit. Each frame is timed from a barrier. The first
one, in which data are read and kernels compiled, is not counted. After the timed frames one more is composited with
messages and raw pixels, which the schedule predicts exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, abort_on_failure, agree
from clusterviz.comm.placement import granted_cores
from clusterviz.composite import Compositor
from clusterviz.errors import SceneError
from clusterviz.frame import FrameLoop, Options, Rendered
from clusterviz.frame.work import DrawnFrame
from clusterviz.gl.devices import choose_device, egl_devices, prefers_cpu
from clusterviz.image.partial import bounding_rect
from clusterviz.plan.plan import Plan
from clusterviz.report.statistics import RankFrame
from clusterviz.scene.animation import scenes_along
from clusterviz.scene.values import Scene

Image = NDArray[np.float32]
Write = Callable[[Image, Scene], None]


@dataclass(frozen=True)
class RankResources:
    """Node, cores and GPU of a rank."""

    host: str
    cores: tuple[int, ...]  # numbers of the cores in the affinity mask
    gpu: int | None  # EGL index of the GPU; None for software rendering, or if nothing was drawn


@dataclass(frozen=True)
class Measured:
    """Measurement of one rank count; lists are by rank.

    Attributes
    ----------
    frames : by frame, then rank; `seconds` has the stages of a frame, `total`, and `cpu`, the CPU time of the process
    once : seconds of the stages done once a job, all in the first frame: `plan`, `load` (reading, summarising,
        uploading), `context`, `shaders`
    rects : bounding rectangle of each rank's images, (x_begin, y_begin, x_end, y_end); empty if nothing was drawn
    size, step : width and height of the picture, and the step in voxels
    """

    frames: list[list[RankFrame]]
    once: list[dict[str, float]]
    finish_seconds: float  # seconds of writing the picture
    resources: list[RankResources]  # node, cores and GPU of each rank
    order: list[int]  # ranks from front to back
    rects: list[tuple[int, int, int, int]]
    algorithm: str  # algorithm of the counted frame; "" if ranks had several images or tiles, which are not counted
    counted: list[list[tuple[int, int]]]  # messages and pixels sent in the counted frame, by rank, then round
    size: tuple[int, int]
    step: float
    bytes_per_pixel: int  # bytes of a pixel of partial images
    sharing: str = "sort-last"  # mode of the last frame, `Sharing.way`

    def as_json(self) -> dict[str, Any]:
        """Return the attributes as a dict."""
        return asdict(self)


def measured_from_json(data: dict[str, Any]) -> Measured:
    """Return the measurement of a dict that `as_json` returned."""
    resources = [RankResources(one["host"], tuple(one["cores"]), one["gpu"]) for one in data["resources"]]
    return Measured(
        **data
        | {
            "frames": [[RankFrame(**rank) for rank in frame] for frame in data["frames"]],
            "resources": resources,
            "rects": [tuple(rect) for rect in data["rects"]],
            "counted": [[tuple(sent) for sent in rank] for rank in data["counted"]],
            "size": tuple(data["size"]),
        }
    )


ONCE_STAGES = ("plan", "load", "context", "shaders")


def measure(
    scene: Scene, channel: Channel, frames: int, write: Write, warm_up: int = 1, orbit: float | None = None
) -> Measured:
    """Draw a scene several times; collective.

    `write`: called on rank 0 with the last picture. `orbit`: total angle of the camera in all frames, degrees; None for
    a static camera. Raises SceneError, RankError: on every rank: there is nothing to draw, or a rank failed.
    """
    count, cpu_seconds, rendered = warm_up + frames, list[float](), list[Rendered]()
    with FrameLoop(scene, channel, options=Options(keep_drawn=True, overlap=False)) as loop:
        scenes = scenes_along(loop.scene, count, orbit, None, "orbit") if orbit else [loop.scene] * count
        for number, shown in enumerate(scenes):
            with abort_on_failure(channel, number, "barrier"):
                channel.barrier()
            began = process_time()
            # Pictures of earlier frames are not needed.
            rendered = [replace(before, image=None, drawn=None) for before in rendered]
            rendered.append(loop.frame(shown, number))
            cpu_seconds.append(process_time() - began)
    drawn, picture = rendered[-1].drawn, rendered[-1].image
    if drawn is None or drawn.work.plan is None:
        raise SceneError("nothing to measure", where="volumes", allowed="a scene with a volume")
    algorithm, counted = _count(channel, drawn, drawn.work.plan)
    began = perf_counter()
    with agree(channel, count, "write"):
        if picture is not None:
            write(picture, drawn.work.scene)
    finish_seconds = perf_counter() - began
    with abort_on_failure(channel, count, "send costs"):
        mine = (cpu_seconds, _resources(channel, drawn), counted, _covered_rect(drawn))
        gathered = channel.allgather(mine)
    timed = [
        [_with_cpu(rank, of_rank[0][number]) for rank, of_rank in zip(one.statistics.per_rank, gathered, strict=True)]
        for number, one in enumerate(rendered)
    ]
    return Measured(
        frames=timed[warm_up:],
        once=[{name: rank.seconds.get(name, 0.0) for name in ONCE_STAGES} for rank in timed[0]],
        finish_seconds=finish_seconds,
        resources=[of_rank[1] for of_rank in gathered],
        order=list(dict.fromkeys(drawn.work.order)),
        rects=[of_rank[3] for of_rank in gathered],
        algorithm=algorithm,
        counted=[of_rank[2] for of_rank in gathered],
        size=drawn.work.scene.image.size,
        step=drawn.work.scene.quality.step,
        bytes_per_pixel=4 * np.dtype(np.float32).itemsize,
        sharing=drawn.work.sharing.way if drawn.work.sharing else "sort-last",
    )


def _with_cpu(rank: RankFrame, seconds: float) -> RankFrame:
    return replace(rank, seconds=rank.seconds | {"cpu": seconds})


def _resources(channel: Channel, drawn: DrawnFrame) -> RankResources:
    place, gpu = channel.placement(), None
    if drawn.counts.bricks and not prefers_cpu():
        devices = egl_devices()
        chosen = choose_device(devices, place.local_rank)
        gpu = None if devices[chosen].software else chosen
    return RankResources(place.host, tuple(sorted(granted_cores())), gpu)


def _covered_rect(drawn: DrawnFrame) -> tuple[int, int, int, int]:
    rect = bounding_rect(partial.rect for partial in drawn.partials)
    rect = drawn.work.plan.on_screen(rect) if drawn.work.plan else rect
    return rect.x_begin, rect.y_begin, rect.x_end, rect.y_end


def _count(channel: Channel, drawn: DrawnFrame, plan: Plan) -> tuple[str, list[tuple[int, int]]]:
    """Composite with messages; return the algorithm, and messages and pixels that this rank sends in each round."""
    share, tiled = drawn.work, drawn.work.mode != "sort-last" and len(drawn.partials) > 1
    with abort_on_failure(channel, drawn.number, "count"):
        tiled = bool(channel.maximum(tiled))
    if tiled or len(set(share.order)) < len(share.order):
        return "", []
    with abort_on_failure(channel, drawn.number, "count"):
        algorithm, operator = share.scene.cluster.compositing, plan.blend_mode.operator
        named: dict[str, Any] = {"algorithm": algorithm, "codec": "raw", "transport": "messages", "operator": operator}
        compositor = Compositor(channel, plan.canvas_size, **named)
        _, counters = compositor.composite(drawn.partials, share.order)
        compositor.close()
    return counters.algorithm, [(stage.messages_sent, stage.pixels_sent) for stage in counters.stages]
