"""The simulator counts what schedules count, predicts by its formula, and refuses what it cannot do."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from clusterviz.composite import ALGORITHMS, Schedule
from clusterviz.composite.model.network import Network, open_network
from clusterviz.composite.schedules import pipeline
from clusterviz.composite.simulation.drawing import MOST_RANKS as MOST_DRAWN
from clusterviz.composite.simulation.drawing import write_drawing
from clusterviz.composite.simulation.simulate import Options, simulate
from clusterviz.errors import InputError

PLAIN = Network("plain", "made up", 1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("footprints", ["dense", "cubes"])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_algorithm_can_be_simulated(algorithm: str, footprints: str) -> None:
    for ranks in (1, 2, 13, 64):
        made = simulate(algorithm, ranks, (96, 80), PLAIN, footprints=footprints, bytes_per_pixel=4)
        counts = ALGORITHMS[algorithm](ranks, 96 * 80, ()).counts()
        assert made.bytes_sent == 4 * made.pixels_sent
        assert made.seconds == made.rounds
        if footprints == "dense":
            found = (made.messages_sent, made.pixels_sent, made.rounds)
            assert found == (counts.messages, counts.pixels, counts.rounds)
        else:
            assert made.pixels_sent <= counts.pixels


@pytest.mark.cover("pipeline", "radix-k")
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_65536_ranks(algorithm: str) -> None:
    made = simulate(algorithm, 65_536, (4096, 4096), PLAIN)
    assert made.pixels_sent == 65_535 * 4096 * 4096
    if algorithm in ("direct-send", "slic", "parallel-pipeline"):
        assert made.messages_sent == 65_536 * 65_535


def test_each_constant_of_the_time_model_counts_what_it_should() -> None:
    load = ALGORITHMS["tree"](5, 100, ()).counts()
    for index, wanted in enumerate((3.0, 3.0, 300 * 4.0, 300.0)):
        constants = [float(index == number) for number in range(4)]
        assert Network("", "", *constants).seconds(load, 4) == wanted


def test_the_worst_rank_of_a_serial_gather_is_the_root() -> None:
    made = simulate("serial", 9, (10, 10), open_network("laptop"))
    assert (made.worst_rank, made.worst_rank_messages_received, made.worst_rank_pixels_received) == (0, 8, 800)


def test_options_reach_their_algorithms() -> None:
    assert simulate("radix-k", 12, (50, 50), PLAIN, options=Options(factors=(3, 4))).rounds == 2
    assert simulate("direct-send", 12, (50, 50), PLAIN, options=Options(owners=3)).messages_sent == 3 * 11
    banded = simulate("direct-send", 12, (50, 50), PLAIN, footprints="cubes", options=Options(bands=4))
    assert banded.messages_sent > simulate("direct-send", 12, (50, 50), PLAIN, footprints="cubes").messages_sent
    assert simulate("pipeline", 12, (50, 50), PLAIN, options=Options(batches=7)).messages_sent == 7 * 11


@pytest.mark.parametrize(
    ("arguments", "keys", "text"),
    [
        (("swap", 4), {}, "unknown compositing algorithm"),
        (("tree", 0), {}, "so many ranks; found 0; allowed 1 to 65536"),
        (("tree", 65_537), {}, "so many ranks"),
        (("slic", 4097), {"footprints": "cubes"}, "of sparse images on so many ranks; found 4097; allowed 1 to 4096"),
        (("tree", 4), {"footprints": "balls"}, "unknown footprints"),
        (("direct-send", 4), {"options": Options(owners=5)}, "owners"),
        (("direct-send", 4), {"options": Options(owners=5), "footprints": "cubes"}, "owners"),
        *(
            (("tree", 4), {"options": options}, "does not have")
            for options in (Options(factors=(2, 2)), Options(owners=2), Options(bands=2), Options(batches=2))
        ),
    ],
)
def test_what_cannot_be_simulated_is_refused(arguments: tuple[str, int], keys: dict[str, Any], text: str) -> None:
    with pytest.raises(InputError, match=text):
        simulate(*arguments, (64, 64), PLAIN, **keys)


def test_a_drawing_has_a_line_for_each_transfer(tmp_path: Path) -> None:
    schedule = ALGORITHMS["2-3-swap"](7, 1000, ())
    write_drawing(schedule, str(tmp_path / "s.svg"), "2 < 3")
    root = ElementTree.parse(tmp_path / "s.svg").getroot()
    drawn = [line[0].text or "" for line in root.iter("{http://www.w3.org/2000/svg}line")]
    assert len(drawn) == len(set(drawn)) == sum(len(stage) for stage in schedule.stages) == 28
    assert drawn[0].startswith("round 1: ")
    write_drawing(ALGORITHMS["tree"](8, 100, ()), str(tmp_path / "s.png"), "tree")
    assert (np.asarray(Image.open(tmp_path / "s.png")) < 250).any(axis=-1).sum() > 500


@pytest.mark.parametrize(
    ("schedule", "name", "text"),
    [
        (ALGORITHMS["tree"](2, 100, ()), "s.pdf", "such a file"),
        (ALGORITHMS["tree"](MOST_DRAWN + 1, 100, ()), "s.svg", "too many ranks"),
        (pipeline.schedule(64, 10**6, batches=200), "s.svg", "too many transfers"),
    ],
)
def test_drawings_that_nobody_could_read_are_refused(schedule: Schedule, name: str, text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=text):
        write_drawing(schedule, str(tmp_path / name), "")
    assert list(tmp_path.iterdir()) == []
