"""The domain of several volumes and geometry, and the voxels of each volume that a brick of the domain needs.

The domain is the axis-aligned box around all content, with cells of the volumes' smallest spacing. Overlapping volumes
are combined slab by slab on one rank. So ranks own bricks of the domain, not bricks of one volume. Rays, slabs,
ownership and visibility order refer to the domain alone.

A volume's axes and spacing may differ from the domain's. The image of a brick in the volume's index space is a
parallelepiped; the box around it, clipped to the volume, is read and stored for that brick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.geometry.section import GeometrySection
from clusterviz.content.grid.section import GridSection
from clusterviz.data.bricks import Box, BrickLayout
from clusterviz.data.source import Grid, Index, Triple
from clusterviz.errors import InputError

Floats = NDArray[np.float64]
Placed = GeometrySection | GridSection
MOST_BRICKS, MOST_OF_VOLUMES = 1 << 20, 1 << 16
"""Every rank holds arrays over all bricks; fewer are allowed where volumes have not many of their own."""
MOST_WITH_GEOMETRY = 1 << 16
"""Bricks are larger than asked for if there would be more around geometry, which may lie far apart."""
MOST_BESIDE_VOLUMES, TIMES_OWN = 1 << 12, 8
"""The same beside volumes, unless they have more bricks of their own; then so many times these."""
CELLS_OF_GEOMETRY = 512
"""Cells along the longest side of a domain without volumes, at least; at most twice as many."""
GROWTH = 2.0**-10
"""Cells by which the domain is larger than geometry that lies beyond all volumes, or where it would be flat."""
EMPTY = np.zeros((0, 3))
SIDES_A_BRICK = 7.0
"""Sides of tetrahedra along that of a brick where bricks are many: those that are in several bricks are few then."""
LEAST_SIDES = 2.0
"""The same where bricks are few."""
ENOUGH_BRICKS = 8
"""Bricks along the longest side of a domain that are enough to balance ranks."""
USUAL_BRICK = 64
ROUNDING = 1e-9
"""Part of a cell by which an extent may exceed a whole number of cells."""
LARGEST_BRICK = 1 << 20
"""Cells along the side of a brick up to which bricks grow by themselves: float32 holds a position to a 16th of one."""


@dataclass(frozen=True)
class Domain:
    """A box in the world.

    Attributes
    ----------
    origin : its low corner (x, y, z), world units
    spacing : side of a cell, world units
    extent : its lengths along x, y, z in cells; not whole numbers
    volume : grid of a volume that is alone, whose index space, cells and box are then the domain's
    """

    origin: Triple
    spacing: float
    extent: Triple
    volume: Grid | None = None

    @property
    def grid(self) -> Grid:
        """The grid whose cells cover the box; its index space is that of the domain."""
        if self.volume:
            return self.volume
        z, y, x = (max(1, math.ceil(length - ROUNDING)) + 1 for length in self.extent[::-1])
        return Grid((z, y, x), (self.spacing,) * 3, self.origin)


def make_domain(grids: Sequence[Grid], boxes: Sequence[NDArray[np.float64]] = ()) -> Domain:
    """Return the domain of volumes and of boxes, low and high corners (2, 3) or (0, 3); a small box around nothing."""
    volumes, geometry = np.concatenate([EMPTY, *(grid.corners for grid in grids)]), np.concatenate([EMPTY, *boxes])
    if not len(volumes) + len(geometry):
        geometry = np.zeros((1, 3))
    if len(grids) == 1 and not len(geometry):
        z, y, x = (float(side - 1) for side in grids[0].shape_zyx)
        return Domain(grids[0].origin, min(grids[0].spacing), (x, y, z), grids[0])
    corners = np.concatenate([volumes, geometry])
    longest = float(np.ptp(corners, axis=0).max()) or float(np.abs(corners).max()) or 1.0
    widest = 2.0 ** math.floor(math.log2(longest / CELLS_OF_GEOMETRY))
    spacing = min((min(grid.spacing) for grid in grids), default=widest)
    margin = GROWTH * spacing + 2.0**-48 * np.abs(geometry).max(initial=0.0)
    low, high = corners.min(axis=0), corners.max(axis=0)
    flat = (low == high) & bool(len(geometry))
    low = np.where(flat | (low < volumes.min(axis=0, initial=np.inf)), low - margin, low)
    high = np.where(flat | (high > volumes.max(axis=0, initial=-np.inf)), high + margin, high)
    x, y, z = (float(length) for length in (high - low) / spacing)
    return Domain((float(low[0]), float(low[1]), float(low[2])), spacing, (x, y, z))


def domain_layout(
    domain: Domain, brick: int, has_geometry: bool = False, side: float = 0.0, volumes: Sequence[Grid] = ()
) -> BrickLayout:
    """Return the brick layout of a domain.

    Parameters
    ----------
    brick : cells along the side of one
    has_geometry : bricks may be larger, by a power of two
    side : mean side of the box around a tetrahedron, world units; bricks of `USUAL_BRICK` cells are made so much larger
        that they hold most tetrahedra alone, and others in proportion
    volumes : grids of all volumes

    Raises
    ------
    InputError
        There would be too many bricks.
    """

    def count() -> float:
        return math.prod(max(1.0, length / brick) for length in domain.extent)

    own_bricks = sum(math.prod(BrickLayout(grid.shape_zyx, brick).counts_zyx) for grid in volumes)
    if side > 0:
        longest = max(domain.extent)
        wanted = min(SIDES_A_BRICK * side / domain.spacing, longest / ENOUGH_BRICKS)
        wanted = min(max(wanted, LEAST_SIDES * side / domain.spacing), longest / 2)
        brick = math.ceil(brick * max(1.0, wanted / USUAL_BRICK))
    beside = max(MOST_BESIDE_VOLUMES, TIMES_OWN * own_bricks) if own_bricks else MOST_WITH_GEOMETRY
    most = min(beside, MOST_WITH_GEOMETRY)
    while has_geometry and count() > most and brick < LARGEST_BRICK:
        brick *= 2
    most = MOST_BRICKS if has_geometry else min(MOST_BRICKS, max(MOST_OF_VOLUMES, TIMES_OWN * own_bricks))
    if count() > most:
        found, asked = f"{_product(domain.extent)} cells of {domain.spacing:g} in bricks of {brick}", brick
        while count() > most:
            brick *= 2
        boxes = [np.ptp(grid.corners, axis=0).tolist() for grid in volumes]
        each = zip(boxes, volumes, strict=True)
        listed = [f"volumes[{n}] of {_product(box)} has {min(grid.spacing):g}" for n, (box, grid) in enumerate(each)]
        raise InputError(
            "the volumes lie too far apart, or reach too far, for their smallest spacing",
            where="scene" if has_geometry else "volumes",
            found=", ".join([found, *listed]),
            allowed=f"{most} bricks: cluster.brick={brick} instead of {asked}, or spacings that are more alike",
        )
    return BrickLayout(domain.grid.shape_zyx, brick)


def _product(sides: Sequence[float]) -> str:
    return " × ".join(f"{float(f'{length:.3g}'):g}" for length in sides)


@dataclass(frozen=True, eq=False)
class BrickGrid:
    """Bricks of a plan, which have primitives in `reach` cells beyond their own."""

    domain: Domain
    layout: BrickLayout
    reach: int

    def index_from_file(self, section: Placed) -> Floats:
        """Return the map from an entry's coordinates to cells of the domain, float64 (3, 4)."""
        matrix = world_from_file(section)[:3].copy()
        matrix[:, 3] -= self.domain.origin
        return matrix / self.domain.spacing


def world_from_file(section: Placed) -> Floats:
    """Return the entry's transform, float64 (4, 4)."""
    return np.array(section.transform or np.eye(4), np.float64)


SLACK = 1e-3
"""Voxels beyond the image of a brick, more than the rounding of a float32 position inside it."""


@dataclass(frozen=True, eq=False)
class Cut:
    """Map from the bricks of a domain to boxes of one volume.

    Attributes
    ----------
    layout : the domain's bricks
    extent : cells of the domain along (x, y, z)
    shape_zyx : samples of the volume
    index_from_domain : float64 (3, 4), maps (x, y, z, 1) in cells of the domain to samples (x, y, z) of the volume
    margin : samples beyond the corners of its cells that are read for a brick, on every side
    reach : cells of the domain beyond its own in which a brick samples the volume, at the ends of its slabs
    slack : voxels beyond the image of a brick that are read, too; 0 where the domain's cells are the volume's
    level : whose samples it cuts, see `at`
    """

    layout: BrickLayout
    extent: tuple[float, float, float]
    shape_zyx: Index
    index_from_domain: Floats
    margin: int = 0
    reach: int = 0
    slack: float = SLACK
    level: int = 0

    def at(self, level: int) -> Cut:
        """Return the cut of a coarser level of the volume, whose samples are 2^level apart and cover all of it."""
        z, y, x = (-(-(side - 1) // (1 << level)) + 1 for side in self.shape_zyx)
        return replace(
            self, shape_zyx=(z, y, x), index_from_domain=self.index_from_domain * 0.5**level, level=self.level + level
        )

    @property
    def most_cells_zyx(self) -> Index:
        """Cells along each axis of the largest box of the cut."""
        sides = np.minimum(self.layout.brick, np.array(self.layout.cells_zyx[::-1]))
        lengths = np.abs(self.index_from_domain[:, :3]) @ (sides + 2.0 * self.reach) + 2 * self.slack
        # Boxes that begin at cells have no part of another one.
        more = bool(self.slack or (self.layout.brick | self.reach) % (1 << self.level))
        x, y, z = (
            min(max(1, n - 1), int(np.ceil(a)) + more) for a, n in zip(lengths, self.shape_zyx[::-1], strict=True)
        )
        return z, y, x

    def images(self, begin: Floats, end: Floats) -> tuple[Floats, Floats]:
        """Return boxes [low, high], float64 (…, 3), in samples (x, y, z): bounds of all samples for boxes of cells."""
        matrix, offset = self.index_from_domain[:, :3], self.index_from_domain[:, 3]
        begin, end = begin - self.reach, end + self.reach
        least, most = np.minimum(matrix, 0), np.maximum(matrix, 0)
        return begin @ most.T + end @ least.T + offset, begin @ least.T + end @ most.T + offset

    def brick_edges(self) -> tuple[Floats, Floats]:
        """Return begin and end of all bricks, float64 (bz, by, bx, 3), along (x, y, z) in the domain's cells."""
        brick, (nz, ny, nx) = self.layout.brick, self.layout.counts_zyx
        z, y, x = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
        begin = brick * np.stack([x, y, z], axis=-1).astype(np.float64)
        return begin, np.minimum(begin + brick, self.extent)

    def meets(self, low: Floats, high: Floats) -> NDArray[np.bool_]:
        """Return the boxes [low, high] (…, 3) of samples that meet the volume; none if it is flat."""
        last = np.array(self.shape_zyx[::-1]) - 1
        return np.asarray(((high >= -SLACK) & (low <= last + SLACK)).all(axis=-1) & bool(min(self.shape_zyx) > 1))

    def bricks_met(self) -> NDArray[np.bool_]:
        """Return the bricks of the domain that meet the volume, bool (bz, by, bx)."""
        return self.meets(*self.images(*self.brick_edges()))

    def cell_box(self, index_zyx: Index) -> Box:
        """Return the half-open box of the volume's cells that a brick, which must meet the volume, may sample."""
        begin = self.layout.brick * np.array(index_zyx[::-1], np.float64)
        low, high = self.images(begin, np.minimum(begin + self.layout.brick, self.extent))
        cells = np.array(self.shape_zyx[::-1]) - 1
        first = np.clip(np.floor(low - self.slack), 0, cells - 1).astype(int)
        last = np.clip(np.ceil(high + self.slack), first + 1, cells).astype(int)
        (x, y, z), (x_end, y_end, z_end) = first.tolist(), last.tolist()
        return (z, y, x), (z_end, y_end, x_end)

    def sample_box(self, index_zyx: Index) -> Box:
        """Return the half-open box of samples of those cells and the margin, inside the volume."""
        begin, end = self.cell_box(index_zyx)
        low_z, low_y, low_x = (max(0, b - self.margin) for b in begin)
        z, y, x = (min(n, e + 1 + self.margin) for e, n in zip(end, self.shape_zyx, strict=True))
        return (low_z, low_y, low_x), (z, y, x)


def make_cut(domain: Domain, layout: BrickLayout, grid: Grid, margin: int, reach: int = 0) -> Cut:
    """Return the cut of a volume by the bricks of a domain."""
    if domain.volume == grid:
        return Cut(layout, domain.extent, grid.shape_zyx, np.eye(3, 4), margin, reach, slack=0.0)
    index_from_world = np.linalg.inv(grid.world_from_index[:3, :3])
    offset = index_from_world @ (np.array(domain.origin) - np.array(grid.origin))
    matrix = np.column_stack([index_from_world * domain.spacing, offset])
    return Cut(layout, domain.extent, grid.shape_zyx, matrix, margin, reach)


def samples_in_bricks(cut: Cut, own: BrickLayout, hidden: NDArray[np.bool_]) -> Floats:
    """Return the cost of the volume in each brick of the domain, float64 (bz, by, bx): cells, as in `brick_cost`.

    It is 0 where all that a brick may sample is hidden. `hidden` says of the volume's `own` bricks which are.
    """
    begin, end = cut.brick_edges()
    low, high = cut.images(begin, end)
    meets = cut.meets(low, high)
    last = np.array(cut.shape_zyx[::-1]) - 1.0
    first_brick = np.clip(np.floor((low - SLACK) / own.brick), 0, np.array(own.counts_zyx[::-1]) - 1).astype(int)
    last_brick = np.clip(np.floor((high + SLACK) / own.brick), 0, np.array(own.counts_zyx[::-1]) - 1).astype(int)
    shown = count_in_boxes(~hidden, first_brick[..., ::-1], last_brick[..., ::-1] + 1) > 0
    inside = np.clip(np.minimum(high, last) - np.maximum(low, 0), 0, None) / np.maximum(high - low, 1e-300)
    # A brick that just touches the volume costs something.
    share = np.maximum(inside.prod(axis=-1), 1 / 64)
    return np.where(meets & shown, share * (end - begin).clip(0).prod(axis=-1).clip(1), 0.0)


def count_in_boxes(flags: NDArray[np.bool_], begin: NDArray[np.int_], end: NDArray[np.int_]) -> NDArray[np.int64]:
    """Count the flags (z, y, x) set in half-open boxes (…, 3), (z, y, x), by a summed-volume table."""
    sums = np.zeros(np.array(flags.shape) + 1, np.int64)
    sums[1:, 1:, 1:] = flags.cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
    found = np.zeros(begin.shape[:-1], np.int64)
    for corner in np.ndindex(2, 2, 2):
        z, y, x = np.moveaxis(np.where(corner, end, begin), -1, 0)
        found += (-1) ** (3 - sum(corner)) * sums[z, y, x]
    return found
