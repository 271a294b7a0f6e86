"""Parcels: bricks come out as they went in, and no damage passes for a brick."""

from __future__ import annotations

import numpy as np
import pytest
from render.scenes import SHAPE, camera_at, noise, prepare, scene_of

from clusterviz.codec import pack
from clusterviz.codec.contract import CodecError
from clusterviz.data.grid import Grid
from clusterviz.frame.parcel import Parcels, parcels_of
from clusterviz.render.stored import Stored, store

BRICK = (1, 0, 2)


def made(dtype: str, filter: str = "exact") -> tuple[Parcels, Stored]:
    voxels = noise(dtype=dtype)
    prepared = prepare(scene_of(voxels, camera_at("outside", Grid(SHAPE)), filter=filter), voxels, brick=7)
    parcels = parcels_of(prepared.plan, voxels.dtype)
    return parcels, store(prepared.bricks[BRICK], prepared.plan.encoding, parcels.slot)


@pytest.mark.parametrize("codec", ["raw", "active+lz4", "active+delta+shuffle+lz4"])
@pytest.mark.parametrize("filter", ["exact", "hardware"])
@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32", "float64"])
def test_bricks_come_out_as_they_went_in(dtype: str, filter: str, codec: str) -> None:
    parcels, stored = made(dtype, filter)
    parcel = parcels.wrap(BRICK, stored, lambda pixels, rows: pack(pixels, codec, rows))
    assert parcel.size <= parcels.most_bytes
    found = parcels.unwrap(parcel, BRICK)
    z, y, x = stored.samples.shape
    assert found.samples[:z, :y, :x].tobytes() == np.ascontiguousarray(stored.samples).tobytes()
    assert (found.low == stored.low).all()
    assert (found.high == stored.high).all()
    assert (found.low.dtype, found.voxels) == (stored.low.dtype, stored.voxels)


@pytest.mark.parametrize("codec", ["raw", "lz4"])
def test_no_damage_passes_for_a_brick(codec: str) -> None:
    parcels, stored = made("uint8")
    flat = Stored(np.zeros_like(stored.samples), stored.low, stored.high, stored.voxels)
    parcel = parcels.wrap(BRICK, flat, lambda pixels, rows: pack(pixels, codec, rows))
    assert (parcel.size < 300) == (codec == "lz4")
    for at in range(parcel.size):
        damaged = parcel.copy()
        damaged[at] ^= 1 << at % 8
        try:
            found = parcels.unwrap(damaged, BRICK)
        except CodecError:
            continue
        # Zeros may be copied from any place where there are some.
        assert codec == "lz4"
        assert not found.samples.any()
        assert (found.low == stored.low).all()
    for size in (0, 10, 33, parcel.size - 1):
        with pytest.raises(CodecError):
            parcels.unwrap(parcel[:size], BRICK)


def test_another_brick_and_another_way_of_storing_are_refused() -> None:
    parcels, stored = made("float32")
    parcel = parcels.wrap(BRICK, stored, lambda pixels, rows: pack(pixels, "raw", rows))
    with pytest.raises(CodecError):
        parcels.unwrap(parcel, (0, 0, 2))
    with pytest.raises(CodecError):
        Parcels(parcels.slot, parcels.dtype, parcels.stamp ^ 1).unwrap(parcel, BRICK)
