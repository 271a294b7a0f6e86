"""Checks of scene keys that exclude or require each other.

Each check raises an `InvalidValueError` that names the key, the value found and the values allowed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import compress
from typing import Any

from clusterviz.scene.background import background_rgb
from clusterviz.scene.blend_modes import BLEND_MODES, Blending
from clusterviz.scene.checks import InvalidValueError

NO_COMMON_SCALE = "their values have no scale in common, of which a ray could show one"
ONE_SPECTRUM = "light is scattered back and forth in one volume only"
SINGLE_VOLUME_QUALITY = {
    "borders": "what each brick needs of a volume is cut out of it already",
    "filter": "the texture unit samples one volume a brick",
    "adaptive": "there is no bound on the error of mixtures",
}
"""Keys of `quality` that must keep their default with several volumes, and the reason."""
ALLOWED_WITH_SEVERAL = ("overlap", "exact")
MAX_SURFACES = 32
"""Isosurfaces in all volumes of a scene; the surfaces of one slab are sorted in a list of this length."""


def check_surfaces(blending: Blending, isosurfaces: tuple[object, ...]) -> None:
    """Require isosurfaces for a mode that shows nothing else, and refuse them with projections."""
    surfaces = BLEND_MODES[blending].surfaces
    if surfaces == "required" and not isosurfaces:
        raise InvalidValueError("missing", f"one data value or more, for blending: {blending}", key="isosurfaces")
    if isosurfaces and surfaces == "refused":
        allowed = f"this key with blending: {_names(mode.surfaces != 'refused' for mode in BLEND_MODES.values())}"
        raise InvalidValueError(f"not for blending: {blending}", allowed, key="isosurfaces")


NOT_WITH_OPTICS = ("preset", "cmap", "clim", "opacity", "opacity_unit_distance")


def check_optics(volume: Any, blending: Blending) -> None:
    """Require optics for spectral modes only, and refuse a transfer function beside them."""
    spectral = BLEND_MODES[blending].spectral
    if spectral and volume.optics is None:
        raise InvalidValueError("missing", f"materials or coefficients, for blending: {blending}", key="optics")
    if volume.optics is not None and not spectral:
        allowed = _names(mode.spectral for mode in BLEND_MODES.values())
        raise InvalidValueError("not with optics", allowed, key="blending", found=blending)
    for key in NOT_WITH_OPTICS if spectral else ():
        if (found := getattr(volume, key)) is not None:
            raise InvalidValueError("not with optics", "null, or no optics", key=key, found=found)


def _check_spectral(scene: Any) -> None:
    """Refuse a transparent background of spectral volumes, which light passes back and forth, and an error bound."""
    quality, background = scene.quality, scene.image.background
    if any(BLEND_MODES[volume.blending].spectral for volume in scene.volumes):
        if background_rgb(background) is None:
            text, allowed = "not with optics, which let through and reflect the background's light", "an opaque colour"
            raise InvalidValueError(text, allowed, key="image.background", found=background)
        if quality.max_error is not None:
            text = "not with optics: there is no bound on their error"
            raise InvalidValueError(text, "null", key="quality.max_error", found=quality.max_error)


def _check_refraction(scene: Any) -> None:
    """Refuse with refraction what supposes straight rays, fields without a gradient, and data divided among ranks."""
    if not scene.refracts:
        return
    volumes, clip, quality, cluster = scene.volumes, scene.clip, scene.quality, scene.cluster
    clipping = "planes or a box" if clip.planes or clip.box is not None else None
    whole, tiles = "rays bend, so that any rank may need any brick", "each rank draws its own part of the picture"
    rules: tuple[tuple[str, object, tuple[object, ...], str], ...] = (
        ("volumes[0].interpolation", volumes[0].interpolation, ("linear", "cubic"), "nearest voxels have no gradient"),
        ("quality.filter", quality.filter, ("exact",), "a texture unit's gradients are too coarse"),
        ("clip", clipping, (None,), "straight rays are clipped"),
        ("quality.jitter", quality.jitter, (False,), "rays bend by equal steps"),
        ("quality.renderer", quality.renderer, ("raycast",), "slices are met by straight rays"),
        ("cluster.mode", cluster.mode, ("auto", "sort-first"), whole),
        ("cluster.groups", cluster.groups, (None,), whole),
        ("cluster.distribution", cluster.distribution, ("auto",), whole),
        ("cluster.compositing", cluster.compositing, ("auto",), tiles),
        ("cluster.transport", cluster.transport, ("auto", "messages"), tiles),
    )
    for key, found, possible, why in rules:
        if found not in possible:
            allowed = " or ".join("null" if one is None else str(one).lower() for one in possible)
            raise InvalidValueError(f"not with refraction: {why}", allowed, key=key, found=found)


def check_gradient(kernel: str, interpolation: str) -> None:
    """Refuse spline gradients with nearest-neighbour interpolation."""
    if kernel == "smooth" and interpolation == "nearest":
        raise InvalidValueError("not for interpolation: nearest", "central", key="gradient", found=kernel)


def check_gradient_opacity(
    blending: Blending, has_gradient_opacity: bool, has_table: bool, has_opacity: bool, has_shader: bool
) -> None:
    """Allow gradient-dependent opacity and looks for composited volumes only, and opacity in one key only."""
    keys = ("gradient_opacity", has_gradient_opacity), ("transfer_2d", has_table), ("shader", has_shader)
    for key, found in keys:
        if found and not BLEND_MODES[blending].absorbs:
            allowed = f"this key with blending: {_names(mode.absorbs for mode in BLEND_MODES.values())}"
            raise InvalidValueError(f"not for blending: {blending}", allowed, key=key)
    if has_table and has_shader:
        raise InvalidValueError("colour and opacity are in transfer_2d already", "one of the two keys", key="shader")
    if has_table and (has_opacity or has_gradient_opacity):
        other = "opacity" if has_opacity else "gradient_opacity"
        raise InvalidValueError("opacity is in transfer_2d already", "one of the two keys", key=other)


def check_ambient_occlusion(blending: Blending, shade: bool, has_own_opacity: bool) -> None:
    """Refuse ambient occlusion without light, and where opacity depends on more than the scalar."""
    problem = "" if shade else "shade: false"
    problem = problem if BLEND_MODES[blending].lit else f"blending: {blending}"
    problem = "gradient_opacity, transfer_2d or shader" if has_own_opacity else problem
    if problem:
        lit = _names(mode.lit for mode in BLEND_MODES.values())
        allowed = f"null, or shade: true and blending: {lit}, with opacity alone"
        raise InvalidValueError(f"not with {problem}", allowed, key="ambient_occlusion")


def _check_several_volumes(scene: Any) -> None:
    """Refuse projections and settings that support a single volume only, and nothing else."""
    volumes, geometry, grids, flows = scene.volumes, scene.geometry, scene.grids, scene.flows
    quality, cluster = scene.quality, scene.cluster
    has_levels = any(volume.detail != "full" for volume in volumes)
    if len(volumes) < 2 and not geometry and not grids and not flows and not has_levels:
        return
    with_what, allowed = "for several volumes", "one volume with it"
    if has_levels:
        with_what, allowed = "with volumes[].detail", "detail: full with it"
    if geometry:
        with_what, allowed = "with meshes, lines or points", "one volume alone with it"
    elif grids:
        with_what, allowed = "with unstructured grids", "one volume alone with it"
    elif flows:
        with_what, allowed = "with flows", "one volume alone with it"
    projections = [(n, volume.blending) for n, volume in enumerate(volumes) if not BLEND_MODES[volume.blending].mixed]
    reasons = [ONE_SPECTRUM if BLEND_MODES[blending].spectral else NO_COMMON_SCALE for _, blending in projections]
    keys = [(f"volumes[{n}].blending", mode, why) for (n, mode), why in zip(projections, reasons, strict=True)]
    keys += [(f"quality.{name}", getattr(quality, name), why) for name, why in SINGLE_VOLUME_QUALITY.items()]
    keys.append(("cluster.largest_brick", cluster.largest_brick, "bricks of their domain are of one size"))
    for key, found, why in keys:
        if found and found not in ALLOWED_WITH_SEVERAL:
            raise InvalidValueError(f"not {with_what}: {why}", allowed, key=key, found=found)
    count = sum(len(volume.isosurfaces) for volume in volumes)
    if count > MAX_SURFACES:
        allowed = f"{MAX_SURFACES} isosurfaces in all volumes"
        raise InvalidValueError("too many", allowed, key="volumes: isosurfaces", found=count)


MOST_VOLUMES = 8
"""Volumes of a scene, with those that flows become."""
VOLUMES_OF_LIC = 4
"""Volumes that line integral convolution becomes: its values, and the three components of the vectors."""


def _check_flows(scene: Any) -> None:
    """Refuse more volumes, with those of flows, than a slab may be in."""
    volumes, found = scene.volumes, sum(flow.show == "lic" for flow in scene.flows)
    most = (MOST_VOLUMES - len(volumes)) // VOLUMES_OF_LIC
    if found > most:
        beside = f" beside {len(volumes)} volumes" * bool(volumes)
        raise InvalidValueError("too many with show: lic", f"at most {most}{beside}", key="flows", found=found)


def _check_renderer(scene: Any) -> None:
    """Refuse jitter of slices, whose planes are those of all pixels."""
    if scene.quality.renderer == "slices" and scene.quality.jitter:
        allowed = "raycast, or jitter: false"
        raise InvalidValueError("not with quality.jitter", allowed, key="quality.renderer", found="slices")


def _check_frame_coherence(scene: Any) -> None:
    """Refuse frame coherence with projections, which have no first hit, and where bricks are not drawn whole."""
    volumes, quality, cluster = scene.volumes, scene.quality, scene.cluster
    if not quality.frame_coherence:
        return
    groups = cluster.groups is not None and cluster.groups > 1
    problems = {
        "settings chosen for quality.max_error": quality.max_error is not None,
        "quality.adaptive": bool(quality.adaptive),
        f"cluster.mode: {cluster.mode}": cluster.mode in ("sort-first", "hybrid"),
        "cluster.groups: ranks do not know what other tiles hit": groups,
        **{f"blending: {volume.blending}": not BLEND_MODES[volume.blending].composited for volume in volumes},
    }
    for name, is_one in problems.items():
        if is_one:
            raise InvalidValueError(f"not with {name}", "false", key="quality.frame_coherence", found=True)


def _check_pixel_format(scene: Any) -> None:
    """Refuse rounded pixels with projections, whose partial images hold scalars and sums instead of colours."""
    pixel = scene.quality.pixel
    for number, volume in enumerate(scene.volumes):
        if pixel != "float32" and not BLEND_MODES[volume.blending].composited:
            found = f"blending: {volume.blending} in volumes[{number}]"
            raise InvalidValueError(f"{pixel} holds colours only", "float32 with it", key="quality.pixel", found=found)


def _wanted_layers(scene: Any) -> dict[str, Any]:
    found = {"image.layers": list(scene.image.layers)} if scene.image.layers else {}
    return found | {f"flows[{n}].show": flow.show for n, flow in enumerate(scene.flows) if flow.show == "surface-lic"}


def _check_layers(scene: Any) -> None:
    """Refuse layers with projections, which have no depth, with unstructured grids, and with slabs cut at bricks."""
    problems = {"unstructured grids": "no grids"} if scene.grids else {}
    for one in scene.volumes:
        if BLEND_MODES[one.blending].surfaces == "refused":
            names = _names(mode.surfaces != "refused" for mode in BLEND_MODES.values())
            problems[f"blending: {one.blending}"] = f"blending: {names}"
    problems |= {"borders: split": "borders: overlap"} if scene.quality.borders == "split" else {}
    for key, found in _wanted_layers(scene).items():
        for name, remedy in problems.items():
            without = "[]" if key == "image.layers" else "another one"
            raise InvalidValueError(f"not with {name}", f"{without}, or {remedy}", key=key, found=found)


def _check_lens(scene: Any) -> None:
    """Refuse a lens where a pixel shows one depth, and where sub-images would not have an order or an opacity."""
    if not scene.camera.aperture:
        return
    volumes, grids, quality = scene.volumes, scene.grids, scene.quality
    allowed = "those of a pinhole, with aperture: 0"
    problems = {key: (found, allowed) for key, found in _wanted_layers(scene).items()}
    for key in ("frame_coherence", "early_discarding", "max_error"):
        found = getattr(quality, key)
        if found is not None and found is not False:
            problems[f"quality.{key}"] = found, "its default with a lens"
    if quality.lens.sub_images is not None:
        allowed = "quality.lens: {eye_points: 64} with it"
        for number, volume in enumerate(volumes):
            if not BLEND_MODES[volume.blending].composited:
                problems[f"volumes[{number}].blending"] = volume.blending, f"a composited mode, or {allowed}"
        for number, grid in enumerate(grids):
            if grid.visibility != "exact":
                problems[f"grids[{number}].visibility"] = "a k-buffer", f"exact, or {allowed}"
    for number, volume in enumerate(volumes):
        if volume.optics is not None:
            problems[f"volumes[{number}].optics"] = "optics", "no optics with a lens"
    for key, (found, allowed) in problems.items():
        raise InvalidValueError("not with camera.aperture", allowed, key=key, found=found)


def _check_surface_lic(scene: Any) -> None:
    """Refuse surface LIC on what has no surface, and two on one surface."""
    taken, surfaces = dict[str, int](), scene.surface_keys
    allowed = ", ".join(surfaces) or "a scene with meshes, or with volumes that have isosurfaces"
    for number, flow in enumerate(scene.flows):
        if flow.show != "surface-lic":
            continue
        key = f"flows[{number}].surfaces"
        if not surfaces:
            raise InvalidValueError("there is no surface", allowed, key=key)
        for name in flow.surfaces if flow.surfaces is not None else surfaces:
            if name not in surfaces:
                raise InvalidValueError("not a surface", allowed, key=key, found=name)
            if name in taken:
                raise InvalidValueError(f"has a pattern by flows[{taken[name]}]", "another one", key=key, found=name)
            taken[name] = number


def check_brick_sizes(brick: int, largest: int | None) -> None:
    """Require that larger bricks consist of whole smallest ones, and these of whole groups of cells."""
    if largest is None:
        return
    if brick % 8:
        allowed = "a multiple of 8, or largest_brick: null"
        raise InvalidValueError("bricks of several sizes are made of groups of 8", allowed, key="brick", found=brick)
    if largest % brick:
        raise InvalidValueError(
            "not made of whole bricks", f"a multiple of {brick}", key="largest_brick", found=largest
        )


def check_groups(mode: str, groups: int | None) -> None:
    """Refuse a number of groups where the mode fixes it: one for sort-last, one a rank for sort-first."""
    if mode == "sort-last" and groups not in (None, 1):
        raise InvalidValueError("sort-last has one group", "1, or mode: hybrid", key="groups", found=groups)
    if mode == "sort-first" and groups is not None:
        raise InvalidValueError("sort-first has a group a rank", "null, or mode: hybrid", key="groups", found=groups)


def check_mode(mode: str, tiling: str, distribution: str, compositing: str, transport: str) -> None:
    """Refuse tilings without a shared screen, and distributions, compositing and transports without shared data."""
    if mode == "sort-last" and tiling != "auto":
        allowed = "auto, or mode: sort-first or hybrid"
        raise InvalidValueError("sort-last does not share the screen", allowed, key="tiling", found=tiling)
    if mode in ("sort-first", "hybrid") and distribution != "auto":
        allowed = "auto, or mode: sort-last"
        text = "where the screen is shared, bricks are assigned by trees"
        raise InvalidValueError(text, allowed, key="distribution", found=distribution)
    if mode == "sort-first" and compositing != "auto":
        allowed = "auto, or mode: sort-last or hybrid"
        raise InvalidValueError("sort-first blends nothing", allowed, key="compositing", found=compositing)
    if mode == "sort-first" and transport not in ("auto", "messages"):
        allowed = "messages, auto, or mode: sort-last or hybrid"
        raise InvalidValueError("sort-first sends tiles straight to rank 0", allowed, key="transport", found=transport)


def check_together(scene: Any) -> None:
    """Check the keys of a scene whose sections are valid."""
    for check in CHECKS:
        check(scene)


CHECKS: tuple[Callable[[Any], None], ...] = (
    _check_several_volumes,
    _check_flows,
    _check_renderer,
    _check_frame_coherence,
    _check_pixel_format,
    _check_layers,
    _check_surface_lic,
    _check_spectral,
    _check_lens,
    _check_refraction,
)


def _names(chosen: Iterable[bool]) -> str:
    return " or ".join(compress(BLEND_MODES, chosen))
