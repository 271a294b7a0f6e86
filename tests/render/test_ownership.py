"""Every slab of every ray belongs to one rank, whoever draws what: samples of random draws, counted.

A draw is a camera, a brick size, a number of ranks and a distribution, of one of three volumes that are faint
everywhere: no slab is left out, so that a slab that two ranks draw, or none, changes the number of samples. One draw in
four looks along an axis, with rays that lie in the faces of bricks, or all but do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import moderngl
import numpy as np
import pytest

from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.data.summary import VolumeSummary, summarise
from clusterviz.distribution.contract import distribution_of
from clusterviz.distribution.memory_budget import MemoryBudget
from clusterviz.gl.context import open_context
from clusterviz.partition import BrickBox, Owners, Piece, owner_pieces
from clusterviz.plan.content import Bricks, KnownVolume, bricks_of_volume
from clusterviz.plan.plan import Plan, make_plan
from clusterviz.render.cpu.device import cpu_caster
from clusterviz.render.opengl import opengl_caster
from clusterviz.scene.values import Camera, Cluster, ImageSettings, Quality, Scene, Volume

BRICKS = (3, 5, 8, 11, 16, 24)
DISTRIBUTIONS = ("coherent", "interleaved", "replicated", "dynamic", "scattered")
"""The last one: bricks at random, as while they move from rank to rank."""
SIZE = (41, 33)


@dataclass(frozen=True)
class Draw:
    """One camera, and who draws what of what it sees."""

    volume: int
    brick: int
    ranks: int
    distribution: str
    camera: Camera
    step: float
    seed: int


@dataclass(frozen=True)
class Held:
    """A volume in bricks."""

    source: ArraySource
    layout: BrickLayout
    summary: VolumeSummary
    bricks: Bricks


def random_draws(count: int, seed: int) -> list[Draw]:
    """The same for the same seed; draws of the same bricks follow each other."""
    rng, draws = np.random.default_rng(seed), []
    for _ in range(count):
        volume, brick, ranks = int(rng.integers(3)), int(rng.choice(BRICKS)), int(rng.integers(1, 9))
        grid = grids()[volume]
        camera = _aligned(grid, brick, rng) if rng.random() < 0.25 else _anywhere(grid, rng)
        step, distribution = float(rng.uniform(0.2, 1.5)), str(rng.choice(DISTRIBUTIONS))
        draws.append(Draw(volume, brick, ranks, distribution, camera, step, int(rng.integers(1 << 30))))
    return sorted(draws, key=lambda draw: (draw.volume, draw.brick))


def counted(draws: Sequence[Draw], context: moderngl.Context | None) -> Iterator[tuple[Draw, dict[str, int]]]:
    """Of each draw the samples, by who took them; by the CPU alone where there is no context."""
    casters: list[Any] = []
    of = None
    for draw in draws:
        held, scene = hold(draw.volume, draw.brick), scene_of(draw)
        plan = make_plan(scene, [KnownVolume(held.source, held.layout, held.summary)])
        if of != (draw.volume, draw.brick):
            for caster in casters:
                caster.release()
            casters = [cpu_caster(plan), *([opengl_caster(context, plan)] if context else [])]
            for caster in casters:
                caster.load(plan, dict(held.bricks))
            of = draw.volume, draw.brick
        pieces = deal(draw, plan)
        counts = dict[str, int]()
        for name, caster in zip(("processor", "opengl"), casters, strict=False):
            if not caster.can_draw(plan):
                caster.compile(plan)
            whole = [Piece(0, BrickBox((0, 0, 0), plan.layout.counts_zyx))]
            counts[name] = sum(drawn.samples for drawn in caster.draw(plan, whole))
            counts[f"{name}, in {len(pieces)} pieces"] = sum(drawn.samples for drawn in caster.draw(plan, pieces))
        yield draw, counts


def deal(draw: Draw, plan: Plan) -> tuple[Piece, ...]:
    """The pieces of all ranks."""
    if draw.distribution != "scattered":
        cluster = Cluster(distribution=draw.distribution)  # type: ignore[arg-type]
        return distribution_of(cluster, draw.ranks, 1, MemoryBudget(), True).assign(plan)
    owner = np.random.default_rng(draw.seed).integers(0, draw.ranks, plan.layout.counts_zyx).astype(np.int32)
    return owner_pieces(Owners(draw.ranks, owner), plan.eye_in_bricks(), plan.view.forward)


def scene_of(draw: Draw) -> Scene:
    """Of a volume that is faint everywhere."""
    clim = (0.0, 1.0)
    opacity = ((0.0, 1e-6), (1.0, 1e-6))
    volume = Volume(path="memory", cmap="gray", clim=clim, opacity=opacity, opacity_unit_distance=1.0)
    image, quality = ImageSettings(size=SIZE), Quality(step=draw.step)
    return Scene(volumes=(volume,), camera=draw.camera, image=image, quality=quality)


@cache
def grids() -> tuple[Grid, ...]:
    """Of the volumes: a cube that bricks divide, one that nothing divides, and a thin one of other spacing."""
    return Grid((49, 49, 49)), Grid((37, 41, 53)), Grid((9, 70, 45), spacing=(0.7, 1.3, 2.1), origin=(5.0, -3.0, 2.0))


@cache
def hold(volume: int, brick: int) -> Held:
    """A volume of noise, in bricks."""
    grid, dtype = grids()[volume], (np.uint8, np.int16, np.float32)[volume]
    source = ArraySource((100 * np.random.default_rng(volume).random(grid.shape_zyx)).astype(dtype), grid)
    layout = BrickLayout(grid.shape_zyx, brick)
    samples = list(read_bricks(source, layout, list(np.ndindex(*layout.counts_zyx))))
    summary = summarise(source.dtype, layout, lambda: iter(samples), lambda it: [it])
    return Held(source, layout, summary, bricks_of_volume(layout, samples))


def _anywhere(grid: Grid, rng: np.random.Generator) -> Camera:
    """Outside or inside, in perspective or parallel."""
    low, high = grid.corners.min(axis=0), grid.corners.max(axis=0)
    diagonal = float(np.linalg.norm(high - low))
    centre = rng.uniform(low, high)
    away = rng.normal(size=3)
    position = centre + away / np.linalg.norm(away) * diagonal * rng.choice([0.2, 1.0, 3.0, 100.0])
    lens = {"view_angle": float(rng.uniform(1.0, 90.0))}
    if rng.random() < 0.3:
        lens = {"parallel_scale": float(rng.uniform(0.1, 0.7) * diagonal)}
    return _camera(position, centre, rng.normal(size=3), lens)


def _aligned(grid: Grid, brick: int, rng: np.random.Generator) -> Camera:
    """Along an axis, from a corner of bricks; or at an angle that is as small as it can be."""
    axis, shape = int(rng.integers(3)), np.array(grid.shape_zyx[::-1])
    index = brick * rng.integers(0, 1 + (shape - 1) // brick)
    centre = np.array(grid.origin) + np.array(grid.spacing) * index
    position = centre.copy()
    position[axis] += rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 3.0) * np.linalg.norm(shape)
    aside = (axis + 1 + int(rng.integers(2))) % 3
    position[aside] = np.nextafter(position[aside], position[aside] + rng.choice([-1.0, 0.0, 1.0]))
    # Odd pictures have a pixel in their middle; parallel rays are a voxel apart.
    lens = {"view_angle": float(rng.uniform(1.0, 60.0))}
    if rng.random() < 0.5:
        lens = {"parallel_scale": SIZE[1] / 2 * float(grid.spacing[0])}
    return _camera(position, centre, np.eye(3)[3 - axis - aside], lens)


def _camera(position: Any, focal_point: Any, up: Any, lens: dict[str, float]) -> Camera:
    places = (tuple(float(part) for part in vector) for vector in (position, focal_point, up))
    return Camera(**dict(zip(("position", "focal_point", "view_up"), places, strict=True)), **lens)


@pytest.mark.long
def test_every_slab_is_drawn_once_whoever_draws_it() -> None:
    for draw, counts in counted(random_draws(12, seed=7), None):
        assert len(set(counts.values())) == 1, f"{draw}: {counts}"


@pytest.mark.long
@pytest.mark.gl
def test_opengl_takes_the_samples_of_the_processor() -> None:
    with open_context() as context:
        for draw, counts in counted(random_draws(6, seed=8), context):
            assert len(counts) == 4
            assert len(set(counts.values())) == 1, f"{draw}: {counts}"
