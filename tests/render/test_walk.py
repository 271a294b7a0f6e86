"""The walk through tetrahedra in float32, compiled for this CPU, against the reference: nothing is lost or doubled."""

from __future__ import annotations

import numpy as np
import pytest
from data.cells import lattice, tetrahedra

from clusterviz.data.faces import NONE, find_neighbours
from clusterviz.data.tetrahedra import Tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.gl.shader import shader_file
from clusterviz.reference.cells import find_passages
from clusterviz.reference.rays import Rays
from clusterviz.spmd.adversary import DRIVERS
from clusterviz.spmd.machine_code import ADVERSARY_VARIABLE, addresses, function_of, object_code
from clusterviz.spmd.source import ShaderSource

PROGRAM = """
layout(std430, binding = 0) readonly buffer VerticesBlock { vec4 vertices[]; };
layout(std430, binding = 1) readonly buffer CornersBlock { int corners[]; };
layout(std430, binding = 2) readonly buffer NextBlock { int next[]; };
layout(std430, binding = 3) readonly buffer RaysBlock { vec4 rays[]; }; // slope, half-face that it enters, or -1
layout(std430, binding = 4) writeonly buffer FoundBlock { vec4 found[]; }; // length, ∫ scalar, tetrahedra, step back
vec2 slope = rays[gl_LocalInvocationIndex].xy;
int cell_corner(int half_face) { return corners[half_face]; }
int cell_next(int half_face) { return next[half_face]; }
vec4 cell_vertex(int row) {
    precise vec2 way = slope * vertices[row].z;
    precise vec2 at = vertices[row].xy - way;
    return vec4(at, vertices[row].zw);
}
#include
void main() {
    vec4 sum = vec4(0.0);
    if (rays[gl_LocalInvocationIndex].z >= 0.0) {
        Walk walk = enter(int(rays[gl_LocalInvocationIndex].z));
        vec2 front = met(walk);
        while (walk.half_face >= 0 && sum.z < 1000.0) {
            pass(walk);
            vec2 back = met(walk);
            sum += vec4(back.x - front.x, 0.5 * (front.y + back.y) * (back.x - front.x), 1.0, 0.0);
            sum.w = max(sum.w, front.x - back.x);
            front = back;
        }
    }
    found[gl_LocalInvocationIndex] = sum;
}
"""


def walked(cells: Tetrahedra, slopes: np.ndarray, lanes: int) -> np.ndarray:
    """What rays from the origin find: float32 (n, 4), as `FoundBlock`; n is a multiple of the lanes."""
    topology = find_neighbours(cells.corners, len(cells.points)).ascending()
    entries = np.array([_entry(cells, topology.tetrahedra, topology.halves, slope) for slope in slopes], np.float32)
    files = "".join(shader_file(name).read_text() for name in ("strict_side.glsl", "walk.glsl"))
    source = ShaderSource(PROGRAM.replace("#include", files), ("test",))
    call = function_of(object_code(source, f"walk{lanes}", lanes), f"walk{lanes}")
    vertices = np.column_stack([cells.points, cells.values]).astype(np.float32)
    rays = np.column_stack([slopes, entries, entries]).astype(np.float32)
    found, system = np.zeros((len(slopes), 4), np.float32), np.zeros(7, np.uint32)
    following = np.where(topology.halves == NONE, -1, topology.halves.astype(np.int64)).astype(np.int32)
    buffers = {0: vertices, 1: topology.tetrahedra.astype(np.int32), 2: following, 3: rays, 4: found}
    table = addresses({}, buffers, system)
    for system[6] in range(0, len(slopes), lanes):
        call(table.ctypes.data)
    return found


def _entry(cells: Tetrahedra, corners: np.ndarray, halves: np.ndarray, slope: np.ndarray) -> int:
    """The half-face at the boundary of a convex grid through which a ray that is moved by (ε, ε²) enters, or −1."""
    x, y = (cells.points[:, axis] - slope[axis] * cells.points[:, 2] for axis in (0, 1))
    row, k = np.nonzero(halves == NONE)
    face = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[k]
    own = np.take_along_axis(corners[row], face, 1).astype(int)
    ends = [(own[:, a], own[:, b]) for a, b in ((0, 1), (1, 2), (2, 0))]
    sides = np.array([x[a] * y[b] - y[a] * x[b] for a, b in ends])
    moved = np.array([np.where(y[a] != y[b], y[a] - y[b], x[b] - x[a]) for a, b in ends])
    signs = np.sign(np.where(sides != 0, sides, moved))
    met = np.flatnonzero(np.abs(signs.sum(axis=0)) == 3)
    depth = (sides[[1, 2, 0]] * cells.points[own, 2].T).sum(axis=0)[met] / sides.sum(axis=0)[met]
    beyond = corners[row[met], k[met]].astype(int)
    a, b, c = (cells.points[own[met, n]] for n in range(3))
    normal = np.cross(b - a, c - a)
    inward = ((cells.points[beyond] - a) * normal).sum(axis=1) * (normal @ [*slope, 1.0]) > 0
    found = met[inward]
    return int(4 * row[found[0]] + k[found[0]]) if len(found) and len(depth) else -1


def slopes_through(step: float) -> np.ndarray:
    """Slopes of 16 x 16 rays, of which those of whole steps meet corners and edges of a lattice exactly."""
    return step * np.stack(np.meshgrid(np.arange(-8, 8), np.arange(-7, 9)), axis=-1).reshape(-1, 2)


@pytest.mark.cover
@pytest.mark.parametrize("lanes", [4, 16])
@pytest.mark.parametrize("step", [1.0, 0.5, 0.25, 1 / 3])
def test_rays_through_corners_and_edges_pass_what_the_reference_passes(step: float, lanes: int) -> None:
    """In float32 nothing is lost but a few roundings of the depth."""
    box = lattice(4, 12, 12)
    cells = tetrahedra(UnstructuredGrid("a", box.points - [6, 6, -2], box.cells, box.point_arrays))
    slopes = slopes_through(step).astype(np.float32).astype(float)
    found = walked(cells, slopes, lanes)
    rays = Rays(np.zeros((256, 3)), np.column_stack([slopes, np.ones(256)]))
    passed = find_passages(rays, cells)
    square = (rays.direction**2).sum(axis=1)[passed.ray]
    way = (passed.end - passed.begin) / square  # in depth
    lengths, scalars = (
        np.bincount(passed.ray, each, minlength=256) for each in (way, way * (passed.front + passed.back) / 2)
    )
    np.testing.assert_allclose(found[:, 0], lengths, atol=3e-6)
    np.testing.assert_allclose(found[:, 1], scalars, atol=1e-4)
    assert lengths.max() == pytest.approx(4)
    assert found[:, 2].max() < 80
    assert found[:, 3].max() < 1e-5


def test_slivers_are_passed() -> None:
    box = lattice(3, 3, 3)
    thin = UnstructuredGrid("a", (box.points - [1.5, 1.5, 0]) * [1, 1, 1e-6] + [0, 0, 1], box.cells, box.point_arrays)
    rng = np.random.default_rng(4)
    found = walked(tetrahedra(thin), rng.uniform(-1.4, 1.4, (64, 2)).astype(np.float32).astype(float), 16)
    np.testing.assert_allclose(found[:, 0], 3e-6, atol=5e-7)  # three roundings of the depth, which is 1


@pytest.mark.parametrize("driver", ["", *DRIVERS])
def test_rays_through_every_corner_and_edge_pass_what_the_reference_passes(
    driver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a frustum of layers at powers of two all slopes to corners, and between them, are exact in float32."""
    box = lattice(3, 5, 5)
    depth = 2.0 ** box.points[:, 2]
    aside = box.points[:, :2] / 4 - 5 / 8
    is_inner = ((box.points > 0) & (box.points < [5, 5, 3])).all(axis=1)
    aside += is_inner[:, None] * np.random.default_rng(7).integers(-6, 7, aside.shape) / 128
    cells = tetrahedra(
        UnstructuredGrid(
            "a", np.column_stack([aside * depth[:, None], depth]), box.cells, {"f": aside @ [3, 2] + depth}
        )
    )
    ends = np.unique(
        np.sort(cells.corners[:, [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]].reshape(-1, 2), axis=1), axis=0
    )
    slopes = cells.points[:, :2] / cells.points[:, 2:]
    slopes = np.unique(np.concatenate([slopes, slopes[ends].mean(axis=1)]), axis=0)
    slopes = slopes[(np.abs(slopes) < 5 / 8).all(axis=1)]
    slopes = np.concatenate([slopes, np.zeros((-len(slopes) % 16, 2))])
    np.testing.assert_array_equal(slopes, slopes.astype(np.float32))
    monkeypatch.setenv(ADVERSARY_VARIABLE, driver)
    found = walked(cells, slopes, 16)
    passed = find_passages(Rays(np.zeros((len(slopes), 3)), np.column_stack([slopes, np.ones(len(slopes))])), cells)
    way = (passed.end - passed.begin) / ((slopes**2).sum(axis=1) + 1)[passed.ray]
    np.testing.assert_allclose(np.bincount(passed.ray, way), 7, rtol=1e-12)
    np.testing.assert_allclose(found[:, 0], 7, atol=5e-6)
    np.testing.assert_allclose(found[:, 1], np.bincount(passed.ray, way * (passed.front + passed.back) / 2), atol=5e-5)
    assert found[:, 3].max() < 1e-5
