"""Frame after frame: partial images of all ranks in, pictures out, and what lasts from one to the next.

The compositor keeps shared memory, the plan of the last frame (good as long as the footprints stay) and what was
learnt about codecs. `composite` is the same for one frame and messages only, with the final gather apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from clusterviz.codec import Rows, choose_codec
from clusterviz.codec.contract import Bytes, Pixels
from clusterviz.comm import Channel, as_channel
from clusterviz.comm.agree import mark_agreed
from clusterviz.comm.window import SharedWindow
from clusterviz.composite.counters import CompositeCounters, StageCounters
from clusterviz.composite.footprints import Footprints, gather_footprints
from clusterviz.composite.gather import check_inside, collect
from clusterviz.composite.hierarchical import compose_strip, place_images
from clusterviz.composite.messages import Plan, plan_messages, run_messages
from clusterviz.composite.model.choice import Choice, Wanted, choose
from clusterviz.composite.model.network import Network, default_network
from clusterviz.composite.node_memory import NodeMemory
from clusterviz.composite.packing import compile_codecs, packer
from clusterviz.composite.piece import Piece
from clusterviz.composite.shared import StripPlan, blend_strip, plan_strip, share_images
from clusterviz.errors import InputError
from clusterviz.image.merge import Operator
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect

Images = PartialImage | Pixels | Sequence[PartialImage]


@dataclass(frozen=True, eq=False)
class _Planned:
    """What was decided for footprints: the choice, and the plan of messages or of a strip."""

    footprints: Footprints
    window: SharedWindow | None
    choice: Choice
    messages: Plan | None
    strip: StripPlan | None


class Compositor:
    """Makes one picture of the partial images of all ranks, as often as asked; every method is collective.

    Parameters
    ----------
    channel : to the other ranks: a Channel, or an mpi4py communicator
    size : (width, height) of the picture
    algorithm, codec, transport : a name of their registries, or "auto", which chooses by the time model
    network : the constants of the time model; those that `clusterviz bench network` kept where None
    root : the channel's rank that gets the picture
    operator : how pixels of two images become one, as `image/merge.py` says; for others than over images are float32

    Raises
    ------
    InputError
        On every rank: an unknown name; a shared transport across nodes.
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
        # The file may differ from node to node, and all must choose alike.
        with _on_every_rank():
            mine = network or default_network(len(self._nodes))
        self._network = self._channel.broadcast(mine)
        with _on_every_rank():
            choose_codec(codec)
            self._wanted = Wanted(algorithm, transport, codec)
        self._pack = packer(codec, self._network, len(self._nodes))
        picture = size[0] * size[1] * 16 if self._channel.rank == root else 0
        self._memory = NodeMemory(self._channel, picture) if self._uses_memory() else None
        self._planned: _Planned | None = None
        self._codec, self._prepared = codec, set[np.dtype[Any]]()

    def image(self, rect: Rect, dtype: Any) -> Pixels:
        """Memory for this rank's next partial image, (height, width, 4), from which it need not be copied.

        Not collective. Its contents are anything. It may be used until the next `composite` has returned.
        """
        if self._memory:
            return self._memory.image(rect, np.dtype(dtype))
        return np.empty((rect.height, rect.width, 4), dtype)

    def composite(
        self, images: Images, order: Sequence[int], out: Pixels | None = None
    ) -> tuple[Pixels | None, CompositeCounters]:
        """One picture.

        Parameters
        ----------
        images : of this rank: one, or several from front to back; never changed. A bare array covers the picture
        order : channel ranks from front to back, the same on every rank: one entry for each image of each rank
        out : where messages shall make the picture on the root, (height, width, 4); new memory where None

        Returns
        -------
        picture : (height, width, 4), premultiplied, of the images' type, on the root; None elsewhere. It may lie in
            shared memory, which the next call changes
        counters : what it cost on this rank

        Raises
        ------
        InputError
            On every rank: images of wrong or different types or shapes or outside of the picture, a wrong order, a
            choice that does not fit them.
        """
        mine = as_images(images)
        started = perf_counter()
        if self._memory and len(self._nodes) == 1:
            told = share_images(mine, order, self._channel, self._memory, self._operator)
        else:
            told = gather_footprints(mine, order, self._channel, operator=self._operator)
        footprints = told.in_best_order(self._nodes)
        planned = self._plan(footprints)
        choice = planned.choice
        seconds_agree = perf_counter() - started
        piece, stages = self._run(mine, footprints, planned)
        started = perf_counter()
        messages: list[int] = []

        def counted(pixels: Pixels, rows: Rows, key: tuple[int, int]) -> Bytes:
            message = self._pack(pixels, rows, key)
            messages.append(message.nbytes)
            return message

        picture = collect(piece, self._size, self._channel, self._root, out, counted)
        seconds_collect = perf_counter() - started
        counters = _counters(choice, footprints, seconds_agree, stages)
        return picture, replace(counters, seconds_collect=seconds_collect, bytes_collected=sum(messages))

    def close(self) -> None:
        """Give the shared memory back, and every picture in it."""
        if self._memory:
            self._memory.free()

    def _run(
        self, images: Sequence[PartialImage], footprints: Footprints, planned: _Planned
    ) -> tuple[Piece, tuple[StageCounters, ...]]:
        choice, memory = planned.choice, self._memory
        if choice.transport != "shared":
            self._prepare_codecs(footprints.dtype)
        if planned.messages:
            return run_messages(images, footprints, planned.messages, self._channel, self._pack)
        if planned.strip and memory:
            piece, counters = blend_strip(planned.strip, footprints, memory)
            return piece, (counters,)
        assert memory, "only ranks that share memory are given this choice"
        placed = place_images(images, footprints, self._channel, memory)
        return compose_strip(placed, self._nodes, self._channel, memory, choice.algorithm, self._pack)

    def _prepare_codecs(self, dtype: np.dtype[Any]) -> None:
        """Compile what codecs need, once for a type of pixels; collective."""
        if self._codec != "raw" and dtype not in self._prepared:
            compile_codecs(self._channel, dtype)
            self._prepared.add(dtype)

    def _plan(self, footprints: Footprints) -> _Planned:
        """The plan of the last frame, where neither the images nor their memory have moved."""
        window = self._memory.window if self._memory and len(self._nodes) == 1 else None
        last = self._planned
        if last is None or last.window is not window or last.footprints != footprints:
            self._planned = last = self._plan_anew(footprints, window)
        return last

    def _plan_anew(self, footprints: Footprints, window: SharedWindow | None) -> _Planned:
        with _on_every_rank():
            choice = choose(self._wanted, footprints, self._nodes, self._network, several=footprints.several)
        messages = strip = None
        if choice.transport == "messages":
            messages = plan_messages(footprints, self._channel.rank, choice.algorithm)
        elif choice.transport == "shared" and self._memory:
            check_inside(footprints.canvas, self._size)
            strip = plan_strip(footprints, self._channel, self._memory, self._size, self._root)
        return _Planned(footprints, window, choice, messages, strip)

    def _uses_memory(self) -> bool:
        """Whether a transport that shares memory may be chosen; the ranks of the nodes are the same for all."""
        if self._wanted.transport == "shared" and len(self._nodes) > 1:
            text = "shared memory does not reach across nodes"
            allowed = "messages, hierarchical, auto"
            raise mark_agreed(InputError(text, where="cluster.transport", found="shared", allowed=allowed))
        return self._wanted.transport != "messages" and any(len(ranks) > 1 for ranks in self._nodes)


def composite(
    images: Images,
    order: Sequence[int],
    channel: Any,
    algorithm: str = "auto",
    codec: str = "auto",
    operator: Operator = "over",
) -> tuple[Piece, CompositeCounters]:
    """Blend the partial images of all ranks by messages; collective.

    Parameters
    ----------
    images : of this rank: one, or several from front to back; never changed. A bare array (height, width, 4) covers
        the picture
    order : channel ranks from front to back, the same on every rank: one entry for each image of each rank
    channel : to the other ranks: a Channel, or an mpi4py communicator
    algorithm, codec : a name of their registries, or "auto"
    operator : how pixels of two images become one, as `image/merge.py` says; for others than over images are float32

    Returns
    -------
    piece : the part of the picture that this rank owns now; `collect` brings them together
    counters : what it cost on this rank

    Raises
    ------
    InputError
        On every rank: an unknown name, images of a wrong type or shape, images of different types.
    """
    channel = as_channel(channel)
    with _on_every_rank():
        nodes = channel.nodes()
        network = channel.broadcast(default_network(len(nodes)))
        choose_codec(codec)
        wanted = Wanted(algorithm, "messages", codec)
    started = perf_counter()
    mine = as_images(images)
    footprints = gather_footprints(mine, order, channel, operator=operator).in_best_order(nodes)
    with _on_every_rank():
        apart = tuple((rank,) for rank in range(channel.size))
        choice = choose(wanted, footprints, apart, network, several=footprints.several)
    seconds_agree = perf_counter() - started
    plan = plan_messages(footprints, channel.rank, choice.algorithm)
    piece, stages = run_messages(mine, footprints, plan, channel, packer(codec, network, len(nodes)))
    return piece, _counters(choice, footprints, seconds_agree, stages)


def _counters(
    choice: Choice, footprints: Footprints, seconds_agree: float, stages: tuple[StageCounters, ...]
) -> CompositeCounters:
    return CompositeCounters(
        choice.algorithm,
        choice.codec,
        choice.transport,
        len(footprints.order),
        seconds_agree,
        choice.seconds_predicted,
        stages,
    )


def as_images(images: Images) -> Sequence[PartialImage]:
    """The images of one rank as a sequence; a bare array lies in the picture's corner and covers it."""
    if isinstance(images, PartialImage):
        return (images,)
    if isinstance(images, np.ndarray):
        height, width = images.shape[:2] if images.ndim == 3 else (0, 0)
        return (PartialImage(Rect(0, 0, width, height), images),)
    return tuple(images)


@contextmanager
def _on_every_rank() -> Iterator[None]:
    """Of what all ranks do alike, errors are alike too."""
    try:
        yield
    except InputError as error:
        raise mark_agreed(error) from None
