"""Wire format of bricks: round trips, and detection of damage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from data.cells import mixed
from render.scenes import SHAPE, camera_at, noise, prepare, scene_of

from clusterviz.codec import pack
from clusterviz.codec.contract import CodecError
from clusterviz.comm import LoopbackChannel
from clusterviz.content.geometry.section import MeshSection, PointsSection
from clusterviz.content.grid.section import GridSection
from clusterviz.data.geometry import Geometry, Mesh, Points
from clusterviz.data.source import Grid
from clusterviz.frame.opening import open_content
from clusterviz.frame.run import Options, Run
from clusterviz.migration.wire_format import WireFormat, wire_format_of
from clusterviz.render.content_bricks import store
from clusterviz.render.stored_brick import Part, Stored
from clusterviz.scene.values import Camera, Cluster, Scene

BRICK = (1, 0, 2)
PART_BYTES = 144


def made(dtype: str, filter: str = "exact") -> tuple[WireFormat, Stored]:
    voxels = noise(dtype=dtype)
    prepared = prepare(scene_of(voxels, camera_at("outside", Grid(SHAPE)), filter=filter), voxels, brick=7)
    wire_format = replace(wire_format_of(prepared.plan), part_bytes=PART_BYTES)
    return wire_format, store(prepared.bricks[BRICK], prepared.plan.content, wire_format.slot)


@pytest.mark.parametrize(
    ("dtype", "filter", "codec"),
    [
        ("uint8", "exact", "raw"),
        ("uint8", "hardware", "active+lz4"),
        ("int16", "exact", "active+delta+shuffle+lz4"),
        ("int16", "hardware", "raw"),
        ("float32", "exact", "active+lz4"),
        ("float32", "hardware", "active+delta+shuffle+lz4"),
        ("float64", "exact", "active+delta+shuffle+lz4"),
        ("float64", "hardware", "raw"),
    ],
)
def test_bricks_come_out_as_they_went_in(dtype: str, filter: str, codec: str) -> None:
    wire_format, stored = made(dtype, filter)
    stream, came = wire_format.stream(stored), np.zeros(wire_format.stream_bytes, np.uint8)
    assert wire_format.parts > 3
    for number in reversed(range(wire_format.parts)):
        piece = wire_format.wrap(BRICK, stored.voxels, stream, number, lambda pixels, rows: pack(pixels, codec, rows))
        assert piece.size <= wire_format.most_bytes(number)
        voxels = wire_format.unwrap(piece, BRICK, number, came)
    found = wire_format.brick(came, voxels)
    ((came_in,), (went_out,)) = found.parts, stored.parts
    z, y, x = went_out.samples.shape
    assert came_in.samples[:z, :y, :x].tobytes() == np.ascontiguousarray(went_out.samples).tobytes()
    assert (found.low == stored.low).all()
    assert (found.high == stored.high).all()
    assert (found.low.dtype, found.voxels) == (stored.low.dtype, stored.voxels)


def test_primitives_and_tetrahedra_come_out_as_they_went_in() -> None:
    rng = np.random.default_rng(3)
    vertices, faces = rng.random((300, 3)).astype(np.float32) * 20, rng.integers(0, 300, (200, 3))
    mesh = Geometry(mesh=Mesh("m", vertices, faces, {"heat": vertices[:, 0]}))
    points = Geometry(points=Points("p", np.full((1, 3), 4.0)))
    sections = {"meshes": (MeshSection(path="m", scalars="heat"),), "points": (PointsSection(path="p", radius=0.5),)}
    grids = (GridSection(path="g", array="f"),)
    scene = Scene(**sections, grids=grids, cluster=Cluster(brick=256), camera=Camera(position=(60, 50, 40)))
    scene, opened, _ = open_content(Run(LoopbackChannel(), Options()), scene, [mesh, points, mixed()])
    assert opened
    plan = opened.plan(scene)
    wire_format, several = wire_format_of(plan), plan.content
    assert several
    count, lacking = 0, 0
    for index, brick in opened.read(plan, {tuple(each) for each in np.argwhere(plan.cost > 0).tolist()}):
        one, stored = wire_format.of(index), store(brick, several, wire_format.slot)
        stream = one.stream(stored)
        assert one.stream_bytes == stream.size
        assert stream.size >= sum(each.nbytes for each in brick.members if each)
        found_one = one.brick(stream, 0)
        for came, went in zip(found_one.members, brick.members, strict=True):
            assert type(came) is type(went)
            lacking += went is None
            for name, array in vars(went).items() if went else ():
                found = getattr(came, name)
                assert (found.dtype, found.shape) == (array.dtype, array.shape)
                assert found.tobytes() == array.tobytes()
                count += array.size
    assert count > 1000
    assert lacking


@pytest.mark.parametrize("codec", ["raw", "lz4"])
def test_no_damage_passes_for_a_brick(codec: str) -> None:
    wire_format, stored = made("uint8")
    flat = Stored([Part(np.zeros_like(stored.parts[0].samples))], stored.low, stored.high, stored.voxels)
    stream, came = wire_format.stream(flat), np.zeros(wire_format.stream_bytes, np.uint8)
    first = wire_format.wrap(BRICK, flat.voxels, stream, 0, lambda pixels, rows: pack(pixels, codec, rows))
    assert (first.size < 100) == (codec == "lz4")
    for at in range(first.size):
        damaged = first.copy()
        damaged[at] ^= 1 << at % 8
        try:
            wire_format.unwrap(damaged, BRICK, 0, came)
        except CodecError:
            continue
        # Zeros may be copied from any place where there are some.
        assert codec == "lz4"
        assert not came.any()
    for size in (0, 10, 32, first.size - 1):
        with pytest.raises(CodecError):
            wire_format.unwrap(first[:size], BRICK, 0, came)


def test_another_brick_another_piece_and_another_way_of_storing_are_refused() -> None:
    wire_format, stored = made("float32")
    stream, came = wire_format.stream(stored), np.zeros(wire_format.stream_bytes, np.uint8)
    piece = wire_format.wrap(BRICK, stored.voxels, stream, 1, lambda pixels, rows: pack(pixels, "raw", rows))
    others = [
        (wire_format, (0, 0, 2), 1),
        (wire_format, BRICK, 0),
        (replace(wire_format, stamp=wire_format.stamp ^ 1), BRICK, 1),
    ]
    for made_of, brick, number in others:
        with pytest.raises(CodecError):
            made_of.unwrap(piece, brick, number, came)
    assert wire_format.unwrap(piece, BRICK, 1, came) == stored.voxels
