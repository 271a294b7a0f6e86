"""GPU memory of a rank's bricks: a pool of few atlases, with a slot for each brick.

An atlas is one buffer or texture, with the visibility of its bricks' groups of cells. Bricks are added and dropped one
by one; groups of bricks within the GPU's limits are compact, so that few parts have to be drawn.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.6.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, MutableMapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import DeviceError
from clusterviz.gl.device import Device
from clusterviz.gl.texels import copy_box, read_box
from clusterviz.partition import UNASSIGNED, BrickBox, Owners, bounding_box, build_tree, visible_groups
from clusterviz.plan.geometry import Members
from clusterviz.plan.plan import Plan
from clusterviz.render.content_bricks import pack_parts, parts_of
from clusterviz.render.group_box import skips_in_box
from clusterviz.render.storage import STORED_TYPE, Slot
from clusterviz.render.stored_brick import Ranges, Stored, doubling_bits, visibility_bits
from clusterviz.scene.transfer import TransferFunction

Index = tuple[int, int, int]
TEXEL_TYPE = {"u8": "f1", "u16": "nu2", "f32": "f4"}  # moderngl's names; integers are normalised
TEXTURE_BYTES = 1 << 30
ABSENT = -3
"""Offset of a brick that is stored when a ray comes to it, see main/pixels.glsl."""


class BrickAtlas:
    """Slots for bricks in one buffer or one texture.

    Parameters
    ----------
    context : a context that this thread has current
    slot : layout of a brick
    slot_count : number of slots, at least 1

    Attributes
    ----------
    slots : the number of each brick's slot

    Raises
    ------
    MemoryError
        The card has no memory for them.
    """

    def __init__(self, context: moderngl.Context, slot: Slot, slot_count: int) -> None:
        self._context, self._slot, self.slot_count = context, slot, slot_count
        self.slots: dict[Index, int] = {}
        self._free = list(range(slot_count))[::-1]
        self._ranges: dict[int, Ranges] = {}
        self._bends = np.zeros((slot_count, 2, *slot.groups_zyx), np.float32) if slot.adaptive else None
        self._doublings: tuple[TransferFunction, NDArray[np.uint32]] | None = None
        self._counts = np.zeros(slot_count, np.int64)
        self._members: dict[int, tuple[Members | None, ...]] = {}
        self._voxels = (
            _texture(context, slot, slot_count) if slot.textured else context.buffer(reserve=slot_count * slot.bytes)
        )
        if context.error == "GL_OUT_OF_MEMORY":
            self._voxels.release()
            raise MemoryError

    @property
    def free(self) -> int:
        """Number of free slots."""
        return len(self._free)

    @property
    def bytes(self) -> int:
        """Bytes of GPU memory."""
        return self.slot_count * self._slot.bytes

    @property
    def voxels(self) -> int:
        """Number of samples of its bricks."""
        return int(self._counts[list(self.slots.values())].sum())

    def put(self, index: Index, stored: Stored) -> None:
        """Store a brick in a free slot."""
        number = self._free.pop()
        self.slots[index] = number
        self._note(number, stored)
        words = pack_parts(stored.parts, self._slot)
        if isinstance(self._voxels, moderngl.Buffer):
            self._voxels.write(words, offset=number * self._slot.bytes)
        else:
            self._voxels.write(words, viewport=self._viewport(number), alignment=1)

    def drop(self, index: Index) -> None:
        """Free a brick's slot."""
        self._free.append(self.slots.pop(index))
        del self._members[self._free[-1]]

    def grown(self, slot_count: int) -> BrickAtlas:
        """Return an atlas with the same bricks and more slots, and release this one."""
        larger = BrickAtlas(self._context, self._slot, slot_count)
        if isinstance(self._voxels, moderngl.Buffer) and isinstance(larger._voxels, moderngl.Buffer):
            larger._take_over(self)
            self._context.copy_buffer(larger._voxels, self._voxels, self.bytes)
        elif hasattr(self._voxels, "glo"):
            larger._take_over(self)
            for number in self.slots.values():
                begin, to = self._viewport(number), larger._viewport(number)
                copy_box(self._voxels.glo, begin[:3], larger._voxels.glo, to[:3], begin[3:])
        else:  # a draw is recorded
            for index, stored in self.stored(list(self.slots)):
                larger.put(index, stored)
        self.release()
        return larger

    def stored(self, bricks: Sequence[Index]) -> Iterator[tuple[Index, Stored]]:
        """Read bricks back from the GPU."""
        for index in bricks:
            number = self.slots[index]
            low, high = self._ranges[number]
            bend = None if self._bends is None else self._bends[number]
            words = self._words(number) if isinstance(self._voxels, moderngl.Buffer) else self._texels(number)
            count, members = int(self._counts[number]), self._members[number]
            yield index, Stored(parts_of(words, self._slot), low, high, count, bend, members)

    def members(self, bricks: NDArray[np.int64]) -> list[tuple[Members | None, ...]]:
        """Return what bricks (m, 3) hold of each layer."""
        return [self._members[self.slots[z, y, x]] for z, y, x in bricks.tolist()]

    def tables(self, plan: Plan, box: BrickBox, bricks: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the offsets, and the visible groups of cells, of all bricks of a box.

        Parameters
        ----------
        bricks : int64 (m, 3), bricks to draw, all in the box

        Returns
        -------
        offsets : int32, one for each brick of the box: first word (buffer) or slot number (texture), −1 for none, and
            `ABSENT` for a brick that is not in this atlas
        groups : uint32, `slot.group_words` for each brick of the box; int32 of several volumes, as `skips_in_box`
        """
        offsets = np.full(box.shape_zyx, -1, np.int32)
        groups = np.zeros((*box.shape_zyx, self._slot.group_words), np.uint32)
        is_here = np.array([(z, y, x) in self.slots for z, y, x in bricks.tolist()], np.bool_)
        absent = tuple((bricks[~is_here] - box.begin_zyx).T)
        # Anything may be visible there.
        offsets[absent], groups[absent] = ABSENT, 0xFFFFFFFF
        bricks = bricks[is_here]
        if not len(bricks):
            return offsets, groups
        numbers = np.array([self.slots[z, y, x] for z, y, x in bricks.tolist()])
        places = tuple((bricks - box.begin_zyx).T)
        offsets[places] = numbers if self._slot.textured else numbers * self._slot.words
        if self._slot.group_box:
            each = [self._ranges[number] for number in numbers.tolist()]
            return offsets, skips_in_box(plan, self._slot.group_box, bricks, each, far=False)
        words = visibility_bits(self._stacked(numbers), plan, self._slot)
        if self._bends is not None:
            words = np.concatenate([words, self._stretches(plan)[numbers]], axis=1)
        groups[places] = words
        return offsets, groups

    def _stretches(self, plan: Plan) -> NDArray[np.uint32]:
        """Return the lengths of slabs in the groups of all slots, cached for one transfer function."""
        if self._doublings is None or self._doublings[0] is not plan.volume.transfer:
            assert self._bends is not None, "the step is fixed"
            found = np.zeros((self.slot_count, 2 * self._slot.visibility_words), np.uint32)
            used = np.array(sorted(self._ranges))
            found[used] = doubling_bits(self._stacked(used), self._bends[used], plan, self._slot)
            self._doublings = plan.volume.transfer, found
        return self._doublings[1]

    def _stacked(self, numbers: NDArray[np.int64]) -> Ranges:
        """Return low and high of slots, each (n, volumes, *slot.groups_zyx)."""
        each = [self._ranges[number] for number in numbers.tolist()]
        return np.stack([low for low, _ in each]), np.stack([high for _, high in each])

    def bind(self, device: Device) -> None:
        """Bind the buffer or texture for drawing."""
        device.bind("voxels" if isinstance(self._voxels, moderngl.Buffer) else "atlas", self._voxels)

    def release(self) -> None:
        """Free the GPU memory."""
        self._voxels.release()

    def _note(self, number: int, stored: Stored) -> None:
        self._ranges[number] = stored.low, stored.high
        if self._bends is not None:
            self._bends[number], self._doublings = stored.bend, None
        self._counts[number], self._members[number] = stored.voxels, stored.members

    def _take_over(self, smaller: BrickAtlas) -> None:
        """Copy the metadata of a smaller atlas, whose bricks keep their slots."""
        self.slots = dict(smaller.slots)
        self._free = [number for number in range(self.slot_count)[::-1] if number >= smaller.slot_count] + smaller._free
        self._counts = _lengthened(smaller._counts, self.slot_count)
        self._members = smaller._members
        self._ranges = smaller._ranges
        if smaller._bends is not None:
            self._bends = _lengthened(smaller._bends, self.slot_count)

    def _words(self, number: int) -> NDArray[Any]:
        """Read a slot of a buffer."""
        assert isinstance(self._voxels, moderngl.Buffer), "textures have texels"
        return np.frombuffer(self._voxels.read(self._slot.bytes, offset=number * self._slot.bytes), "<u4")

    def _texels(self, number: int) -> NDArray[Any]:
        """Read a slot of a texture, (z, y, x)."""
        assert isinstance(self._voxels, moderngl.Texture3D), "buffers have words"
        x, y, z, width, height, depth = self._viewport(number)
        return read_box(self._voxels, (x, y, z), (depth, height, width), STORED_TYPE[self._slot.kind])

    def _viewport(self, number: int) -> tuple[int, int, int, int, int, int]:
        """Return the texels of a slot: corner and size along (x, y, z)."""
        assert isinstance(self._voxels, moderngl.Texture3D), "buffers have no corners"
        z, y, x = self._slot.samples_zyx
        across, down = self._voxels.width // x, self._voxels.height // y
        return number % across * x, number // across % down * y, number // (across * down) * z, x, y, z


def capacity(context: moderngl.Context, slot: Slot, block_bytes: int | None = None) -> int:
    """Return the bricks that one atlas can hold on this context, at least 1.

    Parameters
    ----------
    block_bytes : a limit below the driver's own, for tests
    """
    limit = TEXTURE_BYTES if slot.textured else int(context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
    most = min(limit, block_bytes or limit) // slot.bytes
    if slot.textured:
        side = int(context.info["GL_MAX_3D_TEXTURE_SIZE"])
        most = min(most, int(np.prod([side // n for n in slot.samples_zyx])))
    return max(1, most)


def _lengthened(rows: NDArray[Any], count: int) -> NDArray[Any]:
    """Return the rows, padded with zeros."""
    return np.concatenate([rows, np.zeros((count - len(rows), *rows.shape[1:]), rows.dtype)])


def _texture(context: moderngl.Context, slot: Slot, slot_count: int) -> moderngl.Texture3D:
    """Return a texture of slots side by side along x, then y, then z."""
    side = int(context.info["GL_MAX_3D_TEXTURE_SIZE"])
    z, y, x = slot.samples_zyx
    across, down = min(slot_count, side // x), side // y
    rows = -(-slot_count // across)
    down = min(rows, down)
    texture = context.texture3d(
        (across * x, down * y, -(-rows // down) * z), 1, alignment=1, dtype=TEXEL_TYPE[slot.kind]
    )
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    texture.repeat_x = texture.repeat_y = texture.repeat_z = False
    return texture


def chunks_of(bricks: Collection[Index], capacity: int) -> list[list[Index]]:
    """Divide bricks into groups of at most `capacity` ≥ 1; the box around a group contains no brick of another."""
    if len(bricks) <= capacity:
        return [sorted(bricks)] if bricks else []
    indices = np.array(sorted(bricks), np.int64)
    box = bounding_box(indices)
    present = np.zeros(box.shape_zyx)
    present[tuple((indices - box.begin_zyx).T)] = 1.0
    count = -(-len(bricks) // capacity)
    tree = build_tree(present, count)
    while max(leaf.cost for leaf in tree.leaves) > capacity:
        count += 1
        tree = build_tree(present, count)
    found = [np.argwhere(present[leaf.box.slices]) + leaf.box.begin_zyx + box.begin_zyx for leaf in tree.leaves]
    return [[(int(z), int(y), int(x)) for z, y, x in chunk] for chunk in found if len(chunk)]


T = TypeVar("T")
GROWTH = 1.25  # least growth of a full atlas, so that bricks which come one by one are not copied each time


class BrickPool:
    """Bricks in GPU memory, by index.

    Parameters
    ----------
    context : a context that this thread has current
    slot : layout of a brick
    capacity : most bricks of one atlas
    most : most slots in all, unless more are needed; None: no limit

    Attributes
    ----------
    version : another number whenever bricks have come, gone or moved
    """

    def __init__(self, context: moderngl.Context, slot: Slot, capacity: int, most: int | None = None) -> None:
        self._context, self._slot, self._capacity, self._most = context, slot, capacity, most
        self.version = 0
        self._atlases: list[BrickAtlas] = []
        self._waiting: dict[Index, Callable[[], Stored]] = {}

    @property
    def bricks(self) -> set[Index]:
        """Indices of all bricks, including those not uploaded yet."""
        return {index for atlas in self._atlases for index in atlas.slots} | self._waiting.keys()

    @property
    def bytes(self) -> int:
        """Bytes of GPU memory, including free slots."""
        return sum(atlas.bytes for atlas in self._atlases)

    @property
    def voxels(self) -> int:
        """Number of samples of the bricks."""
        return sum(atlas.voxels for atlas in self._atlases)

    def reserve(self, bricks: int) -> None:
        """Have slots for so many bricks, allocated at once, as an atlas that grows is there twice for a while."""
        if sum(atlas.slot_count for atlas in self._atlases) >= bricks:
            return
        self.release()
        for begin in range(0, bricks, self._capacity):
            slot_count = min(self._capacity, bricks - begin)
            self._atlases.append(self._atlas(slot_count))

    def put(self, bricks: MutableMapping[Index, T], stored: Callable[[Index, T], Stored]) -> None:
        """Add bricks; each is removed from the mapping, so that none is held twice for long."""
        self.version += bool(bricks)
        for atlas in self._atlases:
            for index in sorted(bricks)[: atlas.free]:
                atlas.put(index, stored(index, bricks.pop(index)))
        for chunk in chunks_of(bricks.keys(), self._capacity):
            atlas = self._with_free_slots(len(chunk))
            for index in chunk:
                atlas.put(index, stored(index, bricks.pop(index)))

    def put_later(self, bricks: MutableMapping[Index, T], stored: Callable[[Index, T], Stored]) -> None:
        """Add bricks, removed from the mapping, that stay in host memory until they are needed."""
        self.version += bool(bricks)
        for index in list(bricks):
            self._waiting[index] = partial(stored, index, bricks.pop(index))

    def stored(self, bricks: Iterable[Index]) -> Iterator[tuple[Index, Stored]]:
        """Read bricks back from the GPU."""
        wanted = set(bricks)
        self.fetch(np.array(sorted(wanted)).reshape(-1, 3))
        for atlas in self._atlases:
            yield from atlas.stored(sorted(wanted & atlas.slots.keys()))

    def drop(self, bricks: Iterable[Index]) -> None:
        """Drop bricks."""
        wanted = set(bricks)
        self.version += bool(wanted)
        for index in wanted & self._waiting.keys():
            del self._waiting[index]
        for atlas in self._atlases:
            for index in wanted & atlas.slots.keys():
                atlas.drop(index)

    def holds_in_one(self, bricks: NDArray[np.int64]) -> bool:
        """Return True if all of the bricks (m, 3) are in one atlas, or would be."""
        return len(self._atlases) <= 1 and len(self.bricks | {*map(tuple, bricks.tolist())}) <= self._capacity

    def fetch(self, bricks: NDArray[np.int64]) -> int:
        """Upload those of the bricks (m, 3) that are in host memory, and return their number."""
        wanted = self._waiting.keys() & {(z, y, x) for z, y, x in bricks.tolist()}
        self.put({index: self._waiting.pop(index) for index in wanted}, lambda _, make: make())
        return len(wanted)

    def parts(
        self, plan: Plan, bricks: NDArray[np.int64], waits: bool = False
    ) -> Iterator[tuple[BrickAtlas, NDArray[np.int64]]]:
        """Yield bricks by atlas, in parts that can be drawn one behind the other.

        Parameters
        ----------
        bricks : int64 (m, 3), indices (z, y, x), m at least 1; no ray leaves them for others and returns
        waits : leave those in host memory, as `holds_in_one` allows

        Raises
        ------
        KeyError
            A brick is not in the pool.
        """
        if unknown := {(z, y, x) for z, y, x in bricks.tolist()} - self.bricks:
            raise KeyError(min(unknown))
        if not waits:
            self.fetch(bricks)
        if not self._atlases:
            self._atlases.append(BrickAtlas(self._context, self._slot, 1))
        if len(self._atlases) == 1:
            yield self._atlases[0], bricks
            return
        where = {index: number for number, atlas in enumerate(self._atlases) for index in atlas.slots}
        box = bounding_box(bricks)
        owner = np.full(box.shape_zyx, UNASSIGNED, np.int32)
        owner[tuple((bricks - box.begin_zyx).T)] = [where[z, y, x] for z, y, x in bricks.tolist()]
        for group in visible_groups(
            Owners(len(self._atlases), owner), plan.eye_in_bricks(box.begin_zyx), plan.view.forward
        ):
            yield self._atlases[group.rank], group.bricks + box.begin_zyx

    def release(self) -> None:
        """Free all GPU memory."""
        self.version += 1
        for atlas in self._atlases:
            atlas.release()
        self._atlases, self._waiting = [], {}

    def _with_free_slots(self, bricks: int) -> BrickAtlas:
        """Return an atlas with free slots: the last one, enlarged, or a new one."""
        last = self._atlases[-1] if self._atlases else None
        if last is not None and last.slot_count - last.free + bricks <= self._capacity:
            slot_count = min(self._capacity, int(GROWTH * last.slot_count))
            if self._most is not None:
                slot_count = min(slot_count, self._most - sum(other.slot_count for other in self._atlases[:-1]))
            slot_count = max(slot_count, last.slot_count - last.free + bricks)
            # An atlas that grows is there twice for a while; where that does not fit, another one is drawn behind it.
            with suppress(MemoryError):
                self._atlases[-1] = last.grown(slot_count)
                return self._atlases[-1]
        self._atlases.append(self._atlas(bricks))
        return self._atlases[-1]

    def _atlas(self, slot_count: int) -> BrickAtlas:
        """Return a new atlas.

        Raises
        ------
        DeviceError
            The card has no memory for it.
        """
        try:
            return BrickAtlas(self._context, self._slot, slot_count)
        except MemoryError:
            raise DeviceError(
                f"{self._context.info['GL_RENDERER']} has no memory for {slot_count} more bricks; needed "
                f"{slot_count * self._slot.bytes} bytes beside {self.bytes}; with a cluster.memory_limit below "
                "what the card has, bricks are drawn in passes, and more ranks on other cards have fewer each"
            ) from None
