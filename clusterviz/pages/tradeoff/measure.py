"""Measurement of one setting: the same frame drawn several times on all ranks, and its picture.

Timed are drawing, readback, compositing and the final gather; reading, upload and compilation are done in the first
frame, which is not counted. With frame coherence successive frames must differ: the camera turns half a degree a frame
and ends at the scene's camera, whose picture is compared.
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
    """Cost of a frame on all ranks.

    Attributes
    ----------
    total_seconds : seconds from a barrier until the picture is complete on rank 0, without reading, upload and writing;
        median of the frames
    total_seconds_min, total_seconds_max : the same for the fastest and slowest frame
    bytes_sent, messages_sent : bytes and messages of compositing one frame, all ranks, without the final gather
    """

    render_seconds: float  # seconds of drawing on the slowest rank, median of the frames
    total_seconds: float
    total_seconds_min: float
    total_seconds_max: float
    samples: int  # field samples of one frame, all ranks
    voxel_bytes: int  # memory of the voxels for drawing, all ranks
    peak_memory_bytes: int  # largest peak resident size of a rank
    bytes_sent: int
    messages_sent: int

    def as_json(self) -> dict[str, Any]:
        """Return the attributes as a dict."""
        return asdict(self)


def cost_from_json(data: dict[str, Any]) -> Cost:
    """Return the cost of a dict that `as_json` returned."""
    return Cost(**{field.name: data[field.name] for field in fields(Cost)})


@dataclass(frozen=True)
class Measured:
    """Cost and picture of a setting."""

    cost: Cost
    image: Image | None  # float32 (h, w, 4), premultiplied, on rank 0; None on other ranks
    scene: Scene  # the completed scene
    renderer: str  # name of the renderer, as in OpenGL; "" if nothing was visible


def measure(scene: Scene, channel: Channel, frames: int, warm_up: int = 1) -> Measured:
    """Draw a scene several times; collective.

    `frames`, `warm_up`: numbers of timed frames, and of frames before them, at least one. Raises SceneError, RankError:
    on every rank: there is nothing to draw, or a rank failed.
    """
    if not scene.has_content:
        raise mark_agreed(SceneError("nothing to measure", where="volumes", allowed="a scene that shows something"))
    with FrameLoop(scene, channel) as loop:
        costs = []
        for number, one in enumerate(_along(loop.scene, warm_up + frames)):
            channel.barrier()
            drawn = loop.frame(one, number)
            costs.append(drawn.statistics)
    return Measured(_cost(costs[warm_up:]), drawn.image, drawn.scene, drawn.statistics.renderer)


def _along(scene: Scene, frames: int) -> list[Scene]:
    """Return the scenes of all frames: the same scene, or an approach to its camera with frame coherence."""
    if not scene.quality.frame_coherence:
        return [scene] * frames
    cameras = orbit(scene.camera, TURN * (frames - 1), frames)
    return [scene.model_copy(update={"camera": camera}) for camera in reversed(cameras)]


def _cost(frames: list[FrameStatistics]) -> Cost:
    """Return the cost: times of the slowest rank in each frame, counts of the last frame."""
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
