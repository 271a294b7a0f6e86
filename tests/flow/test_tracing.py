"""Lines of flows: orders of the integrators, ends, loops, seeds, and the same bits on any ranks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clusterviz.comm import run_loopback
from clusterviz.content.flow.section import Seeds, Trace
from clusterviz.data.source import Grid
from clusterviz.data.vectors import VectorArray, open_vectors
from clusterviz.errors import DataError, InputError
from clusterviz.flow.domain import split_box
from clusterviz.flow.tracing import Traced, trace

SEED = (0.5, 0.0, 0.0)


def _error_on_circle(vectors: Any, **settings: Any) -> float:
    """Largest distance of the end of a quarter turn from its place on the circle, by exact vectors."""
    traced = trace(vectors, [SEED], Trace(direction="forward", max_length=np.pi / 4, **settings), exact=True)
    return float(np.linalg.norm(traced.lines.points[-1] - (0, 0.5, 0)))


@pytest.mark.parametrize(("integrator", "order"), [("euler", 1), ("rk4", 4)])
def test_fixed_steps_have_their_order(integrator: str, order: int) -> None:
    vectors = open_vectors("field:rotation:8")
    errors = [_error_on_circle(vectors, integrator=integrator, step=step) for step in (0.4, 0.2, 0.1)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.abs(orders - order).max() < 0.35, orders


def test_rk45_keeps_its_tolerance() -> None:
    vectors = open_vectors("field:rotation:4")
    errors = [_error_on_circle(vectors, tolerance=tolerance) for tolerance in (1e-3, 1e-5, 1e-7)]
    assert all(error < tolerance for error, tolerance in zip(errors, (1e-3, 1e-5, 1e-7), strict=True)), errors
    assert errors[0] > errors[1] > errors[2]


def test_orbits_of_exact_vectors_stay_closed_for_ten_turns() -> None:
    ten = Trace(direction="forward", max_length=10 * np.pi, tolerance=1e-9)
    circle = trace(open_vectors("field:rotation:64"), [SEED], ten, exact=True, close=0)
    np.testing.assert_allclose(circle.lines.points[-1], SEED, atol=1e-6)
    long = Trace(direction="forward", max_length=25.0, tolerance=1e-9)
    points = trace(open_vectors("field:hill-vortex:64"), [(0.3, 0.1, 0.2)], long, exact=True, close=0).lines.points
    axial = (points[:, :2] ** 2).sum(axis=1)
    psi = axial * (0.64 - axial - points[:, 2] ** 2)
    assert (np.diff(np.sign(points[:, 2])) > 0).sum() >= 10  # turns
    # A change of ψ moves the orbit by as much, divided by its gradient, which is above 0.1 at the seed.
    assert np.abs(psi - psi[0]).max() < 1e-7


def test_loops_are_closed_and_limit_cycles_end() -> None:
    closed = trace(open_vectors("field:rotation:32"), [SEED])
    assert closed.ends == {"closed a loop": 2}
    np.testing.assert_array_equal(closed.lines.points[0], closed.lines.points[-1])
    np.testing.assert_allclose(closed.lines.point_attributes["time"][-1], 2 * np.pi, rtol=1e-3)
    grid = Grid((3, 65, 65), (1 / 32,) * 3, (-1, -1, -1 / 32))
    y, x = np.meshgrid(*[np.linspace(-1, 1, 65)] * 2, indexing="ij")
    pull = 0.5 * (1 - 2 * np.sqrt(x * x + y * y))
    plane = np.stack([-y + pull * x, x + pull * y, 0 * x], axis=-1).astype(np.float32)
    cycle = trace(VectorArray(np.stack([plane] * 3), grid), [(0.2, 0.0, 0.0)], Trace(direction="forward"))
    assert cycle.ends == {"ran into a loop": 1}
    assert len(cycle.lines.points) < 2000


def _box(vector: Any, where: Any = np.s_[:], shape: tuple[int, ...] = (8, 8, 8)) -> VectorArray:
    values = np.zeros((*shape, 3), np.float32)
    values[...] = (1, 0, 0)
    values[where] = vector
    return VectorArray(values)


def _sink() -> VectorArray:
    index = np.moveaxis(np.indices((8, 8, 8))[::-1], 0, -1)
    return VectorArray((3.3 - index).astype(np.float32))


@pytest.mark.parametrize(
    ("vectors", "settings", "end", "last"),
    [
        (_box((1, 0, 0)), {}, "left the data", (7, 3, 3)),
        (_box(np.nan, np.s_[:, :, 6:]), {}, "met a region without vectors", (5, 3, 3)),
        (_box(0, np.s_[:, :, 5:]), {}, "reached the least speed", (5, 3, 3)),
        (_sink(), {}, "reached the least speed", (3.3, 3.3, 3.3)),
        (_box((1, 0, 0)), {"max_length": 2.25}, "reached the largest length", (4.25, 3, 3)),
        (_box((1, 0, 0)), {"max_steps": 3, "integrator": "euler"}, "reached the most steps", (3.5, 3, 3)),
        (_box((0.5, 0, 0), np.s_[:, :, 4:]), {"min_speed": 0.75}, "reached the least speed", (3.5, 3, 3)),
        (_box((1, 0, 0), shape=(1, 8, 8)), {}, "left the data", (7, 3, 0)),
    ],
)
def test_lines_end_where_they_should(vectors: VectorArray, settings: Any, end: str, last: Any) -> None:
    seed = (2.0, 3.0, 0.0 if vectors.grid.shape_zyx[0] == 1 else 3.0)
    traced = trace(vectors, [seed], Trace(direction="forward", **settings))
    assert traced.ends == {end: 1}
    np.testing.assert_allclose(traced.lines.points[-1], last, atol=0.02)
    assert np.isfinite(traced.lines.points).all()


def test_seeds_without_a_line_are_counted() -> None:
    traced = trace(_box(0, np.s_[:4]), [(2, 3, 1), (2, 3, 6), (-1, 0, 0), (0, 0, 99)], Trace(direction="forward"))
    assert (traced.seeds, traced.seeds_outside) == (4, 2)
    assert traced.ends == {"left the data": 1, "reached the least speed": 1}
    np.testing.assert_array_equal(traced.lines.line_attributes["seed"], [1])
    assert "2 of 4 seeds lie outside the data" in traced.summary
    nothing = trace(_box((1, 0, 0)), [(99, 99, 99)])
    assert len(nothing.lines.offsets) == 1


def test_units_and_directions_of_grids() -> None:
    """On a turned grid with uneven steps a line goes where the world's vectors say, in the same time."""
    grid = Grid((9, 9, 9), (0.1, 0.2, 0.4), (5.0, 6.0, 7.0), ((0, -1, 0), (1, 0, 0), (0, 0, 1)))
    values = np.broadcast_to(np.float32((0.0, 2.0, 1.0)), (9, 9, 9, 3))
    start = np.array((4.9, 6.1, 7.1))
    traced = trace(VectorArray(values, grid), [start], Trace(direction="forward", max_length=0.5))
    end, time = traced.lines.points[-1], traced.lines.point_attributes["time"][-1]
    np.testing.assert_allclose(end, start + 0.5 / 5**0.5 * np.array((0, 2, 1)), atol=1e-6)
    np.testing.assert_allclose(time, 0.5 / 5**0.5, rtol=1e-6)
    np.testing.assert_allclose(traced.lines.point_attributes["speed"], 5**0.5, rtol=1e-6)


def _turning() -> VectorArray:
    """Uniform flow along (1, t, 0), linear in time, so that its interpolation is exact."""
    steps = np.zeros((4, 12, 12, 12, 3), np.float32)
    for time, step in enumerate(steps):
        step[...] = (1, time, 0)
    return VectorArray(steps, times=(0.0, 1.0, 2.0, 3.0))


def test_pathlines_follow_vectors_that_change() -> None:
    traced = trace(_turning(), [(1, 1, 5)], Trace(tolerance=1e-9), "pathlines")
    assert traced.ends == {"reached the end of the time": 1}
    time = traced.lines.point_attributes["time"]
    assert time[-1] == 3
    exact = np.stack([1 + time, 1 + time**2 / 2, 5 + 0 * time], axis=1)
    np.testing.assert_allclose(traced.lines.points, exact, atol=1e-6)
    half = trace(_turning(), [(1, 1, 5)], Trace(duration=1.5), "pathlines", first_step=1)
    np.testing.assert_allclose(half.lines.points[-1], (2.5, 1 + (2.5**2 - 1) / 2, 5), atol=1e-6)


def test_streaklines_join_particles_of_one_seed() -> None:
    traced = trace(_turning(), [(1, 1, 5), (3, 1, 5)], Trace(tolerance=1e-9, release=0.5), "streaklines")
    assert traced.lines.offsets.tolist() == [0, 7, 14]
    released = traced.lines.point_attributes["time"][:7]
    np.testing.assert_allclose(released, np.arange(3, -0.1, -0.5))
    exact = np.stack([4 - released, 1 + (9 - released**2) / 2, 5 + 0 * released], axis=1)
    np.testing.assert_allclose(traced.lines.points[:7], exact, atol=1e-6)


@pytest.mark.parametrize(
    ("vectors", "settings", "kind", "step", "message"),
    [
        ("field:abc:8", {}, "streaklines", None, "a steady flow has no end of time"),
        ("field:double-gyre:8:3", {"duration": 11.0}, "pathlines", None, "the time steps end before"),
        ("field:double-gyre:8:3", {}, "pathlines", 2, "the time steps end before"),
        ("field:double-gyre:8:3", {}, "streamlines", 3, "no such time step"),
    ],
)
def test_times_that_are_not_there_are_refused(vectors: str, settings: Any, kind: Any, step: Any, message: str) -> None:
    with pytest.raises((InputError, DataError), match=message):
        trace(open_vectors(vectors), [SEED], Trace(**settings), kind, first_step=step)


@pytest.mark.parametrize(
    "seeds",
    [
        Seeds(kind="plane", center=(0, 0, 0.5), normal=(0, 0, 2), radius=0.5, count=300),
        Seeds(kind="sphere", center=(0.1, 0, 0), radius=0.3, count=300),
        Seeds(kind="random", begin=(-1, 0, 0), end=(0, 1, 1), count=300),
        Seeds(kind="line", begin=(-1, 0, 0), end=(1, 0, 0), count=5),
        Seeds(kind="speed", count=300),
    ],
)
def test_seeds_lie_where_they_should(seeds: Seeds) -> None:
    still = Trace(max_steps=1, direction="forward")
    traced = trace(open_vectors("field:shear:16"), seeds, still)
    points = traced.lines.points[traced.lines.offsets[:-1]]
    checks: dict[str, Any] = {
        "plane": lambda p: (np.abs(p[:, 2] - 0.5) < 1e-12).all() and np.linalg.norm(p[:, :2], axis=1).max() <= 0.5,
        "sphere": lambda p: np.linalg.norm(p - (0.1, 0, 0), axis=1).max() <= 0.3,
        "random": lambda p: (
            ((p >= (-1, 0, 0)) & (p <= (0, 1, 1))).all() and np.abs(p.mean(0) - (-0.5, 0.5, 0.5)).max() < 0.06
        ),
        "line": lambda p: True,
        "speed": lambda p: np.abs(np.abs(p[:, 1]).mean() - 2 / 3) < 0.04,  # density |y|
    }
    assert checks[seeds.kind](points)
    assert traced.seeds == seeds.count


def _same(one: Traced, other: Traced) -> None:
    for name in ("points", "offsets"):
        np.testing.assert_array_equal(getattr(one.lines, name), getattr(other.lines, name))
    for name, values in one.lines.point_attributes.items():
        np.testing.assert_array_equal(values, other.lines.point_attributes[name])
    assert (one.ends, one.seeds_outside, one.steps) == (other.ends, other.seeds_outside, other.steps)


KINDS: Any = (
    ("field:abc:20", Trace(), "streamlines"),
    ("field:double-gyre:20:5", Trace(), "pathlines"),
    ("field:double-gyre:20:5", Trace(release=0.5), "streaklines"),
)


@pytest.mark.cover
@pytest.mark.parametrize(("name", "settings", "kind"), KINDS)
@pytest.mark.parametrize("ranks", [2, 3, 5, 7])
def test_lines_do_not_depend_on_ranks(name: str, settings: Trace, kind: Any, ranks: int) -> None:
    vectors, seeds = open_vectors(name), Seeds(kind="speed", count=24)
    alone = trace(vectors, seeds, settings, kind)
    for over in ("data", "seeds"):
        each = run_loopback(
            ranks,
            lambda channel, over=over: trace(vectors, seeds, settings, kind, channel=channel, over=over, threads=1),
        )
        for one in each:
            _same(alone, one)
        assert (each[0].bytes_handed_over > 0) == (over == "data")
        assert each[0].bytes_handed_over % (8 * 26) == 0


def test_blocks_cover_all_cells_once() -> None:
    for ranks in (1, 3, 7, 40):
        covered = np.zeros((3, 4, 2), int)
        for begin, end in split_box((3, 4, 2), ranks):
            covered[tuple(slice(b, e) for b, e in zip(begin, end, strict=True))] += 1
        assert (covered == 1).all()


@pytest.mark.mpi(ranks=[3], timeout=120)
def test_lines_are_the_same_under_mpirun(mpi_ranks: int) -> None:
    from clusterviz.comm import open_channel

    vectors, seeds = open_vectors("field:abc:20"), Seeds(count=24)
    _same(trace(vectors, seeds), trace(vectors, seeds, channel=open_channel(), over="data"))


@pytest.mark.fresh
@pytest.mark.parametrize("how", ["raise", "kill"])
def test_a_rank_that_fails_while_particles_are_handed_over_ends_the_job(how: str) -> None:
    command = ["mpirun", "-n", "3", sys.executable, str(Path(__file__).parent / "failing_job.py"), how]
    job = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert job.returncode != 0
    assert "Traceback" not in job.stderr
    if how == "raise":
        assert job.stderr.count("clusterviz: rank 1, tracing lines: ValueError: odd") == 1
