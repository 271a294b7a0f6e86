"""Annotations: lines in the right order with the data, ticks where the world's units are, text that can be read."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clusterviz
from clusterviz.annotations import annotated, with_annotations
from clusterviz.annotations.canvas import Canvas
from clusterviz.annotations.numbers import tick_labels, ticks
from clusterviz.annotations.picture import _kept_fixed, contrast
from clusterviz.comm import LoopbackChannel
from clusterviz.content.complete import complete_scene
from clusterviz.content.facts import box_corners
from clusterviz.content.geometry.section import LinesSection
from clusterviz.content.volume.info import VolumeInfo
from clusterviz.data.geometry import Geometry, Lines
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import IDENTITY, Grid
from clusterviz.errors import ClustervizError, SceneError
from clusterviz.frame import Options, render_frame
from clusterviz.image.finish import finish
from clusterviz.scene import Camera, Scene, Volume, background_rgb
from clusterviz.scene.camera import project_points
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import ImageSettings

EVERYTHING: dict[str, Any] = {
    **dict.fromkeys(("scalar_bar", "outline", "axes", "orientation", "time", "scale_bar", "legend"), True),
    "title": "A title",
    "text": ["one", "another"],
    "unit": "mm",
}
BLUE = ((0.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 1.0))
TURNED = ((0.6, -0.8, 0.0), (0.8, 0.6, 0.0), (0.0, 0.0, 1.0))
FOG = np.ones((12, 14, 16), np.float32)
CAMERAS = {
    "outside": {"position": (50, 41, 33), "view_angle": 30},
    "near": {"position": (22, 20, 16), "view_angle": 60},
    "parallel": {"position": (50, -41, 33), "parallel_scale": 12},
    "inside": {"view_angle": 80},
}


def made(
    keys: dict[str, Any], size: tuple[int, int] = (320, 240), background: Any = "white", **more: Any
) -> tuple[Scene, list[VolumeInfo]]:
    """A completed scene with a volume of 100 x 80 x 60 world units, and what is known of it."""
    corners = box_corners(np.array([[0.0, 0.0, 0.0], [100.0, 80.0, 60.0]]))
    info = VolumeInfo((61, 81, 101), (1.0, 1.0, 1.0), corners, 0.0, 1.0, 0.0, 1.0, orientation="RAS")
    volume = Volume(path="a.nii", clim=(0, 1), cmap="viridis", opacity=0.1, time=3)
    scene = Scene(volumes=[volume], image=ImageSettings(size=size, background=background), annotations=keys)
    return complete_scene(with_settings(scene, more) if more else scene, [info]), [info]


def edges_of(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the twelve edges of a box, float64 (12, 2, 3)."""
    pairs = [(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit]
    return corners[np.array(pairs)]


def blank(size: tuple[int, int]) -> NDArray[np.float32]:
    return np.zeros((size[1], size[0], 4), np.float32)


@pytest.fixture
def texts(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, tuple[float, ...]]]:
    """Each text that is drawn, and its rectangle."""
    _kept_fixed.cache_clear()
    found: list[tuple[str, tuple[float, ...]]] = []
    draw = Canvas.text

    def recorded(canvas: Canvas, at: Any, text: str, *rest: Any, **more: Any) -> Any:
        rect = draw(canvas, at, text, *rest, **more)
        found.append((text, rect))
        return rect

    monkeypatch.setattr(Canvas, "text", recorded)
    return found


@pytest.mark.cover("outside-True")
@pytest.mark.gl
@pytest.mark.parametrize(("name", "turned"), [*zip(CAMERAS, (True, False, True, False), strict=True)])
def test_edges_are_hidden_by_the_data_as_lines_among_them_are(name: str, turned: bool) -> None:
    """The same edges as opaque tubes of the scene's geometry are put in order by the renderer."""
    size, grid = (160, 120), Grid(FOG.shape, direction=TURNED if turned else IDENTITY)
    centre = grid.corners.mean(axis=0)
    inside = {"position": np.add(centre, (3, 1, -1))} if name == "inside" else {}
    camera = Camera(**{"focal_point": centre, "view_up": (0, 0, 1), **CAMERAS[name], **inside})
    fog = Volume(path="a", clim=(0, 1), cmap=BLUE, opacity=0.1, opacity_unit_distance=1.0)
    keys = {"outline": True, "color": "red", "font_size": 0.2}
    scene = Scene(volumes=[fog], camera=camera, image=ImageSettings(size=size), annotations=keys)
    source, segments = ArraySource(FOG, grid), edges_of(grid.corners)
    drawn = render_frame(scene, LoopbackChannel(), source, Options(annotate=True)).image
    lines = Lines("l", segments.reshape(-1, 3).astype(np.float32), np.arange(0, 25, 2))
    tubes = scene.model_copy(update={"lines": (LinesSection(path="l", color="red", radius=0.25, shade=False),)})
    exact = render_frame(tubes, LoopbackChannel(), [source, Geometry(lines=lines)]).image
    assert drawn is not None
    assert exact is not None
    seen = []
    for number, (begin, end) in enumerate(segments):
        pixels, ahead = project_points(camera, begin + np.linspace(0.1, 0.9, 9)[:, None] * (end - begin), size)
        for (x, y), depth in zip(pixels, ahead, strict=True):
            in_picture = depth > 0.5 and 2 <= x < size[0] - 2 and 2 <= y < size[1] - 2
            if in_picture and distance_to_others(camera, segments, number, (x, y), size) > 4:
                seen.append((exact[int(y), int(x), 0], drawn[int(y), int(x), 0]))
    theirs, ours = np.array(seen).T
    assert len(seen) > 10
    assert theirs.min() < 0.5  # some are behind the data
    assert (theirs.max() > 0.9) == (name != "inside")
    np.testing.assert_allclose(ours, 0.85 * theirs, atol=0.1)


def distance_to_others(
    camera: Camera, segments: NDArray[np.float64], number: int, at: tuple[float, float], size: tuple[int, int]
) -> float:
    """Distance in pixels of a point from all projected segments but one."""
    others = np.delete(segments, number, axis=0)
    points = others[:, :1] + np.linspace(0, 1, 200)[:, None] * (others[:, 1:] - others[:, :1])
    pixels, ahead = project_points(camera, points.reshape(-1, 3), size)
    return float(np.linalg.norm(pixels[ahead > 0.01] - at, axis=1).min())


def test_ticks_are_where_the_worlds_units_are(texts: list[tuple[str, tuple[float, ...]]]) -> None:
    """Seen from the front by parallel projection, a world unit is two pixels."""
    camera = {"position": (50, -500, 30), "focal_point": (50, 40, 30), "view_up": (0, 0, 1), "parallel_scale": 75}
    scene, infos = made({"axes": True, "unit": "mm"}, (400, 300), camera=camera)
    ink = annotated(blank((400, 300)), scene, infos)[..., 3]
    where = [(text, (left + right) / 2, (top + bottom) / 2) for text, (left, top, right, bottom) in texts]
    left, lower = 200 - 100, 150 + 60  # corner of x = 0 and z = 0, pixels
    assert [text for text, *_ in where if "mm" in text] == ["x, mm", "z, mm"]  # y is seen end on
    marks = [(float(text), x) for text, x, y in where if y > lower and "mm" not in text]
    assert [value for value, _ in marks] == [0, 20, 40, 60, 80, 100]
    for value, x in marks:
        assert x == pytest.approx(left + 2 * value, abs=1)
        assert ink[lower + 2 : lower + 4, int(x) - 1 : int(x) + 2].max() > 0.7
        assert ink[lower + 2 : lower + 4, int(x) + 5 : int(x) + 15].max(initial=0) < 0.1
    heights = [(float(text), y) for text, x, y in where if x < left and y <= lower and "mm" not in text]
    assert [value for value, _ in heights] == [0, 20, 40, 60]
    for value, y in heights:
        assert y == pytest.approx(lower - 2 * value, abs=1)


@pytest.mark.parametrize(
    ("low", "high", "most", "labels", "factor"),
    [
        (0.0, 1.0, 6, ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"], ""),
        (-100.0, 150.0, 6, ["−100", "−50", "0", "50", "100", "150"], ""),
        (0.0, 3e-9, 4, ["0", "1", "2", "3"], "×10⁻⁹"),
        (-2e9, 2e9, 5, ["−2", "−1", "0", "1", "2"], "×10⁹"),
        (99.8, 100.3, 3, ["99.8", "100.0", "100.2"], ""),
        (0.0, 162.0, 4, ["0", "50", "100", "150"], ""),
        (5.0, 5.0, 6, ["5"], ""),
        (-1.7e308, 1.7e308, 6, [], ""),
    ],
)
def test_ticks_are_round_numbers(low: float, high: float, most: int, labels: list[str], factor: str) -> None:
    assert tick_labels(ticks(low, high, most)) == (labels, factor)


@pytest.mark.parametrize("background", ["white", "black", "gray", "orange", "transparent"])
def test_text_can_be_read_over_any_content(background: str, texts: list[tuple[str, tuple[float, ...]]]) -> None:
    """Over content of the text's own colour there is a halo; over a transparent background, whatever comes behind."""
    size = (300, 200)
    plain, infos = made({}, size, background)
    scene, _ = made({"text": ["HHH"]}, size, background)
    for content in (None, 0.0, 0.5, 1.0):
        picture = blank(size)
        if content is not None:
            picture[:] = (content, content, content, 1)
        found = annotated(picture, scene, infos)
        ((_, (left, top, right, bottom)),) = texts  # drawn once, and kept
        for behind in [background_rgb(background)] if background != "transparent" else [(0, 0, 0), (1, 1, 1)]:
            pixels = finish(found, behind)[int(top) : int(bottom) + 1, int(left) : int(right) + 1] / 255  # type: ignore[arg-type]
            dark, light = sorted(pixels.reshape(-1, 3).tolist(), key=sum)[:: pixels[..., 0].size - 1]
            assert contrast(tuple(dark), tuple(light)) >= 4.5
    assert annotated(blank(size), plain, infos).max() == 0


def test_a_bar_has_the_colours_and_the_opacity_of_the_scalars() -> None:
    steps = [[0, 1, 0, 0], [0.5, 1, 0, 0], [0.5, 0, 0, 1], [1, 0, 0, 1]]
    scene, infos = made({"scalar_bar": True}, (400, 300), cmap=steps)
    found = annotated(blank((400, 300)), scene, infos)
    red, blue = (np.argwhere((found == colour).all(axis=2)) for colour in ((1, 0, 0, 1), (0, 0, 1, 1)))
    assert len(red) == pytest.approx(len(blue), rel=0.03)
    assert len(red) > 500
    assert blue[:, 0].max() < red[:, 0].min()  # the high values are above
    left = red[:, 1].min()
    assert found[:, left - 12 : left - 4, 3].max() == 0  # opacity does not vary
    scene, _ = made({"scalar_bar": {"position": "left"}}, (400, 300), opacity=[[0.5, 0], [1, 0.4]])
    drawn = annotated(blank((400, 300)), scene, infos)[..., 3] > 0
    top, bottom, left = 52, 200, int(np.argmax(drawn[60:190].all(axis=0)))
    low, middle, high = (int(drawn[y : y + 3, left - 16 : left - 4].sum()) for y in (bottom - 30, top + 40, top + 4))
    assert high > 1.3 * middle > 0
    assert low == 0


def test_a_table_is_shown_over_values_and_magnitudes(tmp_path: Path) -> None:
    table = np.zeros((2, 2, 4), np.float32)
    table[1, 0] = (0, 1, 0, 0.5)  # steep, low values
    np.save(tmp_path / "table.npy", table)
    scene, infos = made(
        {"scalar_bar": True}, (400, 300), transfer_2d={"path": str(tmp_path / "table.npy")}, opacity=None
    )
    found = annotated(blank((400, 300)), scene, infos)
    rows, columns = np.nonzero((found == (0, 1, 0, 1)).all(axis=2))
    height, width = np.ptp(rows), np.ptp(columns)
    assert height > 25
    assert height == pytest.approx(width, abs=3)
    assert rows.mean() < 150  # the upper half of the table


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (1, 300), (127, 400), (128, 128), (400, 130), (200, 1000)])
def test_small_pictures_and_any_shape(size: tuple[int, int], texts: list[tuple[str, tuple[float, ...]]]) -> None:
    for more in ({}, {"camera": {"position": (50, 40, 30), "focal_point": (0, 0, 0)}}, {"parallel_scale": 1e-9}):
        scene, infos = made(EVERYTHING, size, "transparent", **more)
        picture = np.full((size[1], size[0], 4), 0.25, np.float32)
        found = annotated(picture, scene, infos)
        assert found.shape == picture.shape
        assert (picture == 0.25).all()
        assert (found[..., :3] <= found[..., 3:] + 1e-6).all()
        assert (found >= 0).all()
        assert found.max() <= 1 + 1e-6
    assert bool(texts) == (min(size) >= 128)
    for n, (text, a) in enumerate(texts[: len(texts) // 3]):
        for other, b in texts[n + 1 : len(texts) // 3]:
            assert not (a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]), f"{text} over {other}"


@pytest.mark.parametrize(
    ("box", "clim", "camera"),
    [
        (1e-9, (0, 1e-300), {}),
        (1e9, (1e9, 1e9 + 1), {}),
        (1e100, (-1e308, 1e308), {}),
        (0.0, (5, 5), {}),
        (10.0, (0, 1), {"position": (1e7, 1e7, 1e7), "focal_point": (0, 0, 0)}),
        (10.0, (0, 1), {"position": (0, 0, 0), "focal_point": (1, 1, 1)}),  # on a corner
        (10.0, (0, 1), {"position": (5, 0, 0), "focal_point": (5, 5, 5)}),  # on a face
        (10.0, (0, 1), {"position": (5, 5, 30), "focal_point": (5, 5, 0), "view_up": (0, 1, 0), "parallel_scale": 8}),
    ],
)
@pytest.mark.filterwarnings("error")
def test_extremes(box: float, clim: tuple[float, float], camera: dict[str, Any]) -> None:
    corners = box_corners(np.array([[0.0, 0.0, 0.0], [box, box, box]]))
    info = VolumeInfo((2, 2, 2), (box or 1e-3,) * 3, corners, 0.0, 1.0, 0.0, 1.0)
    volume = Volume(path="a", clim=clim, cmap="bone", opacity="linear")
    scene = Scene(volumes=[volume], camera=camera, image=ImageSettings(size=(300, 200)), annotations=EVERYTHING)
    found = annotated(blank((300, 200)), complete_scene(scene, [info]), [info])
    assert np.isfinite(found).all()
    assert (found[..., 3] > 0.5).sum() > 1000


def test_what_is_annotated_by_default() -> None:
    scene, _ = made({"axes": False, "title": "head"})
    chosen = with_annotations(scene).annotations
    assert (chosen.scalar_bar, chosen.outline, chosen.orientation, chosen.axes) == (True, True, True, False)
    assert (chosen.legend, chosen.title, chosen.is_empty) == (False, ("head",), False)
    lines = scene.model_copy(update={"lines": (LinesSection(path="a"),)})
    assert with_annotations(lines).annotations.legend is True


def test_a_time_stamp_follows_the_steps(texts: list[tuple[str, tuple[float, ...]]]) -> None:
    scene, infos = made({"time": {"format": "t = {time:.1f} s", "first": 1, "interval": 0.5}, "axes": True})
    for step in (3, 4):
        annotated(blank((320, 240)), with_settings(scene, {"time": step}), infos)
    assert [text for text, _ in texts if text.startswith("t")] == ["t = 2.5 s", "t = 3.0 s"]


@pytest.mark.gl
def test_only_those_who_ask_get_annotations() -> None:
    scene = Scene(volumes=[Volume(path="field:gaussian:8")], image=ImageSettings(size=(130, 140)))
    asking = scene.model_copy(update={"annotations": with_settings(scene, {"annotations.title": "A"}).annotations})
    plain = clusterviz.render(scene)
    titled = clusterviz.render(asking)
    measured = render_frame(asking, LoopbackChannel()).image
    assert plain is not None
    assert titled is not None
    assert np.array_equal(plain, measured)  # type: ignore[arg-type]
    changed = np.nonzero((plain != titled).any(axis=(1, 2)))[0]
    assert 0 < len(changed) < 30
    assert changed.max() < 30


@pytest.mark.mpi(ranks=[3], timeout=120)
def test_ranks_do_not_change_the_picture(comm: Any) -> None:
    keys: dict[str, Any] = {"annotations": EVERYTHING, "size": (150, 130), "brick": 8}
    found = clusterviz.render("field:gaussian:16", comm=comm, **keys)
    if comm.rank == 0:
        alone = clusterviz.render("field:gaussian:16", comm=comm.Split(0), **keys)
        assert alone is not None
        np.testing.assert_allclose(np.asarray(found), np.asarray(alone), atol=1e-5)
        assert (np.asarray(found)[..., 3] > 0.8).sum() > 300
    else:
        comm.Split(1)
        assert found is None


@pytest.mark.parametrize(
    ("keys", "error"),
    [
        ({"scalarbar": True}, "annotations.scalarbar: unknown key, did you mean scalar_bar"),
        ({"scalar_bar": {"titel": "K"}}, "annotations.scalar_bar.titel: unknown key, did you mean title"),
        ({"axes": 1}, "annotations.axes: neither a switch nor a section; found 1; allowed true, false"),
        ({"time": {"format": "{seconds}"}}, "annotations.time.format: not a format"),
        ({"time": {"format": "now"}}, "annotations.time.format: does not depend on the time"),
        ({"color": "transparent"}, "annotations.color: not a colour"),
        ({"font_size": 0}, "annotations.font_size: too small"),
    ],
)
def test_wrong_keys_are_named(keys: dict[str, Any], error: str) -> None:
    with pytest.raises(SceneError, match=error):
        with_settings(Scene(), {"annotations": keys})


def test_a_key_within_a_switch_turns_it_on() -> None:
    scene = with_settings(Scene(), {"annotations": {"axes": True}})
    assert with_settings(scene, {"annotations.axes.grid": False}).annotations.axes.grid is False  # type: ignore[union-attr]


def test_a_missing_matplotlib_is_named_before_anything_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    begun: list[str] = []
    options = Options(annotate=True, progress=lambda step, done=0.0: begun.append(step))
    scene = Scene(volumes=[Volume(path="field:gaussian:8")], annotations={"title": "A"})
    with pytest.raises(ClustervizError, match=r"annotations need matplotlib: pip install '\.\[report\]' in a checkout"):
        render_frame(scene, LoopbackChannel(), options=options)
    assert begun == ["open"]
