"""Settings of a scene that are replaced, with the value used instead and the reason.

Settings that raise an error have no entry, nor those that are chosen automatically (`auto`, `quality.max_error`).
"""

from __future__ import annotations

from collections.abc import Iterator

from clusterviz.plan.blend_mode import LONGEST_SLAB, has_surfaces, is_lit, is_preintegrated, step_of
from clusterviz.report.decisions import Change
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.values import Scene


def changed_settings(scene: Scene, ranks: int, no_cpu: bool = False) -> tuple[Change, ...]:
    """Return all settings of a scene that are not used as given.

    Parameters
    ----------
    scene : completed, all settings chosen
    ranks : that draw
    no_processor : the CPU ray caster was asked for and cannot draw the scene
    """
    found = [*_of_quality(scene), *_of_light(scene), *_of_cluster(scene, ranks)] if scene.volumes else []
    if no_cpu:
        found.append(Change("device", "cpu", "OpenGL", "the CPU ray caster does not draw this scene"))
    return tuple(found)


def _of_quality(scene: Scene) -> Iterator[Change]:
    volumes, quality = scene.volumes, scene.quality
    step = min(step_of(volume, quality.step, quality.classification) for volume in volumes)
    if step < quality.step:
        text = f"slabs with surfaces or with pre-integration are at most {LONGEST_SLAB:g} voxels long"
        yield Change("quality.step", quality.step, step, text)
    ramps = [is_preintegrated(volume, quality.classification) for volume in volumes]
    if quality.classification == "pre-integrated" and not all(ramps):
        text = "not with isosurfaces, transfer_2d, nearest interpolation or a projection"
        which = "" if not any(ramps) else f" in volumes[{ramps.index(False)}]"
        yield Change("quality.classification", "pre-integrated", f"post{which}", text)
    if quality.borders == "split" and not any(ramps):
        yield Change("quality.borders", "split", "overlap", "only pre-integrated slabs are cut")
    if quality.jitter and any(has_surfaces(volume) for volume in volumes):
        yield Change("quality.jitter", True, False, "isosurfaces are found, not sampled")
    if quality.filter == "hardware" and volumes[0].interpolation == "nearest":
        yield Change("quality.filter", "hardware", "exact", "nearest voxels are not weighted")
    if quality.early_termination > 0 and not any(BLEND_MODES[one.blending].composited for one in volumes):
        yield Change("quality.early_termination", quality.early_termination, 0.0, "a projection hides nothing")


def _of_light(scene: Scene) -> Iterator[Change]:
    for number, volume in enumerate(scene.volumes):
        if volume.shade and not is_lit(volume):
            yield Change(f"volumes[{number}].shade", True, False, f"not with blending: {volume.blending}")


def _of_cluster(scene: Scene, ranks: int) -> Iterator[Change]:
    cluster = scene.cluster
    if cluster.distribution == "replicated" and cluster.copies > ranks:
        yield Change("cluster.copies", cluster.copies, ranks, "there are no more ranks")
    if cluster.mode == "hybrid" and cluster.groups is None and ranks < 3:
        yield Change("cluster.mode", "hybrid", "sort-last", "fewer than three ranks make no groups")
