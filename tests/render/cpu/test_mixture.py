"""Several volumes by the processor: against the float64 reference and OpenGL; ../test_mixture.py holds the scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import pytest
from render import test_multi_volume as by_opengl
from render.cpu.test_kernel import WrittenError
from render.scenes import whole
from render.test_multi_volume import (
    ALONG,
    BYTES,
    CAMERAS,
    FAINT,
    FLOATS,
    LIGHTS,
    ON_A_FACE,
    OPAQUE,
    SMOOTH,
    STEEP,
    TURNED,
    WORDS,
    Part,
    expected,
    prepared,
    scene_of,
    volume,
)
from render.test_multi_volume_blending import CORES, SHELLS

from clusterviz.data.source import Grid
from clusterviz.partition import build_tree, leaf_pieces
from clusterviz.plan.plan import Plan
from clusterviz.reference import over
from clusterviz.render.cpu import caster as casters
from clusterviz.render.cpu import memory, program
from clusterviz.render.cpu.caster import VectorCaster
from clusterviz.render.cpu.kernel import can_draw, kernel_of, mixed_kernel_of
from clusterviz.render.cpu.program import program_of
from clusterviz.render.cpu.width import WIDTHS, Width
from clusterviz.scene.values import Clip, Light, Scene, Volume

BOUND = 1e-6
NARROWEST = WIDTHS[-1]
PAIR = BYTES, FLOATS
INTEGRATED = {"quality": {"classification": "pre-integrated"}}
CUT = {"clip": Clip(planes=(((9, 9, 9), (0.2, 1, 1)),))}
FLAT = (volume(0, 1), np.ones((1, 9, 9), np.float32), Grid((1, 9, 9), origin=(3, 3, 3)))


def drawn(scene: Scene, parts: tuple[Part, ...], leaves: int = 1, width: Width | None = None) -> tuple[np.ndarray, int]:
    """The picture, drawn in so many parts, and the samples taken."""
    plan, bricks = prepared(scene, parts)
    caster = VectorCaster(plan, width)
    caster.load(plan, bricks)
    pieces = leaf_pieces(build_tree(plan.cost, leaves), plan.cost, plan.eye_in_bricks(), plan.view.forward)
    each = caster.draw(plan, pieces)
    return over([whole(one.partial, scene.image.size) for one in each]), sum(one.samples for one in each)


WITH_LIGHT = {"lights": LIGHTS, "quality": {"jitter": True}} | CUT
WITH_ENDS = {"quality": {"classification": "pre-integrated", "jitter": True}} | CUT


@pytest.mark.parametrize(
    ("parts", "sections", "camera"),
    [
        *((PAIR, {}, camera) for camera in CAMERAS),
        ((WORDS, FLOATS), WITH_LIGHT, "outside"),
        ((WORDS, FLOATS), WITH_ENDS, "outside"),
        ((WORDS, FLOATS), WITH_ENDS, "inside"),
    ],
    ids=[*CAMERAS, "nearest, lit, clipped, jittered", "integrated beside nearest", "integrated, from inside"],
)
def test_pictures_are_the_reference(parts: tuple[Part, ...], sections: dict[str, Any], camera: str) -> None:
    scene = scene_of(parts, camera, **dict(sections))
    found, _ = drawn(scene, parts)
    assert found[..., 3].max() > 0.3
    assert np.abs(found - expected(scene, parts)).max() <= BOUND


def test_splines_and_gradients_in_narrow_vectors() -> None:
    parts, lights = (SMOOTH, STEEP), (Light(position=(30, 20, 60), positional=True),)
    scene = scene_of(parts, "inside", lights=lights)
    found, _ = drawn(scene, parts, width=NARROWEST)
    assert np.abs(found - expected(scene, parts)).max() <= BOUND


def test_tables_of_two_dimensions(tmp_path: Path) -> None:
    parts = []
    for number, (part, entries) in enumerate(((BYTES, (4, 6, 4)), (FLOATS, (5, 3)))):
        path, clim = tmp_path / f"{number}.npy", part[0].clim
        np.save(path, np.random.default_rng(number).random(entries) * 0.8)
        table = {"path": str(path), "values": clim, "magnitudes": (0.02 * np.ptp(clim), 0.3 * np.ptp(clim))}
        keys = {"cmap": part[0].cmap, "clim": clim, "opacity_unit_distance": 6.0}
        parts.append((Volume(path="b", transfer_2d=table, **keys), *part[1:]))
    scene = scene_of((*parts,))
    found, _ = drawn(scene, (*parts,), width=NARROWEST)
    assert np.abs(found - expected(scene, (*parts,))).max() <= BOUND


BESIDE = (FLOATS[0], FLOATS[1], Grid((15, 12, 17), origin=(0.5, 0.5, 0.5)))  # midpoints lie on its faces


@pytest.mark.parametrize(
    ("parts", "camera", "step"),
    [
        ((OPAQUE, FAINT), CAMERAS["outside"], 0.7),
        (PAIR, CAMERAS["outside"], 30.0),
        ((BYTES, BESIDE), ALONG, 1.0),
        ((BYTES, BESIDE), ON_A_FACE, 1.0),
        ((BYTES, FLAT), CAMERAS["outside"], 0.7),
    ],
    ids=["opaque and faint", "steps of 30 voxels", "midpoints on faces", "rays in faces", "without thickness"],
)
def test_extremes(parts: tuple[Part, ...], camera: Any, step: float) -> None:
    scene = scene_of(parts, step=step).model_copy(update={"camera": camera})
    found, _ = drawn(scene, parts, width=NARROWEST)
    assert found[..., 3].max() > 0.3
    assert np.abs(found - expected(scene, parts)).max() <= BOUND


@pytest.mark.gl
def test_opengl_draws_the_same(context: moderngl.Context) -> None:
    for camera in CAMERAS:
        scene = scene_of(PAIR, camera)
        (found, samples), (other, others) = drawn(scene, PAIR), by_opengl.drawn(context, scene, PAIR)
        assert np.abs(found - other).max() <= BOUND
        # Whether anything is visible is asked where windows end, and by OpenGL 16 slabs behind a run's begin, too.
        assert abs(samples - others) <= 0.05 * others


@pytest.mark.parametrize(
    ("camera", "sections"), [("parallel", {}), ("inside", INTEGRATED)], ids=["sampled", "integrated"]
)
def test_neither_parts_nor_bricks_change_the_picture(camera: str, sections: dict[str, Any]) -> None:
    """Integrated slabs of two voxels reach a voxel beyond their bricks."""
    keys = {"step": 2.0} | sections
    first, _ = drawn(scene_of(PAIR, camera, 64, **dict(keys)), PAIR)
    for brick, leaves in ((9, 5), (13, 3)):
        scene = scene_of(PAIR, camera, brick, **dict(keys))
        found, samples = drawn(scene, PAIR, leaves)
        assert np.abs(found - first).max() <= BOUND, brick
        assert samples == drawn(scene, PAIR)[1], brick


def blobs() -> tuple[Part, Part]:
    """A small body in each of two volumes, around it nothing."""
    squares = sum((axis - 20.0) ** 2 for axis in np.indices((40, 40, 40)))
    blob = np.exp(-squares / 12)
    turned = Grid(blob.shape, origin=(14, 9, 5), direction=TURNED.direction)
    return (
        (volume(0, 255), np.round(255 * blob).astype(np.uint8), Grid(blob.shape)),
        (volume(0.0, 1.0), blob.astype(np.float32), turned),
    )


@pytest.mark.parametrize(
    ("brick", "sections"),
    [
        (19, {"step": 2.9}),
        (64, {"quality": {"early_termination": 0.3}}),
        (64, {"quality": {"jitter": True}}),
        (64, CUT),
        (19, INTEGRATED),
    ],
    ids=["long steps", "ends early", "jittered", "clipped", "integrated"],
)
def test_leaping_over_what_is_empty_changes_no_bit(
    brick: int, sections: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = blobs()
    scene = scene_of(parts, brick=brick, **dict({"step": 0.37} | sections))
    skipped, fewer = drawn(scene, parts)

    def visible(ranges: Any, _: Plan) -> np.ndarray:
        return np.ones((len(ranges[0]), *ranges[0].shape[2:]), bool)

    monkeypatch.setattr(casters, "visible_groups", visible)
    found, samples = drawn(scene, parts)
    assert skipped.max() > 0.1
    assert fewer < samples
    assert np.array_equal(skipped, found)


def test_a_ray_ends_with_the_slab_that_leaves_too_little_light() -> None:
    (all_, samples), (found, fewer) = (drawn(scene_of(PAIR, quality={"early_termination": e}), PAIR) for e in (0, 0.5))
    assert fewer < 0.95 * samples
    assert np.abs(found - all_).max() <= 0.5


def test_threads_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    pictures = []
    for threads in ("1", "3"):
        monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
        pictures.append(drawn(scene_of(PAIR), PAIR)[0])
    assert np.array_equal(*pictures)


def test_numbers_of_64_bits_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    narrow = drawn(scene_of(PAIR, brick=9), PAIR, width=NARROWEST)
    monkeypatch.setattr(memory, "NARROW", 0)
    wide = drawn(scene_of(PAIR, brick=9), PAIR, width=NARROWEST)
    assert np.array_equal(wide[0], narrow[0])
    assert wide[1] == narrow[1] > 0


def test_surfaces_are_left_to_opengl() -> None:
    hidden = (SHELLS[0].model_copy(update={"isosurfaces": ((100.0, 0.0),)}), *SHELLS[1:])
    for other in (SHELLS, CORES, hidden):
        parts = BYTES, other
        assert not can_draw(prepared(scene_of(parts), parts)[0])
    assert can_draw(prepared(scene_of(PAIR, **INTEGRATED), PAIR)[0])


def test_one_volume_has_nothing_of_several_in_its_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    def write(*_: Any) -> None:
        raise WrittenError

    for part in ("Body", "Bodies", "MixedPlaces", "MultiVolume", "Sampled", "Ramped"):
        monkeypatch.setattr(program, part, write)
    assert program_of(kernel_of(prepared(scene_of((BYTES,)), (BYTES,))[0], 4, None))
    with pytest.raises(WrittenError):
        program_of(mixed_kernel_of(prepared(scene_of(PAIR), PAIR)[0], 4, (None, None)))
