"""What a kernel shall draw, as one record: the constants of a draw, sizes, and where its tables lie.

Each of several volumes has a record of its own beside that of the draw: what samples, classifies and lights a volume
reads the same members of it, and knows of no other volume.
"""

from __future__ import annotations

import numpy as np

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import F32, F64, I32, I64, Value
from clusterviz.render.frame_block import FRAME

JOB = np.dtype(
    [
        ("frame", FRAME),
        ("whole", "i4"),  # 1: the box holds the whole volume
        ("row", "i4"),  # voxels in a row of a brick, rows in a layer times that, where bricks are uniform
        ("layer", "i4"),
        ("window", "i4"),  # slabs of the windows into which rays are cut
        ("far", "i4"),  # 1: samples are so far apart, and bricks so many, that caches hold few of them
        ("brick", "i4"),  # cells along its side
        ("per_brick", "f8"),  # one over that
        ("further_starts", "i4"),  # of the plan's segments
        ("record_floats", "i4"),  # in a row of the records
        ("planes", "i4"),  # how many clip the volume
        ("lights", "i4"),  # how many shine on it
        ("caps", "i4"),  # planes that cut it where it is lit, its own faces among them
        ("surfaces", "i4"),  # isosurfaces in it
        ("fading", "i4"),  # pieces of its gradient opacity
        ("table_sides", "i4", 2),  # of a transfer function of two dimensions: columns, rows
        ("slack", "f4"),  # voxels that float32 may have rounded away
        ("tiles_across", "i4"),
        ("tiles", "i4"),
        ("stride", "i4"),  # pixels in a row of the output
        ("squares_across", "i4"),
        ("group_sides", "i4", 4),  # groups in a brick along x, y, z; their product
        ("last_cell", "i4", 4),  # of a brick in which the field may be sampled, x, y, z
        ("first_cell", "i4"),
        ("first_voxel", "i4"),  # that is stored, from the brick's first cell
        ("counter", "i8"),  # the next tile; threads raise it
        ("taken", "i8"),  # field samples so far
        ("pixels", "i8"),  # addresses from here on: float32 (rows, stride, 4)
        ("work", "i8"),  # uint32, samples of each square of pixels
        ("voxels", "i8"),  # all of them, those of some brick first
        ("bricks", "i8"),  # of the kernel's `word`, one a brick of the box: the number of its first voxel
        (
            "pitches",
            "i8",
        ),  # int32 (bricks of the box, 2), where they differ: voxels from row to row, and layer to layer
        ("skips", "i8"),  # int32, one a group: see empty_space.py
        ("bucket_rows", "i8"),  # float32 (BUCKETS, 4): the next start, the first one, the first segment
        ("colour_rows", "i8"),  # float32 (segments, 8): a slab's opacity, its slope, colour, its slope
        ("pieces", "i8"),  # float32 (ROWS, MOST) as in pieces.py
        ("record_rows", "i8"),  # the plan's own
        ("sums", "i8"),  # float64 (segments, 8) as in plan/preintegration.py
        ("clip", "i8"),
        ("lighting", "i8"),  # float32 (7 + rows · lights + 2 · caps, 4), see plan/shading.py
        ("surface", "i8"),  # float32 (surfaces, 8): value, 0, 0, 0; colour, opacity
        ("grading", "i8"),  # float32 (4 + fading, 4), see plan/grading.py
        ("table", "i8"),  # float32 (rows, columns, 4)
        ("depth", "f8", 4),  # the view depth of (x, y, z) is their product with the first three, and the last
        ("starts", "i8"),  # float32 (rows, stride), read and written: see starts.py
        ("offset", "i4"),  # slabs before that with which rays start
        ("hits", "i8"),  # float32 (3, rows, stride)
        ("plane", "i8"),  # bytes of (rows, stride)
        ("estimated", "i8"),  # rays that the last frame told where to start
        ("left_out", "i8"),  # those that it told to meet nothing
        ("late", "i8"),  # those that it told to start too late, and that began again
        ("volumes", "i8"),  # JOB, one a volume of a mixture: see mixed_order.py
        ("index_from_domain", "f8", 12),  # of one of these: rows of the matrix of plan/cut.py
        ("firsts", "i8"),  # int32 (bricks of the box, 4): its cell that is a brick's first; 1: the brick has any
        ("farthest", "i4"),  # voxels of a window, at most
    ],
    align=True,
)
_ELEMENTS = {"f4": F32, "f8": F64, "i4": I32, "i8": I64}


class Job:
    """A job as a kernel's code reads it.

    Parameters
    ----------
    code : of the kernel
    wide : voxels are so many that their numbers take 64 bits
    at : the job's address; by default the kernel's argument

    Attributes
    ----------
    word : the type of voxels' numbers; unsigned
    """

    def __init__(self, code: Code, wide: bool, at: Value | None = None) -> None:
        self._code, self.word, self._at = code, I64 if wide else I32, code.argument if at is None else at

    def volume(self, number: int) -> Job:
        """The record of one of several volumes."""
        return Job(self._code, self.word is I64, self["volumes"] + JOB.itemsize * number)

    def __getitem__(self, name: str) -> Value:
        """A member that is one number; the first of several."""
        return self.part(name, 0)

    def address(self, name: str) -> Value:
        """Where a member lies, for all threads."""
        return self._at + self._field(name)[1]

    def part(self, name: str, number: int) -> Value:
        """One of a member's numbers."""
        kind, offset = self._field(name)
        element = _ELEMENTS[kind.base.str[1:]]
        return self._code.load(element, self._at + (offset + number * kind.base.itemsize))

    @staticmethod
    def _field(name: str) -> tuple[np.dtype[np.generic], int]:
        fields, frame = JOB.fields, FRAME.fields
        assert fields is not None
        assert frame is not None
        kind, offset = frame[name][:2] if name in frame else fields[name][:2]
        return kind, offset
