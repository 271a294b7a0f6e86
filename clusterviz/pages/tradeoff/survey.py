"""Survey of all settings of a scene, compared with the ground truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from clusterviz.errors import ClustervizError
from clusterviz.pages.tradeoff.ground_truth import Draw, find_ground_truth
from clusterviz.pages.tradeoff.knobs import Setting, changed
from clusterviz.pages.tradeoff.measure import Image, Measured
from clusterviz.pages.tradeoff.page import Report
from clusterviz.pages.tradeoff.rating import FailedSetting, RatedSetting, rate, with_front_numbers
from clusterviz.scene import Scene, background_rgb
from clusterviz.scene.overrides import with_settings

TRUTH, AGAIN = "the picture without error", "the scene as it is, again"


class Job(Protocol):
    """Function that draws timed frames of a scene after warm-up frames, and returns cost and picture."""

    def __call__(self, scene: Scene, frames: int, warm_up: int = 1) -> Measured: ...


@dataclass(frozen=True)
class Survey:
    """Settings to measure, and the parameters of the measurement."""

    settings: Sequence[Setting]  # the unchanged scene comes first
    left_out: int
    ranks: int
    frames: int
    rounds: int  # number of measurements of each setting, of which the fastest counts
    budget_seconds: float  # time limit of the ground truth

    @property
    def steps(self) -> list[str]:
        """Names of the jobs in order."""
        first, *others = (str(setting) for setting in self.settings)
        again = [f"{name}, round {n + 2}" for n in range(self.rounds - 1) for name in (first, *others)]
        return [first, TRUTH, *others, *again, AGAIN]

    def run(self, name: str, scene: Scene, job: Job, progress: Callable[[str], None]) -> Report:
        """Draw the unchanged scene, find the ground truth, then draw all settings.

        `progress`: called with each of `steps` when it begins. Raises ClustervizError: the unchanged scene cannot be
        drawn. Other settings that cannot be drawn are listed in the report.
        """
        steps = iter(self.steps)
        progress(next(steps))
        first = job(scene, self.frames)
        # The scene is completed now, so that settings cannot change automatic choices.
        scene = first.scene
        progress(next(steps))
        truth = find_ground_truth(scene, _with_step(job), self.budget_seconds)
        background = background_rgb(scene.image.background)

        def rated(setting: Setting, drawn: Measured) -> RatedSetting:
            return rate(setting, drawn.cost, _picture(drawn), truth, background)

        best, failed = {str(self.settings[0]): rated(self.settings[0], first)}, dict[str, FailedSetting]()
        for setting in [*self.settings[1:], *(self.rounds - 1) * list(self.settings)]:
            progress(next(steps))
            try:
                found = rated(setting, job(changed(scene, setting), self.frames))
            except ClustervizError as error:
                failed[str(setting)] = FailedSetting(setting, str(error))
            else:
                best[str(setting)] = _faster(best.get(str(setting)), found)
        progress(next(steps))
        again = job(scene, self.frames).cost.total_seconds
        numbered = tuple(with_front_numbers([best[str(one)] for one in self.settings if str(one) in best], truth))
        lost = tuple(one for name, one in failed.items() if name not in best)
        how = (self.ranks, self.frames, self.rounds, first.renderer)
        return Report(name, scene, *how, truth, numbered, lost, self.left_out, again)


def _faster(known: RatedSetting | None, found: RatedSetting) -> RatedSetting:
    return found if known is None or found.cost.total_seconds < known.cost.total_seconds else known


def _with_step(job: Job) -> Draw:
    return lambda scene, step: _picture(job(with_settings(scene, {"step": step}), 1, 0))


def _picture(drawn: Measured) -> Image:
    if drawn.image is None:
        raise ClustervizError("a job left no picture")
    return drawn.image
