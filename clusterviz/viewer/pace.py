"""Size and quality of pictures while the view moves, chosen so that each is drawn within a time budget.

A frame takes a fixed time and a time for each sample, `seconds = fixed + pixels / step · per_sample`; the medians of
the last frames predict the next. The settings are those of a ladder: each level has about two thirds of the samples of
the one before. The level becomes coarser as soon as the prediction exceeds the time for drawing, and finer only if the
next one would clearly fit, so that it does not alternate.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from statistics import median

from clusterviz.scene.annotations import Annotations
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.values import Scene


@dataclass(frozen=True)
class Level:
    """Settings of pictures while the view moves."""

    scale: float  # of the picture's sides
    step: float
    early_termination: float  # opacity left, at which rays may end, at least

    @property
    def cost(self) -> float:
        """Samples, relative to the full picture."""
        return self.scale * self.scale / self.step


LEVELS = (
    Level(1.0, 1.0, 0.0),
    Level(1.0, 1.0, 0.02),
    Level(1.0, 1.5, 0.02),
    Level(0.8, 1.5, 0.02),
    Level(0.7, 2.0, 0.03),
    Level(0.6, 2.0, 0.03),
    Level(0.5, 2.0, 0.03),
    Level(0.45, 2.5, 0.04),
    Level(0.4, 3.0, 0.05),
    Level(0.33, 3.0, 0.05),
    Level(0.28, 3.5, 0.05),
    Level(0.22, 4.0, 0.05),
    Level(0.16, 4.0, 0.05),
)
"""From the full picture on, each with fewer samples."""
FIRST = 8
"""Level of the first picture, whose cost is unknown."""
KNOWN_FRAMES = 3
"""Number of the last frames whose median costs count: a single slow frame, as by other work, changes nothing."""
DRAWING_SHARE = 0.7
"""Share of the budget for drawing; the rest is for encoding, sending and showing the picture."""
ROOM = 0.8
"""Share of the time for drawing within which a finer level has to fit."""
PAUSE = 4
"""Least number of frames before a level becomes finer again."""
SMALLEST_SIDE = 16


class Pace:
    """Choice of the level from frame to frame. `level`: index in `LEVELS` of the next frame."""

    def __init__(self, budget_seconds: float) -> None:
        self._seconds = DRAWING_SHARE * budget_seconds
        self._costs: deque[float] = deque(maxlen=KNOWN_FRAMES)
        self._fixed: deque[float] = deque(maxlen=KNOWN_FRAMES)
        self._pixels = 0
        self._since_change = 0
        self.level = FIRST

    def settings(self, scene: Scene) -> Scene:
        """Return a completed or given scene with the settings of the level."""
        level, quality = LEVELS[self.level], scene.quality
        width, height = (max(SMALLEST_SIDE, round(level.scale * side)) for side in scene.image.size)
        image = scene.image.model_copy(update={"size": (width, height), "layers": ()})
        ends = quality.early_termination
        if any(BLEND_MODES[one.blending].composited for one in scene.drawn_as("samples").values()):
            ends = max(ends, level.early_termination)
        changed = {"step": quality.step * level.step, "early_termination": ends, "max_error": None}
        settings = {"image": image, "quality": quality.model_copy(update=changed), "annotations": Annotations()}
        return scene.model_copy(update=settings)

    def learn(self, pixels: int, seconds: float, fixed_seconds: float) -> None:
        """Learn from a frame of the present level.

        `fixed_seconds`: of these, those that do not depend on the picture's size.
        """
        self._costs.append(max(1e-6, seconds - fixed_seconds) / (LEVELS[self.level].cost * pixels))
        self._fixed.append(fixed_seconds)
        self._pixels = pixels
        self._since_change += 1
        self._choose(seconds)

    def predicted(self, level: int) -> float:
        """Return the expected seconds of a level, after the first frame."""
        return median(self._fixed) + median(self._costs) * LEVELS[level].cost * self._pixels

    def _choose(self, seconds: float) -> None:
        level, coarsest = self.level, len(LEVELS) - 1
        if self.predicted(level) > self._seconds:
            fitting = (n for n in range(level, coarsest) if self.predicted(n) <= self._seconds)
            level = next(fitting, coarsest)
        elif self._since_change >= PAUSE or seconds < self._seconds / 3:
            level = next((n for n in range(level) if self.predicted(n) <= ROOM * self._seconds), level)
        if level != self.level:
            self.level, self._since_change = level, 0
