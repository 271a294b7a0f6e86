"""Distributed array: each rank holds blocks of it, and every rank reads and writes any box.

Reads, writes and atomic operations are one-sided (`comm.remote_memory`): no other rank takes part. They are complete on
return. `sync` is collective: what any rank wrote before it is seen by all ranks after it. Between two calls of `sync` a
rank sees its own writes; whether it sees those of others is not defined.

An array may be larger than the memory of a node, since each holds its part. With a memory limit the blocks of a rank
beyond it lie in a file without a name, which is mapped: the operating system keeps what is used in free memory, and
writes the rest. A store (OME-Zarr) does not serve here: its compressed bricks cannot be changed in place, nor by two
ranks at once. Use `save` for what shall stay.

Floating-point sums depend on their order. `accumulate` of integers, "min" and "max" give the same bits on any ranks;
for "sum" of floats let one block's result be written by one rank, or give `order`.
"""

from __future__ import annotations

import math
import pickle
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from pathlib import Path
from types import EllipsisType
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clusterviz.comm import Channel, RemoteBox, abort_on_failure, agree, all_to_all, mark_agreed
from clusterviz.comm.remote_memory import Transfer, operation_of
from clusterviz.data.bricks import Box, read_bricks
from clusterviz.data.header import check_dtype
from clusterviz.data.source import Grid, Index, Source
from clusterviz.data.store.shards import BrickCodec
from clusterviz.data.store.writer import write_store
from clusterviz.errors import InputError, OutputError
from clusterviz.image.replace import replacing
from clusterviz.jobs.blocks import block_owners, make_blocks
from clusterviz.report.machine import memory

_ALIGNMENT = 64
_TAG = 31_000
MEMORY_SHARE = 0.9
"""Share of a node's free memory that one array may take."""

_Waiting = tuple[int, RemoteBox, int, str, NDArray[Any]]
Key = EllipsisType | int | slice | Box | tuple[int | slice | EllipsisType, ...]


class ArrayBox(tuple[Index, Index]):
    """A `Box` that knows its array.

    Attributes
    ----------
    array : the distributed array
    """

    array: DistributedArray

    def __new__(cls, array: DistributedArray, begin_zyx: Index, end_zyx: Index) -> ArrayBox:
        self = super().__new__(cls, (begin_zyx, end_zyx))
        self.array = array
        return self


class DistributedArray:
    """Array of numbers over all ranks of a channel; construction is collective.

    Parameters
    ----------
    channel : to all ranks; opened for several threads if several threads of a rank use the array
    shape : elements along z, y and x, then components, which blocks do not divide
    dtype : integers or floats of at most 64 bits
    blocks : side of the blocks in elements, or sides along z, y and x
    distribution : of the blocks: coherent or interleaved; see `block_owners`
    memory_limit : bytes of the array in each rank's memory; blocks beyond them lie in a file. None: no limit
    spill : folder for such files, on each rank's node; by default that for temporary files (TMPDIR)
    name : for messages

    Attributes
    ----------
    shape, components : all axes, and those behind z, y and x
    grid : division into blocks
    bytes_fetched : bytes that this rank read from the parts of other ranks
    bytes_local : bytes that this rank read from its own part

    Raises
    ------
    InputError
        On every rank, before anything is allocated: a wrong shape, type or distribution, or too little memory.
    RemoteMemoryError
        On every rank: the memory or the files could not be allocated.
    """

    def __init__(
        self,
        channel: Channel,
        shape: Sequence[int],
        dtype: Any,
        blocks: int | Index = 64,
        *,
        distribution: str = "coherent",
        memory_limit: int | None = None,
        spill: str | Path | None = None,
        name: str = "array",
    ) -> None:
        self.channel, self.name = channel, name
        with agree(channel, None, "array"):
            self.shape = _checked_shape(shape, name)
            self.dtype = check_dtype(np.dtype(dtype), name)
            self.grid = make_blocks(self.shape_zyx, blocks, name)
            self._owners = block_owners(self.grid, channel.size, distribution)
        self.components = self.shape[3:]
        self._zeros = (0,) * len(self.components)
        # Lists answer for one block faster than arrays.
        self._owner_lists: list[list[list[int]]] = self._owners.owner.tolist()
        self.bytes_fetched = self.bytes_local = 0
        self._counting = threading.Lock()
        self._waiting: list[_Waiting] = []
        self._element_bytes = self.dtype.itemsize * math.prod(self.components)
        sizes = -(-self.grid.elements * self._element_bytes // _ALIGNMENT) * _ALIGNMENT
        offset, in_file, in_memory, in_files = _part_layout(sizes, self._owners.owner, channel.size, memory_limit)
        self._offsets: list[list[list[int]]] = offset.tolist()
        self._is_in_file: list[list[list[bool]]] = in_file.tolist()
        _check_memory(channel, in_memory, f"{name} of shape {self.shape} and type {self.dtype}")
        # The blocks in memory, and those in files if there are any.
        self._parts = [channel.remote_memory(int(in_memory[channel.rank]))]
        if in_files.any():
            folder = Path(spill if spill is not None else tempfile.gettempdir())
            self._parts.append(channel.remote_memory(int(in_files[channel.rank]), folder))

    @property
    def shape_zyx(self) -> Index:
        """Elements along z, y and x."""
        return self.shape[0], self.shape[1], self.shape[2]

    @property
    def blocks(self) -> Index:
        """Number of blocks along z, y and x: the grid of a job that has one item a block."""
        return self.grid.counts_zyx

    def owner(self, index_zyx: Index) -> int:
        """Return the rank that holds a block."""
        return int(self._owners.owner[index_zyx])

    def box(self, index_zyx: Index, halo: int = 0) -> ArrayBox:
        """Return the box of a block, and of the elements at most `halo` beyond it along each axis, cut at the array."""
        if not all(0 <= i < n for i, n in zip(index_zyx, self.blocks, strict=True)):
            raise InputError("no such block", where=self.name, found=tuple(index_zyx), allowed=f"below {self.blocks}")
        return ArrayBox(self, *self.grid.box(index_zyx, halo))

    def bytes_by_rank(self, box: Box) -> NDArray[np.int64]:
        """Return the bytes of a box that each rank holds, int64 (ranks,)."""
        along_z, along_y, along_x = self.grid.parts(self._checked_box(box))
        found = [0] * self.channel.size
        for i, z, z_end in along_z:
            for j, y, y_end in along_y:
                owners, rows = self._owner_lists[i][j], (z_end - z) * (y_end - y)
                for k, x, x_end in along_x:
                    found[owners[k]] += rows * (x_end - x)
        return np.array(found, np.int64) * self._element_bytes

    def own_blocks(self) -> Iterator[tuple[Index, NDArray[Any]]]:
        """Yield the blocks that this rank holds, in array order: index and writable elements, (z, y, x, components)."""
        for z, y, x in self._owners.bricks(self.channel.rank).tolist():
            begin, end = self.grid.box((z, y, x))
            number, place = self._place((z, y, x), (begin, end))
            yield (z, y, x), np.ndarray(place.shape, self.dtype, self._parts[number].own, place.offset)

    def read(self, box: Box) -> NDArray[Any]:
        """Return the elements of a box, (z, y, x, components), owned by the caller.

        Raises
        ------
        InputError
            The box does not lie in the array.
        """
        begin, end = self._checked_box(box)
        values = np.empty((*np.subtract(end, begin), *self.components), self.dtype)
        transfers = self._transfers((begin, end), values)
        for part, some in zip(self._parts, transfers, strict=True):
            part.get(some)
        far = sum(values.nbytes for some in transfers for box, values in some if box.rank != self.channel.rank)
        with self._counting:
            self.bytes_fetched += far
            self.bytes_local += values.nbytes - far
        return values

    def write(self, box: Box, values: ArrayLike) -> None:
        """Write values into a box; they are repeated as in NumPy. Of writes to one element at once, one wins.

        Raises
        ------
        InputError
            The box does not lie in the array, or the values do not fit its shape or the array's type.
        """
        transfers = self._transfers(self._checked_box(box), self._fitting(box, values))
        for part, some in zip(self._parts, transfers, strict=True):
            part.put(some)

    def accumulate(self, box: Box, values: ArrayLike, operation: str = "sum", order: int | None = None) -> None:
        """Combine the elements of a box with values: sum, min or max; atomic in each block. NaN wins over numbers.

        Parameters
        ----------
        order : number of this contribution, as the number of the block of a job, that no other contribution has: it is
            kept until `sync`, and then all are applied in rising order, so that sums of floats have the same bits on
            any ranks. None: it is applied at once.

        Raises
        ------
        InputError
            As `write`; or no such operation.
        """
        operation_of(operation)
        transfers = self._transfers(self._checked_box(box), self._fitting(box, values))
        if order is not None:
            with self._counting:
                for number, some in enumerate(transfers):
                    self._waiting += [(order, place, number, operation, np.array(part)) for place, part in some]
            return
        for part, some in zip(self._parts, transfers, strict=True):
            part.accumulate(some, operation)

    def compare_and_swap(self, index: Sequence[int], expected: Any, new: Any) -> Any:
        """Write an element if its bytes are those of `expected`, atomically, and return its previous value.

        Parameters
        ----------
        index : of the element along z, y, x and the components
        expected, new : numbers of the array's type

        Raises
        ------
        InputError
            No such element, or numbers of another type.
        """
        at = tuple(map(int, index))
        if len(at) != len(self.shape) or not all(0 <= i < n for i, n in zip(at, self.shape, strict=True)):
            raise InputError("no such element", where=self.name, found=at, allowed=f"below {self.shape}")
        block = cast(Index, tuple(i // side for i, side in zip(at[:3], self.grid.block_zyx, strict=True)))
        number, place = self._place(block, self.grid.box(block))
        inside = (*(i % side for i, side in zip(at[:3], self.grid.block_zyx, strict=True)), *at[3:])
        element = RemoteBox(place.rank, place.offset, place.shape, inside, tuple(i + 1 for i in inside))
        one = (1,) * len(at)
        old, given = (self._typed(value).reshape(one) for value in (expected, new))
        return self._parts[number].compare_and_swap(element, old, given).reshape(())[()]

    def __getitem__(self, key: Key) -> Any:
        """Read a box: array[...], array[box], or integers and slices along z, y and x as in NumPy."""
        box, dropped = self._box_of(key)
        return self.read(box)[dropped]

    def __setitem__(self, key: Key, values: ArrayLike) -> None:
        """Write a box, given as for reading."""
        box, dropped = self._box_of(key)
        given = np.asarray(values)
        missing = tuple(axis for axis, part in enumerate(dropped) if part == 0)
        self.write(box, np.expand_dims(given, missing) if given.ndim and missing else given)

    def fill(self, value: Any) -> None:
        """Set all elements to a value, or to one for each component; collective."""
        with agree(self.channel, None, "fill"):
            number = self._typed(value)
            for _, elements in self.own_blocks():
                elements[...] = number
        self.sync()

    def fill_from(self, source: Source) -> None:
        """Read all elements from a data source, each rank those of its blocks; collective.

        Raises
        ------
        InputError
            The source has another shape, or a type that the array's does not hold.
        RankError, DataError
            On every rank: it cannot be read.
        """
        with agree(self.channel, None, "read"):
            if source.grid.shape_zyx != self.shape_zyx:
                raise InputError(
                    "not the shape of the array", where=source.name, found=source.grid.shape_zyx, allowed=self.shape_zyx
                )
            if self.components:
                for index, elements in self.own_blocks():
                    elements[...] = self._fitting(self.grid.box(index), source.read(*self.grid.box(index)))
            else:
                own = dict(self.own_blocks())
                for index, samples in read_bricks(source, self.grid, own):
                    own[index][...] = self._typed(samples)
        self.sync()

    def as_source(self, grid: Grid | None = None) -> ArrayBoxes:
        """Return the array as a data source, for `clusterviz.render` on the same ranks.

        Parameters
        ----------
        grid : positions of the elements; by default 1 apart from the world's origin

        Raises
        ------
        InputError
            The array has components, or the grid another shape.
        """
        if self.components:
            raise InputError("not a scalar volume", where=self.name, found=f"shape {self.shape}", allowed="(z, y, x)")
        if grid is not None and grid.shape_zyx != self.shape_zyx:
            raise InputError(
                "not the shape of the array", where=self.name, found=grid.shape_zyx, allowed=self.shape_zyx
            )
        return ArrayBoxes(self, grid or Grid(self.shape_zyx))

    def save(self, path: str | Path, grid: Grid | None = None) -> None:
        """Write the array as a NumPy file (.npy) or a store (.zarr) in a folder that all ranks see; collective.

        Parameters
        ----------
        grid : positions of the elements of a store

        Raises
        ------
        OutputError, RankError
            On every rank: it cannot be written, or has no such name.
        """
        target = Path(path)
        self.sync()
        with agree(self.channel, None, "save"):
            if target.suffix not in (".npy", ".zarr"):
                raise OutputError("no such file of an array", where=str(target), allowed="NAME.npy, NAME.zarr")
            if target.suffix == ".zarr" and target.exists():  # a store of another array would be continued
                raise OutputError("something else is there", where=str(target), allowed="a new name")
        if target.suffix == ".zarr":
            codec, together = BrickCodec(), partial(_stage, self.channel)
            rank, size, share = self.channel.rank, self.channel.size, self.channel.allgather
            write_store(self.as_source(grid), target, codec, 64, rank, size, together, share)
            return
        with ExitStack() as stack:
            with agree(self.channel, None, "save"):
                file = stack.enter_context(replacing(target)) if self.channel.rank == 0 else target
                if self.channel.rank == 0:
                    np.lib.format.open_memmap(file, "w+", self.dtype, self.shape)
            file = self.channel.broadcast(file)
            with agree(self.channel, None, "save"):
                written = np.lib.format.open_memmap(file, "r+")
                for index, elements in self.own_blocks():
                    written[tuple(map(slice, *self.grid.box(index)))] = elements
                written.flush()

    def sync(self) -> None:
        """Apply contributions that wait, and let all ranks see what any of them wrote before; collective."""
        self._parts[0].sync()
        if self.channel.maximum(len(self._waiting)):
            self._apply_waiting()
            self._parts[0].sync()
        for part in self._parts[1:]:
            part.sync()

    def _apply_waiting(self) -> None:
        """Send contributions that wait to the owners of their blocks, and apply those to own blocks in order."""
        sent = [
            pickle.dumps([one for one in self._waiting if one[1].rank == rank]) for rank in range(self.channel.size)
        ]
        self._waiting.clear()
        received = all_to_all(self.channel, [np.frombuffer(data, np.uint8) for data in sent], _TAG)
        mine: list[_Waiting] = [one for data in received for one in pickle.loads(data.tobytes())]
        for _, place, number, operation, values in sorted(mine, key=lambda one: one[0]):
            target = np.ndarray(place.shape, self.dtype, self._parts[number].own, place.offset)[place.slices]
            operation_of(operation)(target, values, out=target)

    def free(self) -> None:
        """Release the memory; collective."""
        for part in self._parts:
            part.free()

    def _place(self, block: Index, box: Box) -> tuple[int, RemoteBox]:
        """Return where a box of one block's elements lies: the number of the part, and the place in it."""
        (z, y, x), (z_end, y_end, x_end) = self.grid.box(block)
        (z_in, y_in, x_in), (z_out, y_out, x_out) = box
        i, j, k = block
        return int(self._is_in_file[i][j][k]), RemoteBox(
            self._owner_lists[i][j][k],
            self._offsets[i][j][k],
            (z_end - z, y_end - y, x_end - x, *self.components),
            (z_in - z, y_in - y, x_in - x, *self._zeros),
            (z_out - z, y_out - y, x_out - x, *self.components),
        )

    def _transfers(self, box: Box, values: NDArray[Any]) -> list[list[Transfer]]:
        """Return what each of `_parts` has of a box, with views of its values."""
        found: list[list[Transfer]] = [[] for _ in self._parts]
        (z, y, x), _ = box
        for block, (begin, end) in self.grid.shared(box):
            number, place = self._place(block, (begin, end))
            part = values[begin[0] - z : end[0] - z, begin[1] - y : end[1] - y, begin[2] - x : end[2] - x]
            found[number].append((place, part))
        return found

    def _checked_box(self, box: Box) -> Box:
        (z, y, x), (z_end, y_end, x_end) = box
        depth, height, width = self.shape_zyx
        if not (0 <= z <= z_end <= depth and 0 <= y <= y_end <= height and 0 <= x <= x_end <= width):
            found = f"{(z, y, x)} to {(z_end, y_end, x_end)}"
            raise InputError("no such box", where=self.name, found=found, allowed=f"inside {self.shape_zyx}")
        return box

    def _typed(self, values: ArrayLike) -> NDArray[Any]:
        """Return values in the array's type."""
        given = np.asarray(values)
        try:
            if given.dtype.kind in "iu" and not hasattr(values, "dtype"):
                return np.asarray(values, self.dtype)
            if np.can_cast(given.dtype, self.dtype, "same_kind"):
                return given.astype(self.dtype, copy=False)
        except OverflowError:
            pass
        raise InputError("not of the array's type", where=self.name, found=given.dtype, allowed=self.dtype)

    def _fitting(self, box: Box, values: ArrayLike) -> NDArray[Any]:
        """Return values in the array's type and the shape of a box."""
        begin, end = box
        shape = (*(e - b for b, e in zip(begin, end, strict=True)), *self.components)
        given = self._typed(values)
        try:
            return np.broadcast_to(given, shape)
        except ValueError:
            raise InputError(
                "not of the box's shape", where=self.name, found=f"values of shape {given.shape}", allowed=shape
            ) from None

    def _box_of(self, key: Key) -> tuple[Box, tuple[int | slice, ...]]:
        """Return the box that a key names, and what takes away the axes of its integers."""
        keys: tuple[Any, ...] = key if isinstance(key, tuple) else (key,)
        if len(keys) == 2 and all(isinstance(corner, tuple) for corner in keys):
            return cast(Box, keys), ()
        if Ellipsis in keys:
            first = keys.index(Ellipsis)
            keys = (*keys[:first], *[slice(None)] * (4 - len(keys)), *keys[first + 1 :])
        keys = (*keys, *[slice(None)] * (3 - len(keys)))
        allowed = "a box, or integers and slices without steps along z, y and x"
        error = InputError("no such part of an array", where=self.name, found=key, allowed=allowed)
        if len(keys) != 3:
            raise error
        spans, dropped = list[tuple[int, int]](), list[int | slice]()
        # An integer is a box of one element, whose axis is taken away afterwards.
        for part, n in zip(keys, self.shape_zyx, strict=True):
            if isinstance(part, int | np.integer):
                at = int(part) + (n if part < 0 else 0)
                spans.append((at, at + 1))
                dropped.append(0)
            elif isinstance(part, slice) and part.step in (None, 1):
                low, high, _ = part.indices(n)
                spans.append((low, max(low, high)))
                dropped.append(slice(None))
            else:
                raise error
        (z, z_end), (y, y_end), (x, x_end) = spans
        return ((z, y, x), (z_end, y_end, x_end)), tuple(dropped)


class ArrayBoxes:
    """Distributed array as a data source; each rank reads the boxes that it needs."""

    def __init__(self, array: DistributedArray, grid: Grid) -> None:
        self._array, self.grid, self.name, self.dtype = array, grid, array.name, array.dtype

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """Read the samples of a box; see `Source.read`."""
        return self._array.read((begin_zyx, end_zyx))


def array_from(channel: Channel, source: Source, blocks: int | Index = 64, **options: Any) -> DistributedArray:
    """Return a distributed array with the samples of a data source; collective.

    Parameters
    ----------
    options : of `DistributedArray`
    """
    array = DistributedArray(channel, source.grid.shape_zyx, source.dtype, blocks, **{"name": source.name} | options)
    array.fill_from(source)
    return array


def _stage(channel: Channel, stage: str) -> AbstractContextManager[None]:
    """Return the context of a stage of `write_store`."""
    return (abort_on_failure if stage == "statistics" else agree)(channel, None, stage)


def _checked_shape(shape: Sequence[int], name: str) -> tuple[int, ...]:
    sizes = tuple(shape) if isinstance(shape, Sequence) else (shape,)
    if len(sizes) < 3 or not all(isinstance(n, int | np.integer) and n >= 1 for n in sizes):
        allowed = "elements along z, y and x, and components, each at least 1"
        raise InputError("no shape of an array", where=name, found=shape, allowed=allowed)
    return tuple(map(int, sizes))


def _part_layout(
    sizes: NDArray[np.int64], owner: NDArray[np.int32], ranks: int, memory_limit: int | None
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
    """Return where each block lies in its owner's parts.

    Parameters
    ----------
    sizes : int64 (bz, by, bx), bytes of the blocks
    owner : int32 (bz, by, bx)

    Returns
    -------
    offset : int64 (bz, by, bx), bytes before a block in its part
    in_file : bool (bz, by, bx)
    in_memory, in_files : int64 (ranks,), bytes of the parts
    """
    order = np.argsort(owner, axis=None, kind="stable")
    owners, sorted_sizes = owner.reshape(-1)[order], sizes.reshape(-1)[order]
    ends = np.cumsum(sorted_sizes)
    totals = np.bincount(owners, sorted_sizes, ranks).astype(np.int64)
    begins = ends - sorted_sizes - (np.cumsum(totals) - totals)[owners]
    limit = totals.max() if memory_limit is None else memory_limit
    is_in_file = begins + sorted_sizes > limit
    in_memory = np.bincount(owners, np.where(is_in_file, 0, sorted_sizes), ranks).astype(np.int64)
    begins -= np.where(is_in_file, in_memory[owners], 0)
    offset, in_file = np.empty(sizes.size, np.int64), np.empty(sizes.size, np.bool_)
    offset[order], in_file[order] = begins, is_in_file
    return offset.reshape(sizes.shape), in_file.reshape(sizes.shape), in_memory, totals - in_memory


def _check_memory(channel: Channel, own_bytes: NDArray[np.int64], where: str) -> None:
    """Refuse an array whose parts do not fit into the free memory of a node; collective.

    Raises
    ------
    InputError
        On every rank.
    """
    place, free = channel.placement(), int(MEMORY_SHARE * memory().available_bytes)
    told = channel.allgather_numbers([place.node, free])
    for node in range(place.nodes):
        ranks = np.flatnonzero(told[:, 0] == node)
        needed, least = int(own_bytes[ranks].sum()), int(told[ranks, 1].min())
        if least and needed > least:
            found = f"{needed} bytes for {len(ranks)} of {channel.size} ranks on node {node}"
            allowed = f"{least} bytes there; more nodes, or a memory_limit beyond which blocks lie in files"
            raise mark_agreed(
                InputError("the array does not fit into memory", where=where, found=found, allowed=allowed)
            )
