"""Projections by every transport and algorithm: what the plain serial merge makes of the same parts.

Maxima, minima and stretches equal it bit for bit, sums to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from composite.images import random_rect
from composite.patches import WIDTHS, line, patches, random_runs
from composite.projected import OPERATORS, random_part, random_pixels
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.codec import open_message, pack, unpack
from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.comm.agree import is_agreed
from clusterviz.comm.mpi import MpiChannel
from clusterviz.composite import ALGORITHMS, CompositeCounters, Compositor, collect, compile_kernels, composite
from clusterviz.composite.over.blend import put_before, put_behind
from clusterviz.composite.over.layers import Layer, blend_layers, plain_layers
from clusterviz.composite.schedules.algorithms import SEVERAL_IMAGES
from clusterviz.errors import InputError
from clusterviz.image.merge import MERGES, ORDER_FREE, Operator, merge_partials
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect

SIZE = (23, 17)
Case = tuple[list[PartialImage], list[int]]


@cache
def case(ranks: int, operator: Operator) -> Case:
    """One part a rank, anywhere, and their order."""
    rng = np.random.default_rng(ranks)
    parts = [random_part(rng, random_rect(rng, SIZE), operator) for _ in range(ranks)]
    return parts, [int(rank) for rank in rng.permutation(ranks)]


def check(made: np.ndarray | None, parts: Sequence[PartialImage], operator: Operator) -> None:
    """Compare a picture with the plain merge of its parts, the first in front."""
    wanted = merge_partials(parts, SIZE, operator)
    assert made is not None
    assert made.dtype == np.float32
    if operator == "sum":
        # n additions, each rounded, of terms of one sign.
        assert np.all(np.abs(made - wanted) <= len(parts) * 2.0**-23 * np.abs(wanted))
    else:
        assert np.array_equal(made, wanted)


def compose(
    channel: Channel, mine: Sequence[PartialImage], order: Sequence[int], operator: Operator, **options: str
) -> tuple[np.ndarray | None, CompositeCounters]:
    """Two frames by one compositor: the second picture, and what it cost."""
    compositor = Compositor(channel, SIZE, operator=operator, **options)
    compositor.composite(mine, order)
    picture, counters = compositor.composite(mine, order)
    kept = None if picture is None else picture.copy()
    compositor.close()
    return kept, counters


@pytest.mark.parametrize("operator", OPERATORS)
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_algorithm_by_messages(algorithm: str, operator: Operator) -> None:
    for ranks in range(1, 10):
        parts, order = case(ranks, operator)

        def run(channel: Channel, parts: Sequence[PartialImage] = parts, order: Sequence[int] = order):  # type: ignore[no-untyped-def]
            piece, _ = composite(parts[channel.rank], order, channel, algorithm, operator=operator)
            return collect(piece, SIZE, channel)

        check(run_loopback(ranks, run)[0], [parts[rank] for rank in order], operator)


@pytest.mark.parametrize("operator", OPERATORS)
@pytest.mark.parametrize("codec", ["raw", "active+delta+shuffle+lz4"])
@pytest.mark.parametrize("transport", ["shared", "hierarchical", "messages"])
def test_every_transport(transport: str, codec: str, operator: Operator) -> None:
    for ranks in range(2, 10):
        parts, order = case(ranks, operator)
        run = lambda c: compose(c, [parts[c.rank]], order, operator, transport=transport, codec=codec)  # noqa: B023, E731
        made = run_loopback(ranks, run, ranks_per_node=None if transport == "shared" else 2)[0][0]
        check(made, [parts[rank] for rank in order], operator)


@pytest.mark.parametrize("operator", OPERATORS)
@pytest.mark.parametrize("algorithm", [*ALGORITHMS, "auto"])
@pytest.mark.parametrize("transport", ["messages", "hierarchical", "shared"])
def test_several_images_a_rank(transport: str, algorithm: str, operator: Operator) -> None:
    rng = np.random.default_rng(3)
    ranks, counts = 5, [3, 1, 0, 4, 2]
    order = [int(rank) for rank in rng.permutation(np.repeat(np.arange(ranks), counts))]
    parts = [random_part(rng, random_rect(rng, SIZE), operator) for _ in order]

    def run(channel: LoopbackChannel) -> tuple[np.ndarray | None, CompositeCounters]:
        mine = [part for part, owner in zip(parts, order, strict=True) if owner == channel.rank]
        return compose(channel, mine, order, operator, transport=transport, algorithm=algorithm)

    found = run_loopback(ranks, run, ranks_per_node=2 if transport == "hierarchical" else None)
    check(found[0][0], parts, operator)
    ran = found[0][1].algorithm
    falls_back = operator not in ORDER_FREE and algorithm not in SEVERAL_IMAGES
    assert algorithm in ("auto", ran) or transport == "shared" or (falls_back and ran == "direct-send")


def test_without_order_images_of_a_node_cross_the_network_as_one() -> None:
    rng = np.random.default_rng(4)
    parts = [random_part(rng, Rect(0, 0, *SIZE), "stretch") for _ in range(4)]
    sent: dict[str, int] = {}
    for operator in ("stretch", "maximum"):
        # The nodes' ranks take turns in depth.
        run = lambda c: compose(c, [parts[c.rank]], [0, 2, 1, 3], operator, transport="hierarchical", codec="raw")[1]  # noqa: B023, E731
        counters = run_loopback(4, run, ranks_per_node=2)
        sent[operator] = sum(counted.total.bytes_sent for counted in counters)
    assert sent["stretch"] == 2 * sent["maximum"] > 0


@pytest.mark.mpi(ranks=[3], timeout=60)
def test_over_mpi(mpi_ranks: int) -> None:
    channel = MpiChannel()
    compile_kernels(channel)
    for operator in OPERATORS:
        parts, order = case(mpi_ranks, operator)
        for transport, algorithm in (("shared", "auto"), ("messages", "binary-swap"), ("messages", "direct-send")):
            made, _ = compose(channel, [parts[channel.rank]], order, operator, transport=transport, algorithm=algorithm)
            if channel.rank == 0:
                check(made, [parts[rank] for rank in order], operator)
    channel.close()


@pytest.mark.parametrize("operator", OPERATORS)
@settings(max_examples=60, deadline=None)
@given(st.data())
def test_the_kernel_equals_plain_numpy_bit_for_bit(operator: Operator, data: st.DataObject) -> None:
    width = data.draw(st.sampled_from(WIDTHS))
    height = data.draw(st.integers(1, 20 if width < 100 else 3))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    layers = []
    for _ in range(data.draw(st.integers(0, 6))):
        patch = data.draw(patches(width, height))
        pixels = random_pixels(rng, patch.count, operator)
        active, runs = random_runs(rng, patch.count)
        layers.append(Layer(patch, pixels[active], runs) if data.draw(st.booleans()) else Layer(patch, pixels))
    split, target = data.draw(st.integers(0, len(layers))), data.draw(patches(width, height))
    out = np.full((target.count, 4), 77, np.float32)
    blend_layers(layers, target, out, operator=operator, split=split)
    assert np.array_equal(out, plain_layers(layers, target, out.dtype, split, operator))


@pytest.mark.parametrize("operator", OPERATORS)
def test_two_images_in_place(operator: Operator) -> None:
    rng = np.random.default_rng(5)
    for count in (1, 3, 4, 5, 700):
        patch, (front, behind) = line(count), (random_pixels(rng, count, operator) for _ in range(2))
        wanted, before, after = MERGES[operator](front, behind), behind.copy(), front.copy()
        put_before(before, patch, front, patch, operator=operator)
        put_behind(after, patch, behind, patch, operator=operator)
        assert np.array_equal(before, wanted)
        assert np.array_equal(after, wanted)


@pytest.mark.parametrize("operator", OPERATORS)
def test_what_a_codec_leaves_out_is_neutral(operator: Operator) -> None:
    pixels = random_pixels(np.random.default_rng(6), 4000, operator)
    pixels[:1000] = 0
    for codec in ("active", "rectangle", "active+shuffle+lz4"):
        message = pack(pixels, codec)
        kept, _ = open_message(message, len(pixels), pixels.dtype)
        assert len(kept) < len(pixels)
        assert np.array_equal(unpack(message, len(pixels), pixels.dtype), pixels)
    blank = np.zeros_like(pixels)
    assert np.array_equal(MERGES[operator](pixels, blank), pixels)
    assert np.array_equal(MERGES[operator](blank, pixels), pixels)


@pytest.mark.parametrize("dtype", [np.uint8, np.float16])
def test_rounded_pixels_are_refused_on_every_rank(dtype: type) -> None:
    image = PartialImage(Rect(0, 0, 2, 2), np.ones((2, 2, 4), dtype))

    def run(channel: LoopbackChannel) -> None:
        with pytest.raises(InputError, match=r"the operator maximum cannot merge; found .*; allowed float32") as caught:
            composite(image, range(2), channel, operator="maximum")
        assert is_agreed(caught.value)

    run_loopback(2, run)
    with pytest.raises(InputError, match="the operator sum cannot merge"):
        blend_layers([Layer(line(4), image.rgba.reshape(-1, 4))], line(4), np.zeros((4, 4), np.float32), operator="sum")


def test_images_of_a_rank_with_none_between_them_need_no_special_algorithm() -> None:
    rng = np.random.default_rng(7)
    order = [1, 1, 1, 2, 0, 0]
    parts = [random_part(rng, random_rect(rng, SIZE), "stretch") for _ in order]
    for algorithm in ALGORITHMS:
        mine = lambda rank: [part for part, owner in zip(parts, order, strict=True) if owner == rank]  # noqa: E731
        run = lambda c: compose(c, mine(c.rank), order, "stretch", algorithm=algorithm, transport="messages")[0]  # noqa: B023, E731
        check(run_loopback(3, run)[0], parts, "stretch")
