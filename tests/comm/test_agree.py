"""Agreement on errors: one failure ends every rank with the same message."""

from __future__ import annotations

import pytest

from clusterviz.comm import LoopbackChannel, abort_on_failure, agree, run_loopback
from clusterviz.comm.agree import is_agreed
from clusterviz.errors import ClustervizError, DataError, DeviceError, RankError, known

BUG, MISSING = ZeroDivisionError("division by zero"), DataError("no such file", where="a.npy")


def stage(channel: LoopbackChannel, fail: dict[int, Exception], name: str = "read") -> None:
    """One in which some ranks fail."""
    with agree(channel, 7, name):
        if channel.rank in fail:
            raise fail[channel.rank]


def errors_of(ranks: int, fail: dict[int, Exception]) -> list[ClustervizError]:
    """What each rank raises when some fail in their stage."""

    def run(channel: LoopbackChannel) -> ClustervizError:
        with pytest.raises(ClustervizError) as caught:
            stage(channel, fail)
        assert is_agreed(caught.value)
        return caught.value

    return run_loopback(ranks, run)


@pytest.mark.parametrize(
    ("ranks", "fail", "text", "status"),
    [
        (4, {2: BUG}, "rank 2, frame 7, read: ZeroDivisionError: division by zero", 1),
        (3, {1: MISSING}, "rank 1, frame 7, read: a.npy: no such file", 2),
        (3, {1: MemoryError(), 2: DeviceError("no EGL")}, f"rank 1, frame 7, read: {known(MemoryError())}", 2),
        (1, {0: MISSING}, "a.npy: no such file", 2),
        (3, dict.fromkeys(range(3), MISSING), "a.npy: no such file", 2),
    ],
    ids=["a bug", "bad input", "the lowest of several speaks", "bad input of one alone", "bad input of all"],
)
def test_what_fails_is_raised_by_all(ranks: int, fail: dict[int, Exception], text: str, status: int) -> None:
    errors = errors_of(ranks, fail)
    assert [(str(error), error.exit_status) for error in errors] == [(text, status)] * ranks
    assert {type(error) for error in errors} == {RankError if "rank" in text else DataError}
    if fail == {2: BUG}:
        assert [error.__cause__ for error in errors] == [None, None, BUG, None]


def test_nothing_is_raised_where_nothing_failed() -> None:
    def run(channel: LoopbackChannel) -> int:
        with agree(channel, 0, "draw"):
            return channel.rank
        raise AssertionError("the stage swallowed its result")

    assert run_loopback(3, run) == [0, 1, 2]


@pytest.mark.parametrize("before", [True, False])
def test_a_stage_may_exchange_what_an_inner_one_has_agreed_on(before: bool) -> None:
    def exchanging(channel: LoopbackChannel) -> None:
        with agree(channel, 1, "plan"):
            if before:
                stage(channel, {})
                channel.allgather(channel.rank)
            if channel.rank == 1:
                raise DataError("no such file", where="b.npy")
            stage(channel, {})
            channel.allgather(channel.rank)

    def run(channel: LoopbackChannel) -> RankError:
        with pytest.raises(RankError) as caught:
            exchanging(channel)
        return caught.value

    assert {error.exit_status for error in run_loopback(3, run)} == {2}


def test_an_error_agreed_on_passes_through_an_outer_stage() -> None:
    def run(channel: LoopbackChannel) -> str:
        with pytest.raises(RankError) as caught, agree(channel, 7, "outer"):
            stage(channel, {0: OSError("disk full")}, "inner")
        return str(caught.value)

    assert run_loopback(2, run) == ["rank 0, frame 7, inner: OSError: disk full"] * 2


def test_ctrl_c_is_not_agreed_on() -> None:
    with pytest.raises(KeyboardInterrupt), agree(LoopbackChannel(), 0, "draw"):
        raise KeyboardInterrupt


class _Recorder(LoopbackChannel):
    """Channel of several ranks that records the status it is aborted with."""

    status: int | None = None

    @property
    def size(self) -> int:
        return 2

    def abort(self, status: int) -> None:
        self.status = status


@pytest.mark.parametrize(
    ("error", "status", "text"),
    [
        (ValueError("odd"), 1, "clusterviz: rank 0, frame 3, composite: ValueError: odd\n"),
        (DataError("bad"), 2, "clusterviz: rank 0, frame 3, composite: bad\n"),
        (KeyboardInterrupt(), 130, "clusterviz: interrupted\n"),
        (errors_of(2, {0: OSError("disk full")})[1], None, ""),
    ],
    ids=["a bug", "bad input", "ctrl-c", "agreed"],
)
def test_an_unexpected_failure_aborts_with_one_message(
    error: BaseException, status: int | None, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    channel = _Recorder()
    with pytest.raises(type(error)), abort_on_failure(channel, 3, "composite"):
        raise error
    assert channel.status == status
    assert capsys.readouterr().err == text
