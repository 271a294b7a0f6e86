"""What a frame cost: plain numbers of each rank, brought together on one."""

from __future__ import annotations

import resource
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from time import perf_counter
from typing import Any

from clusterviz.report.accuracy import Accuracy
from clusterviz.report.changes import Change
from clusterviz.report.leaping import Leaping, together
from clusterviz.report.sharing import Sharing
from clusterviz.report.trace import Span

STAGES = ("plan", "load", "render", "readback", "encode", "exchange", "blend", "collect", "finish")


@dataclass
class Clock:
    """Seconds of each stage on one rank; stages that repeat add up.

    Attributes
    ----------
    seconds : by stage
    spans : when each was, for a trace; None where nobody wants to know
    row : of the trace, as in `Span`
    """

    seconds: dict[str, float] = field(default_factory=dict)
    spans: list[Span] | None = None
    row: str = ""

    @contextmanager
    def stage(self, name: str, shown: str = "") -> Iterator[None]:
        """Measure the body; a trace shows it under another name, where there is one."""
        started = perf_counter()
        try:
            yield
        finally:
            ended = perf_counter()
            self.add(name, ended - started)
            self.note(Span(shown or name, name, started, ended))

    def note(self, *spans: Span) -> None:
        """Keep spans for the trace, if there will be one."""
        if self.spans is not None:
            self.spans.extend(replace(span, row=self.row) for span in spans)

    def add_span(self, name: str, began: float, seconds: float) -> float:
        """Count seconds that were measured elsewhere, from a known time on; when they ended."""
        self.add(name, seconds)
        self.note(Span(name, name, began, began + seconds))
        return began + seconds

    def add(self, name: str, seconds: float) -> None:
        """Count seconds that were measured elsewhere."""
        self.seconds[name] = self.seconds.get(name, 0.0) + seconds


@dataclass(frozen=True)
class RankFrame:
    """One frame on one rank.

    Attributes
    ----------
    seconds : by stage, and `total`
    bricks, bricks_drawn : held, and drawn
    bricks_occluded : not drawn, since all rays ended in front of them
    voxels : samples held in memory, overlap included
    voxel_bytes : memory that they take where they are drawn: OpenGL's, free room for bricks to come included, or the
        processor's
    samples : field samples that rays took
    samples_estimate : of these, in a pre-pass that is not shown
    cpu_seconds : processor time of drawing, of all threads of the process
    bytes_raw, bytes_sent, messages_sent : of compositing, the final gather apart
    peak_memory_bytes : the largest resident size of the process so far
    renderer : OpenGL's name of what drew
    leaping : what the last frame was good for; None where quality.leaping is false
    compositing : what was chosen, predicted and measured, stage by stage and peer by peer
    balance : what was sent and received to even out the ranks, in how many seconds, where the distribution is dynamic
    """

    seconds: dict[str, float]
    bricks: int = 0
    bricks_drawn: int = 0
    bricks_occluded: int = 0
    voxels: int = 0
    voxel_bytes: int = 0
    samples: int = 0
    samples_estimate: int = 0
    cpu_seconds: float = 0.0
    bytes_raw: int = 0
    bytes_sent: int = 0
    messages_sent: int = 0
    peak_memory_bytes: int = 0
    renderer: str = ""
    leaping: Leaping | None = None
    compositing: dict[str, Any] = field(default_factory=dict)
    balance: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class FrameStatistics:
    """One frame on all ranks.

    Attributes
    ----------
    per_rank : index = rank
    number : of the frame in its animation
    accuracy : what was chosen to hold a bound on the error; None where none was asked for
    sharing : by the ranks: mode and groups, and what they were chosen by; None where nobody said
    changes : settings that were asked for and are not used as given
    warnings : why the picture, or a volume in it, is not seen
    """

    per_rank: tuple[RankFrame, ...]
    number: int = 0
    accuracy: Accuracy | None = None
    sharing: Sharing | None = None
    changes: tuple[Change, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def seconds(self) -> dict[str, float]:
        """The slowest rank's seconds of each stage, and of the whole."""
        names = dict.fromkeys(name for rank in self.per_rank for name in rank.seconds)
        return {name: max(rank.seconds.get(name, 0.0) for rank in self.per_rank) for name in names}

    @property
    def renderer(self) -> str:
        """OpenGL's name of what drew; "" where nothing did."""
        return next((rank.renderer for rank in self.per_rank if rank.renderer), "")

    @property
    def leaping(self) -> Leaping | None:
        """What the last frame was good for, on all ranks; None where quality.leaping is false."""
        return together(rank.leaping for rank in self.per_rank)

    @property
    def imbalance(self) -> float:
        """Largest over mean seconds of rendering; 1 where nothing was drawn."""
        cost = [rank.seconds.get("render", 0.0) for rank in self.per_rank]
        return max(cost) * len(cost) / sum(cost) if sum(cost) > 0 else 1.0

    @property
    def migration(self) -> dict[str, float] | None:
        """What bricks on their way took; None where none move.

        Seconds of the rank that worked most on them, planning included, and their share of that rank's frame; what
        planning took the slowest rank; bytes that were sent, and what they would have been unpacked; bricks that
        arrived, all ranks together.
        """
        told = [(rank.balance, rank.seconds.get("total", 0.0)) for rank in self.per_rank if "seconds" in rank.balance]
        if not told:
            return None
        return {
            "seconds": max(each["seconds"] for each, _ in told),
            "share": max(each["seconds"] / total if total else 0.0 for each, total in told),
            "planning_seconds": max(each.get("planning_seconds", 0.0) for each, _ in told),
            "bytes_sent": sum(each["bytes_sent"] for each, _ in told),
            "bytes_raw": sum(each.get("bytes_raw", 0) for each, _ in told),
            "bricks": sum(each.get("bricks_stored", 0) for each, _ in told),
        }

    def as_json(self) -> dict[str, Any]:
        """The frame as it stands in a statistics file."""
        return {
            "number": self.number,
            "warnings": list(self.warnings),
            "seconds": self.seconds,
            "imbalance": self.imbalance,
            "accuracy": asdict(self.accuracy) if self.accuracy else None,
            "sharing": asdict(self.sharing) if self.sharing else None,
            "changes": [asdict(change) for change in self.changes],
            "migration": self.migration,
            "leaping": asdict(self.leaping) if self.leaping else None,
            "per_rank": [asdict(rank) for rank in self.per_rank],
        }


def statistics_file(
    scene: dict[str, Any], frames: Sequence[FrameStatistics], startup: dict[str, float]
) -> dict[str, Any]:
    """What `--stats` writes.

    Parameters
    ----------
    scene : completed, as JSON holds it
    frames : those that were drawn; none where an animation was whole already
    startup : seconds from the start of the process to the first frame, by part
    """
    return {
        "ranks": len(frames[0].per_rank) if frames else 0,
        "size": scene["image"]["size"],
        "renderer": next((frame.renderer for frame in frames if frame.renderer), ""),
        "startup": startup,
        "scene": scene,
        "frames": [frame.as_json() for frame in frames],
    }


def peak_memory_bytes() -> int:
    """The largest resident size of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
