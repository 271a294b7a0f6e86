from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
from data.checks import DTYPES, check_summary, values
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.memory import ArraySource
from clusterviz.data.order_statistics import keys_of, values_of
from clusterviz.data.summary import PERCENTILES, VolumeSummary, summarise


def summary_of(array: NDArray[Any], brick: int = 3, **options: Any) -> VolumeSummary:
    layout = BrickLayout(array.shape, brick)
    held = list(read_bricks(ArraySource(array), layout, np.ndindex(*layout.counts_zyx)))
    return summarise(array.dtype, layout, lambda: iter(held), lambda value: [value], **options)


def summaries_of_ranks(array: NDArray[Any], brick: int, ranks: int) -> list[VolumeSummary]:
    """Summarise with the bricks assigned round-robin to ranks, each a thread."""
    layout, barrier = BrickLayout(array.shape, brick), threading.Barrier(ranks, timeout=60)
    board: list[Any] = [None] * ranks
    results: list[VolumeSummary | None] = [None] * ranks

    def run(rank: int) -> None:
        def allgather(value: Any) -> list[Any]:
            board[rank] = value
            barrier.wait()
            shared = list(board)
            barrier.wait()
            return shared

        mine = list(np.ndindex(*layout.counts_zyx))[rank::ranks]
        source = ArraySource(array)
        results[rank] = summarise(array.dtype, layout, lambda: read_bricks(source, layout, mine), allgather)

    threads = [threading.Thread(target=run, args=(rank,)) for rank in range(ranks)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return [result for result in results if result is not None]


def check_against_numpy(array: NDArray[Any], summary: VolumeSummary) -> None:
    """Check percentiles to a rounding error of float64, and counts exactly."""
    finite = array[np.isfinite(array)]
    scale = max(abs(float(finite.min())), abs(float(finite.max())))
    for q in (0, 100, *PERCENTILES):
        with np.errstate(over="ignore"):
            expected = np.percentile(finite.astype(np.float64) / 4, q) * 4  # a quarter, lest NumPy overflow
        assert summary.percentile(q) == pytest.approx(expected, rel=1e-12, abs=1e-15 * scale)
    assert summary.value_range == (float(finite.min()), float(finite.max()))
    assert summary.histogram.sum() == finite.size
    assert summary.histogram.dtype == np.int64


@pytest.mark.parametrize("dtype", DTYPES)
def test_every_type_over_its_whole_range_and_in_a_narrow_one(dtype: str) -> None:
    array = values(dtype, (7, 8, 9))
    check_against_numpy(array, summary_of(array))
    array = np.random.default_rng(3).integers(3, 90, (7, 8, 9)).astype(dtype)
    summary = summary_of(array, bins=10)
    check_against_numpy(array, summary)
    np.testing.assert_array_equal(summary.histogram, np.histogram(array.astype(float), 10)[0])


@settings(deadline=None, max_examples=40)
@given(
    st.sampled_from(["u1", "i2", "i8", "f4", "f8"]).flatmap(
        lambda dtype: hnp.arrays(np.dtype(dtype), st.tuples(*[st.integers(1, 6)] * 3))
    ),
    st.integers(1, 7),
)
def test_any_array_against_numpy(array: NDArray[Any], brick: int) -> None:
    if np.isfinite(array).any():
        check_against_numpy(array, summary_of(array, brick))
    check_summary(summary_of(array, brick), summary_of(array, 2), bricks_too=False)


@pytest.mark.parametrize(("dtype", "ranks"), [("u1", 40), ("i4", 3), ("f4", 2), ("f4", 7), ("f8", 3)])
def test_neither_ranks_nor_bricks_show(dtype: str, ranks: int) -> None:
    array = values(dtype, (7, 8, 9))
    alone = summary_of(array, 3)
    for brick in (3, 4):
        results = summaries_of_ranks(array, brick, ranks)
        assert len(results) == ranks
        for result in results:
            check_summary(result, alone, bricks_too=brick == 3)


def test_bricks_are_summarised_with_their_overlap() -> None:
    array = np.arange(5 * 5 * 5, dtype=np.float32).reshape(5, 5, 5)
    array[2, 2, 2] = np.nan
    array[4, 4, 4] = np.inf
    summary = summary_of(array, 2)
    assert summary.minimum.shape == (2, 2, 2)
    for index in np.ndindex(2, 2, 2):
        z, y, x = (2 * i for i in index)
        part = array[z : z + 3, y : y + 3, x : x + 3]
        finite = part[np.isfinite(part)]
        assert summary.minimum[index] == finite.min()
        assert summary.maximum[index] == finite.max()
    assert summary.histogram.sum() == 123


def test_outliers_do_not_blur_percentiles() -> None:
    array = np.random.default_rng(0).random((20, 20, 20)).astype(np.float32)
    array[0, 0, :3], array[0, 1, :2] = 1e30, -1e30
    summary = summary_of(array, 8)
    check_against_numpy(array, summary)
    assert 0 < summary.percentile(1) < 0.02
    assert 0.98 < summary.percentile(99) < 1


@pytest.mark.parametrize("value", [0.0, -0.0, 7.5, -3e38, 1e-40])
def test_a_constant_volume(value: float) -> None:
    summary = summary_of(np.full((4, 5, 6), value, np.float32), 2, bins=4)
    assert {found for _, found in summary.percentiles} == {float(np.float32(value))}
    assert summary.histogram.tolist() == [120, 0, 0, 0]
    one = summary_of(np.full((1, 1, 1), value, np.float32), 64)
    assert one.percentile(1) == one.percentile(99) == float(np.float32(value))
    assert one.histogram.sum() == 1


@pytest.mark.parametrize("invalid", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", ["f2", "f4", "f8"])
def test_nothing_finite(dtype: str, invalid: float) -> None:
    for summary in summaries_of_ranks(np.full((3, 4, 5), invalid, dtype), 2, 3):
        assert (summary.minimum == np.inf).all()
        assert (summary.maximum == -np.inf).all()
        assert summary.histogram.sum() == 0
        assert (summary.percentile(0), summary.percentile(100)) == (0, 1)
        assert summary.value_range == (0, 1)


def test_only_what_was_counted_is_told() -> None:
    array = values("f4", (7, 8, 9))
    summary = summary_of(array, percentiles=(33.3,))
    assert [q for q, _ in summary.percentiles] == [0, 33.3, 100]
    with pytest.raises(ValueError, match="percentile 50 was not counted"):
        summary.percentile(50)


def test_bricks_that_do_not_make_up_the_volume() -> None:
    layout = BrickLayout((4, 4, 4), 2)
    held = list(read_bricks(ArraySource(np.zeros((4, 4, 4))), layout, np.ndindex(*layout.counts_zyx)))
    for wrong in (held[1:], [*held, held[0]]):
        with pytest.raises(ValueError, match="the volume 64"):
            summarise(np.dtype(float), layout, lambda wrong=wrong: iter(wrong), lambda value: [value])


@pytest.mark.parametrize("dtype", DTYPES)
def test_keys_are_ordered_as_samples_and_lead_back(dtype: str) -> None:
    samples = values(dtype, (500,))
    samples = np.sort(samples[np.isfinite(samples)])
    keys = keys_of(samples)
    assert (keys[1:] >= keys[:-1]).all()
    np.testing.assert_array_equal(values_of(keys, samples.dtype), samples.astype(np.float64))
