"""A setting that was asked for and is not used as given."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Change:
    """One setting.

    Attributes
    ----------
    key : in the scene, or the option of the command
    asked, used : the two values
    reason : in words
    """

    key: str
    asked: float | str | bool
    used: float | str | bool
    reason: str

    def __str__(self) -> str:
        return f"{self.key}: {self.used} is used instead of {self.asked} ({self.reason})"
