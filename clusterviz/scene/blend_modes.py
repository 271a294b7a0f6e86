"""Blend modes: how the samples along a ray become a pixel. One record each, from which all else follows.

The documentation lists the table; the renderer takes shader, merge operator and resolve step from it;
checks of the scene and empty-space skipping go by its flags. `docs/how-to/add-a-blend-mode.md` adds a record.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from clusterviz.image.merge import Operator

Resolve = Literal["none", "colour", "colour of run", "mean", "integral", "light"]
Skip = Literal["nothing", "transparent", "transparent below", "transparent above", "below threshold", "all"]


@dataclass(frozen=True)
class BlendModeTraits:
    """What is known of a blend mode before any scene."""

    pixel: str  # what a pixel shows, in one line of the documentation
    shader: str | tuple[str, ...]  # file in `shaders/` that blends samples, behind those that it needs
    operator: Operator = "over"  # merge operator of partial images, see `image/merge.py`
    resolve: Resolve = "none"  # how merged pixels become colours, see `render/render_result.py`
    # samples that change no pixel. "transparent": those of opacity 0; "transparent below" and "transparent above":
    # those below, or above, which all opacities are 0; "below threshold": those below the key `threshold`; "all":
    # samples, but not isosurfaces
    skip: Skip = "nothing"
    constants: tuple[str, ...] = ()  # GLSL declarations for the shader
    # isosurfaces are "refused", "allowed" among the samples, or "required"
    surfaces: Literal["refused", "allowed", "required"] = "refused"
    # opacity accumulates with the length of the ray, so it can be pre-integrated, depend on the gradient, and be
    # sampled by an adaptive step
    absorbs: bool = False
    lit: bool = False  # samples and surfaces can be shaded by the gradient
    threshold: bool = False  # the mode uses the key `threshold`
    # the mode uses the key `optics` in place of a transfer function, and is drawn for each wavelength
    spectral: bool = False
    # transparent parts of a volume change the picture, so the automatic camera shows all of it
    shows_transparent: bool = False

    @property
    def only_surfaces(self) -> bool:
        """Whether isosurfaces are all that is shown."""
        return self.surfaces == "required"

    @property
    def mixed(self) -> bool:
        """Whether several volumes can be shown in this mode; their slabs hold absorbing samples and surfaces."""
        return self.surfaces != "refused"

    @property
    def composited(self) -> bool:
        """Whether partial images hold colours and opacities, which hide what lies behind; else it is a projection."""
        return self.resolve == "none"


Blending = Literal[
    "composite", "maximum", "minimum", "average", "additive", "local-maximum", "first-hit", "isosurface", "two-flux"
]
"""Names of the table, for type checkers."""
BLEND_MODES: dict[Blending, BlendModeTraits] = {
    "composite": BlendModeTraits(
        "emission and absorption", "composite.glsl", skip="transparent", surfaces="allowed", absorbs=True, lit=True
    ),
    "maximum": BlendModeTraits(
        "colour and opacity of the largest scalar",
        "extreme.glsl",
        "maximum",
        "colour",
        skip="transparent below",
        constants=("const bool LARGEST = true;",),
    ),
    "minimum": BlendModeTraits(
        "colour and opacity of the smallest scalar",
        "extreme.glsl",
        "minimum",
        "colour",
        skip="transparent above",
        constants=("const bool LARGEST = false;",),
        shows_transparent=True,
    ),
    "average": BlendModeTraits(
        "mean of opacity times scalar, which clim maps to 0 … 1, along the ray; grey and opaque",
        "sum.glsl",
        "sum",
        "mean",
        shows_transparent=True,
    ),
    "additive": BlendModeTraits(
        "integral of opacity times scalar, which clim maps to 0 … 1, over opacity_unit_distance; grey and opaque",
        "sum.glsl",
        "sum",
        "integral",
        shows_transparent=True,
    ),
    "local-maximum": BlendModeTraits(
        "colour and opacity of the largest scalar in the first interval not below threshold, else of the whole ray",
        "local_maximum.glsl",
        "run",
        "colour of run",
        threshold=True,
    ),
    "first-hit": BlendModeTraits(
        "colour and opacity of the first scalar not below threshold, transparent if there is none",
        "first_hit.glsl",
        resolve="colour",
        skip="below threshold",
        threshold=True,
    ),
    "isosurface": BlendModeTraits(
        "the surfaces of isosurfaces", "composite.glsl", skip="all", surfaces="required", lit=True
    ),
    "two-flux": BlendModeTraits(
        "light that optics scatter and absorb, at each wavelength",
        ("kubelka_munk.glsl", "two_flux.glsl"),
        "two-flux",
        "light",
        skip="transparent",
        spectral=True,
    ),
}
DEFAULT_BLENDING: Blending = "composite"
