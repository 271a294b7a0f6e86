"""Direct send: every rank owns one piece of the picture and receives that piece from all others at once.

What: each of the n ranks owns one of n pieces. Each piece has the same number of covered pixels, and is assigned to a
rank whose own image lies there. With b bands, b·n bands of rows are assigned round robin instead. With m owners, m
evenly spaced ranks own pieces.
When: up to some tens of ranks, and sparse images on any number: no pixel moves twice, and nothing is sent to owners of
pieces outside the footprint.
When not: dense images on hundreds of ranks: the number of messages grows with n².
Cost: 1 round, n(n − 1) messages; a rank sends and receives (1 − 1/n)·P. With m owners, m(n − 1) messages; a rank sends
at most P, an owner receives (n − 1)/m·P. Bands balance images with holes better, but need more messages.
Limits: any number of partial images a rank, in any order of depth. With more ranks than pixels, some own nothing.
Reference: W. M. Hsu, "Segmented ray casting for data parallel volume rendering"; U. Neumann, "Parallel volume-rendering
algorithm performance on mesh-connected multicomputers"; both Parallel Rendering Symposium 1993.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.composite.schedules.rectangles import Rectangles
from clusterviz.composite.schedules.schedule import Indices, Patches, Schedule, Stage, borders, sum_by
from clusterviz.errors import InputError

SEVERAL_IMAGES = True


def schedule(
    ranks: int,
    pixels: int,
    footprints: Patches = (),
    *,
    owners: int | None = None,
    bands: int | None = None,
    owners_of: Sequence[int] | None = None,
) -> Schedule:
    """Return the schedule: every rank sends to every owner, in one stage.

    Raises InputError if there are more owners than ranks, or none; or no bands.

    Parameters
    ----------
    footprints : patch of each image; without them the canvas is one row that all of them cover
    owners : number of ranks that own pieces; by default all
    bands : bands of equal height of each owner; by default one piece each, with equal numbers of covered pixels
    owners_of : rank of each image, if ranks have several; by default, rank k has image k
    """
    known = Rectangles.of_patches(footprints) if footprints else None
    owner, cuts = choose_pieces(ranks, pixels, known, owners, bands, owners_of)
    if ranks < 2:
        return Schedule(ranks, pixels, ())
    source = np.arange(ranks, dtype=np.int64)[:, None]
    return Schedule(ranks, pixels, (Stage.of_columns(source, owner, cuts[:-1], cuts[1:]),))


def choose_pieces(
    ranks: int,
    pixels: int,
    footprints: Rectangles | None,
    owners: int | None = None,
    bands: int | None = None,
    owners_of: Sequence[int] | None = None,
) -> tuple[Indices, Indices]:
    """Return the owner of each piece, and the borders of the pieces; arguments and errors as of `schedule`."""
    if owners is not None and not min(ranks, 1) <= owners <= ranks:
        raise InputError("wrong number of owners for direct send", found=owners, allowed=f"1 to {ranks}")
    owners = ranks if owners is None else owners
    owner = np.arange(owners, dtype=np.int64) * ranks // max(owners, 1)
    if bands is not None:
        if bands < 1:
            raise InputError("too few bands for direct send", found=bands, allowed="1 and more")
        count = bands * owners
        return np.tile(owner, bands), row_borders(count, footprints) if footprints is not None else borders(
            count, pixels
        )
    if footprints is None:
        return owner, borders(owners, pixels)
    return top_to_bottom(footprints, ranks, owners_of)[owner], weighted_borders(owners, footprints)


def weighted_borders(pieces: int, footprints: Rectangles) -> Indices:
    """Return the borders of pieces with the same number of covered pixels.

    A pixel counts once for each rectangle that covers it. Between rows in which a rectangle begins or ends, the count
    grows linearly, so sums over those rows give all borders; they are integers, so that every rank computes the same.
    Inside the row of a border, the count is assumed to be uniform.

    Returns int64 (pieces + 1,), ascending; those of `schedule.borders` where every rectangle is the whole canvas.
    """
    wide = footprints.x_end - footprints.x_begin
    rows = np.concatenate([footprints.y_begin, footprints.y_end])
    order = rows.argsort()
    rows, cover = rows[order], np.concatenate([wide, -wide])[order].cumsum()
    before = np.zeros_like(rows)
    np.cumsum(cover[:-1] * (rows[1:] - rows[:-1]), out=before[1:])
    total = int(before[-1])
    if total == 0:
        return borders(pieces, footprints.canvas_pixels)
    wanted = borders(pieces, total)
    # Of several rows with one sum, the last: what is covered begins there.
    at = before.searchsorted(wanted[1:-1], "right") - 1
    row, rest = np.divmod(wanted[1:-1] - before[at], cover[at])
    result = np.empty_like(wanted)
    result[0], result[-1] = 0, footprints.canvas_pixels
    result[1:-1] = (rows[at] + row) * footprints.width + rest * footprints.width // cover[at]
    return result


def row_borders(pieces: int, footprints: Rectangles) -> Indices:
    """Return borders of equal pieces of whole rows, or of pixels if there are fewer rows than pieces."""
    if pieces > footprints.height:
        return borders(pieces, footprints.canvas_pixels)
    return borders(pieces, footprints.height) * footprints.width


def top_to_bottom(footprints: Rectangles, ranks: int, owners_of: Sequence[int] | None = None) -> Indices:
    """Return the ranks sorted by the vertical centre of their images; `owners_of` is the rank of each image."""
    middle = footprints.y_begin + footprints.y_end
    if owners_of is not None:
        owner, area = np.asarray(owners_of, np.int64), footprints.count()
        middle = sum_by(ranks, owner, area * middle) // np.maximum(sum_by(ranks, owner, area), 1)
    return middle.argsort(kind="stable")
