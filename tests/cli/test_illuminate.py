"""`clusterviz illuminate`: a spectral picture under several lights."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clusterviz.image import read_image
from clusterviz.image.files import read_text
from clusterviz.image.spectral import Fluxes, SpectralPicture, read_spectral, write_spectral
from clusterviz.image.spectral.colour import decoded


@pytest.fixture
def picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Nothing on the left, a dense red layer on the right, 2 x 4 pixels."""
    monkeypatch.chdir(tmp_path)
    at = np.array([450.0, 550.0, 650.0])
    front, transmitted = np.zeros((2, 4, 3), np.float32), np.ones((2, 4, 3), np.float32)
    front[:, 2:], transmitted[:, 2:] = (0.02, 0.02, 0.8), 0.01
    write_spectral("a.spectral.npz", SpectralPicture(Fluxes(front, front, transmitted), at))
    return tmp_path


def test_daylight_shows_white_and_a_lamp_its_colour(cli: Callable[..., Any], picture: Path) -> None:
    assert cli("illuminate", "a.spectral.npz", "-o", "day.png").status == 0
    day = read_image("day.png")
    assert day.shape == (2, 4, 4)
    np.testing.assert_allclose(day[:, :2], 1)
    red, green, blue, alpha = day[0, 3]
    assert red > 2 * max(green, blue)
    assert alpha == 1
    assert cli("illuminate", "a.spectral.npz", "--light", "A", "-o", "lamp.png").status == 0
    lamp = read_image("lamp.png")
    assert lamp[0, 0, 0] == 1 > lamp[0, 0, 1] > lamp[0, 0, 2]
    assert read_text("lamp.png", "clusterviz light") == "A"
    assert cli("illuminate", "a.spectral.npz", "--light", "A", "--adapt", "-o", "adapted.png").status == 0
    np.testing.assert_allclose(read_image("adapted.png")[:, :2], 1)
    assert cli("illuminate", "a.spectral.npz", "--light", "laser:450", "-o", "laser.png").status == 0
    laser = read_image("laser.png")
    assert laser[0, 0].argmax() == 2 or laser[0, 0, 2] == 1
    assert laser[0, 3, :3].max() < 0.25  # the layer is dark in blue light


def test_floating_point_files_are_linear(cli: Callable[..., Any], picture: Path) -> None:
    outcome = cli("illuminate", "a.spectral.npz", "--background", "#808080", "-o", "a.exr")
    assert outcome.status == 0
    assert "3 wavelengths from 450 to 650 nm by D65" in outcome.out
    np.testing.assert_allclose(read_image("a.exr")[0, 0], [*[decoded(np.float64(128 / 255))] * 3, 1], rtol=1e-4)
    assert cli("illuminate", "a.spectral.npz", "--background", "#808080", "-o", "a.png").status == 0
    np.testing.assert_allclose(read_image("a.png")[0, 0, :3], 128 / 255)


def test_render_writes_fluxes_or_their_light(
    cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = "volumes: [{path: 'field:gaussian:16', optics: {wavelengths: rgb, materials: [[0.1, air], [1, blood]]}}]\n"
    Path("scene.yaml").write_text(text)
    for name in ("a.npz", "a.png", "a.exr"):
        assert cli("render", "scene.yaml", "--size", "16x12", "-o", name).status == 0
    assert read_spectral("a.npz").fluxes.front.shape == (12, 16, 3)
    for name in ("b.png", "b.exr"):
        assert cli("illuminate", "a.npz", "-o", name).status == 0
    np.testing.assert_array_equal(read_image("a.png"), read_image("b.png"))
    np.testing.assert_allclose(read_image("a.exr"), read_image("b.exr"), atol=2e-6)
    red, green, blue, alpha = read_image("a.png")[6, 8]
    assert red > max(green, blue)
    assert alpha == 1
    np.testing.assert_array_equal(read_image("a.png")[0, 0], 1)  # the background
    assert "rendered again" not in cli("replay", "a.png", "-o", "c.png").err
    np.testing.assert_array_equal(read_image("a.png"), read_image("c.png"))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("none.npz -o a.png", "none.npz: cannot be read as a spectral picture; found No such file"),
        ("a.spectral.npz -o a.xyz", "a.xyz: unknown extension"),
        ("a.spectral.npz -o none/a.png", "none is missing"),
        ("a.spectral.npz -o a.png --light sun", "light: unknown light; found sun; allowed D65, A, F11, E, laser:NM"),
        ("a.spectral.npz -o a.png --light laser:650 --adapt", "laser 650 nm: has no white to adapt to"),
        ("a.spectral.npz -o a.png --background transparent", "--background: not an opaque colour; found transparent"),
        ("a.spectral.npz -o a.png --background whit", "--background: not an opaque colour; found whit; allowed a CSS"),
    ],
)
def test_bad_input_leaves_no_file(cli: Callable[..., Any], picture: Path, arguments: str, said: str) -> None:
    outcome = cli("illuminate", *arguments.split())
    assert outcome.status == 2
    assert said in outcome.err
    assert sorted(path.name for path in picture.iterdir()) == ["a.spectral.npz"]
