"""Cluster: one process, several devices, or all ranks of mpirun; the same program with the same results.

with jobs.cluster() as c:
    src = c.array((512, 512, 512), np.float32, blocks=128)
    c.run(run, grid=src.blocks)
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, Counters, abort_on_failure, agree, as_channel, limit_threads, open_channel
from clusterviz.comm.agree import describe, exit_status_of, is_agreed, mark_agreed
from clusterviz.comm.back_off import poll_until
from clusterviz.data.source import Index as IndexZyx
from clusterviz.data.source import Source
from clusterviz.errors import ClustervizError, InputError, RankError
from clusterviz.jobs.array import DistributedArray, array_from
from clusterviz.jobs.device import DevicePool, DeviceSetting, devices_of, with_pool
from clusterviz.jobs.job import Job
from clusterviz.jobs.scheduler import (
    QueueReader,
    Schedule,
    ScheduleName,
    dependency_order,
    in_order,
    make_schedule,
)
from clusterviz.jobs.task import Grid, Index, indices
from clusterviz.jobs.time_limit import BlockWatch

Block = tuple[int, Index]
"""Number of a job in a run, and the index of its block."""
_THREAD = threading.local()


@dataclass(frozen=True, eq=False)
class Run:
    """What a run of a job has found.

    Attributes
    ----------
    grid : of blocks
    values : what the blocks that this rank has run have returned, by index
    blocks, stolen, bytes_fetched : int64 (ranks,); blocks that each rank has run, those of them that it took from
        another's queue, and bytes that it has read from other ranks
    """

    grid: Grid
    values: dict[Index, Any]
    blocks: NDArray[np.int64]
    stolen: NDArray[np.int64]
    bytes_fetched: NDArray[np.int64]


class Cluster:
    """Ranks and their devices; `cluster` makes one.

    Parameters
    ----------
    channel : to all ranks
    pool : devices of this rank

    Attributes
    ----------
    rank, size : number of this rank, and of all ranks
    """

    def __init__(self, channel: Channel, pool: DevicePool) -> None:
        self.channel, self.rank, self.size, self._pool = channel, channel.rank, channel.size, pool
        self._arrays: list[DistributedArray] = []
        self._counters: Counters | None = None
        self._count = 0

    def run(self, job: Job, grid: Grid, schedule: ScheduleName = "local", seed: int = 0) -> Run:
        """Run a job on all blocks of a grid; collective.

        Parameters
        ----------
        grid : number of blocks, or numbers along several axes, such as `array.blocks`
        schedule : see `scheduler.py`
        seed : of "random"

        Raises
        ------
        RankError
            On every rank: a block has failed.
        InputError
            On every rank: wrong arguments, or blocks that wait for each other in a circle.
        """
        return self.run_all([(job, grid)], schedule, seed)[0]

    def run_all(self, parts: Sequence[tuple[Job, Grid]], schedule: ScheduleName = "local", seed: int = 0) -> list[Run]:
        """Run several jobs together, whose blocks may wait for blocks of each other; collective; see `run`."""
        if getattr(_THREAD, "in_job", False):
            raise InputError("a block of a job cannot run jobs", where="Cluster.run", allowed="tasks")
        for array in self._arrays:
            array.sync()
        with agree(self.channel, None, "jobs"):
            blocks: list[Block] = [(n, block) for n, (_, grid) in enumerate(parts) for block in indices(grid)]
            after = _dependencies([job for job, _ in parts], blocks)
        held = self._held([job for job, _ in parts], blocks) if schedule == "local" and self.size > 1 else None
        with agree(self.channel, None, "jobs"):
            planned = make_schedule(schedule, len(blocks), self.size, held, seed)
            if after:
                names = [f"{parts[part][0].name} {block}" for part, block in blocks]
                planned = in_order(planned, dependency_order(after, names.__getitem__))
        return _Runner(self, parts, blocks, after, planned).run()

    def array(self, shape: Sequence[int], dtype: Any, blocks: int | IndexZyx = 64, **options: Any) -> DistributedArray:
        """Return a distributed array of zeros, which lives as long as the cluster; collective; see `array.py`."""
        made = DistributedArray(self.channel, shape, dtype, blocks, **options)
        self._arrays.append(made)
        return made

    def array_from(self, source: Source, blocks: int | IndexZyx = 64, **options: Any) -> DistributedArray:
        """Return a distributed array of a data source's samples, each rank reading its own; collective."""
        made = array_from(self.channel, source, blocks, **options)
        self._arrays.append(made)
        return made

    def free(self, array: DistributedArray) -> None:
        """Release an array before the cluster ends; collective."""
        self._arrays.remove(array)
        array.free()

    def collect(self, run: Run) -> list[Any]:
        """Return the values of all blocks of a run in C order, on every rank; collective."""
        found = {block: value for values in self.channel.allgather(run.values) for block, value in values.items()}
        return [found[block] for block in indices(run.grid)]

    def reduce(self, run: Run, function: Callable[[Any, Any], Any]) -> Any:
        """Return the values of all blocks, joined one after the other in C order: the same bits on any ranks.

        Collective; of no blocks None.
        """
        values = self.collect(run)
        return reduce(function, values) if values else None

    def close(self) -> None:
        """Release arrays, counters and threads; collective."""
        for array in self._arrays:
            array.free()
        if self._counters is not None:
            self._counters.free()
        self._pool.close()

    def _zeroed(self, count: int) -> Counters:
        """Return at least `count` counters that are 0; collective."""
        if self._counters is None or self._count < count:
            if self._counters is not None:
                self._counters.free()
            self._counters, self._count = self.channel.counters(count), count
        self._counters.reset()
        return self._counters

    def _held(self, jobs: Sequence[Job], blocks: Sequence[Block]) -> NDArray[np.int64] | None:
        """Return how many bytes of what each block reads each rank holds, int64 (blocks, ranks); collective.

        Each rank finds a part of them.
        """
        if not any(job.reads for job in jobs):
            return None
        share = -(-len(blocks) // self.size)
        own = np.zeros((share, self.size), np.int64)
        with agree(self.channel, None, "declared reads"):
            for row, (number, block) in enumerate(blocks[share * self.rank : share * (self.rank + 1)]):
                for array, box in _boxes(jobs[number], block):
                    own[row] += array.bytes_by_rank(box)
        found = self.channel.allgather_numbers(own.reshape(-1))
        return found.reshape(-1, self.size)[: len(blocks)]


class _Runner:
    """One rank's part of a run.

    Parameters
    ----------
    blocks : of all jobs, by number
    after : numbers of the blocks that a block waits for
    """

    def __init__(
        self,
        cluster: Cluster,
        parts: Sequence[tuple[Job, Grid]],
        blocks: Sequence[Block],
        after: dict[int, list[int]],
        schedule: Schedule,
    ) -> None:
        self._cluster, self._parts, self._blocks = cluster, parts, blocks
        self._after, self._schedule = after, schedule
        queues = len(schedule.queues)
        # One for each queue; with dependencies, one for each block that is 1 when it is done, and one if any failed.
        self._done, self._failed = queues, queues + len(blocks)
        self._add = cluster._zeroed(queues + len(blocks) + 1 if after else queues).add
        self._lock = threading.Lock()
        self._values: list[dict[Index, Any]] = [{} for _ in parts]
        self._stolen = [0] * len(parts)
        self._failure: tuple[str, BaseException] | None = None
        self._watch = BlockWatch(cluster.channel)

    def run(self) -> list[Run]:
        fetched = self._bytes_fetched()
        with self._watch:
            self._run_blocks()
        return self._finish(self._bytes_fetched() - fetched)

    def _run_blocks(self) -> None:
        pool = self._cluster._pool
        if any(job.devices == "all" for job, _ in self._parts):
            with with_pool(pool):
                self._work()
            return
        try:
            pool.run(self._work)
        except BaseException:  # interrupted: the devices' threads take no more
            QueueReader(self._schedule, self._add, self._cluster.rank).close()
            raise

    def _work(self) -> None:
        """Take blocks and run them; one device's part."""
        reader = QueueReader(self._schedule, self._add, self._cluster.rank)
        _THREAD.in_job = True
        try:
            while (taken := reader.take()) is not None:
                number, stolen = taken
                if not self._run_block(number, stolen):
                    reader.close()
        finally:
            _THREAD.in_job = False

    def _run_block(self, number: int, stolen: bool) -> bool:
        """Run a block; return False if it has failed."""
        part, block = self._blocks[number]
        job = self._parts[part][0]
        name = f"job {job.name}, block {block}"
        try:
            if not self._wait_for(self._after.get(number, ())):
                return True  # another rank has failed
            with self._watch.block(name, job.time_limit):
                value = job.function(block)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # sys.exit() too, since other ranks wait for this one
            with self._lock:
                self._failure = self._failure or (name, error)
            if self._after:
                self._add(self._failed, 1)
            return False
        with self._lock:
            self._values[part][block] = value
            self._stolen[part] += stolen
        if self._after:
            self._add(self._done + number, 1)
        return True

    def _wait_for(self, others: Sequence[int]) -> bool:
        """Wait until other blocks are done; return False if a block has failed."""
        for other in others:
            counters = self._done + other, self._failed
            poll_until(lambda counters=counters: any(self._add(each, 0) for each in counters))  # type: ignore[misc]
            if self._add(self._failed, 0):
                return False
        return True

    def _finish(self, fetched: int) -> list[Run]:
        """Agree on failures, and exchange the counts; collective."""
        channel, failure = self._cluster.channel, self._failure
        counts = [len(values) for values in self._values]
        numbers = channel.allgather_numbers([failure is not None, fetched, *counts, *self._stolen])
        if numbers[:, 0].any():
            status = None
            if failure is not None:
                cause = failure[1]
                status = failure[0], describe(cause), exit_status_of(cause)
            reports = channel.allgather(status)
            rank = int(numbers[:, 0].argmax())
            where, text, exit_status = reports[rank] or ("", "", 1)
            raised = mark_agreed(RankError(rank, None, where, text, exit_status))
            raise raised from (failure[1] if failure is not None and rank == channel.rank else None)
        n = len(self._parts)
        return [
            Run(grid, self._values[k], numbers[:, 2 + k], numbers[:, 2 + n + k], numbers[:, 1])
            for k, (_, grid) in enumerate(self._parts)
        ]

    def _bytes_fetched(self) -> int:
        return sum(array.bytes_fetched for array in self._cluster._arrays)


def _boxes(job: Job, block: Index) -> list[tuple[Any, Any]]:
    """Return the arrays and boxes that a block declares to read.

    Raises
    ------
    InputError
        Something else.
    """
    declared = job.reads(block) if job.reads else []
    found = []
    for each in declared if isinstance(declared, list) else [declared]:
        match (each.array, each) if hasattr(each, "array") else each:
            case (DistributedArray() as array, box):
                found.append((array, box))
            case _:
                where, allowed = f"reads of job {job.name}", "array.box(i), (array, box), or a list of them"
                raise InputError("no box of a distributed array", where=where, found=each, allowed=allowed)
    return found


def _dependencies(jobs: Sequence[Job], blocks: Sequence[Block]) -> dict[int, list[int]]:
    """Return the numbers of the blocks that each block waits for; empty if no job has `after`.

    Raises
    ------
    InputError
        A block waits for one that is not run.
    """
    if not any(job.after for job in jobs):
        return {}
    numbers = {block: number for number, block in enumerate(blocks)}
    found: dict[int, list[int]] = {}
    for number, (part, block) in enumerate(blocks):
        own, found[number] = jobs[part].after, []
        for each in own(block) if own else ():
            job, index = each if isinstance(each, tuple) and isinstance(each[0], Job) else (jobs[part], each)
            other = numbers.get((jobs.index(job), index)) if job in jobs else None
            if other is None:
                what = f"job {jobs[part].name}, block {block} waits for a block that is not run"
                raise InputError(what, found=f"job {job.name}, block {index}")
            found[number].append(other)
    return found


@contextmanager
def cluster(comm: Any = None, devices: Sequence[DeviceSetting] | None = None) -> Iterator[Cluster]:
    """Return a context of all ranks and their devices; collective.

    Parameters
    ----------
    comm : mpi4py communicator or clusterviz channel; None: all ranks of mpirun, or this process alone
    devices : devices of each rank: "cpu" or the index of an EGL device, each; None: the one that the renderer would
        choose, or, without mpirun, all GPUs

    Notes
    -----
    Under mpirun, an error that all ranks agree on is printed once, by rank 0, and ends the program with its exit
    status; any other error of a rank ends all ranks. Catch errors inside of the context, or give a communicator, to go
    on after them.

    Raises
    ------
    InputError
        A device that does not exist, or several on ranks whose MPI does not serve several threads.
    """
    several = devices is not None and len(devices) > 1
    channel = open_channel(several_threads=several) if comm is None else as_channel(comm)
    try:
        with abort_on_failure(channel):
            placement = channel.placement()
            if channel.size > 1:
                limit_threads(placement)
            with agree(channel, None, "devices"):
                pool = DevicePool(devices_of(devices, placement.local_rank, channel.size))
            if several and channel.size > 1 and channel.for_thread() is None:
                found = "MPI was started for one thread"
                raise mark_agreed(InputError("several devices a rank", where="devices", found=found, allowed="one"))
            made = Cluster(channel, pool)
            try:
                yield made
            except Exception as error:
                if channel.size == 1 or is_agreed(error):  # else other ranks may never reach this place
                    made.close()
                raise
            made.close()
    except ClustervizError as error:
        if comm is not None or channel.size == 1 or not is_agreed(error):
            raise
        if channel.rank == 0:
            print(f"clusterviz: {error}", file=sys.stderr, flush=True)
        raise SystemExit(error.exit_status) from None
