"""The picture equals the serial one in float64, whatever the ranks, the algorithm, the order and the footprints."""

from __future__ import annotations

import numpy as np
import pytest
from composite.images import composite_all, over_all, random_partial, random_rect, worst_error
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.comm.agree import is_agreed
from clusterviz.composite import ALGORITHMS, collect, composite
from clusterviz.errors import InputError
from clusterviz.image.partial import PartialImage, blank
from clusterviz.image.region import EMPTY, Rect

NAMES = list(ALGORITHMS)


def _bound(dtype: type, ranks: int) -> float:
    """float32: n·2⁻²³. Bytes: half a level for each of at most n − 1 merges."""
    return max(ranks, 2) * 2.0**-23 if dtype is np.float32 else 0.5 * (ranks - 1) + 0.01


@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
@pytest.mark.parametrize("algorithm", NAMES)
@pytest.mark.parametrize("ranks", range(1, 17))
def test_odd_process_counts(ranks: int, algorithm: str, dtype: type) -> None:
    rng = np.random.default_rng(ranks)
    partials = [random_partial(rng, random_rect(rng, (23, 17)), dtype) for _ in range(ranks)]
    order = [int(rank) for rank in rng.permutation(ranks)]
    assert worst_error(partials, order, (23, 17), algorithm) <= _bound(dtype, ranks)


@pytest.mark.parametrize("algorithm", NAMES)
@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (2, 1), (37, 3)])
def test_odd_image_sizes_and_more_ranks_than_pixels(size: tuple[int, int], algorithm: str) -> None:
    rng = np.random.default_rng(1)
    partials = [random_partial(rng, Rect(0, 0, *size), np.float32) for _ in range(11)]
    assert worst_error(partials, range(11), size, algorithm) <= _bound(np.float32, 11)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_random_footprints_orders_and_roots(data: st.DataObject) -> None:
    ranks = data.draw(st.integers(1, 9), label="ranks")
    size = data.draw(st.tuples(st.integers(1, 12), st.integers(1, 12)), label="size")
    xs = st.tuples(st.integers(0, size[0]), st.integers(0, size[0])).map(sorted)
    ys = st.tuples(st.integers(0, size[1]), st.integers(0, size[1])).map(sorted)
    rects = [
        Rect(x[0], y[0], x[1], y[1]) for x, y in data.draw(st.lists(st.tuples(xs, ys), min_size=ranks, max_size=ranks))
    ]
    order = data.draw(st.permutations(range(ranks)), label="order")
    root = data.draw(st.integers(0, ranks - 1), label="root")
    dtype = data.draw(st.sampled_from([np.float32, np.uint8]), label="dtype")
    algorithm = data.draw(st.sampled_from(NAMES), label="algorithm")
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1), label="seed"))
    partials = [random_partial(rng, rect, dtype) for rect in rects]
    made = composite_all(partials, order, size, algorithm, root)
    assert made.dtype == dtype
    assert np.abs(made - over_all(partials, order, size)).max() <= _bound(dtype, ranks)


@pytest.mark.parametrize("algorithm", NAMES)
def test_blank_images(algorithm: str) -> None:
    made = composite_all([blank()] * 5, range(5), (7, 4), algorithm)
    assert made.shape == (4, 7, 4)
    assert not made.any()


@pytest.mark.parametrize("algorithm", NAMES)
@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
def test_all_but_one_blank_sends_nothing(algorithm: str, dtype: type) -> None:
    seen = random_partial(np.random.default_rng(3), Rect(2, 1, 6, 4), dtype)
    partials = [seen if rank == 3 else blank() for rank in range(5)]
    made = composite_all(partials, range(5), (7, 5), algorithm)
    assert np.array_equal(made[1:4, 2:6], seen.rgba)
    assert np.count_nonzero(made) == np.count_nonzero(seen.rgba)
    counted = run_loopback(5, lambda c: composite(partials[c.rank], range(5), c, algorithm)[1])
    assert [c.participants for c in counted] == [1] * 5
    assert sum(c.total.messages_sent for c in counted) == 0


def test_footprints_that_do_not_meet_send_no_empty_message() -> None:
    rng = np.random.default_rng(4)
    partials = [random_partial(rng, Rect(0, 4 * rank, 8, 4 * rank + 4), np.float32) for rank in range(4)]
    counted = run_loopback(4, lambda c: composite(partials[c.rank], range(4), c, "direct-send")[1])
    assert [c.total.messages_sent for c in counted] == [0] * 4


@pytest.mark.parametrize("algorithm", NAMES)
def test_dense_images_move_what_theory_says(algorithm: str) -> None:
    rng = np.random.default_rng(5)
    partials = [random_partial(rng, Rect(0, 0, 12, 10), np.uint8) for _ in range(6)]
    counted = run_loopback(6, lambda c: composite(partials[c.rank], range(6), c, algorithm)[1])
    theory = ALGORITHMS[algorithm](6, 120, ()).counts()
    assert sum(c.total.messages_sent for c in counted) == theory.messages
    assert sum(c.total.pixels_sent for c in counted) == theory.pixels == 5 * 120
    assert sum(c.total.bytes_sent for c in counted) == 4 * theory.pixels


@pytest.mark.parametrize("algorithm", NAMES)
def test_non_contiguous_and_read_only_images_are_taken_and_not_changed(algorithm: str) -> None:
    rng = np.random.default_rng(6)
    rect = Rect(0, 0, 9, 6)
    whole = [random_partial(rng, Rect(0, 0, 18, 6), np.float32).rgba for _ in range(5)]
    partials = [PartialImage(rect, rgba[:, ::2]) for rgba in whole[:3]]
    partials += [PartialImage(rect, rgba[:, ::2].copy()) for rgba in whole[3:]]
    before = [partial.rgba.copy() for partial in partials]
    assert worst_error(partials, range(5), (9, 6), algorithm) <= _bound(np.float32, 5)
    assert all(np.array_equal(a, b.rgba) for a, b in zip(before, partials, strict=True))


def test_order_of_arrival_does_not_change_a_bit() -> None:
    rng = np.random.default_rng(7)
    partials = [random_partial(rng, random_rect(rng, (31, 29)), np.float32) for _ in range(12)]
    made = [composite_all(partials, range(12), (31, 29), "direct-send") for _ in range(5)]
    assert all(np.array_equal(made[0], other) for other in made[1:])


def _failures(partials: list[PartialImage], order: list[int], algorithm: str = "auto") -> list[str]:
    def run(channel: LoopbackChannel) -> str:
        with pytest.raises(InputError) as caught:
            composite(partials[channel.rank], order, channel, algorithm)
        assert is_agreed(caught.value)
        return str(caught.value)

    return run_loopback(len(partials), run)


def test_mixed_pixel_types_are_refused_on_every_rank() -> None:
    rng = np.random.default_rng(8)
    partials = [random_partial(rng, Rect(0, 0, 2, 2), t) for t in (np.float32, np.uint8, np.float32)]
    assert _failures(partials, [0, 1, 2]) == ["partial images differ in pixel type; found float32, uint8"] * 3


@pytest.mark.parametrize("dtype", [np.float64, np.int32, np.int16, ">f4"])
def test_a_wrong_dtype_is_refused_on_every_rank(dtype: str) -> None:
    partials = [PartialImage(Rect(0, 0, 2, 2), np.zeros((2, 2, 4), d)) for d in (np.float32, dtype)]
    texts = _failures(partials, [0, 1])
    assert texts[0] == texts[1]
    assert "rank 1" in texts[0]
    assert str(np.dtype(dtype)) in texts[0]


def test_a_wrong_shape_is_refused_on_every_rank() -> None:
    partials = [PartialImage(Rect(0, 0, 2, 2), np.zeros((2, w, 4), np.uint8)) for w in (2, 3)]
    assert "(2, 3, 4)" in _failures(partials, [0, 1])[0]


@pytest.mark.parametrize("order", [[0, 0], [0], [0, 1, 2], [1, 2]])
def test_an_order_that_is_no_permutation_is_refused(order: list[int]) -> None:
    assert "no permutation of 2" in _failures([blank(), blank()], order)[1]


def test_orders_that_differ_are_refused() -> None:
    def run(channel: LoopbackChannel) -> None:
        with pytest.raises(InputError, match="ranks 0 and 1 give different"):
            composite(blank(), [[0, 1], [1, 0]][channel.rank], channel)

    run_loopback(2, run)


def test_unknown_names_are_refused() -> None:
    assert f"allowed {', '.join(NAMES)}, auto" in _failures([blank()], [0], "swap")[0]
    with pytest.raises(InputError, match="unknown codec"):
        composite(blank(), [0], LoopbackChannel(), codec="zip")


def test_a_canvas_outside_the_picture_is_refused() -> None:
    channel = LoopbackChannel()
    piece, _ = composite(PartialImage(Rect(3, 0, 6, 2), np.zeros((2, 3, 4), np.float32)), [0], channel)
    with pytest.raises(InputError, match="outside the picture"):
        collect(piece, (5, 2), channel)


def test_an_empty_rectangle_of_any_kind_is_empty() -> None:
    partials = [PartialImage(Rect(5, 5, 2, 9), np.zeros((4, 0, 4), np.float32)), blank()]
    assert partials[1].rect == EMPTY
    assert not composite_all(partials, [1, 0], (3, 3), "auto").any()


@pytest.mark.parametrize("algorithm", NAMES)
def test_writable_images_of_odd_footprints_are_not_changed(algorithm: str) -> None:
    rng = np.random.default_rng(16)
    drawn = [random_partial(rng, random_rect(rng, (23, 17)), np.float32) for _ in range(16)]
    partials = [PartialImage(partial.rect, partial.rgba.copy()) for partial in drawn]
    composite_all(partials, range(16), (23, 17), algorithm)
    assert all(np.array_equal(a.rgba, b.rgba) for a, b in zip(drawn, partials, strict=True))
