"""Compositor of a sequence of frames: partial images of all ranks in, pictures out.

The compositor keeps shared memory, the plan of the last frame (valid while the footprints do not change) and the
measurements of the automatic codec. `composite` composites one frame by messages only, without the final gather.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from clusterviz.codec import choose_codec
from clusterviz.codec.contract import Pixels
from clusterviz.comm import Channel, as_channel
from clusterviz.comm.agree import agreed_errors, mark_agreed
from clusterviz.comm.window import SharedWindow
from clusterviz.composite import messages
from clusterviz.composite.counters import CompositeCounters, StageCounters
from clusterviz.composite.footprints import Footprints, gather_footprints
from clusterviz.composite.fragment import OwnedPixels
from clusterviz.composite.gather import check_inside, collect
from clusterviz.composite.hierarchical import compose_strip, place_images
from clusterviz.composite.model.choice import Choice, Request, choose
from clusterviz.composite.model.network import Network, default_network
from clusterviz.composite.shared import NodeMemory, StripPlan, blend_strip, plan_strip, share_images
from clusterviz.errors import InputError
from clusterviz.image.merge import Operator
from clusterviz.image.partial import PartialImage, Rect

Images = PartialImage | Pixels | Sequence[PartialImage]


@dataclass(frozen=True, eq=False)
class _FramePlan:
    footprints: Footprints
    window: SharedWindow | None
    choice: Choice
    traffic: messages.MessagePlan | None
    strip: StripPlan | None


class Compositor:
    """Compositor that blends the partial images of all ranks into one picture, frame after frame.

    Methods are collective unless they say otherwise.

    Raises InputError on every rank for an unknown name; a shared transport across nodes.

    Parameters
    ----------
    algorithm, codec, transport : registered name, or "auto", which chooses by the time model
    network : constants of the time model; if None, those that `clusterviz bench network` saved
    root : rank of the channel that receives the picture
    operator : merge operator of `image/merge.py`; all but over need float32 images
    """

    def __init__(
        self,
        channel: Any,
        size: tuple[int, int],
        *,
        algorithm: str = "auto",
        codec: str = "auto",
        transport: str = "auto",
        network: Network | None = None,
        root: int = 0,
        operator: Operator = "over",
    ) -> None:
        self._channel: Channel = as_channel(channel)
        self._size, self._root, self._operator = size, root, operator
        self._nodes = self._channel.nodes()
        # The network file may differ from node to node, and all ranks have to choose the same.
        with agreed_errors():
            mine = network or default_network(len(self._nodes))
        self._network = self._channel.broadcast(mine)
        with agreed_errors():
            choose_codec(codec)
            self._request = Request(algorithm, transport, codec)
        self._pack = messages.packer(codec, self._network, len(self._nodes))
        picture = size[0] * size[1] * 16 if self._channel.rank == root else 0
        self._memory = NodeMemory(self._channel, picture) if self._uses_memory() else None
        self._frame_plan: _FramePlan | None = None
        self._codec, self._has_codecs = codec, False

    def image(self, rect: Rect, dtype: Any) -> Pixels:
        """Return memory for this rank's next partial image, (height, width, 4), which is composited without a copy.

        Not collective. The contents are undefined. The memory is valid until the next `composite` has returned.
        """
        if self._memory:
            return self._memory.image(rect, np.dtype(dtype))
        return np.empty((rect.height, rect.width, 4), dtype)

    def composite(
        self, images: Images, order: Sequence[int], out: Pixels | None = None
    ) -> tuple[Pixels | None, CompositeCounters]:
        """Composite one picture.

        Raises InputError on every rank for images of wrong or different types or shapes or outside of the picture, a
        wrong order, a choice that is not possible for them.

        Parameters
        ----------
        images : this rank's image, or several from front to back; not changed. A bare array covers the picture
        order : channel ranks from front to back, the same on every rank: one entry for each image of each rank
        out : memory for the picture on the root where messages are used, (height, width, 4); allocated if None

        Returns
        -------
        picture : (height, width, 4), premultiplied, of the images' type, on the root; None elsewhere. It may lie in
            shared memory, which the next call changes
        counters : cost on this rank
        """
        owned, counters = self.blend(images, order)
        started = perf_counter()
        packing = messages.CountingPacker(self._pack)
        picture = collect(owned, self._size, self._channel, self._root, out, packing)
        return picture, replace(counters, seconds_collect=perf_counter() - started, bytes_collected=packing.bytes)

    def blend(self, images: Images, order: Sequence[int]) -> tuple[OwnedPixels, CompositeCounters]:
        """Composite without the final gather; arguments and errors as of `composite`.

        Returns the pixels of the picture that this rank owns then, and the cost on this rank.
        """
        mine = as_images(images)
        started = perf_counter()
        if self._memory and len(self._nodes) == 1:
            gathered = share_images(mine, order, self._channel, self._memory, self._operator)
        else:
            gathered = gather_footprints(mine, order, self._channel, operator=self._operator)
        footprints = gathered.in_best_order(self._nodes)
        frame_plan = self._plan(footprints)
        choice = frame_plan.choice
        seconds_agree = perf_counter() - started
        owned, stages = self._run(mine, footprints, frame_plan)
        ran = (choice.algorithm, choice.codec, choice.transport, len(footprints.order))
        return owned, CompositeCounters(*ran, seconds_agree, choice.seconds_predicted, stages)

    def close(self) -> None:
        """Free the shared memory and all pictures in it."""
        if self._memory:
            self._memory.free()

    def _run(
        self, images: Sequence[PartialImage], footprints: Footprints, frame_plan: _FramePlan
    ) -> tuple[OwnedPixels, tuple[StageCounters, ...]]:
        choice, memory = frame_plan.choice, self._memory
        if choice.transport != "shared" and self._codec != "raw" and not self._has_codecs:
            messages.compile_codecs(self._channel)
            self._has_codecs = True
        if frame_plan.traffic:
            own = messages.own_fragments(images, footprints, self._channel.rank)
            return messages.run_messages(own, footprints, frame_plan.traffic, self._channel, self._pack)
        if frame_plan.strip and memory:
            owned, counters = blend_strip(frame_plan.strip, footprints, memory)
            return owned, (counters,)
        assert memory, "only ranks that share memory are given this choice"
        placed = place_images(images, footprints, self._channel, memory)
        return compose_strip(placed, self._nodes, self._channel, memory, choice.algorithm, self._pack)

    def _plan(self, footprints: Footprints) -> _FramePlan:
        """Return the plan of the last frame if the footprints and the shared memory are the same, else a new one."""
        window = self._memory.window if self._memory and len(self._nodes) == 1 else None
        last = self._frame_plan
        if last is None or last.window is not window or last.footprints != footprints:
            self._frame_plan = last = self._make_plan(footprints, window)
        return last

    def _make_plan(self, footprints: Footprints, window: SharedWindow | None) -> _FramePlan:
        with agreed_errors():
            choice = choose(self._request, footprints, self._nodes, self._network)
        traffic = strip = None
        if choice.transport == "messages":
            traffic = messages.plan_messages(footprints, self._channel.rank, choice.algorithm)
        elif choice.transport == "shared" and self._memory:
            check_inside(footprints.canvas, self._size)
            strip = plan_strip(footprints, self._channel, self._memory, self._size, self._root)
        return _FramePlan(footprints, window, choice, traffic, strip)

    def _uses_memory(self) -> bool:
        """Return whether a transport with shared memory may be chosen; the same on every rank."""
        if self._request.transport == "shared" and len(self._nodes) > 1:
            text = "shared memory does not reach across nodes"
            allowed = "messages, hierarchical, auto"
            raise mark_agreed(InputError(text, where="cluster.transport", found="shared", allowed=allowed))
        return self._request.transport != "messages" and any(len(ranks) > 1 for ranks in self._nodes)


def composite(
    images: Images,
    order: Sequence[int],
    channel: Any,
    algorithm: str = "auto",
    codec: str = "auto",
    operator: Operator = "over",
) -> tuple[OwnedPixels, CompositeCounters]:
    """Composite the partial images of all ranks by messages; collective.

    Raises InputError on every rank for an unknown name, images of a wrong type or shape, images of different types.

    Parameters
    ----------
    images : this rank's image, or several from front to back; not changed. A bare array (height, width, 4) covers
        the picture
    order : channel ranks from front to back, the same on every rank: one entry for each image of each rank
    channel : Channel or mpi4py communicator of the ranks
    algorithm, codec : registered name, or "auto"
    operator : merge operator of `image/merge.py`; all but over need float32 images

    Returns
    -------
    owned : pixels of the picture that this rank owns now; `collect` gathers those of all ranks
    counters : cost on this rank
    """
    compositor = Compositor(channel, (0, 0), algorithm=algorithm, codec=codec, transport="messages", operator=operator)
    return compositor.blend(images, order)


def as_images(images: Images) -> Sequence[PartialImage]:
    """Return the images of one rank as a sequence; a bare array covers the picture."""
    if isinstance(images, PartialImage):
        return (images,)
    if isinstance(images, np.ndarray):
        height, width = images.shape[:2] if images.ndim == 3 else (0, 0)
        return (PartialImage(Rect(0, 0, width, height), images),)
    return tuple(images)
