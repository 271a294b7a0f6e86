"""Flows in the frame loop: what they become is drawn as other content is, and the same on any ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from data.grid_writers import GRID, vtu
from frame.views import on_ranks, pixels

from clusterviz.cli.verify import compare_with_reference
from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.content.flow.opening import open_flow
from clusterviz.content.flow.section import FlowSection
from clusterviz.data.source import Grid
from clusterviz.data.vectors import VectorArray
from clusterviz.errors import ClustervizError
from clusterviz.flow.cells import Cells
from clusterviz.flow.glyphs import vectors_at
from clusterviz.frame import render_frame
from clusterviz.image import compare
from clusterviz.scene import Camera, Scene
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import ImageSettings

RING, GYRE = "field:hill-vortex:12", "field:double-gyre:10:5"
SHOWN: list[dict[str, Any]] = [
    {"path": RING, "lic": {"length": 6, "density": 0.1}},
    {"path": RING, "show": "streamlines", "seeds": {"count": 9}, "radius": 0.06, "opacity": 0.7},
    {"path": GYRE, "show": "streaklines", "seeds": {"count": 5}, "trace": {"release": 0.2}, "radius": 0.05},
    {"path": RING, "show": "glyphs", "seeds": {"kind": "speed", "count": 7}, "length": 0.6, "radius": 0.05},
]


def scene_of(**keys: Any) -> Scene:
    camera, image = Camera(position=(4, 3, 3), focal_point=(0, 0, 0)), ImageSettings(size=(28, 22))
    return Scene(flows=[FlowSection(**keys)], camera=camera, image=image)


@pytest.mark.cover("streaklines")
@pytest.mark.gl
@pytest.mark.parametrize("keys", SHOWN, ids=lambda keys: keys.get("show", "lic"))
def test_the_picture_is_the_reference_on_any_number_of_ranks(keys: dict[str, Any]) -> None:
    scene = scene_of(**keys)
    assert compare_with_reference(scene).max < 2e-5
    one, three = (on_ranks(ranks, [with_settings(scene, {"brick": brick})])[0] for ranks, brick in ((1, 64), (3, 6)))
    assert pixels(one)[..., 3].max() > 0.3
    assert compare(pixels(one), pixels(three), 2e-6).count == 0


def test_arrows_have_the_vectors_of_their_places() -> None:
    """Of vectors that are linear; beyond the data and beside a vector that is NaN there are none."""
    grid = Grid((4, 5, 6), (0.5, 1.0, 2.0), (1.0, 0.0, 0.0))
    z, y, x = np.meshgrid(*(np.arange(side, dtype=float) for side in grid.shape_zyx), indexing="ij")
    values = np.stack([x, y + z, 2 * x - z], axis=-1)
    values[0, 0, 0] = np.nan
    places = np.array([[1.0, 2, 4], [2.2, 3.7, 1.4], [3.5, 4, 6], [1.1, 0.1, 0.1], [3.6, 0, 0], [np.nan, 0, 0]])
    at = (places - grid.origin) / grid.spacing
    expected = np.stack([at[:, 0], at[:, 1] + at[:, 2], 2 * at[:, 0] - at[:, 2]], axis=1)
    expected[3:] = np.nan
    vectors = VectorArray(values, grid)
    for found in run_loopback(3, lambda channel: vectors_at(vectors, places, channel)):
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_vectors_of_unstructured_grids_are_resampled_but_for_lines(tmp_path: Path) -> None:
    points = " ".join(map(repr, np.tile((3.0, 4.0, 0.0), len(GRID.points)).tolist()))
    array = f'<DataArray type="Float64" Name="U" NumberOfComponents="3" format="ascii">{points}</DataArray></PointData>'
    path = vtu(tmp_path / "a.vtu")
    path.write_text(path.read_text().replace("</PointData>", array))
    exact, regular = (
        run_loopback(2, lambda channel, keys=keys: open_flow(FlowSection(path=str(path), **keys), None, "", channel))
        for keys in ({"show": "streamlines"}, {"show": "glyphs", "samples": 6, "scale": 2.0})
    )
    assert isinstance(exact[1].vectors, Cells)
    assert [each.info.fastest for each in (*exact, *regular)] == pytest.approx([5, 5, 10, 10])
    vectors = regular[0].vectors
    assert not isinstance(vectors, Cells)
    assert max(vectors.grid.shape_zyx) == 6


def test_seeds_without_vectors_are_told() -> None:
    seeds = {"kind": "list", "points": [[0, 0, 0.5], [9, 0, 0]]}
    with pytest.warns(UserWarning, match=r"flows\[0\]: 1 of 2 points are left out"):
        render_frame(scene_of(path=RING, show="glyphs", seeds=seeds, color="red", color_by="color"), LoopbackChannel())
    far = {"kind": "list", "points": [[9, 0, 0]]}
    with pytest.warns(UserWarning, match=r"flows\[0\]: nothing is drawn"):
        render_frame(scene_of(path=RING, show="streamlines", seeds=far), LoopbackChannel())


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"path": RING, "show": "pathlines"}, r"flows\[0\].show: nothing changes with time in field:hill-vortex:12"),
        ({"path": GYRE, "show": "pathlines", "trace": {"duration": 99}}, "the time steps end before"),
        ({"path": GYRE, "time": 7}, "step.*7"),
        ({"path": "field:vortx"}, "vortx"),
    ],
)
def test_what_cannot_be_shown_is_said_once(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ClustervizError, match=said):
        render_frame(scene_of(**keys), LoopbackChannel())
