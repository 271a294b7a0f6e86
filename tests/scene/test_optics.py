"""Optics of spectral volumes, and materials."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from plan.slabs import slab

from clusterviz.content.volume.optics import WAVELENGTH_SETS, Optics, optical_function
from clusterviz.errors import SceneError
from clusterviz.image.spectral import Fluxes, SpectralPicture, illuminant, illuminate
from clusterviz.scene.materials import MATERIALS, material, material_of_colour

AT = np.array(WAVELENGTH_SETS["visible-31"])
DIRECT: dict[str, Any] = {
    "wavelengths": [450, 550, 650],
    "absorption": [[40, 0.1, 0.1, 0.02], [220, 0.4, 0.2, 0.1]],
    "scattering": [[40, 0.0, 0.0, 0.0], [220, 0.6, 0.6, 0.6]],
}


def test_coefficients_are_linear_between_scalars() -> None:
    found = optical_function(Optics(**DIRECT))
    k, s = found.coefficients([-1e9, 40, 130, 220, 1e9, np.nan])
    np.testing.assert_allclose(k[2], [0.25, 0.15, 0.06])
    np.testing.assert_allclose(s[2], 0.3)
    np.testing.assert_allclose(k[[0, 1]], [[0.1, 0.1, 0.02]] * 2)
    np.testing.assert_allclose(k[[3, 4]], [[0.4, 0.2, 0.1]] * 2)
    assert not k[5].any()
    assert not s[5].any()
    alone = optical_function(Optics(wavelengths=[550], absorption=[[0, 1], [0, 2]]))  # type: ignore[arg-type]
    assert alone.coefficients([-1, 0])[0].tolist() == [[1], [2]]
    assert not alone.coefficients(3)[1].any()


def test_indices_are_those_given_or_of_materials() -> None:
    rows = [[0, 1.0], [10, 1.5, 1.4, 1.3], [10, 2.0]]
    index = optical_function(Optics(**DIRECT, refraction=True, refractive_index=rows, outside_index=1.1)).index
    assert index
    assert index.outside == 1.1
    np.testing.assert_allclose(index.at([-1, 5, 10]), [[1, 1, 1], [1.25, 1.2, 1.15], [2, 2, 2]])
    assert optical_function(Optics(**DIRECT)).index is None
    mixed = Optics(wavelengths=[589], materials=[[0, "air"], [1, "water", 0.5]], refraction=True)  # type: ignore[arg-type]
    water = optical_function(mixed).index
    assert water
    assert water.at(0.5)[0] == pytest.approx(1.1665, abs=1e-3)


def test_materials_are_mixed_between_scalars_and_scaled() -> None:
    given = Optics(wavelengths="visible-31", materials=[[0, "air"], [100, "blood", 0.5], [200, "#c08040"]])  # type: ignore[arg-type]
    k, s = optical_function(given).coefficients([0, 50, 100, 200])
    blood = material("blood").at(AT)
    assert not k[0].any()
    np.testing.assert_allclose(k[1], blood.absorption / 4)
    np.testing.assert_allclose(s[2], blood.scattering / 2)
    np.testing.assert_allclose(s[3], 1)
    inches = optical_function(given.model_copy(update={"millimetres": 25.4}))
    np.testing.assert_allclose(inches.coefficients(100)[0], 25.4 * k[2])
    assert Optics.model_validate(given.model_dump()) == given


@pytest.mark.parametrize("name", MATERIALS)
def test_every_material_is_known_over_the_visible_range(name: str) -> None:
    found = material(name)
    assert found.wavelengths[0] <= 380
    assert found.wavelengths[-1] >= 780
    assert (np.diff(found.wavelengths) > 0).all()
    for each in (found.absorption, found.scattering):
        assert np.isfinite(each).all()
        assert (each >= 0).all()
    assert ((found.refractive_index >= 1) & (found.refractive_index < 1.9)).all()


def test_materials_have_the_numbers_of_their_sources() -> None:
    water = material("water").at([700.0])
    assert water.absorption[0] == pytest.approx(2 * 4 * np.pi * 3.35e-8 / 700e-6, rel=1e-4)
    oxygenated, deoxygenated = (material(name).at([577, 660]) for name in ("blood", "blood-deoxygenated"))
    assert oxygenated.absorption[0] == pytest.approx(2 * 27, rel=0.1)
    assert deoxygenated.absorption[1] > 5 * oxygenated.absorption[1]  # venous blood is dark in red light
    # The catalogue's n_F, n_d and n_C.
    glass, flint = (material(name).at([486.1, 587.6, 656.3]).refractive_index for name in ("glass", "flint-glass"))
    np.testing.assert_allclose(glass, [1.52238, 1.51680, 1.51432], atol=2e-4)
    np.testing.assert_allclose(flint, [1.80651, 1.78472, 1.77596], atol=5e-4)
    assert material("intralipid").at([633.0]).scattering[0] == pytest.approx(0.75 * 24, rel=0.1)


def thick(name_or_rgb: Any) -> np.ndarray:
    """The sRGB colour of 50 mm of a material before black."""
    found = material(name_or_rgb).at(AT) if isinstance(name_or_rgb, str) else material_of_colour(name_or_rgb, AT)
    layer = slab(50 * found.absorption, 50 * found.scattering)
    shaped = [each.reshape(1, 1, -1) for each in (layer.reflected, layer.reflected, layer.transmitted)]
    return illuminate(SpectralPicture(Fluxes(*shaped), AT), illuminant("D65"), 0.0)[0, 0, :3]


def test_thick_layers_have_the_colours_of_their_materials() -> None:
    red, green, blue = thick("blood")
    assert red > 2 * green
    assert red > 2 * blue
    assert thick("blood-deoxygenated")[0] < red
    assert thick("intralipid").min() > 0.9
    skin = thick("dermis")
    assert skin[0] > skin[1] > skin[2] > 0.3
    np.testing.assert_allclose(thick((0.75, 0.5, 0.25)), (0.75, 0.5, 0.25), atol=2e-3)


BENT = {"refraction": True}
BAD = [
    ({"wavelengths": [550, 450, 650]}, "wavelengths: wavelengths out of order: 450 after 550", "ascending numbers"),
    ({"wavelengths": [450, 450, 650]}, "wavelengths: wavelengths out of order: 450 after 450", "ascending"),
    ({"wavelengths": [300, 450, 650]}, "wavelengths[0]: too small; found 300", "at least 380"),
    ({"wavelengths": [450, 550, 1064]}, "wavelengths[2]: too large; found 1064", "at most 780"),
    ({"wavelengths": []}, "wavelengths: too few values", "a list, such as [450, 550, 650]"),
    ({"wavelengths": [float("nan")]}, "wavelengths[0]: not finite", "a finite number"),
    ({"wavelengths": "visible"}, 'wavelengths: unknown wavelengths; found "visible"', "visible-16"),
    ({"wavelengths": [400 + n for n in range(65)]}, "wavelengths: too many values", "at most 64"),
    ({"wavelengths": [450, 550]}, "absorption: as many coefficients as wavelengths", "a scalar and 2"),
    ({"absorption": [[40, 0.1, 0.1]]}, "absorption: as many coefficients as wavelengths; found [40.0", "and 3"),
    ({"absorption": [[40, 0.1, -0.1, 0]]}, "absorption: a negative coefficient, -0.1", "at least 0"),
    ({"absorption": [[40, 0.1, float("nan"), 0]]}, "absorption[0][2]: not finite", "a finite number"),
    ({"scattering": [[40, 0, 0, 0], [20, 0, 0, 0]]}, "scattering: control points out of order", "sorted by value"),
    ({"scattering": []}, "scattering: no control points", "at least one"),
    ({"absorption": None, "scattering": None}, "materials: missing", "[[scalar, material], …], or absorption"),
    ({"materials": [[40, "fat"]]}, "absorption: not with materials", "null, or no materials"),
    ({"millimetres": 2}, "millimetres: not without materials", "null"),
    ({"refractive_index": [[0, 1.3]]}, "refractive_index: not without refraction", "null, or refraction: true"),
    ({"outside_index": 1.3}, "outside_index: not without refraction; found 1.3", "null, or refraction: true"),
    (BENT | {"refractive_index": [[0, 0]]}, "refractive_index: a refractive index of 0", "refractive indices above 0"),
    (BENT | {"refractive_index": [[0, -1.5]]}, "refractive_index: a refractive index of -1.5", "above 0"),
    (BENT | {"refractive_index": [[0, float("nan")]]}, "refractive_index[0][1]: not finite", "a finite number"),
    (
        BENT | {"refractive_index": [[0, 1, 1]]},
        "refractive_index: as many indices as wavelengths",
        "and 3, one for each",
    ),
    (BENT | {"refractive_index": [[1, 1], [0, 1]]}, "refractive_index: control points out of order", "sorted by value"),
    (BENT | {"outside_index": 0}, "outside_index: too small; found 0", "more than 0"),
    ({"model": "phong"}, 'model: not one of the choices; found "phong"', "kubelka-munk"),
    ({"lights": 3}, "lights: unknown key", "model, wavelengths, materials"),
]
BAD_MATERIALS = [
    ([[40, "bloood"]], "materials[0][1]: unknown material, did you mean blood?", "air, water, blood"),
    ([[40, "transparent"]], "materials[0][1]: unknown material", "a CSS colour name or #rrggbb"),
    ([[40, "fat", -1]], "materials[0][2]: too small; found -1", "at least 0"),
    ([[40]], "materials[0]: too few values", "a list"),
    ([["fat", 40]], "materials[0][0]: not a number", "a number"),
    ([[40, "fat"], [20, "bone"]], "materials: control points out of order", "sorted by value"),
    ("fat", "materials: not a list of materials", "[[scalar, material], …]"),
    ([], "materials: no control points", "at least one"),
]


@pytest.mark.parametrize(
    ("keys", "said", "allowed"),
    [
        *((DIRECT | keys, *rest) for keys, *rest in BAD),
        *(({"materials": rows}, *rest) for rows, *rest in BAD_MATERIALS),
    ],
)
def test_invalid_optics_are_one_clear_error(keys: dict[str, Any], said: str, allowed: str) -> None:
    with pytest.raises(SceneError) as caught:
        Optics(**keys)
    first = str(caught.value).splitlines()[0]  # a line for each key that is wrong
    assert f"Optics: {said}" in first
    assert allowed in first.partition("allowed")[2]
