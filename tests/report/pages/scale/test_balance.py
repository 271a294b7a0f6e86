"""Imbalance of distributions over an orbit."""

from __future__ import annotations

from report.pages.scale.test_forecast import CURVE
from report.pages.scale.test_points import measured

from clusterviz.report.pages.scale.points import STRONG, make_balance, make_point
from clusterviz.report.pages.scale.survey import SurveyResult
from clusterviz.report.pages.scale.verdict import verdict


def test_frames_of_an_orbit_are_told_one_by_one() -> None:
    found = make_balance("dynamic", measured([[1.0, 3.0], [2.0, 2.0], [0.0, 0.0]], [10, 30]))
    assert found.imbalance == (1.5, 1.0, 1.0)
    assert found.imbalance_samples == (1.5,) * 3
    assert found.busiest_samples == (30,) * 3
    assert [(row["frame"], row["distribution"], row["ranks"]) for row in found.rows()] == [
        (number, "dynamic", 2) for number in range(3)
    ]


def test_the_first_sentence_names_imbalance_where_it_takes_most() -> None:
    shares = ([1, 1, 1, 87], [25, 25, 25, 25])
    uneven, even = (make_point(STRONG, measured([[9.0] * 4], samples), None) for samples in shares)
    balance = tuple(make_balance(name, measured([[1.0, 3.0]], [10, 30])) for name in ("coherent", "dynamic"))
    said = verdict(SurveyResult((uneven,), (), (), balance), CURVE, "a network")
    assert said[0].startswith("The bottleneck is imbalance: 73% of a frame of 9.1 s on 4 ranks")
    assert "busiest of 2 ranks takes this multiple of the mean samples: 1.50 (coherent) and 1.50 (dynamic)." in said[1]
    plain = verdict(SurveyResult((even,), (), ()), CURVE, "a network")
    assert plain[0].startswith("The bottleneck is drawing: 99% of a frame of 9.1 s on 4 ranks")
    assert not any("orbit" in sentence for sentence in plain)
