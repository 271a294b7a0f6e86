"""From a scene to what each rank has to draw: the scene completed, the frame planned, its pieces dealt."""

from __future__ import annotations

from dataclasses import replace

from clusterviz.frame.distribution import Distribution
from clusterviz.frame.run import Run
from clusterviz.frame.several import Opened
from clusterviz.frame.share import Share
from clusterviz.frame.shared_screen import SharedScreen
from clusterviz.plan.plan import Plan
from clusterviz.plan.view import make_view
from clusterviz.scene.complete import complete_scene
from clusterviz.scene.diff import check_same_volume
from clusterviz.scene.values import Scene


def deal(run: Run, opened: Opened | None, scene: Scene, distribution: Distribution, last: Share | None = None) -> Share:
    """Complete the scene, plan the frame, and have it dealt out; collective.

    Parameters
    ----------
    last : of the frame before, from which the scene may differ in camera and transfer function only
    """
    with run.alone("plan", "plan"):
        completed = complete_scene(scene, opened.facts if opened else ())
        if last:
            check_same_volume(last.scene, completed)
        if opened is None:
            return Share(completed, None, (), frozenset())
        plan = plan_frame(opened, completed, last)
        pieces = distribution.deal(plan)
        mode = distribution.mode if isinstance(distribution, SharedScreen) else "sort-last"
        return Share(completed, plan, pieces, distribution.holds(run.channel.rank), mode)


def plan_frame(opened: Opened, scene: Scene, last: Share | None) -> Plan:
    """The decisions for a completed scene; of the last frame only the view is made anew where only the camera moved."""
    if last and last.plan and scene == last.scene.model_copy(update={"camera": scene.camera}):
        return replace(last.plan, view=make_view(scene.camera, scene.image.size, opened.grid))
    return opened.plan(scene)
