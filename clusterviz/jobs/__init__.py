"""Work that is not pictures: kernels on devices, tasks on the devices of a node, jobs over ranks.

kernel.py     GLSL function of a point of a grid, on a GPU or on CPU vectors
device.py     devices of a process, and the launch of a kernel on each kind
task.py       Python function of a block, on the devices of a node
job.py        Python function of a block, on all ranks
scheduler.py  which rank runs which block; pure
cluster.py    runs jobs
time_limit.py watch over blocks that run for long
array.py      distributed arrays
blocks.py     their division into blocks, and the owners of these
"""

from __future__ import annotations

from clusterviz.jobs.array import DistributedArray, array_from
from clusterviz.jobs.cluster import Cluster, Run, cluster
from clusterviz.jobs.device import Device, devices, on_device
from clusterviz.jobs.job import Job, job
from clusterviz.jobs.kernel import Kernel, KernelError, kernel
from clusterviz.jobs.task import Task, task

__all__ = [
    "Cluster",
    "Device",
    "DistributedArray",
    "Job",
    "Kernel",
    "KernelError",
    "Run",
    "Task",
    "array_from",
    "cluster",
    "devices",
    "job",
    "kernel",
    "on_device",
    "task",
]
