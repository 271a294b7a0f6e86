"""What `quality.max_error` came to: the settings that were chosen for a frame, and the error that they should have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

CONFIDENCE = "no proof: see docs/accuracy.md for how often such bounds are held"


@dataclass(frozen=True)
class Accuracy:
    """A choice, and what it took to make.

    Attributes
    ----------
    max_error : that was asked for
    error : the largest that is to be expected, estimated
    reached : whether that is within the bound
    step : in voxels
    classification, filter, early_termination, pixel : as in the scene
    reasons : for them, in words, by their names
    verified : whether the error was estimated in all pixels, by a picture of longer steps, and not in a sample of them
    pilot_pixels : of each of the small pictures that were drawn to find out
    pilot_samples, pilot_seconds : of all of them together, on all ranks
    """

    max_error: float
    error: float
    reached: bool
    step: float
    classification: str
    filter: str
    early_termination: float
    pixel: str
    pilot_pixels: int
    pilot_samples: int
    pilot_seconds: float
    reasons: Mapping[str, str] = field(default_factory=dict)
    verified: bool = False

    def __str__(self) -> str:
        """What was chosen and what that should come to, in a line."""
        text = f"error about {self.error:.2g} at most (asked for {self.max_error:.3g}): step {self.step:.3g}"
        how = "in all pixels" if self.verified else "in a sample of pixels"
        return (
            f"{text}, {self.classification}, {self.filter}, {self.pixel}; estimated {how}, with "
            f"{self.pilot_samples:,} samples in {self.pilot_seconds:.2f} s; {CONFIDENCE}"
        )

    @property
    def warning(self) -> str:
        """What a user must know of a bound that cannot be held; "" where it can."""
        if self.reached:
            return ""
        return (
            f"quality.max_error {self.max_error:.3g} is out of reach: the error may be about {self.error:.2g} at the "
            f"settings that come nearest, step {self.step:.3g} and {self.classification} classification"
        )
