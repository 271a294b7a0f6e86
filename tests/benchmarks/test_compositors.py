"""What the program that compares compositors says of its runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from composite_icet import Row, beside, goals, verdicts
from compositors import (
    Choice,
    Images,
    Runs,
    by_turns,
    error_levels,
    open_images,
    parse_choice,
    wire_bytes,
    write_noise,
)


def runs(*passes: tuple[float, float]) -> Runs:
    return Runs([{"min_ms": least, "median_ms": middle, "bytes_sent": [9]} for least, middle in passes])


def row(case: str, name: str, ratio: float, ratio_median: float) -> Row:
    return {"case": case, "program": name, "ratio": ratio, "ratio_median": ratio_median}


@pytest.mark.parametrize("text", ["direct-send/raw/messages", "auto/auto/shared/copy"])
def test_choice_is_read_as_it_is_written(text: str) -> None:
    assert str(parse_choice(text)) == text


@pytest.mark.parametrize("text", ["direct-send/raw", "direct-send", "a/b/shared/kopy", "a/b/shared/copy/copy"])
def test_choice_of_another_form_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"unpack|only /copy"):
        parse_choice(text)


def test_choice_is_a_key() -> None:
    assert len({Choice("a", "b", "c"), Choice("a", "b", "c"), Choice("a", "b", "c", copy=True)}) == 2


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
    assert wire_bytes({"bytes_sent": 7}) == 7  # IceT counts all ranks together


def test_programs_take_turns(tmp_path: Path) -> None:
    images, turns = write_noise(tmp_path, 1, (4, 3)), []

    def program(name: str) -> Row:
        turns.append(name)
        return {"min_ms": float(len(turns)), "median_ms": 1.0, "bytes_sent": [0]}

    def draw(name: str, out: Path) -> Row:
        out.write_bytes((tmp_path / "img_0.rgba").read_bytes())
        return program(name)

    found = by_turns(images, {name: lambda out, name=name: draw(name, out) for name in "ab"}, 2)  # type: ignore[misc]
    assert turns == ["a", "b", "a", "b"]
    assert (found["a"].min_ms, found["b"].min_ms, found["a"].levels) == (1.0, 2.0, 0.0)


def test_passes_become_the_least_of_all_and_the_median_of_medians() -> None:
    found = runs((3.0, 6.0), (1.0, 2.0), (2.0, 4.0))
    assert (found.min_ms, found.median_ms, found.bytes_sent) == (1.0, 4.0, 9)


def test_best_of_icet_counts_for_minima_and_for_medians_apart() -> None:
    found = beside("case", "ours", runs((3, 9)), {"bswap": runs((2, 6)), "tree": runs((1.5, 10))})
    assert (found["icet"], found["ratio"], found["ratio_median"]) == ("tree", 2.0, 1.5)


def test_goal_is_that_of_the_transport() -> None:
    ratios = [(0.4, 0.6), (0.5, 0.4), (0.9, 0.9)]
    shared, messages = (
        next(goals([row(str(i), f"auto/auto/{name}, openmpi", *pair) for i, pair in enumerate(ratios)]))
        for name in ("shared", "messages")
    )
    assert "≤ 0.5 of IceT's time in 2 of 3 cases by minima, 1 by medians; worst 0.90 (2)" in shared
    assert "≤ 1 of IceT's time in 3 of 3 cases by minima, 3 by medians" in messages


def test_auto_is_measured_by_the_best_fixed_choice_of_the_same_case() -> None:
    def measured(case: str, asked: str, ran: str, ms: float) -> Row:
        return {"case": case, "asked": asked, "ran": ran, "ms": ms, "off": 2.0}

    tree, send, window = "tree/raw/messages", "direct-send/raw/messages", "auto/raw/shared"
    rows = [measured("a", tree, tree, 2.0), measured("a", send, send, 1.0), measured("a", window, window, 0.5)]
    # Measured once more as what auto took, so that the same program is not slower than itself.
    rows += [measured("a", "auto/raw/messages", tree, 9.0), measured("a", "auto/raw/auto", window, 9.0)]
    assert list(verdicts(rows)) == [
        "- auto/raw/messages: within 1.15 of the best in 0 of 1 cases; worst 2.00",
        "- auto/raw/auto: within 1.15 of the best in 1 of 1 cases; worst 1.00",
        "- predictions: off by a factor of 2.00 (median), 2.00 (worst)",
    ]
