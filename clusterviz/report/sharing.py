"""How ranks shared a frame: data, screen or both, and what that was expected to take beside other ways."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Forecast:
    """One way to share.

    Attributes
    ----------
    groups : of ranks, that share the screen; 1 is sort-last, one a rank sort-first
    samples : of the busiest rank
    seconds_drawing, seconds_compositing : that should take
    bytes_held : of bricks, by the rank that holds most
    """

    groups: int
    samples: float
    seconds_drawing: float
    seconds_compositing: float
    bytes_held: int

    @property
    def seconds(self) -> float:
        """Both."""
        return self.seconds_drawing + self.seconds_compositing


@dataclass(frozen=True)
class Sharing:
    """What was taken.

    Attributes
    ----------
    mode : sort-last, sort-first or hybrid
    groups : of ranks, that share the screen
    forecasts : of all ways that were compared; none where the scene left nothing open, or memory nothing to choose
    """

    mode: str
    groups: int
    forecasts: tuple[Forecast, ...] = ()

    @property
    def way(self) -> str:
        """The mode, and of hybrids the number of groups."""
        return f"{self.mode}, {self.groups} groups" if self.mode == "hybrid" else self.mode

    def __str__(self) -> str:
        """What was chosen, and what was expected of it and of others, in a line."""
        text = f"{self.mode}, {self.groups} {'group' if self.groups == 1 else 'groups'}"
        each = ", ".join(
            f"{one.groups}: {one.samples / 1e6:.2f} M samples, {one.seconds:.3f} s" for one in self.forecasts
        )
        return f"{text} (expected of the slowest rank, by groups: {each})" if each else text
