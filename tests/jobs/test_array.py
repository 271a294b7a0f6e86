"""Distributed arrays: boxes across blocks and ranks, atomic operations, files, and what is refused."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clusterviz.comm import Channel, LoopbackChannel, RemoteMemoryError, ThrottledChannel, run_loopback
from clusterviz.comm.mpi import MpiChannel
from clusterviz.comm.placement import RANKS_PER_NODE_VARIABLE
from clusterviz.data import open_source
from clusterviz.data.given import given_scene
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.data.vectors import VectorArray
from clusterviz.errors import ClustervizError, InputError, OutputError, is_agreed
from clusterviz.frame import Options, render_frame
from clusterviz.jobs import array as array_module
from clusterviz.jobs.array import DistributedArray, array_from
from clusterviz.report.machine import Memory

SHAPE = (7, 10, 13)
RANKS = (1, 2, 3, 5, 7)
NUMBERS = np.random.default_rng(1).normal(size=SHAPE).astype(np.float32)
NUMBERS[2, 3, 4] = np.nan


def boxes(count: int) -> list[Any]:
    """Random boxes in the array, also empty ones, from a fixed seed."""
    dice = np.random.default_rng(7)
    corners = [np.sort(dice.integers(0, np.array(SHAPE) + 1, (2, 3)), axis=0).tolist() for _ in range(count)]
    whole = [[0, 0, 0], list(SHAPE)]
    return [tuple(map(tuple, pair)) for pair in (*corners, whole, [[3, 3, 3], [3, 9, 9]])]


def slices(box: Any) -> tuple[slice, ...]:
    return tuple(map(slice, *box))


def check_boxes(channel: Channel, options: dict[str, Any]) -> list[bytes]:
    """Whatever is read is what a NumPy array holds; bytes of all boxes, the same on any ranks."""
    array = array_from(channel, ArraySource(NUMBERS), **options)
    found = [array.read(box) for box in boxes(8)]
    for box, values in zip(boxes(8), found, strict=True):
        assert np.array_equal(values, NUMBERS[slices(box)], equal_nan=True)
        held = array.bytes_by_rank(box)
        assert held.sum() == values.nbytes
    assert array.bytes_fetched + array.bytes_local == sum(values.nbytes for values in found)
    assert array.bytes_fetched == sum(
        int(array.bytes_by_rank(box).sum() - array.bytes_by_rank(box)[channel.rank]) for box in boxes(8)
    )
    array.sync()
    # Each rank writes its blocks with halos of 0; then all ranks add integers everywhere.
    for index, _ in list(array.own_blocks()):
        box = array.box(index)
        array.write(box, array.read(box) * 2 + 1)
    array.sync()
    assert np.array_equal(array[...], NUMBERS * 2 + 1, equal_nan=True)
    array.free()
    return [values.tobytes() for values in found]


def check_atomic(channel: Channel, options: dict[str, Any]) -> None:
    """All ranks change the same elements at once; nothing is lost."""
    total = DistributedArray(channel, SHAPE, np.int64, **options)
    low = DistributedArray(channel, SHAPE, np.float32, **options)
    low.fill(100)
    for turn in range(4):
        total.accumulate(((1, 2, 3), (6, 9, 12)), channel.rank + turn)
        low.accumulate(((0, 0, 0), SHAPE), NUMBERS + channel.rank, "min")
        while (before := total[0, 0, 0]) != total.compare_and_swap((0, 0, 0), before, before + 1):
            pass
    total.sync()
    low.sync()
    expected = np.zeros(SHAPE, np.int64)
    expected[1:6, 2:9, 3:12] = sum(rank + turn for rank in range(channel.size) for turn in range(4))
    expected[0, 0, 0] = 4 * channel.size
    assert np.array_equal(total[...], expected)
    assert np.array_equal(low[...], np.minimum(NUMBERS, 100), equal_nan=True)
    low.sync()
    nan = np.float32(np.nan)  # compared by its bits
    found = channel.allgather(low.compare_and_swap((2, 3, 4), nan, channel.rank))
    assert sum(map(np.isnan, found)) == 1
    total.free()
    low.free()


CASES: dict[str, dict[str, Any]] = {
    "cubes": {"blocks": 4},
    "one element a block": {"blocks": (1, 5, 1), "distribution": "interleaved"},
    "one block": {"blocks": 99},
    "in files": {"blocks": 3, "memory_limit": 500},
    "all in files": {"blocks": (2, 10, 3), "memory_limit": 0, "distribution": "interleaved"},
}


@pytest.mark.parametrize("case", CASES)
def test_boxes_are_those_of_a_numpy_array_on_any_ranks(case: str, tmp_path: Path) -> None:
    options = CASES[case] | {"spill": tmp_path}
    found = {ranks: run_loopback(ranks, lambda channel: check_boxes(channel, options)) for ranks in RANKS}
    assert all(one == found[1][0] for each in found.values() for one in each)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("case", ["cubes", "in files"])
@pytest.mark.parametrize("ranks", [1, 3, 5])
def test_changes_at_once_are_all_kept(ranks: int, case: str, tmp_path: Path) -> None:
    run_loopback(ranks, lambda channel: check_atomic(ThrottledChannel(channel, 1e9), CASES[case] | {"spill": tmp_path}))


@pytest.mark.mpi(ranks=[3], timeout=60)
def test_over_mpi(mpi_ranks: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Parts that ranks map, and parts behind MPI calls: on simulated nodes of two ranks."""
    bits = run_loopback(1, lambda channel: check_boxes(channel, {"blocks": 4}))[0]
    for ranks_per_node in ("", "2"):
        monkeypatch.setenv(RANKS_PER_NODE_VARIABLE, ranks_per_node) if ranks_per_node else None
        channel = MpiChannel()
        for options in (CASES["cubes"], CASES["in files"] | {"spill": tmp_path}):
            assert check_boxes(channel, options) == bits
            check_atomic(channel, options)
        channel.close()
    assert not list(tmp_path.iterdir())


def test_another_thread_calls_mpi_only_if_it_was_started_for_several() -> None:
    code = (
        "import threading; from clusterviz.comm.mpi import MpiChannel; from clusterviz.jobs import DistributedArray\n"
        "array = DistributedArray(MpiChannel({}), (2, 2, 2), int, 1); whole = ((0, 0, 0), (2, 2, 2))\n"
        "thread = threading.Thread(target=lambda: (print(array[...].sum()), array.accumulate(whole, 1)))\n"
        "thread.start(); thread.join(); print(array[...].sum()); array.free()"
    )
    refused = "ThreadError: MPI was not started for several threads; open the channel with several_threads=True"
    for given, printed, said in (("", "0\n0\n", refused), ("several_threads=True", "0\n8\n", "")):
        command = [sys.executable, "-c", code.format(given)]
        run = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        assert run.stdout == printed
        assert said in run.stderr


def test_components_keys_and_scalars() -> None:
    def check(channel: Channel) -> None:
        array = DistributedArray(channel, (*SHAPE, 3), np.float64, 4)
        vectors = np.random.default_rng(4).random((*SHAPE, 3))
        array.fill_from(VectorArray(vectors))
        assert np.array_equal(array[...], vectors)
        array.fill((1, 2, 3))
        assert array[2, 3, 4].tolist() == [1, 2, 3]
        if channel.rank == 0:
            array[-1, 2:5, :] = np.ones((3, 13, 3))
            array[1, ..., 4] = 8
        array.sync()
        expected = np.broadcast_to([1.0, 2, 3], (*SHAPE, 3)).copy()
        expected[-1, 2:5], expected[1, :, 4] = 1, 8
        assert np.array_equal(array[...], expected)
        assert array[5:2].shape == (0, 10, 13, 3)
        assert array.compare_and_swap((0, 0, 0, 1), 2.0, 7) == 2
        with pytest.raises(InputError, match="not a scalar volume"):
            array.as_source()

    run_loopback(1, check)
    run_loopback(3, lambda channel: check(channel) if channel.rank < 0 else None)


@pytest.mark.parametrize("case", ["cubes", "in files"])
def test_ordered_sums_of_floats_have_the_same_bits_on_any_ranks(case: str, tmp_path: Path) -> None:
    """40 contributions of very different size, from whichever rank has taken them, and one at once."""

    def run(channel: Channel) -> bytes:
        array = DistributedArray(channel, SHAPE, np.float32, **CASES[case], spill=tmp_path)
        dice = np.random.default_rng(3)
        for number in dice.permutation(40).tolist():
            values = np.random.default_rng(number).normal(size=(5, 8, 9)) * 10.0 ** (number % 7)
            if number % channel.size == channel.rank:
                array.accumulate(((1, 1, 1), (6, 9, 10)), values, order=number)
        before = array[...]
        array.sync()
        assert not before.any()
        found: bytes = array[...].tobytes()
        return found

    each = [bits for ranks in RANKS for bits in run_loopback(ranks, run)]
    expected = np.zeros(SHAPE, np.float32)
    for number in range(40):
        values = np.random.default_rng(number).normal(size=(5, 8, 9)) * 10.0 ** (number % 7)
        expected[1:6, 1:9, 1:10] += values.astype(np.float32)
    assert set(each) == {expected.tobytes()}


def test_a_saved_array_is_read_again(tmp_path: Path) -> None:
    """As .npy with components, and as a store with its grid, which another array does not continue."""
    grid = Grid(SHAPE, (1.0, 2.0, 3.0))

    def run(channel: Channel) -> None:
        array = array_from(channel, ArraySource(NUMBERS), 4)
        array.save(tmp_path / "a.zarr", grid)
        with pytest.raises(OutputError, match="something else is there"):
            array.save(tmp_path / "a.zarr", grid)
        with pytest.raises(OutputError, match=r"no such file of an array; allowed NAME.npy, NAME.zarr"):
            array.save(tmp_path / "a.tif")
        with pytest.raises(ClustervizError, match=r"rank 0, save: .*/nowhere is missing"):
            array.save(tmp_path / "nowhere" / "a.npy")
        vectors = DistributedArray(channel, (*SHAPE, 2), np.int16, 4)
        vectors.fill((1, 2))
        vectors.save(tmp_path / "v.npy")
        store = open_source(tmp_path / "a.zarr")
        again = array_from(channel, store, 5, distribution="interleaved")
        assert np.array_equal(again[...], NUMBERS, equal_nan=True)
        assert store.grid.spacing == grid.spacing

    run_loopback(3, run, timeout_seconds=300)  # kernels are compiled
    assert np.array_equal(np.load(tmp_path / "v.npy"), np.broadcast_to(np.array([1, 2], np.int16), (*SHAPE, 2)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zarr", "v.npy"]


def test_an_array_is_rendered_as_the_numpy_array(tmp_path: Path) -> None:
    """By the ranks that hold it, each reading its bricks, some of them in files."""
    values = np.random.default_rng(2).random((12, 11, 10)).astype(np.float32)

    def run(channel: Channel, held: Any) -> Any:
        scene, source = given_scene(held, None, {"size": (24, 20), "brick": 4}, "render")
        return render_frame(scene, channel, source, Options(device="cpu")).image

    def run_distributed(channel: Channel) -> Any:
        array = array_from(channel, ArraySource(values), 4, memory_limit=1000, spill=tmp_path)
        return run(channel, array.as_source())

    expected = run(LoopbackChannel(), values)
    assert expected.any()
    assert np.allclose(run_loopback(3, run_distributed)[0], expected, atol=1e-6)


REFUSED: dict[str, tuple[Callable[[DistributedArray], object], str]] = {
    "box outside": (lambda a: a.read(((0, 0, 0), (8, 1, 1))), r"no such box; found \(0, 0, 0\) to \(8, 1, 1\)"),
    "box upside down": (lambda a: a.write(((3, 0, 0), (2, 1, 1)), 0), "no such box"),
    "block": (lambda a: a.box((0, 3, 0)), r"no such block; found \(0, 3, 0\); allowed below \(2, 3, 4\)"),
    "shape": (lambda a: a.write(((0, 0, 0), (2, 2, 2)), np.zeros((2, 3, 2), np.int32)), "not of the box's shape"),
    "floats": (lambda a: a.accumulate(((0, 0, 0), (1, 1, 1)), 0.5), "not of the array's type; found float64; allowed"),
    "complex": (lambda a: a.accumulate(((0, 0, 0), (1, 1, 1)), 1j), "not of the array's type"),
    "text": (lambda a: a.accumulate(((0, 0, 0), (1, 1, 1)), "1"), "not of the array's type"),
    "too large": (lambda a: a.fill(2**40), "not of the array's type"),
    "operation": (lambda a: a.accumulate(((0, 0, 0), (1, 1, 1)), 1, "xor"), "found xor; allowed sum, min, max"),
    "element": (lambda a: a.compare_and_swap((7, 0, 0), 0, 1), "no such element"),
    "step": (lambda a: a[::2], "no such part of an array"),
    "source": (lambda a: a.fill_from(ArraySource(np.zeros((2, 2, 2)))), "not the shape of the array"),
    "source's type": (lambda a: a.fill_from(ArraySource(np.zeros(SHAPE))), "not of the array's type"),
    "grid": (lambda a: a.as_source(Grid((2, 2, 2))), "not the shape of the array"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_one_clear_error(case: str) -> None:
    use, text = REFUSED[case]

    def run(channel: Channel) -> None:
        use(DistributedArray(channel, SHAPE, np.int32, 4, name="a"))

    with pytest.raises(InputError, match=text) as caught:
        run_loopback(2, run)
    assert str(caught.value).startswith(("a: ", "accumulate: ", "array: "))


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"shape": (4, 4)}, "no shape of an array"),
        ({"shape": (4, 0, 4)}, "no shape of an array"),
        ({"dtype": np.complex64}, "not a scalar volume"),
        ({"blocks": 0}, "no blocks; found 0"),
        ({"distribution": "random"}, "found random; allowed coherent, interleaved"),
        (
            {"shape": (10**6,) * 3, "blocks": 50_000},
            r"does not fit into memory; found \d+ bytes for 3 of 3 ranks on node 0",
        ),
        ({"memory_limit": 0, "spill": "/nowhere"}, "No such file or directory while"),
    ],
)
def test_an_array_that_cannot_be_is_refused_on_all_ranks(options: dict[str, Any], text: str) -> None:
    """Also one far beyond memory, before anything is allocated."""

    def run(channel: Channel) -> str:
        with pytest.raises((InputError, RemoteMemoryError), match=text) as caught:
            DistributedArray(channel, **{"shape": (40, 40, 40), "dtype": np.float32, "blocks": 20} | options)
        assert is_agreed(caught.value)  # so that it is printed once
        return str(caught.value)

    assert len(set(run_loopback(3, run))) == 1


def test_memory_counts_all_ranks_of_a_node(monkeypatch: pytest.MonkeyPatch) -> None:
    """An array that fits into the free memory of a node once, but not with the shares of all its ranks."""
    monkeypatch.setattr(array_module, "memory", lambda: Memory(10**6, 10**6))

    def run(channel: Channel, side: int, **options: Any) -> None:
        DistributedArray(channel, (side, 100, 100), np.float32, 10, **options).free()

    run_loopback(3, lambda channel: run(channel, 20))
    with pytest.raises(InputError, match="found 1209600 bytes for 3 of 3 ranks on node 0; allowed 900000") as caught:
        run_loopback(3, lambda channel: run(channel, 30))
    assert is_agreed(caught.value)
    run_loopback(3, lambda channel: run(channel, 30, memory_limit=200_000))
