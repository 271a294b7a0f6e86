"""Labels of any size: they stay apart, whatever float32 holds, and many of them have many colours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from data.checks import check_source, refused

from clusterviz.cli.verify import compare_with_reference
from clusterviz.comm import Channel, run_loopback
from clusterviz.data import open_volume
from clusterviz.data.labels import hashed, places
from clusterviz.data.memory import ArraySource
from clusterviz.frame import Options, Rendered, render_frame
from clusterviz.image import compare
from clusterviz.scene import Scene, Volume, scene_of_data
from clusterviz.scene.overrides import with_settings

NUMBERS = np.zeros((12, 12, 12), int)
for _number in range(1, 5):
    _z, _y, _x = 3 + 2 * _number, 1 + 5 * (_number // 3), 1 + 5 * (_number % 2)
    NUMBERS[2:_z, _y : _y + 4, _x : _x + 4] = _number
FAR: dict[str, tuple[str, list[int]]] = {
    "beyond 2^24": ("u4", [2**24 + n for n in range(4)]),
    "beyond 2^53": ("u8", [2**53 + n for n in range(4)]),
    "beyond 2^63": ("u8", [2**63 + n for n in range(4)]),
    "far apart": ("u4", [1, 2, 4_000_000_000, 4_000_000_001]),
    "of both signs": ("i8", [-(2**62), 1 - 2**62, 2**62, 2**62 + 1]),
}


def draw(scene: Scene, labels: np.ndarray | None = None, ranks: int = 1) -> Rendered:
    source = None if labels is None else ArraySource(labels)

    def render(channel: Channel) -> Rendered:
        return render_frame(scene, channel, source, Options(device="cpu"))

    return run_loopback(ranks, render)[0]


def automatic(path: str = "a.npy", **keys: Any) -> Scene:
    return with_settings(scene_of_data(path), {"size": (32, 24), "brick": 8, **keys})


@pytest.mark.cover
@pytest.mark.parametrize("name", FAR)
def test_large_labels_are_drawn_as_small_ones(name: str, tmp_path: Path) -> None:
    dtype, ids = FAR[name]
    labels = np.array([0, *ids], dtype)[NUMBERS]
    expected = draw(automatic(preset="labels"), NUMBERS.astype("u1"))
    found = draw(automatic(preset="labels"), labels, ranks=3)
    assert expected.image is not None
    assert len(np.unique(expected.image.reshape(-1, 4), axis=0)) > 50
    assert compare(found.image, expected.image, 1e-6).count == 0
    assert found.scene.volumes[0].labels == (0, *ids)
    # A completed scene, as pictures record it, opens the file alike.
    np.save(tmp_path / "a.npy", labels)
    kept = Scene.model_validate_json(found.scene.model_dump_json())
    kept = with_settings(kept, {"path": str(tmp_path / "a.npy")})
    assert compare(draw(kept).image, expected.image, 1e-6).count == 0
    check_source(open_volume(kept.volumes[0]), NUMBERS.astype("u2"))


@pytest.mark.parametrize("keys", [{}, {"preset": "labels"}])
def test_many_labels_have_many_colours(keys: dict[str, Any]) -> None:
    ids = np.random.default_rng(0).choice(10**15, 600, replace=False).astype("u8") + 7 * 10**17
    labels = np.zeros((22, 22, 22), "u8")
    labels[1:21, 1:21, 1:21] = np.kron(ids[:216].reshape(6, 6, 6), np.ones((4, 4, 4), "u8"))[:20, :20, :20]
    labels[1, 1, 1:21] = ids[216:236]
    labels[1:21, 1:21, 1] = ids[200:600].reshape(20, 20)
    found = draw(automatic(**keys), labels)
    assert found.scene.volumes[0].labels == "hashed"
    assert found.image is not None
    colours = found.image[..., :3].reshape(-1, 3)
    assert len({tuple(np.rint(8 * colour / colour.max())) for colour in colours if colour.max() > 0.1}) > 30


def test_large_labels_are_those_of_the_reference(tmp_path: Path) -> None:
    dtype, ids = FAR["beyond 2^63"]
    np.save(tmp_path / "a.npy", np.array([0, *ids], dtype)[NUMBERS])
    assert compare_with_reference(automatic(str(tmp_path / "a.npy"), preset="labels", size=(16, 12))).max < 1e-5


def test_labels_of_a_scene(tmp_path: Path) -> None:
    labels = np.arange(60, dtype="i8").reshape(3, 4, 5) - 2**60
    np.save(tmp_path / "a.npy", labels)
    volume = Volume(path=str(tmp_path / "a.npy"), labels=(-(2**60) + 7, 2**70, -(2**60)), spacing=(1, 2, 3))
    expected = np.full(60, 3, "u2")
    expected[[7, 0]] = 0, 2
    source = open_volume(volume)
    check_source(source, expected.reshape(3, 4, 5))
    assert source.grid.spacing == (1, 2, 3)
    many = hashed(np.arange(100_000, dtype="u8") << np.uint64(40))
    assert (many.dtype, many[0], many[1:].min(), many.max()) == (np.uint16, 0, 1, 511)
    assert np.bincount(many, minlength=512)[1:].min() > 100
    np.testing.assert_array_equal(places(np.array([5, 6, 7], "u1"), (300, 6)), [2, 1, 2])
    np.save(tmp_path / "b.npy", labels.astype("f4"))
    refused(
        lambda: open_volume(volume.model_copy(update={"path": str(tmp_path / "b.npy")})), "no integer type", "float32"
    )


def test_a_smooth_field_of_large_integers_is_no_label_map() -> None:
    z, y, x = np.indices((10, 10, 10)) - 4.5
    field = ((1 - (z**2 + y**2 + x**2) / 80) * 2.0**62).astype("i8")
    assert draw(automatic(), field).scene.volumes[0].labels is None
