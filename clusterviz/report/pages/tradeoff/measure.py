"""One setting on all ranks: the same frame drawn several times, as an animation would draw it, and its picture.

Reading, uploading and compiling are done once, before; what is timed is drawing, reading back, compositing and bringing
the pieces together. The first frame is not counted: drivers and kernels finish compiling in it.

Where rays start by the last frame, that must be another one: the camera then turns half a degree a frame, and the last
frame, whose picture counts, is that of the scene.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel
from clusterviz.comm.agree import mark_agreed
from clusterviz.errors import SceneError
from clusterviz.frame import FrameLoop
from clusterviz.report.statistics import FrameStatistics
from clusterviz.scene.animation import orbit
from clusterviz.scene.values import Scene

Image = NDArray[np.float32]
TURN = 0.5  # degrees


@dataclass(frozen=True)
class Cost:
    """What a frame costs, of all ranks.

    Attributes
    ----------
    render_seconds : drawing on the slowest rank; the median frame
    total_seconds : from a barrier until the picture is whole on rank 0; reading, uploading and writing apart; likewise
    total_seconds_min, total_seconds_max : of the fastest and the slowest frame
    samples : field samples of one frame, all ranks
    voxel_bytes : memory in which voxels lie for drawing, all ranks
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


def measure(scene: Scene, channel: Channel, frames: int, warm_up: int = 1) -> Measured:
    """Draw a scene several times; collective.

    Parameters
    ----------
    scene : with a volume
    frames, warm_up : how many are timed, after how many that are not: at least one, which reads, uploads and compiles

    Raises
    ------
    SceneError, RankError
        On every rank: nothing to draw, or a rank failed.
    """
    if not scene.volumes:
        raise mark_agreed(SceneError("nothing to measure", where="volumes", allowed="a scene with a volume"))
    with FrameLoop(scene, channel) as loop:
        costs = []
        for number, one in enumerate(_along(loop.scene, warm_up + frames)):
            channel.barrier()
            drawn = loop.frame(one, number)
            costs.append(drawn.statistics)
    return Measured(_cost(costs[warm_up:]), drawn.image, drawn.scene, drawn.statistics.renderer)


def _along(scene: Scene, frames: int) -> list[Scene]:
    """A completed scene so many times; where one frame tells the next, on the way to its camera."""
    if not scene.quality.leaping:
        return [scene] * frames
    cameras = orbit(scene.camera, TURN * (frames - 1), frames)
    return [scene.model_copy(update={"camera": camera}) for camera in reversed(cameras)]


def _cost(frames: list[FrameStatistics]) -> Cost:
    """Times are of the slowest rank in each frame; counts are of the last frame, and the same in each."""
    totals = [frame.seconds["total"] for frame in frames]
    last = frames[-1].per_rank
    return Cost(
        median(frame.seconds["render"] for frame in frames),
        median(totals),
        min(totals),
        max(totals),
        sum(rank.samples for rank in last),
        sum(rank.voxel_bytes for rank in last),
        max(rank.peak_memory_bytes for rank in last),
        sum(rank.bytes_sent for rank in last),
        sum(rank.messages_sent for rank in last),
    )
