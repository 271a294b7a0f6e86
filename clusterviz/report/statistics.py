"""Statistics of frames: seconds, bytes and counts of each rank, gathered on rank 0."""

from __future__ import annotations

import resource
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from time import perf_counter
from typing import Any

from clusterviz.report.counts import EarlyDiscarding, FrameCoherence, KBufferCounts, all_counts
from clusterviz.report.decisions import Accuracy, Change, Detail, Sharing
from clusterviz.report.trace import Span

STAGES = ("plan", "load", "render", "readback", "encode", "exchange", "blend", "collect", "finish")


@dataclass
class Clock:
    """Timer of the stages on one rank; repeated stages add up."""

    seconds: dict[str, float] = field(default_factory=dict)  # stage -> seconds
    spans: list[Span] | None = None  # spans for a trace; None without a trace
    row: str = ""

    @contextmanager
    def stage(self, name: str, shown: str = "") -> Iterator[None]:
        """Time the body as a stage; `shown` is its name in a trace."""
        started = perf_counter()
        try:
            yield
        finally:
            ended = perf_counter()
            self.add(name, ended - started)
            self.note(Span(shown or name, name, started, ended))

    def note(self, *spans: Span) -> None:
        """Add spans to the trace, if there is one."""
        if self.spans is not None:
            self.spans.extend(replace(span, row=self.row) for span in spans)

    def add_span(self, name: str, began: float, seconds: float) -> float:
        """Add a stage of known begin and duration; return its end."""
        self.add(name, seconds)
        self.note(Span(name, name, began, began + seconds))
        return began + seconds

    def add(self, name: str, seconds: float) -> None:
        """Add seconds to a stage."""
        self.seconds[name] = self.seconds.get(name, 0.0) + seconds


@dataclass(frozen=True)
class RankFrame:
    """Statistics of one frame on one rank.

    Attributes
    ----------
    bricks_read, bytes_read : bricks that were read for the frame, and bytes: encoded ones of stores, else of samples
    readback_bytes, readback_pixel : bytes read from a GPU for pictures, and their pixel format; "" without a GPU
    passes : parts of this rank's bricks that were loaded one after another, within a limit of memory; 0 without one
    brick_memory_bytes : with a limit, most memory of voxels, samples that were read, and decoded bricks of stores
    samples : field samples of all rays, and their segments in the tetrahedra of unstructured grids; a segment counts
        once, on the rank that owns its begin. Empty groups of cells are skipped, but a run of samples goes on to its
        brick's end, so the number depends on `cluster.brick`
    bytes_raw, bytes_sent, messages_sent : bytes and messages of compositing without the final gather
    renderer, driver : name of the renderer and version of its driver, as in OpenGL; no driver on the CPU
    calls : of OpenGL for drawing: dispatches and draw calls, waits for the device, buffers and textures made, bytes
        uploaded and read, without those that store bricks; empty on the CPU
    frame_coherence : statistics of frame coherence; None if quality.frame_coherence is false
    early_discarding : statistics of early fragment discarding; None if all fragments are stored
    compositing : algorithm, prediction and measurements, by stage and peer
    balance : bytes and seconds of load balancing in a dynamic distribution
    """

    seconds: dict[str, float]  # stage -> seconds, and `total`
    bricks: int = 0
    bricks_drawn: int = 0
    bricks_occluded: int = 0  # number of bricks not drawn since all rays ended in front of them
    voxels: int = 0  # voxels held in memory, including ghost voxels
    voxel_bytes: int = 0  # memory of the voxels on the device that draws, including reserved memory
    bricks_read: int = 0
    bytes_read: int = 0
    readback_bytes: int = 0
    readback_pixel: str = ""
    passes: int = 0
    brick_memory_bytes: int = 0
    samples: int = 0
    samples_estimate: int = 0  # samples of these in a pre-pass
    cpu_seconds: float = 0.0  # CPU time of drawing, all threads
    bytes_raw: int = 0
    bytes_sent: int = 0
    messages_sent: int = 0
    peak_memory_bytes: int = 0  # peak resident size of the process
    renderer: str = ""
    driver: str = ""
    choices: dict[str, str] = field(default_factory=dict)  # what was chosen by the device, and why, in a few words each
    calls: dict[str, int] = field(default_factory=dict)
    frame_coherence: FrameCoherence | None = None
    early_discarding: EarlyDiscarding | None = None
    kbuffer: KBufferCounts | None = None  # counts of a k-buffer; None without one
    cut_short: int = 0  # walks of rays through unstructured grids that went in a circle
    compositing: dict[str, Any] = field(default_factory=dict)
    balance: dict[str, Any] = field(default_factory=dict)


def summed(counts: Sequence[RankFrame]) -> RankFrame:
    """Return the costs of pictures of one rank that became one frame: sums, and all else as of the last."""
    names = ["samples", "samples_estimate", "cpu_seconds", "bricks_read", "bytes_read", "readback_bytes"]
    names += ["bytes_raw", "bytes_sent", "messages_sent", "cut_short"]
    calls = {name: sum(one.calls.get(name, 0) for one in counts) for name in counts[-1].calls}
    return replace(counts[-1], calls=calls, **{name: sum(getattr(one, name) for one in counts) for name in names})


@dataclass(frozen=True)
class FrameStatistics:
    """Statistics of one frame on all ranks."""

    per_rank: tuple[RankFrame, ...]  # index = rank
    number: int = 0
    accuracy: Accuracy | None = None  # settings chosen for an error bound; None without a bound
    sharing: Sharing | None = None  # mode and groups, and the predictions for the choice; None if not recorded
    changes: tuple[Change, ...] = ()  # settings that are not used as given
    warnings: tuple[str, ...] = ()  # warnings about volumes that are not visible
    detail: tuple[Detail, ...] = ()  # levels of each volume that has a store's
    flows: tuple[str, ...] = ()  # what the ranks exchanged for flows when they were opened, a line each

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds of each stage, and `total`, on the slowest rank."""
        names = dict.fromkeys(name for rank in self.per_rank for name in rank.seconds)
        return {name: max(rank.seconds.get(name, 0.0) for rank in self.per_rank) for name in names}

    @property
    def renderer(self) -> str:
        """Name of the renderer, or "" if nothing was drawn."""
        return next((rank.renderer for rank in self.per_rank if rank.renderer), "")

    @property
    def frame_coherence(self) -> FrameCoherence | None:
        """Statistics of frame coherence on all ranks; None if quality.frame_coherence is false."""
        return all_counts(rank.frame_coherence for rank in self.per_rank)

    @property
    def early_discarding(self) -> EarlyDiscarding | None:
        """Statistics of early fragment discarding on all ranks; None if all fragments are stored."""
        return all_counts(rank.early_discarding for rank in self.per_rank)

    @property
    def kbuffer(self) -> KBufferCounts | None:
        """Counts of a k-buffer on all ranks; None without one."""
        return all_counts(rank.kbuffer for rank in self.per_rank)

    @property
    def imbalance(self) -> float:
        """Largest over mean seconds of rendering; 1 if nothing was drawn."""
        cost = [rank.seconds.get("render", 0.0) for rank in self.per_rank]
        return max(cost) * len(cost) / sum(cost) if sum(cost) > 0 else 1.0

    @property
    def migration(self) -> dict[str, float] | None:
        """Cost of migrating bricks; None if the distribution is not dynamic.

        `seconds` and `share` are those of the busiest rank, in seconds and as a share of its frame, planning included;
        `planning_seconds` is that of the slowest rank; bytes (sent, and unpacked) and bricks received are sums.
        """
        balances = [
            (rank.balance, rank.seconds.get("total", 0.0)) for rank in self.per_rank if "seconds" in rank.balance
        ]
        if not balances:
            return None
        return {
            "seconds": max(each["seconds"] for each, _ in balances),
            "share": max(each["seconds"] / total if total else 0.0 for each, total in balances),
            "planning_seconds": max(each.get("planning_seconds", 0.0) for each, _ in balances),
            "bytes_sent": sum(each["bytes_sent"] for each, _ in balances),
            "bytes_raw": sum(each.get("bytes_raw", 0) for each, _ in balances),
            "bricks": sum(each.get("bricks_stored", 0) for each, _ in balances),
        }

    def as_json(self) -> dict[str, Any]:
        """Return the frame's entry in a statistics file."""
        return {
            "number": self.number,
            "warnings": list(self.warnings),
            "seconds": self.seconds,
            "imbalance": self.imbalance,
            "accuracy": asdict(self.accuracy) if self.accuracy else None,
            "sharing": asdict(self.sharing) if self.sharing else None,
            "detail": [asdict(each) for each in self.detail],
            "flows": list(self.flows),
            "changes": [asdict(change) for change in self.changes],
            "migration": self.migration,
            "frame_coherence": asdict(self.frame_coherence) if self.frame_coherence else None,
            "early_discarding": asdict(self.early_discarding) if self.early_discarding else None,
            "kbuffer": asdict(self.kbuffer) if self.kbuffer else None,
            "per_rank": [asdict(rank) for rank in self.per_rank],
        }


def statistics_file(
    scene: dict[str, Any], frames: Sequence[FrameStatistics], startup: dict[str, float]
) -> dict[str, Any]:
    """Return the contents of a `--stats` file.

    `scene`: the completed scene as JSON values. `startup`: part of the start-up -> seconds.
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
    """Return the peak resident size of this process."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
