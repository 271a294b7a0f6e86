"""The compositor: every transport and any number of images a rank make the picture, frame after frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from composite.images import over_all, random_partial, random_rect
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.comm.agree import is_agreed
from clusterviz.composite import ALGORITHMS, CompositeCounters, Compositor, collect, composite
from clusterviz.composite.schedules.algorithms import SEVERAL_IMAGES
from clusterviz.errors import InputError
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import EMPTY, Rect

SIZE = (31, 23)
Frames = Sequence[Sequence[PartialImage]]


def compose(
    frames: Frames, order: Sequence[int], transport: str, *, per_node: int | None = None, root: int = 0, **options: str
) -> tuple[list[np.ndarray], list[CompositeCounters]]:
    """The pictures of several frames, one image a rank; and what the last cost each rank."""

    def run(channel: LoopbackChannel) -> tuple[list[Any], CompositeCounters]:
        compositor = Compositor(channel, SIZE, transport=transport, root=root, **options)
        pictures = []
        for partials in frames:
            picture, counters = compositor.composite(partials[channel.rank], order)
            assert (picture is not None) == (channel.rank == root)
            pictures.append(None if picture is None else picture.copy())
        compositor.close()
        return pictures, counters

    results = run_loopback(len(frames[0]), run, ranks_per_node=per_node)
    return results[root][0], [counters for _, counters in results]


def bound(dtype: Any, ranks: int, roundings: int = 1) -> float:
    """In units of the pixel type: half a level for each rounding, or n·2⁻²³ and a little for the float64 oracle."""
    if dtype == np.uint8:
        return 0.5 * roundings + 0.01
    return ranks * 2.0**-23 if dtype == np.float32 else roundings * 2.0**-11


@pytest.mark.parametrize("transport", ["messages", "shared"])
@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_random_images_orders_and_roots(transport: str, data: st.DataObject) -> None:
    ranks = data.draw(st.integers(1, 7))
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    dtype = data.draw(st.sampled_from([np.uint8, np.float32]))
    partials = [random_partial(rng, random_rect(rng, SIZE), dtype) for _ in range(ranks)]
    order = data.draw(st.permutations(range(ranks)))
    root = data.draw(st.integers(0, ranks - 1))
    algorithm = "direct-send" if transport == "messages" else "auto"
    pictures, _ = compose([partials, partials], order, transport, root=root, algorithm=algorithm)
    wanted = over_all(partials, order, SIZE)
    for picture in pictures:
        assert np.abs(picture - wanted).max() <= bound(dtype, ranks)


@pytest.mark.parametrize("per_node", [1, 2, 3])
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_a_hierarchy_of_nodes_makes_the_picture(per_node: int, data: st.DataObject) -> None:
    ranks = data.draw(st.integers(1, 8))
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    dtype = data.draw(st.sampled_from([np.uint8, np.float32]))
    partials = [random_partial(rng, random_rect(rng, SIZE), dtype) for _ in range(ranks)]
    # Where nodes are intervals of depth, any algorithm will do; else one that takes several images a node.
    ordered = data.draw(st.booleans())
    order = list(range(ranks)) if ordered else data.draw(st.permutations(range(ranks)))
    names = sorted(ALGORITHMS if ordered else SEVERAL_IMAGES)
    algorithm = data.draw(st.sampled_from(names))
    transport = "hierarchical" if ranks > 1 and per_node > 1 else "auto"
    pictures, _ = compose([partials], order, transport, per_node=per_node, algorithm=algorithm)
    assert np.abs(pictures[0] - over_all(partials, order, SIZE)).max() <= bound(dtype, ranks, 2 + ranks)


@pytest.mark.parametrize("transport", ["messages", "shared"])
@pytest.mark.parametrize("ranks", [2, 5, 16])
def test_bytes_in_one_round_are_rounded_once(ranks: int, transport: str) -> None:
    rng = np.random.default_rng(ranks)
    partials = [random_partial(rng, Rect(0, 0, *SIZE), np.uint8) for _ in range(ranks)]
    algorithm = "direct-send" if transport == "messages" else "auto"
    pictures, _ = compose([partials], range(ranks), transport, algorithm=algorithm)
    assert np.abs(pictures[0] - over_all(partials, range(ranks), SIZE)).max() <= 0.51


@pytest.mark.parametrize("algorithm", ["binary-swap", "2-3-swap", "radix-k", "tree"])
@pytest.mark.parametrize("ranks", [3, 8, 13])
def test_bytes_in_several_rounds_are_rounded_once_a_round(ranks: int, algorithm: str) -> None:
    rng = np.random.default_rng(ranks)
    partials = [random_partial(rng, Rect(0, 0, *SIZE), np.uint8) for _ in range(ranks)]
    pictures, _ = compose([partials], range(ranks), "messages", algorithm=algorithm)
    error = pictures[0] - over_all(partials, range(ranks), SIZE)
    # Half a level at the end, and a level for each value that was rounded before: its colour, and what its rounded
    # opacity lets through. For each pixel there are fewer such values than merges.
    assert np.abs(error).max() <= 0.5 + (ranks - 2)
    assert np.sqrt(np.mean(error**2)) <= 0.5


@pytest.mark.parametrize("codec", ["raw", "active", "rectangle", "lz4", "shuffle+lz4", "delta+lz4", "auto"])
@pytest.mark.parametrize("algorithm", ["direct-send", "binary-swap", "slic"])
def test_no_codec_changes_a_bit(algorithm: str, codec: str) -> None:
    rng = np.random.default_rng(9)
    partials = [random_partial(rng, random_rect(rng, SIZE), np.float32) for _ in range(5)]
    raw, _ = compose([partials], range(5), "messages", algorithm=algorithm, codec="raw")
    packed, _ = compose([partials] * 3, range(5), "messages", algorithm=algorithm, codec=codec)
    assert all(np.array_equal(raw[0], picture) for picture in packed)


@pytest.mark.parametrize("transport", ["messages", "shared", "hierarchical"])
def test_half_precision(transport: str) -> None:
    rng = np.random.default_rng(1)
    partials = []
    for _ in range(5):
        drawn = random_partial(rng, random_rect(rng, SIZE), np.float32)
        partials.append(PartialImage(drawn.rect, drawn.rgba.astype(np.float16)))
    per_node = 2 if transport == "hierarchical" else None
    pictures, _ = compose([partials], range(5), transport, per_node=per_node)
    assert pictures[0].dtype == np.float16
    assert np.abs(pictures[0] - over_all(partials, range(5), SIZE)).max() <= bound(np.float16, 5, 2)


@pytest.mark.parametrize(("transport", "per_node"), [("shared", None), ("hierarchical", 2)])
def test_images_that_grow_from_frame_to_frame(transport: str, per_node: int | None) -> None:
    rng = np.random.default_rng(4)
    frames = [
        [random_partial(rng, Rect(0, 0, 1 + 3 * number, 2 + 2 * number), np.float32) for _ in range(3)]
        for number in (0, 1, 0, 5, 10, 2)
    ]
    pictures, _ = compose(frames, [0, 1, 2], transport, per_node=per_node)
    for partials, picture in zip(frames, pictures, strict=True):
        assert np.abs(picture - over_all(partials, [0, 1, 2], SIZE)).max() <= bound(np.float32, 3)


def test_an_image_drawn_into_shared_memory_is_not_copied() -> None:
    rng = np.random.default_rng(5)
    partials = [random_partial(rng, Rect(2, 1, 20, 20), np.float32) for _ in range(3)]

    def run(channel: LoopbackChannel) -> np.ndarray | None:
        compositor = Compositor(channel, SIZE, transport="shared")
        compositor.composite(partials[channel.rank], [0, 1, 2])
        memory = compositor.image(partials[channel.rank].rect, np.float32)
        memory[:] = partials[channel.rank].rgba
        window = compositor._memory.window  # type: ignore[union-attr]
        assert np.shares_memory(memory, window.part(window.index))
        for _ in range(2):
            picture, _ = compositor.composite(PartialImage(partials[channel.rank].rect, memory), [0, 1, 2])
            assert np.array_equal(memory, partials[channel.rank].rgba)
        return None if picture is None else picture.copy()

    picture = run_loopback(3, run)[0]
    assert np.abs(picture - over_all(partials, [0, 1, 2], SIZE)).max() <= bound(np.float32, 3)


@pytest.mark.parametrize("transport", ["messages", "shared", "hierarchical"])
@pytest.mark.parametrize("drawn", [0, 1])
def test_all_empty_and_all_but_one(transport: str, drawn: int) -> None:
    rng = np.random.default_rng(6)
    rects = [Rect(3, 4, 9, 8) if rank < drawn else EMPTY for rank in range(5)]
    partials = [random_partial(rng, rect, np.float32) for rect in rects]
    pictures, _ = compose([partials], [4, 2, 0, 1, 3], transport, per_node=2 if transport == "hierarchical" else None)
    assert np.array_equal(pictures[0], over_all(partials, [4, 2, 0, 1, 3], SIZE).astype(np.float32))


@pytest.mark.parametrize("transport", ["messages", "shared"])
def test_more_ranks_than_pixels_and_a_picture_of_one(transport: str) -> None:
    rng = np.random.default_rng(8)
    partials = [random_partial(rng, Rect(0, 0, 1, 1), np.float32) for _ in range(7)]

    def run(channel: LoopbackChannel) -> np.ndarray | None:
        picture, _ = Compositor(channel, (1, 1), transport=transport).composite(partials[channel.rank], range(7))
        return picture

    assert np.abs(run_loopback(7, run)[0] - over_all(partials, range(7), (1, 1))).max() <= bound(np.float32, 7)


@pytest.mark.parametrize("transport", ["messages", "shared"])
def test_arrays_in_any_order_of_memory_and_bare_arrays(transport: str) -> None:
    rng = np.random.default_rng(7)
    full = Rect(0, 0, *SIZE)
    drawn = [random_partial(rng, full, np.float32).rgba for _ in range(4)]
    given = [drawn[0], np.asfortranarray(drawn[1]), drawn[2][::-1][::-1], np.repeat(drawn[3], 2, axis=1)[:, ::2]]

    def run(channel: LoopbackChannel) -> np.ndarray | None:
        picture, _ = Compositor(channel, SIZE, transport=transport).composite(given[channel.rank], range(4))
        return None if picture is None else picture.copy()

    wanted = over_all([PartialImage(full, rgba) for rgba in drawn], range(4), SIZE)
    assert np.abs(run_loopback(4, run)[0] - wanted).max() <= bound(np.float32, 4)


def test_a_picture_made_in_given_memory_keeps_nothing_of_what_was_there() -> None:
    rng = np.random.default_rng(2)
    partials = [random_partial(rng, Rect(5, 6, 12, 20), np.float32) for _ in range(3)]
    for algorithm in ("direct-send", "slic", "serial", "tree"):

        def run(channel: LoopbackChannel, algorithm: str = algorithm) -> np.ndarray | None:
            out = np.full((SIZE[1], SIZE[0], 4), 7, np.float32)
            piece, _ = composite(partials[channel.rank], range(3), channel, algorithm)
            return collect(piece, SIZE, channel, out=out)

        wanted = over_all(partials, range(3), SIZE)
        assert np.abs(run_loopback(3, run)[0] - wanted).max() <= bound(np.float32, 3)


def test_shared_memory_across_nodes_is_refused() -> None:
    def run(channel: LoopbackChannel) -> None:
        with pytest.raises(InputError, match=r"across nodes.*found shared") as caught:
            Compositor(channel, SIZE, transport="shared")
        assert is_agreed(caught.value)

    run_loopback(4, run, ranks_per_node=2)


def test_an_image_outside_the_picture_is_refused_in_shared_memory_too() -> None:
    image = PartialImage(Rect(30, 0, 40, 2), np.zeros((2, 10, 4), np.float32))

    def run(channel: LoopbackChannel) -> None:
        with pytest.raises(InputError, match="outside the picture") as caught:
            Compositor(channel, SIZE, transport="shared").composite(image, [0, 1])
        assert is_agreed(caught.value)

    run_loopback(2, run)


def test_counters_tell_what_went_to_whom() -> None:
    rng = np.random.default_rng(11)
    partials = [random_partial(rng, Rect(0, 0, *SIZE), np.float32) for _ in range(4)]
    _, counters = compose([partials], range(4), "messages", algorithm="direct-send", codec="raw")
    pixels = SIZE[0] * SIZE[1]
    for rank, counted in enumerate(counters):
        (stage,) = counted.stages
        assert sorted(peer.peer for peer in stage.peers) == [other for other in range(4) if other != rank]
        assert stage.messages_sent == sum(peer.messages_sent for peer in stage.peers) == 3
        assert stage.bytes_sent == stage.bytes_raw == 16 * stage.pixels_sent
        assert all(peer.seconds_wait > 0 for peer in stage.peers)
        assert counted.transport == "messages"
        assert counted.seconds_predicted > 0
    assert sum(counted.total.pixels_sent for counted in counters) == 3 * pixels
    owned = [pixels * (rank + 1) // 4 - pixels * rank // 4 for rank in range(4)]
    assert [counted.bytes_collected for counted in counters] == [0, *(16 * count for count in owned[1:])]
