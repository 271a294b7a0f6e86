"""Brick atlas: one GPU buffer or texture with a slot for each brick, and the visibility of their groups of cells."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.texels import read_box
from clusterviz.partition import BrickBox
from clusterviz.plan.plan import Plan
from clusterviz.render.empty_space import visibility_bits
from clusterviz.render.field_curvature import stretch_bits
from clusterviz.render.storage import STORED_TYPE, Slot
from clusterviz.render.stored_brick import Stored
from clusterviz.scene.transfer import TransferFunction

Index = tuple[int, int, int]
TEXEL_TYPE = {"u8": "f1", "u16": "nu2", "f32": "f4"}  # moderngl's names; integers are normalised
TEXTURE_BYTES = 1 << 30


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
    """

    def __init__(self, context: moderngl.Context, slot: Slot, slot_count: int) -> None:
        self._context, self._slot, self.slot_count = context, slot, slot_count
        self.slots: dict[Index, int] = {}
        self._free = list(range(slot_count))[::-1]
        self._ranges: tuple[NDArray[Any], NDArray[Any]] | None = None
        self._bends = np.zeros((slot_count, 2, *slot.groups_zyx), np.float32) if slot.stretched else None
        self._stretched: tuple[TransferFunction, NDArray[np.uint32]] | None = None
        self._counts = np.zeros(slot_count, np.int64)
        self._voxels = (
            _texture(context, slot, slot_count) if slot.textured else context.buffer(reserve=slot_count * slot.bytes)
        )

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
        words = self._slot.pack(stored.samples)
        if isinstance(self._voxels, moderngl.Buffer):
            self._voxels.write(words, offset=number * self._slot.bytes)
        else:
            self._voxels.write(words, viewport=self._viewport(number), alignment=1)

    def drop(self, index: Index) -> None:
        """Free a brick's slot."""
        self._free.append(self.slots.pop(index))

    def grown(self, slot_count: int) -> BrickAtlas:
        """Return an atlas with the same bricks and more slots, and release this one."""
        larger = BrickAtlas(self._context, self._slot, slot_count)
        if isinstance(self._voxels, moderngl.Buffer) and isinstance(larger._voxels, moderngl.Buffer):
            larger._take_over(self)
            self._context.copy_buffer(larger._voxels, self._voxels, self.bytes)
        else:
            for index, stored in self.stored(list(self.slots)):
                larger.put(index, stored)
        self.release()
        return larger

    def stored(self, bricks: Sequence[Index]) -> Iterator[tuple[Index, Stored]]:
        """Read bricks back from the GPU."""
        for index in bricks:
            number = self.slots[index]
            low, high = (side[number] for side in self._ranges or ())
            bend = None if self._bends is None else self._bends[number]
            words = self._words(number) if isinstance(self._voxels, moderngl.Buffer) else self._texels(number)
            yield index, Stored(self._slot.unpack(words), low, high, int(self._counts[number]), bend)

    def tables(self, plan: Plan, box: BrickBox, bricks: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the offsets, and the visible groups of cells, of all bricks of a box.

        Parameters
        ----------
        bricks : int64 (m, 3), bricks to draw, all of this atlas and in the box

        Returns
        -------
        offsets : int32, one for each brick of the box: first word (buffer) or slot number (texture), −1 for none
        groups : uint32, `slot.group_words` for each brick of the box
        """
        numbers = np.array([self.slots[z, y, x] for z, y, x in bricks.tolist()])
        places = tuple((bricks - box.begin_zyx).T)
        offsets = np.full(box.shape_zyx, -1, np.int32)
        offsets[places] = numbers if self._slot.textured else numbers * self._slot.words
        groups = np.zeros((*box.shape_zyx, self._slot.group_words), np.uint32)
        assert self._ranges, "no slot was filled"
        ranges = self._ranges[0][numbers], self._ranges[1][numbers]
        words = visibility_bits(ranges, plan, self._slot)
        if self._bends is not None:
            words = np.concatenate([words, self._stretches(plan)[numbers]], axis=1)
        groups[places] = words
        return offsets, groups

    def _stretches(self, plan: Plan) -> NDArray[np.uint32]:
        """Return the lengths of slabs in the groups of all slots, cached for one transfer function."""
        if self._stretched is None or self._stretched[0] is not plan.transfer:
            assert self._ranges, "no slot was filled"
            assert self._bends is not None, "nothing is stretched"
            self._stretched = plan.transfer, stretch_bits(self._ranges, self._bends, plan, self._slot)
        return self._stretched[1]

    def bind(self) -> None:
        """Bind the buffer or texture for drawing."""
        if isinstance(self._voxels, moderngl.Buffer):
            self._voxels.bind_to_storage_buffer(7)
        else:
            self._voxels.use(0)

    def release(self) -> None:
        """Free the GPU memory."""
        self._voxels.release()

    def _note(self, number: int, stored: Stored) -> None:
        if self._ranges is None:
            shape = (self.slot_count, *stored.low.shape)
            self._ranges = np.zeros(shape, stored.low.dtype), np.zeros(shape, stored.high.dtype)
        self._ranges[0][number], self._ranges[1][number] = stored.low, stored.high
        if self._bends is not None:
            self._bends[number], self._stretched = stored.bend, None
        self._counts[number] = stored.voxels

    def _take_over(self, smaller: BrickAtlas) -> None:
        """Copy the metadata of a smaller atlas, whose bricks keep their slots."""
        self.slots = dict(smaller.slots)
        self._free = [number for number in range(self.slot_count)[::-1] if number >= smaller.slot_count] + smaller._free
        self._counts = _lengthened(smaller._counts, self.slot_count)
        if smaller._ranges is not None:
            low, high = (_lengthened(side, self.slot_count) for side in smaller._ranges)
            self._ranges = low, high
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
