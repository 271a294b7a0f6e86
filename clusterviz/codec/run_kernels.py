"""Finding, checking, gathering and scattering runs of pixels that are not blank."""

from __future__ import annotations

from numba import uint64

from clusterviz.codec.compiled import clear_bytes, compiled, copy_bytes, low_zeros

_ALL = uint64(0xFFFFFFFFFFFFFFFF)


@compiled
def find_runs(marks, gap, table):  # type: ignore[no-untyped-def]
    """The runs of pixels that are not blank; blank stretches of at most `gap` pixels stay inside a run.

    Parameters
    ----------
    table : int32 (k, 2), receives [first pixel, length]

    Returns
    -------
    runs, pixels : how many there are, and how many pixels they hold; (-1, 0) where the table is too short
    """
    runs, end, kept = 0, -gap - 1, 0
    for word in range(marks.size):
        left = marks[word]
        while left:
            low = low_zeros(left)
            length = low_zeros(~(left >> uint64(low)))
            begin = 64 * word + low
            if begin - end > gap:
                if runs == len(table):
                    return -1, 0
                table[runs, 0], table[runs, 1] = begin, 0
                end = begin
                runs += 1
            grown = begin + length - end
            table[runs - 1, 1] += grown
            kept += grown
            end = begin + length
            left = left & (_ALL << uint64(low + length)) if low + length < 64 else uint64(0)
    return runs, kept


@compiled
def check_runs(runs, count):  # type: ignore[no-untyped-def]
    """How many pixels the runs hold; -1 unless they are ascending, disjoint, not empty and within `count` pixels."""
    end, kept = 0, 0
    for k in range(len(runs)):
        begin, length = int(runs[k, 0]), int(runs[k, 1])
        if begin < end or length < 1 or begin + length > count:
            return -1
        end = begin + length
        kept += length
    return kept


@compiled
def gather(pixels, runs, pixel_bytes, target):  # type: ignore[no-untyped-def]
    """Copy the pixels of the runs, one run after the other; the runs are known to lie within the pixels."""
    taken = 0
    for k in range(len(runs)):
        size = int(runs[k, 1]) * pixel_bytes
        copy_bytes(target, taken, pixels, int(runs[k, 0]) * pixel_bytes, size)
        taken += size


@compiled
def scatter(packed, runs, pixel_bytes, target):  # type: ignore[no-untyped-def]
    """The inverse of `gather`; what lies in no run is cleared."""
    taken, end = 0, 0
    for k in range(len(runs)):
        begin, size = int(runs[k, 0]) * pixel_bytes, int(runs[k, 1]) * pixel_bytes
        clear_bytes(target, end, begin - end)
        copy_bytes(target, begin, packed, taken, size)
        taken += size
        end = begin + size
    clear_bytes(target, end, target.size - end)
