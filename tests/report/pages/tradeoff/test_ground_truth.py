"""Ground truth: convergence, its own error, and the choice of the renderer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clusterviz.errors import InputError
from clusterviz.report.pages.tradeoff import ground_truth
from clusterviz.report.pages.tradeoff.ground_truth import COARSEST, GOAL, converge, find_ground_truth
from clusterviz.scene import Scene, Volume, VolumeInfo, complete_scene
from clusterviz.scene.settings import with_settings

FACTS = VolumeInfo((9, 9, 9), (0.25,) * 3, 2.0 * np.mgrid[:2, :2, :2].reshape(3, -1).T - 1, 0.0, 1.0, 0.0, 1.0)


def scene(**settings: Any) -> Scene:
    plain = Scene(volumes=(Volume(path="field:gaussian:9", clim=(0.0, 1.0)),))
    return complete_scene(with_settings(plain, {"size": (12, 9)} | settings), FACTS)


def never(scene: Scene, step: float) -> Any:
    raise AssertionError("the renderer is not needed")


@pytest.mark.parametrize("order", [1, 2])
def test_the_estimate_is_no_smaller_than_the_error(order: int) -> None:
    limit = np.full((2, 2, 4), 0.5)
    picture, halvings = converge(lambda step: limit + 0.1 * step**order, 60)
    assert np.abs(picture - limit).max() <= halvings[-1].max * (1 + 1e-9) <= GOAL * (1 + 1e-9)
    assert [h.step for h in halvings] == [COARSEST / 2 ** (k + 1) for k in range(len(halvings))]


def test_it_ends_where_the_budget_does() -> None:
    calls: list[float] = []
    picture, halvings = converge(lambda step: calls.append(step) or np.full((1, 1, 4), step), 0)
    assert (calls, len(halvings), picture.max()) == ([0.25, 0.125], 1, 0.125)
    assert halvings[0].max == 0.125


def test_the_reference_is_taken_where_there_is_time() -> None:
    found = find_ground_truth(scene(), never, 60)
    assert (found.source, found.picture.shape, found.checked) == ("reference", (9, 12, 4), None)
    assert 0 < found.max <= GOAL
    assert found.picture.max() > 0.01
    assert "allowed" in found.why


def test_else_the_renderer_is_and_is_checked_against_float64() -> None:
    steps: list[tuple[tuple[int, int], float]] = []

    def renderer(of: Scene, step: float) -> Any:
        steps.append((of.image.size, step))
        exact = ground_truth._reference_renderer(of)[0]
        assert exact is not None
        return exact(of, step) + 1e-3

    found = find_ground_truth(scene(size=(80, 60)), renderer, 1e-9)
    assert found.source == "renderer"
    assert "more than" in found.why
    assert steps[0] == ((80, 60), 0.25)
    assert steps[-1][0] == (64, 48)
    assert found.checked is not None
    assert found.checked[0] == pytest.approx(1e-3)
    assert found.max == pytest.approx(found.halvings[-1].max + 1e-3)


@pytest.mark.parametrize("fault", ["large", "unknown"])
def test_what_the_reference_cannot_draw_is_said(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> Any:
        raise InputError("no such look")

    if fault == "large":
        monkeypatch.setattr(ground_truth, "MAX_REFERENCE_BYTES", 100)
    else:
        monkeypatch.setattr(ground_truth, "render_reference", refuse)
    found = find_ground_truth(scene(), lambda of, step: np.full((9, 12, 4), 0.5, np.float32), 60)
    assert (found.source, found.checked, found.max) == ("renderer", None, 0)
    assert ("GiB" in found.why) if fault == "large" else ("no such look" in found.why)
