"""Bricks in GPU memory: one buffer or one texture for a box of bricks, and the table of where each brick begins."""

from __future__ import annotations

from collections.abc import Iterable, MutableMapping
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.partition import BrickBox
from clusterviz.plan.encoding import Encoding
from clusterviz.plan.plan import Plan
from clusterviz.render.emptiness import Ranges, group_ranges, visibility_bits
from clusterviz.render.storage import Slot

Index = tuple[int, int, int]
TEXEL_TYPE = {"u8": "f1", "u16": "nu2", "f32": "f4"}  # moderngl's names; integers are normalised
TEXTURE_BYTES = 1 << 30


@dataclass(frozen=True)
class Residence:
    """A box of bricks, uploaded.

    Attributes
    ----------
    box : the bricks
    offsets : GPU buffer of int32, one a brick of the box: first word (buffer) or slot number (texture), −1 for none
    places : int (n, 3), where each stored brick lies in the box, (z, y, x)
    ranges : lowest and highest sample of the groups of cells of each, (n, *slot.groups_zyx)
    voxels : the buffer of words, or the texture of slots
    bricks : how many are stored
    bytes : GPU memory taken by their voxels
    """

    box: BrickBox
    offsets: moderngl.Buffer
    places: NDArray[np.intp]
    ranges: Ranges
    voxels: moderngl.Buffer | moderngl.Texture3D
    bricks: int
    bytes: int

    def visibility(self, plan: Plan, slot: Slot) -> NDArray[np.uint32]:
        """Which groups of cells may show something: uint32, `slot.visibility_words` a brick of the box."""
        words = np.zeros((*self.box.shape_zyx, slot.visibility_words), np.uint32)
        words[tuple(self.places.T)] = visibility_bits(self.ranges, plan, slot)
        return words

    def release(self) -> None:
        """Give the GPU memory back."""
        self.offsets.release()
        self.voxels.release()


def capacity(context: moderngl.Context, slot: Slot, block_bytes: int | None = None) -> int:
    """Bricks that one residence can hold on this context, at least 1.

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


def upload(
    context: moderngl.Context,
    box: BrickBox,
    bricks: MutableMapping[Index, NDArray[Any]],
    slot: Slot,
    encoding: Encoding,
) -> Residence:
    """Store the bricks that lie in a box.

    Parameters
    ----------
    bricks : samples (z, y, x) by brick index; bricks outside of the box are passed over, absent ones are not drawn.
        What is stored is taken out, so that no brick is held twice for long.
    """
    inside = [i for i in bricks if all(b <= n < e for b, n, e in zip(box.begin_zyx, i, box.end_zyx, strict=True))]
    places = np.array(inside, np.intp).reshape(-1, 3) - box.begin_zyx
    ranges: list[Ranges] = []
    packed = (_packed(bricks.pop(index), slot, encoding, ranges) for index in inside)
    voxels: moderngl.Buffer | moderngl.Texture3D
    voxels, starts = (_into_texture if slot.textured else _into_buffer)(context, packed, len(inside), slot)
    offsets = np.full(box.shape_zyx, -1, np.int32)
    offsets[tuple(places.T)] = starts
    low, high = (np.array([pair[side] for pair in ranges]).reshape(-1, *slot.groups_zyx) for side in (0, 1))
    table = context.buffer(offsets.tobytes())
    return Residence(box, table, places, (low, high), voxels, len(inside), len(inside) * slot.bytes)


def _packed(voxels: NDArray[Any], slot: Slot, encoding: Encoding, ranges: list[Ranges]) -> NDArray[Any]:
    """One brick as its slot keeps it; its ranges are noted on the way."""
    ranges.append(group_ranges(voxels, slot))
    return slot.pack(voxels, encoding)


def _into_buffer(
    context: moderngl.Context, packed: Iterable[NDArray[Any]], count: int, slot: Slot
) -> tuple[moderngl.Buffer, list[int]]:
    """One after the other; where each begins, in words."""
    buffer = context.buffer(reserve=max(1, count) * slot.bytes)
    for number, words in enumerate(packed):
        buffer.write(words, offset=number * slot.bytes)
    return buffer, [number * slot.words for number in range(count)]


def _into_texture(
    context: moderngl.Context, packed: Iterable[NDArray[Any]], count: int, slot: Slot
) -> tuple[moderngl.Texture3D, list[int]]:
    """Side by side along x, then y, then z; the number of each slot."""
    side = int(context.info["GL_MAX_3D_TEXTURE_SIZE"])
    z, y, x = slot.samples_zyx
    across, down = min(count, side // x), side // y
    rows = -(-count // across)
    down = min(rows, down)
    size = (across * x, down * y, -(-rows // down) * z)
    texture = context.texture3d(size, 1, alignment=1, dtype=TEXEL_TYPE[slot.kind])
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    texture.repeat_x = texture.repeat_y = texture.repeat_z = False
    for number, texels in enumerate(packed):
        corner = (number % across * x, number // across % down * y, number // (across * down) * z)
        texture.write(texels, viewport=(*corner, x, y, z), alignment=1)
    return texture, list(range(count))
