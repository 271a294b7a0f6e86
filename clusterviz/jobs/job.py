"""Jobs: Python functions of a block of a grid, spread over ranks.

    @jobs.job(reads=lambda i: src.box(i, halo=2))
    def run(i):
        ...

What a block declares to read decides which rank runs it (`scheduler.py`), and what it waits for decides when. A block
must not communicate except by distributed arrays, and blocks may write only to places of their own, or accumulate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, overload

from clusterviz.errors import InputError
from clusterviz.jobs.task import Index

Function = Callable[[Any], Any]


@dataclass(frozen=True)
class Job:
    """Job; `Cluster.run` runs it.

    Attributes
    ----------
    function : of a block's index
    reads : the boxes of distributed arrays that a block reads: what `array.box` returns, or (array, box), or a list
    after : the blocks that a block waits for: indices of this job's blocks, or (job, index), in a list
    devices : "one": each device of a rank takes blocks of its own; "all": a rank has one block at a time, and its tasks
        are spread over the devices
    time_limit : seconds that a block may take; one that takes longer ends all ranks; None: any
    """

    function: Function
    reads: Function | None = None
    after: Function | None = None
    devices: Literal["one", "all"] = "one"
    time_limit: float | None = None

    @property
    def name(self) -> str:
        """Name of the function."""
        return getattr(self.function, "__name__", "job")

    def __call__(self, block: Index) -> Any:
        """Run a block here."""
        return self.function(block)


@overload
def job(function: Function) -> Job: ...
@overload
def job(
    *,
    reads: Function | None = None,
    after: Function | None = None,
    devices: Literal["one", "all"] = "one",
    time_limit: float | None = None,
) -> Callable[[Function], Job]: ...
def job(function: Function | None = None, **options: Any) -> Job | Callable[[Function], Job]:
    """Make a job of a function of a block's index; see `Job` for the options.

    Raises
    ------
    InputError
        `devices` is neither "one" nor "all", or `time_limit` is not above 0.
    """
    if options.get("devices", "one") not in ("one", "all"):
        raise InputError("no such choice of devices", where="job", found=options["devices"], allowed="one, all")
    limit = options.get("time_limit")
    if limit is not None and not limit > 0:
        raise InputError("impossible time limit", where="job", found=limit, allowed="seconds above 0, or None")
    return Job(function) if function is not None else lambda given: Job(given, **options)
