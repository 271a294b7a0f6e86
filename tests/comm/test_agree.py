"""Agreement on errors: one failure ends every rank with the same message."""

from __future__ import annotations

import pytest

from clusterviz.comm import LoopbackChannel, abort_on_failure, agree, run_loopback
from clusterviz.comm.agree import is_agreed
from clusterviz.errors import ClustervizError, DataError, DeviceError, RankError


def _errors(ranks: int, fail: dict[int, Exception]) -> list[ClustervizError]:
    """Return what each rank raises when some fail in their stage."""

    def run(channel: LoopbackChannel) -> ClustervizError:
        try:
            with agree(channel, 7, "read"):
                if channel.rank in fail:
                    raise fail[channel.rank]
        except ClustervizError as error:
            return error
        raise AssertionError("nothing was raised")

    errors = run_loopback(ranks, run)
    assert all(is_agreed(error) for error in errors)
    return errors


def test_nothing_is_raised_where_nothing_failed() -> None:
    def run(channel: LoopbackChannel) -> int:
        with agree(channel, 0, "draw"):
            return channel.rank
        raise AssertionError("the stage swallowed its result")

    assert run_loopback(3, run) == [0, 1, 2]


def test_a_bug_on_one_rank_is_raised_by_all_with_its_cause_chained() -> None:
    bug = ZeroDivisionError("division by zero")
    errors = _errors(4, {2: bug})
    assert {str(error) for error in errors} == {"rank 2, frame 7, read: ZeroDivisionError: division by zero"}
    assert {error.exit_status for error in errors} == {1}
    assert [error.__cause__ for error in errors] == [None, None, bug, None]


def test_bad_input_on_one_rank_keeps_its_exit_status() -> None:
    errors = _errors(3, {1: DataError("the file is truncated", where="head.nrrd")})
    assert {str(error) for error in errors} == {"rank 1, frame 7, read: head.nrrd: the file is truncated"}
    assert {error.exit_status for error in errors} == {2}


def test_the_lowest_of_several_failing_ranks_speaks() -> None:
    errors = _errors(3, {1: MemoryError(), 2: DeviceError("no EGL")})
    assert {str(error) for error in errors} == {"rank 1, frame 7, read: MemoryError"}


@pytest.mark.parametrize("ranks", [1, 3])
def test_bad_input_that_all_ranks_meet_comes_out_as_it_is(ranks: int) -> None:
    errors = _errors(ranks, {rank: DataError("no such file", where="a.npy") for rank in range(ranks)})
    assert [type(error) for error in errors] == [DataError] * ranks
    assert {str(error) for error in errors} == {"a.npy: no such file"}


def test_an_error_agreed_on_passes_through_an_outer_stage() -> None:
    def run(channel: LoopbackChannel) -> str:
        try:
            with agree(channel, 0, "outer"), agree(channel, 0, "inner"):
                if channel.rank == 0:
                    raise OSError("disk full")
        except RankError as error:
            return str(error)
        return "nothing was raised"

    assert run_loopback(2, run) == ["rank 0, frame 0, inner: OSError: disk full"] * 2


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
    ],
)
def test_an_unexpected_failure_aborts_with_one_message(
    error: BaseException, status: int, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    channel = _Recorder()
    with pytest.raises(type(error)), abort_on_failure(channel, 3, "composite"):
        raise error
    assert channel.status == status
    assert capsys.readouterr().err == text


def test_an_error_that_every_rank_raises_aborts_nobody() -> None:
    channel = _Recorder()
    error = _errors(2, {0: OSError("disk full")})[1]
    with pytest.raises(RankError), abort_on_failure(channel):
        raise error
    assert channel.status is None
