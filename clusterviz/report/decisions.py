"""Decisions of a frame: settings chosen for an error bound, the mode chosen, and settings not used as given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

CONFIDENCE = "no proof: see docs/measurements/accuracy.md for how often such bounds are held"


@dataclass(frozen=True)
class Accuracy:
    """Settings chosen for `quality.max_error`, and the expected error.

    `verified`: whether the error was estimated in all pixels, from pictures of other steps, or in a sample of pixels.
    `pilot_samples`, `pilot_seconds`: samples and seconds of all pilot pictures, on all ranks.
    """

    max_error: float
    error: float  # the largest error expected, an estimate
    step: float  # sampling distance, voxels
    classification: str
    filter: str
    early_termination: float
    pixel: str
    pilot_pixels: int  # pixels of each pilot picture
    pilot_samples: int
    pilot_seconds: float
    reasons: Mapping[str, str] = field(default_factory=dict)  # setting -> reason in words
    verified: bool = False

    def __str__(self) -> str:
        """Return the settings and the expected error on one line."""
        text = f"error about {self.error:.2g} at most (asked for {self.max_error:.3g}): step {self.step:.3g}"
        how = "in all pixels" if self.verified else "in a sample of pixels"
        return (
            f"{text}, {self.classification}, {self.filter}, {self.pixel}; estimated {how}, with "
            f"{self.pilot_samples:,} samples in {self.pilot_seconds:.2f} s; {CONFIDENCE}"
        )


@dataclass(frozen=True)
class Detail:
    """Levels of a store that a picture uses, and the bound of its error.

    `bound`: of the difference of any pixel from a picture of the volume that was stored; None: not known.
    """

    volume: int
    levels: tuple[int, ...]  # drawn bricks of the store at each level, the finest first
    bytes: int  # of their samples, on the rank with most
    reached: bool = True  # whether they hold what was asked for
    bound: float | None = None
    store: float | None = None  # part of the bound that the store's own error has at its finest level
    reason: str = ""  # why no bound is known

    def __str__(self) -> str:
        """Return the levels and the bound on one line."""
        bricks = ", ".join(f"{count} at level {level}" for level, count in enumerate(self.levels) if count)
        error = f"no bound of the error is known ({self.reason})"
        if self.bound is not None:
            error = f"error at most {self.bound:.2g}" + (f", {self.store:.2g} by the store" if self.store else "")
        size = f"{self.bytes / 2**20:.1f} MiB on a rank" + (", more than asked for" if not self.reached else "")
        return f"volumes[{self.volume}]: bricks {bricks or 'none'}; {size}; {error}"


@dataclass(frozen=True)
class Change:
    """Setting that is not used as given. `asked`, `used`: the value given, and the value used."""

    key: str  # key of the scene, or option of the command
    asked: float | str | bool
    used: float | str | bool
    reason: str

    def __str__(self) -> str:
        return f"{self.key}: {self.used} is used instead of {self.asked} ({self.reason})"


@dataclass(frozen=True)
class Forecast:
    """Predicted cost of a mode. `seconds_drawing`, `seconds_compositing`: predicted seconds."""

    groups: int  # number of groups of ranks that share the screen; 1 is sort-last, one a rank sort-first
    samples: float
    seconds_drawing: float
    seconds_compositing: float
    bytes_held: int  # largest number of bytes of bricks on a rank

    @property
    def seconds(self) -> float:
        """Predicted seconds of drawing and compositing."""
        return self.seconds_drawing + self.seconds_compositing


@dataclass(frozen=True)
class Sharing:
    """Mode of a frame, and the predictions by which it was chosen.

    `forecasts`: predictions of all modes compared; empty if the scene or the memory left no choice.
    """

    mode: str  # sort-last, sort-first or hybrid
    groups: int  # number of groups of ranks that share the screen
    forecasts: tuple[Forecast, ...] = ()

    @property
    def way(self) -> str:
        """Mode, with the number of groups for hybrid."""
        return f"{self.mode}, {self.groups} groups" if self.mode == "hybrid" else self.mode

    def __str__(self) -> str:
        """Return the mode and all predictions on one line."""
        text = f"{self.mode}, {self.groups} {'group' if self.groups == 1 else 'groups'}"
        each = ", ".join(
            f"{one.groups}: {one.samples / 1e6:.2f} M samples, {one.seconds:.3f} s" for one in self.forecasts
        )
        return f"{text} (expected of the slowest rank, by groups: {each})" if each else text
