"""Compositing: every algorithm, transport and kind of pixel makes the picture that merging one by one makes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from composite.cases import (
    KINDS,
    OPERATORS,
    SIZE,
    Case,
    compose,
    compose_on,
    dense_case,
    over_all,
    picture,
    random_case,
    random_image,
    random_rect,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.codec import CODECS
from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.comm.agree import is_agreed
from clusterviz.composite import (
    ALGORITHMS,
    Compositor,
    as_floats,
    collect,
    composite,
    rounded,
    rounding_bound,
)
from clusterviz.composite.schedules.algorithms import SEVERAL_IMAGES
from clusterviz.errors import InputError
from clusterviz.image.merge import ORDER_FREE
from clusterviz.image.partial import PartialImage, Rect, blank

TRANSPORTS = ("messages", "shared", "hierarchical")
NODES = {"messages": None, "shared": None, "hierarchical": 2}
"""Ranks a node."""
WHOLE = Rect(0, 0, *SIZE)


def drawn(case: Case, algorithm: str, root: int = 0) -> np.ndarray | None:
    """The picture by `composite` and `collect`, on its root only."""
    found = run_loopback(case.ranks, lambda channel: picture(channel, case, algorithm, root))
    assert [rank for rank, image in enumerate(found) if image is not None] == [root]
    return found[root]


@pytest.mark.cover
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_algorithm_with_any_number_of_ranks(algorithm: str, kind: str) -> None:
    """In the last cases there are more ranks than pixels, or sides that no number divides.

    What ranks merge does not depend on the kind of pixels, so all counts of ranks have one kind only.
    """
    plain = kind == "float32"
    cases = [random_case(ranks, kind) for ranks in ((*range(1, 9), 13, 16) if plain else (3, 6))]
    cases += [dense_case(11, kind, size) for size in (((1, 1), (1, 9), (9, 1), (2, 1)) if plain else ((37, 3),))]
    for case in cases:
        case.check(drawn(case, algorithm), case.ranks - 1)


@pytest.mark.cover
@pytest.mark.parametrize("algorithm", ALGORITHMS)
@settings(max_examples=12, deadline=None)
@given(st.data(), st.integers(1, 11), st.tuples(st.integers(1, 13), st.integers(1, 11)))
def test_any_footprints_orders_and_roots(
    algorithm: str, data: st.DataObject, ranks: int, size: tuple[int, int]
) -> None:
    sides = [st.tuples(st.integers(0, side), st.integers(0, side)).map(sorted) for side in size]
    rects = [Rect(x[0], y[0], x[1], y[1]) for x, y in data.draw(st.tuples(*[st.tuples(*sides)] * ranks))]
    order, root = data.draw(st.permutations(range(ranks))), data.draw(st.integers(0, ranks - 1))
    rng, kind = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1))), data.draw(st.sampled_from(KINDS))
    case = Case(ranks, order, [random_image(rng, rect, kind) for rect in rects], kind, size)
    case.check(drawn(case, algorithm, root), ranks - 1)


@pytest.mark.cover
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("transport", TRANSPORTS)
def test_several_images_a_rank_lie_between_those_of_others(transport: str, kind: str) -> None:
    case, names = random_case(5, kind, counts=[3, 1, 0, 4, 2]), [*ALGORITHMS, "auto"]
    # Every algorithm with some kinds, those of several images a rank with each.
    for algorithm in {*names[KINDS.index(kind) % 3 :: 3], *SEVERAL_IMAGES}:
        made, counters = compose(case, algorithm, transport, NODES[transport])
        case.check(made, 12)
        ran = counters[0].algorithm
        falls_back = kind not in ORDER_FREE and algorithm not in SEVERAL_IMAGES
        assert algorithm in ("auto", ran) or transport == "shared" or (falls_back and ran == "direct-send")


@pytest.mark.cover
@pytest.mark.parametrize("transport", TRANSPORTS)
@settings(max_examples=20, deadline=None)
@given(data=st.data(), ranks=st.integers(1, 8), seed=st.integers(0, 1000), kind=st.sampled_from((*KINDS, "float16")))
def test_every_transport(transport: str, data: st.DataObject, ranks: int, seed: int, kind: str) -> None:
    case = random_case(ranks, kind, seed=seed)
    per_node = data.draw(st.integers(2, 3)) if transport == "hierarchical" else data.draw(st.sampled_from([None, 1]))
    names, transport = (["auto"], "shared") if transport == "shared" else (sorted(ALGORITHMS), transport)
    made, _ = compose(
        case,
        data.draw(st.sampled_from(names)),
        "messages" if ranks == 1 and transport == "hierarchical" else transport,
        None if transport == "shared" else per_node,
        root=data.draw(st.integers(0, ranks - 1)),
        codec=data.draw(st.sampled_from(["raw", "active+delta+shuffle+lz4", "auto"])),
    )
    case.check(made, 2 + ranks if transport != "shared" else 1)


@pytest.mark.mpi(ranks=[2, 5], timeout=120)
def test_mpi_equals_loopback(mpi_ranks: int) -> None:
    from clusterviz.comm.mpi import MpiChannel
    from clusterviz.composite import compile_kernels

    channel = MpiChannel()
    compile_kernels(channel)
    for kind in KINDS:
        case = random_case(mpi_ranks, kind)
        for root, algorithm in enumerate(ALGORITHMS if kind not in OPERATORS else ("binary-swap", "direct-send")):
            root %= mpi_ranks
            made = picture(channel, case, algorithm, root)
            assert (made is None) == (channel.rank != root)
            assert made is None or np.array_equal(made, drawn(case, algorithm))
        made, _ = compose_on(channel, case, transport="shared")
        if channel.rank == 0:
            case.check(made)
    channel.close()


@pytest.mark.parametrize("algorithm", ["direct-send", "binary-swap", "slic"])
def test_no_codec_changes_a_bit(algorithm: str) -> None:
    case = random_case(5)
    raw, _ = compose(case, algorithm, codec="raw")
    for codec in (*CODECS, "auto") if algorithm == "direct-send" else ("active", "rectangle+delta+shuffle+lz4"):
        assert np.array_equal(raw, compose(case, algorithm, codec=codec)[0]), codec


@pytest.mark.cover
@pytest.mark.parametrize("kind", ["uint8", "float16"])
@pytest.mark.parametrize("ranks", [2, 5, 13])
def test_fewer_bits_are_rounded_once_a_round(ranks: int, kind: str) -> None:
    case = dense_case(ranks, kind)
    for transport, rounds in (("messages", 1), ("shared", 1), ("hierarchical", 2 if kind == "float16" else 2 + ranks)):
        case.check(compose(case, "direct-send", transport, NODES[transport])[0], rounds)
    if kind == "float16":
        return
    for algorithm in ("binary-swap", "2-3-swap", "radix-k", "tree"):
        error = compose(case, algorithm)[0] - over_all(case.images, SIZE)
        # Half a level at the end, and a level for each value that was rounded before: its colour, and what its rounded
        # opacity lets through. For each pixel there are fewer such values than merges.
        assert np.abs(error).max() <= 0.51 + (ranks - 2)
        assert np.sqrt(np.mean(error**2)) <= 0.5


@pytest.mark.parametrize("pixel", ["float16", "uint8"])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_no_rounded_picture_is_further_off_than_is_stated(algorithm: str, pixel: str) -> None:
    for ranks in (2, 5):
        case = random_case(ranks)
        images = [random_image(np.random.default_rng(9), WHOLE), *case.images[1:]]
        stored = Case(ranks, case.order, [rounded(one, pixel) for one in images], pixel)
        made = drawn(stored, algorithm)
        assert made is not None
        assert 0 < np.abs(as_floats(made) - over_all(images, SIZE)).max() <= rounding_bound(pixel, ranks)


@pytest.mark.parametrize("pixel", ["float16", "uint8"])
def test_values_are_rounded_to_nearest(pixel: str) -> None:
    image = random_image(np.random.default_rng(3), Rect(2, 1, 9, 8))
    found, step = rounded(image, pixel), 2.0**-11 if pixel == "float16" else 1 / 255
    assert (found.rect, found.rgba.dtype) == (image.rect, pixel)
    floats = as_floats(found.rgba)
    assert np.abs(floats - image.rgba).max() <= 0.5001 * step
    np.testing.assert_array_equal(rounded(PartialImage(image.rect, floats), pixel).rgba, found.rgba)
    assert rounded(image, "float32") is image
    assert rounded(blank(), pixel).rgba.shape == (0, 0, 4)


@pytest.mark.parametrize(("seen", "kind"), [(None, "float32"), (3, "uint8")])
def test_all_blank_and_all_but_one_send_nothing(seen: int | None, kind: str) -> None:
    image = random_image(np.random.default_rng(3), Rect(2, 1, 6, 4), kind)
    # An empty rectangle of any kind is empty.
    empty = PartialImage(Rect(5, 5, 2, 9), np.zeros((4, 0, 4), kind))
    order = [4, 2, 0, 1, 3]
    others = [blank() if rank % 2 else empty for rank in order]
    case = Case(5, order, [image if rank == seen else other for rank, other in zip(order, others, strict=True)], kind)
    for algorithm in ALGORITHMS:
        made = drawn(case, algorithm)
        assert made is not None
        assert np.count_nonzero(made) == (np.count_nonzero(image.rgba) if seen else 0)
        assert seen is None or np.array_equal(made[1:4, 2:6], image.rgba)
        counted = run_loopback(5, lambda c: composite(case.of(c.rank), case.order, c, algorithm)[1])  # noqa: B023
        assert [c.participants for c in counted] == [int(seen is not None)] * 5
        assert sum(c.total.messages_sent for c in counted) == 0
    for transport in TRANSPORTS:
        found = compose(case, transport=transport, per_node=NODES[transport])[0]
        assert np.array_equal(found, over_all(case.images, SIZE).astype(kind))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_dense_images_move_what_theory_says(algorithm: str) -> None:
    case = dense_case(6, "uint8", (12, 10))
    counted = run_loopback(6, lambda c: composite(case.of(c.rank), case.order, c, algorithm)[1])
    theory = ALGORITHMS[algorithm](6, 120, ()).counts()
    assert sum(c.total.messages_sent for c in counted) == theory.messages
    assert sum(c.total.pixels_sent for c in counted) == theory.pixels == 5 * 120
    assert sum(c.total.bytes_sent for c in counted) == 4 * theory.pixels


def test_counters_tell_what_went_to_whom() -> None:
    _, counters = compose(dense_case(4), "direct-send", codec="raw")
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


def test_footprints_that_do_not_meet_send_no_empty_message() -> None:
    rng = np.random.default_rng(4)
    images = [random_image(rng, Rect(0, 4 * rank, 8, 4 * rank + 4)) for rank in range(4)]
    counted = run_loopback(4, lambda c: composite(images[c.rank], range(4), c, "direct-send")[1])
    assert [c.total.messages_sent for c in counted] == [0] * 4


def test_order_of_arrival_does_not_change_a_bit() -> None:
    made = [drawn(random_case(12), "direct-send") for _ in range(5)]
    assert all(np.array_equal(made[0], other) for other in made[1:])


@pytest.mark.parametrize("algorithm", sorted(SEVERAL_IMAGES))
def test_several_images_that_no_other_rank_meets(algorithm: str) -> None:
    """A box around two images of a rank hides nothing between them."""
    rng = np.random.default_rng(12)
    layers = [random_image(rng, Rect(0, 0, 9, 9)) for _ in range(3)]
    elsewhere = random_image(rng, Rect(20, 0, 23, 9))
    for case in (Case(1, [0] * 3, layers), Case(2, [0, 0, 1, 0], [*layers[:2], elsewhere, layers[2]])):
        case.check(drawn(case, algorithm))
    beside = [random_image(rng, Rect(x, 0, x + 5, SIZE[1])) for x in (0, 8, 18)]
    for root in range(3):
        made = drawn(Case(3, [0, 1, 0], beside), algorithm, root)
        assert np.array_equal(made, over_all(beside, SIZE).astype(np.float32))


@pytest.mark.parametrize("algorithm", sorted(ALGORITHMS.keys() - SEVERAL_IMAGES))
def test_an_algorithm_of_one_image_a_rank_runs_where_images_may_be_brought_side_by_side(algorithm: str) -> None:
    """Else direct send does: where each of two ranks has images in front of the other's."""
    rng = np.random.default_rng(17)
    left, right = Rect(0, 0, 9, SIZE[1]), Rect(9, 0, *SIZE)
    for order, rects, ran in (
        ([0, 1, 1, 0, 2], (WHOLE, left, left, right, left), algorithm),
        ([1, 1, 1, 2, 0, 0], (WHOLE, left, right, WHOLE, left, WHOLE), algorithm),
        ([0, 1, 2, 0, 1], (WHOLE, left, left, WHOLE, left), "direct-send"),
    ):
        for kind in ("float32", "run"):
            case = Case(3, order, [random_image(rng, rect, kind) for rect in rects], kind)
            made, counters = compose(case, algorithm)
            assert counters[0].algorithm == ran
            case.check(made)


def test_without_order_images_of_a_node_cross_the_network_as_one() -> None:
    sent = {}
    for operator in ("run", "maximum"):
        # The nodes' ranks take turns in depth.
        case = Case(4, [0, 2, 1, 3], dense_case(4, "run").images, operator)
        _, counters = compose(case, "auto", "hierarchical", 2, codec="raw")
        sent[operator] = sum(counted.total.bytes_sent for counted in counters)
    assert sent["run"] == 2 * sent["maximum"] > 0


@pytest.mark.parametrize("transport", ["shared", "hierarchical"])
def test_images_that_grow_from_frame_to_frame(transport: str) -> None:
    rng = np.random.default_rng(4)
    frames = [
        Case(3, range(3), [random_image(rng, Rect(0, 0, 1 + 3 * number, 2 + 2 * number)) for _ in range(3)])
        for number in (0, 1, 0, 5, 7, 2)
    ]

    def run(channel: LoopbackChannel) -> None:
        compositor = Compositor(channel, SIZE, transport=transport)
        for case in frames:
            made, _ = compositor.composite(case.of(channel.rank), case.order)
            if made is not None:
                case.check(made)

    run_loopback(3, run, ranks_per_node=NODES[transport])


def test_an_image_drawn_into_shared_memory_is_not_copied() -> None:
    rng = np.random.default_rng(5)
    case = Case(3, range(3), [random_image(rng, Rect(2, 1, 20, 15)) for _ in range(3)])

    def run(channel: LoopbackChannel) -> None:
        (image,) = case.of(channel.rank)
        compositor = Compositor(channel, SIZE, transport="shared")
        compositor.composite(image, [0, 1, 2])
        memory = compositor.image(image.rect, np.float32)
        memory[:] = image.rgba
        window = compositor._memory.window  # type: ignore[union-attr]
        assert np.shares_memory(memory, window.part(window.index))
        for _ in range(2):
            made, _ = compositor.composite(PartialImage(image.rect, memory), [0, 1, 2])
            assert np.array_equal(memory, image.rgba)
        if made is not None:
            case.check(made)

    run_loopback(3, run)


@pytest.mark.parametrize("algorithm", ["serial", "tree", "direct-send", "radix-k", "slic"])
def test_images_of_any_order_of_memory_are_taken_and_not_changed(algorithm: str) -> None:
    rng = np.random.default_rng(7)
    a, b, c, d = (random_image(rng, WHOLE).rgba for _ in range(4))
    given = [a.copy(), np.asfortranarray(b), c[::-1].copy()[::-1], np.repeat(d, 2, axis=1)[:, ::2]]
    case = Case(5, range(5), [PartialImage(WHOLE, rgba) for rgba in given] + [random_image(rng, random_rect(rng))])
    before = [rgba.copy() for rgba in given]
    case.check(drawn(case, algorithm))
    bare = run_loopback(
        4, lambda channel: collect(composite(given[channel.rank], range(4), channel, algorithm)[0], SIZE, channel)
    )
    Case(4, range(4), case.images[:4]).check(bare[0])
    if algorithm == "direct-send":
        Case(4, range(4), case.images[:4]).check(
            run_loopback(4, lambda c: Compositor(c, SIZE, transport="shared").composite(given[c.rank], range(4))[0])[0]
        )
    assert all(np.array_equal(a, b) for a, b in zip(before, given, strict=True))


def test_a_picture_made_in_given_memory_keeps_nothing_of_what_was_there() -> None:
    rng = np.random.default_rng(2)
    case = Case(3, range(3), [random_image(rng, Rect(5, 6, 12, 16)) for _ in range(3)])
    for algorithm in ("direct-send", "slic", "serial", "tree"):

        def run(channel: LoopbackChannel, algorithm: str = algorithm) -> np.ndarray | None:
            out = np.full((SIZE[1], SIZE[0], 4), 7, np.float32)
            return collect(composite(case.of(channel.rank), range(3), channel, algorithm)[0], SIZE, channel, out=out)

        case.check(run_loopback(3, run)[0])


def image_of(dtype: Any, width: int = 2, x: int = 0) -> PartialImage:
    return PartialImage(Rect(x, 0, x + 2, 2), np.ones((2, width, 4), dtype))


FLOAT, BYTE = image_of(np.float32), image_of(np.uint8)


@pytest.mark.parametrize(
    ("images", "orders", "options", "text"),
    [
        ([FLOAT, BYTE, FLOAT], None, {}, "^partial images differ in pixel type; found float32, uint8$"),
        *(([FLOAT, image_of(dtype)], None, {}, f"rank 1.*{np.dtype(dtype)}") for dtype in ("f8", "i4", "i2", ">f4")),
        ([BYTE, image_of(np.uint8, 3)], None, {}, r"\(2, 3, 4\)"),
        *(([blank()] * 2, [order] * 2, {}, "no permutation of 2") for order in ([0, 0], [0], [0, 1, 2], [1, 2])),
        ([blank()] * 2, [[0, 1], [1, 0]], {}, "ranks 0 and 1 give different"),
        ([blank()], None, {"algorithm": "swap"}, f"allowed {', '.join(ALGORITHMS)}, auto"),
        ([blank()], None, {"codec": "zip"}, "unknown codec"),
        *(
            ([image_of(dtype)] * 2, None, {"operator": "maximum"}, "maximum cannot merge; found .*; allowed float32")
            for dtype in (np.uint8, np.float16)
        ),
    ],
)
def test_what_cannot_be_composited_is_refused_alike_on_every_rank(
    images: Sequence[PartialImage], orders: Sequence[Sequence[int]] | None, options: dict[str, Any], text: str
) -> None:
    def run(channel: LoopbackChannel) -> str:
        order = orders[channel.rank] if orders else range(channel.size)
        with pytest.raises(InputError, match=text) as caught:
            composite(images[channel.rank], order, channel, **options)
        assert is_agreed(caught.value)
        return str(caught.value)

    assert len(set(run_loopback(len(images), run))) == 1


def test_images_outside_the_picture_and_memory_across_nodes_are_refused() -> None:
    with pytest.raises(InputError, match="outside the picture"):
        picture(LoopbackChannel(), Case(1, [0], [image_of(np.float32, x=4)], size=(5, 2)), "auto")

    def shared(channel: LoopbackChannel) -> str:
        with pytest.raises(InputError) as caught:
            Compositor(channel, (5, 2), transport="shared").composite(image_of(np.float32, x=4), range(4))
        assert is_agreed(caught.value)
        return str(caught.value)

    assert all("outside the picture" in text for text in run_loopback(4, shared))
    told = run_loopback(4, shared, ranks_per_node=2)
    assert all("across nodes" in text and "found shared" in text for text in told)
