"""Spectral pictures: lights, colours and files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clusterviz.errors import InputError
from clusterviz.image.spectral import (
    Fluxes,
    SpectralPicture,
    illuminant,
    illuminate,
    laser,
    light_of,
    read_light,
    read_spectral,
    reflectance_of,
    spectrum,
    write_spectral,
)
from clusterviz.image.spectral.colour import (
    LUMINANCE,
    SRGB_FROM_XYZ,
    decoded,
    encoded,
    into_gamut,
    srgb_weights,
    xyz_weights,
)
from clusterviz.image.spectral.lights import read_table

NAN = float("nan")
FIVE = np.arange(380.0, 781.0, 5.0)
D65 = illuminant("D65")


def picture_of(front: Any, transmitted: Any, wavelengths: Any, back: Any = None) -> SpectralPicture:
    """A picture of one pixel."""
    fluxes = [np.float32(front if each is None else each).reshape(1, 1, -1) for each in (front, back, transmitted)]
    return SpectralPicture(Fluxes(*fluxes), np.asarray(wavelengths, float))


def colour_of(reflectance: Any, wavelengths: Any, light: Any = D65, **options: Any) -> np.ndarray:
    reflectance = np.broadcast_to(reflectance, len(wavelengths))
    return illuminate(picture_of(reflectance, 0 * reflectance, wavelengths), light, 0.0, **options)[0, 0, :3]


@pytest.mark.parametrize(
    ("name", "white"),
    # CIE 15:2004, tables T.3 and T.9 for 10 degrees; F11 by sums at 5 nm, which differ from integrals by 0.05.
    [("D65", (94.81, 100, 107.32)), ("A", (111.14, 100, 35.20)), ("F11", (103.86, 100, 65.61)), ("E", (100, 100, 100))],
)
def test_whites_of_the_illuminants(name: str, white: tuple[float, ...]) -> None:
    found = 100 * xyz_weights(FIVE, light_of(name)).sum(axis=0)
    np.testing.assert_allclose(found, white, atol=0.06)


def test_tables_have_the_standards_numbers() -> None:
    observer = read_table("observer_1964.csv")
    rows = {int(row[0]): row[1:].tolist() for row in observer}
    assert rows[450] == [0.370702, 0.089456, 1.9948]
    assert observer[observer[:, 2].argmax()].tolist()[::2] == [557, 1]
    assert len(observer) == 401
    assert len(read_table("illuminants.csv")) == 81
    np.testing.assert_allclose(np.interp(560, *read_table("illuminants.csv")[:, [0, 2]].T), 100)


def test_the_matrix_is_that_of_the_primaries() -> None:
    xy = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])
    primaries = np.array([[x / y, 1, (1 - x - y) / y] for x, y in xy]).T
    white = np.array([0.3127, 0.3290, 1 - 0.3127 - 0.3290]) / 0.3290
    derived = np.linalg.inv(primaries * np.linalg.solve(primaries, white))
    np.testing.assert_allclose(SRGB_FROM_XYZ, derived, atol=6e-4)  # the standard's come from a white of four digits
    np.testing.assert_allclose(LUMINANCE, [0.2126, 0.7152, 0.0722], atol=5e-5)


def test_the_thesis_matrix_does_not_show_daylight_white() -> None:
    printed = np.array([[1.967, -0.5388, 0.064], [-0.548, 1.938, -0.027], [-0.297, -0.130, 0.982]])
    white = np.array([0.3127, 0.3290, 1 - 0.3127 - 0.3290]) / 0.3290
    np.testing.assert_allclose(white @ printed, [1.00, 1.28, 1.10], atol=0.005)
    ntsc = np.array([[1.967, -0.955, 0.064], [-0.548, 1.938, -0.130], [-0.297, -0.027, 0.982]])
    np.testing.assert_allclose(white @ ntsc, 1, atol=0.003)


@pytest.mark.parametrize("wavelengths", [[550.0], [450.0, 550.0, 650.0], [400, 401, 500, 780], FIVE, [380.0, 780.0]])
def test_white_is_white_and_grey_is_grey_at_any_wavelengths(wavelengths: Any) -> None:
    np.testing.assert_allclose(colour_of(1.0, wavelengths), 1, atol=1e-6)
    np.testing.assert_allclose(colour_of(0.18, wavelengths, linear=True), 0.18, atol=1e-6)
    np.testing.assert_allclose(colour_of(0.18, wavelengths), encoded(np.float64(0.18)), atol=1e-6)
    for name in ("A", "F11"):
        np.testing.assert_allclose(colour_of(1.0, wavelengths, light_of(name), adapt=True), 1, atol=1e-6)


def test_any_quadrature_converges_to_the_integral() -> None:
    def reflectance(at: np.ndarray) -> np.ndarray:
        return 0.5 + 0.4 * np.sin(at / 30)

    exact = reflectance(np.arange(380.0, 781.0)) @ srgb_weights(np.arange(380.0, 781.0), D65)
    errors = []
    for count in (21, 41, 81):
        uneven = 380 + 400 * np.linspace(0, 1, count) ** 1.3
        errors.append(np.abs(reflectance(uneven) @ srgb_weights(uneven, D65) - exact).max())
    assert errors[0] < 0.03
    assert errors[1] < errors[0] / 3
    assert errors[2] < errors[1] / 3


def test_lights_keep_their_colour_unless_adapted() -> None:
    red, green, blue = (colour_of(1.0, FIVE, light_of("A"))[n] for n in range(3))
    assert red == pytest.approx(1)
    assert red > green > blue
    for nm, brightest in ((450, 2), (532, 1), (650, 0)):
        seen = colour_of(1.0, FIVE, laser(nm))
        assert seen.argmax() == brightest
        assert seen.max() == pytest.approx(1)
        assert seen.min() == pytest.approx(0, abs=1e-6)
    with pytest.raises(InputError, match="no white to adapt to"):
        colour_of(1.0, FIVE, laser(650), adapt=True)


def test_a_laser_shows_the_reflectance_at_its_wavelength() -> None:
    at = np.array([450.0, 550.0, 650.0])
    half = colour_of([0.0, 1.0, 0.0], at, laser(500), linear=True) / colour_of(1.0, at, laser(500), linear=True)
    np.testing.assert_allclose(half, 0.5, rtol=1e-5)
    np.testing.assert_allclose(laser(532, 10).powers @ laser(532, 10).wavelengths / laser(532, 10).powers.sum(), 532)
    wide = laser(532, 10)
    above = wide.wavelengths[wide.powers >= 0.5]
    assert np.ptp(above) == pytest.approx(10, abs=0.5)  # nodes are 0.32 nm apart
    assert len(laser(380, 30).wavelengths) < len(wide.wavelengths)  # the rest is not visible


def test_metamers_differ_under_another_light() -> None:
    at = np.linspace(400, 700, 31)
    smooth = reflectance_of((0.6, 0.5, 0.4), at)
    # What is added has no colour under D65.
    weights = srgb_weights(at, D65)
    wave = np.sin(at / 9)
    wave -= weights @ np.linalg.solve(weights.T @ weights, weights.T @ wave)
    other = smooth + 0.1 * wave / np.abs(wave).max()
    np.testing.assert_allclose(colour_of(smooth, at), colour_of(other, at), atol=1e-5)
    assert np.abs(colour_of(smooth, at, light_of("F11")) - colour_of(other, at, light_of("F11"))).max() > 0.01


def test_the_background_is_seen_through_the_layers_from_behind() -> None:
    lit = illuminate(picture_of([0.2], [0.5], [550.0], back=[0.4]), D65, 0.8, linear=True)[0, 0]
    np.testing.assert_allclose(lit, [*[0.2 + 0.5**2 * 0.8 / (1 - 0.4 * 0.8)] * 3, 1], rtol=1e-6)
    clear = illuminate(picture_of([0.0] * 31, [1.0] * 31, np.linspace(400, 700, 31)), D65)
    np.testing.assert_allclose(clear, 1, atol=1e-6)


@pytest.mark.parametrize("rgb", [(0.9, 0.8, 0.6), (0.2, 0.5, 0.3), (0.5, 0.5, 0.5), (1, 1, 1), (0, 0, 0), (1, 0, 0)])
def test_spectra_have_the_colours_they_are_made_of(rgb: tuple[float, ...]) -> None:
    at = np.linspace(400, 700, 31)
    made = reflectance_of(rgb, at)
    assert made.min() >= 0
    assert made.max() <= 1
    np.testing.assert_allclose(made @ srgb_weights(at, D65), decoded(np.array(rgb, float)), atol=3e-3)
    assert np.abs(np.diff(made, 2)).max() < 0.15 or min(rgb) == 0  # smooth
    assert 0 <= reflectance_of(rgb, np.array([550.0]))[0] <= 1


def test_encoding_is_that_of_the_standard_and_its_inverse() -> None:
    values = np.linspace(0, 1, 4097)
    np.testing.assert_allclose(encoded(decoded(values)), values, atol=2e-7)
    assert encoded(np.float64(0.5)) == pytest.approx(0.7353570, abs=1e-6)
    assert encoded(np.float64(0.002)) == pytest.approx(0.02584)


def test_colours_out_of_gamut_keep_their_luminance() -> None:
    given = np.array([[1.2, 0.3, 0.2], [-0.2, 0.6, 0.1], [0.2, 0.4, 0.9], [3.0, 3.0, 3.0], [1.5, -0.2, 0.3]])
    found = into_gamut(given)
    assert found.min() >= 0
    assert found.max() <= 1
    np.testing.assert_allclose(found @ LUMINANCE, np.minimum(given @ LUMINANCE, 1), atol=1e-7)
    np.testing.assert_allclose(found[2], given[2], rtol=1e-15)
    chroma = given - (given @ LUMINANCE)[:, None]
    assert (np.sum(chroma * (found - (found @ LUMINANCE)[:, None]), axis=1) >= -1e-12).all()


def test_files_keep_pictures(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    fluxes = Fluxes(*(rng.uniform(0, 0.5, (3, 5, 4)).astype(np.float32) for _ in range(3)))
    picture = SpectralPicture(fluxes, np.array([450.0, 500.0, 600.0, 650.0]))
    write_spectral(tmp_path / "a.spectral.npz", picture)
    found = read_spectral(tmp_path / "a.spectral.npz")
    for before, after in zip(fluxes, found.fluxes, strict=True):
        np.testing.assert_array_equal(before, after)
        assert after.dtype == np.float32
    np.testing.assert_array_equal(found.wavelengths, picture.wavelengths)
    with np.load(tmp_path / "a.spectral.npz") as file:
        assert sorted(file) == ["R_back", "R_front", "T", "wavelengths"]


def test_tables_of_light_are_read(tmp_path: Path) -> None:
    (tmp_path / "lamp.csv").write_text("# nm, power\n300, 0\n500, 1\n\n600 1\n900, 0\n")
    lamp = light_of(str(tmp_path / "lamp.csv"))
    assert lamp.name == "lamp.csv"
    assert (lamp.wavelengths[0], lamp.wavelengths[-1]) == (380, 780)
    np.testing.assert_allclose(lamp.powers.sum(), 100 + 120 * 0.7 + 180 * 0.7, rtol=1e-6)
    np.testing.assert_allclose(spectrum([532], [4]).wavelengths, [532])


def pixel(**changes: Any) -> Callable[[], SpectralPicture]:
    keys = {"front": [0.1], "transmitted": [0.2], "wavelengths": [550.0]} | changes
    return lambda: picture_of(**keys)


BAD: list[tuple[Callable[[], Any], str]] = [
    (pixel(wavelengths=[]), "not wavelengths; found shape"),
    (pixel(wavelengths=[300.0]), "not a wavelength; found 300 nm; allowed 380 to 780 nm"),
    (pixel(wavelengths=[NAN]), "not a wavelength; found nan nm"),
    (pixel(front=[0, 0], transmitted=[0, 0], wavelengths=[600, 500]), "out of order; found 500 nm after 600 nm"),
    (pixel(front=[0, 0], transmitted=[0, 0], wavelengths=[500, 500]), "out of order; found 500 nm after 500 nm"),
    (pixel(front=[0, 0]), "shapes do not fit"),
    (pixel(front=[0, 0], transmitted=[0, 0]), "shapes do not fit"),
    (pixel(front=[NAN]), "R_front: not shares of light; found nan; allowed 0 to 1"),
    (pixel(transmitted=[1.1]), "T: not shares of light; found 1.1"),
    (pixel(back=[-0.1]), "R_back: not shares of light; found -0.1"),
    (lambda: illuminate(pixel()(), D65, [0.1, 0.2]), "background: shapes do not fit"),
    (lambda: illuminate(pixel()(), D65, NAN), "background: not a reflectance; found nan"),
    (lambda: illuminate(pixel()(), D65, 1.5), "background: not a reflectance; found 1.5"),
    (lambda: spectrum([500, 600], [1, NAN]), "not a power; found nan at 600 nm; allowed finite powers of at least 0"),
    (lambda: spectrum([500, 600], [-1, 1]), "not a power; found -1 at 500 nm"),
    (lambda: spectrum([500, 600], [1, float("inf")]), "not a power; found inf at 600 nm"),
    (lambda: spectrum([500, 600], [0, 0]), "not a visible light; found no power from 380 to 780 nm"),
    (lambda: spectrum([800, 900], [1, 1]), "not a visible light"),
    (lambda: spectrum([600, 500], [1, 1]), "wavelengths out of order"),
    (lambda: spectrum([500, 600], [1]), "wavelengths and powers differ in shape"),
    (lambda: light_of("D66"), "light: unknown light; found D66; allowed D65, A, F11, E, laser:NM"),
    (lambda: light_of("laser:green"), "light: not a laser; found laser:green; allowed laser:NM or laser:NM:WIDTH"),
    (lambda: light_of("laser:nan"), "laser: not visible; found nan nm"),
    (lambda: light_of("laser:1064"), "laser: not visible; found 1064 nm; allowed 380 to 780 nm"),
    (lambda: light_of("laser:532:-1"), "laser: not a width of a line; found -1 nm"),
    (lambda: read_light("none.csv"), "none.csv: cannot be read as a spectrum; found No such file"),
    (lambda: read_spectral("none.npz"), "none.npz: cannot be read as a spectral picture; found No such file"),
]


@pytest.mark.parametrize(("make", "said"), BAD, ids=[said[:40] for _, said in BAD])
def test_bad_input_is_one_clear_error(make: Callable[[], Any], said: str) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.npz", b"PK\3\4 and nothing", "cannot be read as a spectral picture"),
        ("a.npz", b"", "cannot be read as a spectral picture"),
        ("a.csv", b"400 1\n500\n", "cannot be read as a spectrum; found rows of different lengths"),
        ("a.csv", b"400 1 2\n500 1 2\n", "not a spectrum; found shape (2, 3); allowed two columns"),
        ("a.csv", b"\xff\xfe\0", "cannot be read as a spectrum"),
        ("a.csv", b"", "not a spectrum"),
    ],
)
def test_damaged_files(tmp_path: Path, name: str, content: bytes, said: str) -> None:
    (tmp_path / name).write_bytes(content)
    read = read_spectral if name.endswith("npz") else read_light
    with pytest.raises(InputError, match=r"a\.(npz|csv): ") as caught:
        read(tmp_path / name)
    assert said in str(caught.value)


def test_pictures_without_the_arrays_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", rgba=np.zeros((1, 1, 4)))
    with pytest.raises(InputError, match="not a spectral picture; found no R_front"):
        read_spectral(tmp_path / "a.npz")
