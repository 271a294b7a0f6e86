"""What the programs that compare compositors say of their runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from composite_icet import Row, Runs, automatic, beside, goals, summarise
from compositors import Choice, Images, error_levels, open_images, parse_choice, table, wire_bytes
from slow_link import Row as LinkRow
from slow_link import write_noise
from wire_bytes import Row as WireRow


def runs(name: str, min_ms: float, median_ms: float, mpi: str = "openmpi") -> Runs:
    return Runs((mpi, name), min_ms, median_ms, 0.5, 1_000_000)


def row(case: str, name: str, ratio: float, ratio_median: float) -> Row:
    return Row(case, runs(name, ratio, ratio_median), runs("bswap", 1, 1, ""), ratio, ratio_median)


@pytest.mark.parametrize("text", ["direct-send/raw/messages", "auto/auto/shared/copy"])
def test_choice_is_read_as_it_is_written(text: str) -> None:
    assert str(parse_choice(text)) == text


@pytest.mark.parametrize("text", ["direct-send/raw", "direct-send", "a/b/shared/kopy", "a/b/shared/copy/copy"])
def test_choice_of_another_form_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"unpack|only /copy"):
        parse_choice(text)


def test_folder_tells_its_ranks_and_size(tmp_path: Path) -> None:
    found = write_noise(tmp_path, 3, (7, 5))
    assert (found.ranks, found.size) == (3, (7, 5))
    assert found == open_images(tmp_path)


def test_noise_is_premultiplied_and_nowhere_blank(tmp_path: Path) -> None:
    write_noise(tmp_path, 1, (40, 30))
    pixels = np.fromfile(tmp_path / "img_0.rgba", np.uint8).reshape(30, 40, 4)
    assert pixels[..., 3].min() > 0
    assert (pixels[..., :3] <= pixels[..., 3:]).all()
    assert np.load(tmp_path / "exact.npy") == pytest.approx(pixels / 255, abs=1e-15)


def test_error_is_the_largest_of_all_channels_in_levels(tmp_path: Path) -> None:
    exact = np.full((2, 3, 4), 0.5)
    np.save(tmp_path / "exact.npy", exact)
    picture = np.full((2, 3, 4), 128, np.uint8)  # half a level too much
    picture[1, 2, 1] = 124  # 3.5 too few
    picture.tofile(tmp_path / "picture.rgba")
    assert error_levels(tmp_path / "picture.rgba", Images(tmp_path, "", 1, (3, 2))) == pytest.approx(3.5)


def test_gather_counts_where_it_is_told() -> None:
    assert wire_bytes({"bytes_sent": [3, 4]}) == 7
    assert wire_bytes({"bytes_sent": [3, 4], "bytes_collected": [0, 2]}) == 9


def test_table_has_as_many_columns_in_every_line() -> None:
    lines = table(["a | b", "c"], [["1 | 2", "3"]]).splitlines()
    assert lines == ["| a | b | c |", "| --- | --- | --- |", "| 1 | 2 | 3 |"]


def test_passes_become_the_least_of_all_and_the_median_of_medians() -> None:
    reports = [{"min_ms": m, "median_ms": 2 * m, "bytes_sent": 9} for m in (3.0, 1.0, 2.0)]
    assert summarise(("", "bswap"), reports, 1.5) == Runs(("", "bswap"), 1.0, 4.0, 1.5, 9)


def test_best_of_icet_counts_for_minima_and_for_medians_apart() -> None:
    found = beside("case", runs("x/raw/shared", 3, 9), [runs("bswap", 2, 6, ""), runs("tree", 1.5, 10, "")])
    assert found.icet.program[1] == "tree"
    assert (found.ratio, found.ratio_median) == (2.0, 1.5)


def test_goal_is_that_of_the_transport() -> None:
    ratios = [(0.4, 0.6), (0.5, 0.4), (0.9, 0.9)]
    shared, messages = (
        next(iter(goals([row(str(i), f"auto/auto/{name}", *pair) for i, pair in enumerate(ratios)])))
        for name in ("shared", "messages")
    )
    assert "≤ 0.5 of IceT's time in 2 of 3 cases by minima, 1 by medians; worst 0.90 (2)" in shared
    assert "≤ 1 of IceT's time in 3 of 3 cases by minima, 3 by medians" in messages


def test_auto_is_measured_by_the_best_fixed_choice_of_the_same_case() -> None:
    auto, fixed, other = "auto/auto/auto", "direct-send/raw/shared", "tree/raw/messages"
    rows = [row("a", auto, 1.1, 1), row("a", fixed, 1.0, 1), row("a", other, 2.0, 1)]
    rows += [row("b", auto, 1.3, 1), row("b", fixed, 2.0, 1), row("b", other, 1.0, 1)]
    assert list(automatic(rows)) == [f"- {auto}, openmpi: within 1.15 times the best fixed choice in 1 of 2 cases"]
    assert list(automatic([r for r in rows if r.ours.program[1] != auto])) == []


def test_auto_is_off_only_where_it_sends_exactly_the_raw_bytes() -> None:
    def told(sent: int) -> str:
        return LinkRow("case", "1", {"raw": 1.0, "auto": 1.0}, {"raw": 100, "auto": sent}).told

    assert [told(100), told(50)] == ["off", "0.50 of the bytes"]


def test_bytes_are_told_as_shares_of_raw_and_of_icet_s_fewest() -> None:
    found = WireRow(
        "case", "serial", {"raw": 4_000_000, "active": 1_000_000}, {"tree": 3_000_000, "bswap": 2_000_000}, True
    )
    assert found.cells == ["case", "serial", "4.00", "0.250", "2.00 (bswap)", "0.50 (active)"]


def test_choice_is_a_key() -> None:
    assert len({Choice("a", "b", "c"), Choice("a", "b", "c"), Choice("a", "b", "c", copy=True)}) == 2
