"""Profiles of pixels and of code, against costs that are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import LIT, camera_at, prepare, scene_of, smooth

from clusterviz.data.source import Grid
from clusterviz.pages.profile.code import Code, code_of
from clusterviz.partition import build_tree, leaf_pieces
from clusterviz.plan.plan import Plan
from clusterviz.render.cpu.device import Cpu
from clusterviz.render.profiling import PieceProfile, Profiler
from clusterviz.render.storage import slot_of
from clusterviz.scene.values import Cluster, Scene

SHAPE, BRICK = (19, 23, 26), 8
VISIBLE_FROM = 0.83
OPAQUE = ((0.0, 1.0), (1.0, 1.0))
SPARSE = ((0.0, 0.0), (0.6, 0.0), (0.7, 0.5), (1.0, 0.9))
SPLIT = {"classification": "pre-integrated", "borders": "split", "cluster": Cluster(brick=BRICK)}
LOOKS: dict[str, dict[str, Any]] = {
    "plain": {},
    "sparse, ended early": {"opacity": SPARSE, "unit": 1.0, "early_termination": 0.05},
    "jittered": {"jitter": True},
    "adaptive step": {"adaptive": 0.9, "step": 0.125, "opacity": ((0.0, 0.001), (1.0, 0.002))},
    "isosurfaces": {"blending": "isosurface", "isosurfaces": [[90.0, 0.3], [200.0, 0.8]]},
    "cut at borders": SPLIT,
    "maximum": {"blending": "maximum"},
}


def scene(voxels: np.ndarray, **keys: Any) -> Scene:
    return scene_of(voxels, camera_at("outside", Grid(SHAPE)), **({"early_termination": 0.0} | keys))


def profiles(
    where: moderngl.Context | None, voxels: np.ndarray, parts: int = 1, with_code: bool = False, **keys: Any
) -> tuple[Plan, list[PieceProfile]]:
    """Profile the pieces of some ranks."""
    prepared = prepare(scene(voxels, **keys), voxels, brick=BRICK)
    plan, profiler = prepared.plan, Profiler(prepared.plan, prepared.shown, where)
    pieces = leaf_pieces(build_tree(plan.cost, parts), plan.cost, plan.eye_in_bricks(), plan.view.forward)
    found = [each for piece in pieces if (each := profiler.profile(piece, with_code)) is not None]
    profiler.release()
    return plan, found


def whole(plan: Plan, found: list[PieceProfile], name: str) -> np.ndarray:
    """A map of all pieces, int64 (h, w)."""
    width, height = plan.view.size
    total = np.zeros((height, width), np.int64)
    for each in found:
        rect = each.rect
        total[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end] += each.maps[name].astype(np.int64)
    return total


def rays(plan: Plan) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Slabs, int (h, w); in voxels midpoints of first and last, and from one to the next, float64 (h, w, 3)."""
    view, (width, height) = plan.view, plan.view.size
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, height / 2 - np.arange(height) - 0.5)
    aside = (x[..., None] * np.array(view.right) + y[..., None] * np.array(view.up)) * view.pixel
    direction = (np.array(view.forward) + aside) / np.sqrt(1 + (x**2 + y**2) * view.pixel**2)[..., None]
    extent, eye = np.array(plan.extent), np.array(view.eye)
    ends = np.stack([-eye / direction, (extent - eye) / direction])
    entry, leave = np.maximum(ends.min(axis=0).max(axis=-1), 0.0), ends.max(axis=0).min(axis=-1)
    slabs = np.ceil(np.maximum(leave - entry, 0.0) / plan.march.step_world).astype(int)
    step = plan.march.step_world
    last = 0.5 * (leave + entry + (slabs - 1) * step)
    return slabs, eye + direction * (entry + 0.5 * step)[..., None], eye + direction * last[..., None], direction * step


def check_counts(where: moderngl.Context | None, look: dict[str, Any]) -> None:
    voxels = smooth(SHAPE, "uint8")
    plan, one = profiles(where, voxels, **look)
    slabs, samples, covered, skipped = (whole(plan, one, name) for name in ("slabs", "samples", "covered", "skipped"))
    if not look.get("jitter"):
        assert np.array_equal(slabs, rays(plan)[0])
    assert samples.sum() == one[0].result.samples > 0
    ends_early = bool(plan.march.residual)
    left_out = slabs - covered - skipped
    assert left_out.min() >= 0
    assert (left_out.max() > 0) == ends_early
    assert (samples.sum() < covered.sum()) == ("adaptive" in look)
    ticks = one[0].maps["ticks"]
    rect = one[0].rect
    assert np.all((ticks > 0) >= (samples > 0)[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end])
    if not ends_early:
        _, three = profiles(where, voxels, 3, **look)
        assert len(three) == 3
        for name in ("slabs", "samples", "skipped"):
            assert np.array_equal(sum_of := whole(plan, three, name), whole(plan, one, name)), (name, sum_of.sum())


@pytest.mark.cover("jittered", "adaptive step")
@pytest.mark.parametrize("name", LOOKS)
def test_slabs_are_sampled_skipped_or_left_out_on_a_cpu(name: str) -> None:
    check_counts(None, LOOKS[name])


@pytest.mark.cover("isosurfaces", "adaptive step", "jittered")
@pytest.mark.gl
@pytest.mark.parametrize("name", LOOKS)
def test_slabs_are_sampled_skipped_or_left_out_in_opengl(name: str, context: moderngl.Context) -> None:
    check_counts(context, LOOKS[name])


def test_an_opaque_front_costs_what_early_termination_says() -> None:
    voxels = smooth(SHAPE, "uint8")
    plan, found = profiles(None, voxels, opacity=OPAQUE, early_termination=0.02)
    slabs, first, _, by = rays(plan)
    batch = int(Cpu().frame(plan, _box(plan), found[0].rect, slot_of(plan))["cells"][0, 3])
    expected = np.zeros_like(slabs)
    for pixel in np.argwhere(slabs):
        k = np.arange(slabs[tuple(pixel)] - 1)[:, None]
        cells = np.clip(
            np.floor(first[tuple(pixel)] + k * by[tuple(pixel)]), 0, np.array(plan.layout.cells_zyx[::-1]) - 1
        )
        begins = np.append(cells // BRICK, k // batch, axis=1)
        changes = 1 + np.flatnonzero((begins[1:] != begins[:-1]).any(axis=1))
        ends = changes[changes >= 2]  # one slab's opacity is 7 / 8, two have more than 0.98
        expected[tuple(pixel)] = ends[0] if len(ends) else len(k) + (len(k) < 2)
    assert np.array_equal(whole(plan, found, "covered"), expected)
    assert expected.sum() < 0.5 * slabs.sum()


def _box(plan: Plan) -> Any:
    return build_tree(plan.cost, 1).leaves[0].box


def test_twice_the_step_halves_the_samples() -> None:
    voxels = smooth(SHAPE, "uint8")
    fine, coarse = (whole(*profiles(None, voxels, step=step), "samples") for step in (0.5, 1.0))
    assert coarse.max() > 10
    assert np.all((2 * coarse >= fine) & (2 * coarse - fine <= 1))


@pytest.fixture(scope="module")
def lit() -> tuple[Plan, PieceProfile, Code]:
    opacity = ((0.0, 0.0), (VISIBLE_FROM, 0.0), (1.0, 0.9))
    plan, (found,) = profiles(None, smooth(SHAPE, "uint8"), with_code=True, opacity=opacity, clim=(0.0, 255.0), **LIT)
    assert found.code
    code = code_of([found.code])
    assert code
    return plan, found, code


def values_at(voxels: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The trilinear field at points (x, y, z), float64 (n,)."""
    cells = np.clip(np.floor(points), 0, np.array(voxels.shape[::-1]) - 2).astype(int)
    found, shares = np.zeros(len(points)), points - cells
    for corner in np.ndindex(2, 2, 2):
        x, y, z = (cells + corner).T
        found += voxels[z, y, x] * np.where(corner, shares, 1 - shares).prod(axis=1)
    return found


@pytest.mark.long
def test_light_is_executed_once_for_each_visible_sample(lit: tuple[Plan, PieceProfile, Code]) -> None:
    plan, found, code = lit
    slabs, first, last, by = rays(plan)
    points = [last[slabs > 0]]
    for k in range(slabs.max() - 1):
        inside = k < slabs - 1
        points.append(first[inside] + k * by[inside])
    values = values_at(smooth(SHAPE, "uint8").astype(np.float64), np.concatenate(points)) / 255
    assert np.abs(values - VISIBLE_FROM).min() > 1e-6
    calls = {one.name: one for one in code.functions}
    assert calls["lit"].lanes == (values > VISIBLE_FROM).sum() > 100
    assert calls["ray_through"].lanes == found.rect.pixels
    assert calls["ray_through"].executions >= found.rect.pixels / code.lanes


def test_lines_are_executed_as_often_as_pixels_count(lit: tuple[Plan, PieceProfile, Code]) -> None:
    _, found, code = lit
    lines = {one.name: one for one in code.lines}

    def lanes(text: str) -> int:
        file = code.source["march.glsl"]
        names = [f"march.glsl:{n}" for n, line in file.items() if line.strip() == text]
        return sum(lines[name].lanes for name in names if name in lines)

    maps = {name: int(values.sum()) for name, values in found.maps.items()}
    assert lanes("samples += taken(1);") + lanes("samples += taken(slabs >> doublings);") == maps["runs"] > 0
    assert lanes("count_gap(k, next);") + lanes("count_gap(k, k + 1);") == maps["gaps"] > 0
    assert all(0 <= one.idle < 1 and one.lanes <= one.executions * code.lanes for one in code.lines)


def test_light_has_its_share_of_the_whole(lit: tuple[Plan, PieceProfile, Code]) -> None:
    _, _, code = lit
    shares = {one.name: one.share for one in code.functions}
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["lit"] > 0
    assert 0 < code.ideal < 1
    assert sum(one.share for one in code.lines) <= 1 + 1e-9
    assert any(one.share > 0 for one in code.lines if one.name.startswith("lights.glsl"))


@pytest.mark.gl
def test_without_a_shader_clock_squares_are_drawn_alone(
    context: moderngl.Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    voxels = smooth(SHAPE, "uint8")
    prepared = prepare(scene(voxels), voxels, brick=BRICK)
    profiler = Profiler(prepared.plan, prepared.shown, context)
    monkeypatch.setattr(type(profiler._caster), "clock", "")
    (piece,) = leaf_pieces(build_tree(prepared.plan.cost, 1), prepared.plan.cost, None, prepared.plan.view.forward)
    found = profiler.profile(replace(piece))
    profiler.release()
    assert found
    assert "drawn alone" in found.clock
    ticks = found.maps["ticks"]
    assert ticks.shape == found.maps["samples"].shape
    assert ticks.max() > ticks.min() == 0
