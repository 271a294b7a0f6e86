"""Completion of a scene, the plan of its frame, and the assignment of pieces to ranks."""

from __future__ import annotations

from dataclasses import replace

from clusterviz.distribution.contract import Distribution
from clusterviz.frame.opening import Opened
from clusterviz.frame.run import Run
from clusterviz.frame.work import RankWork
from clusterviz.plan.plan import Plan
from clusterviz.plan.view import make_view
from clusterviz.scene.complete import complete_scene
from clusterviz.scene.diff import check_same_volume
from clusterviz.scene.values import Scene


def assign_work(
    run: Run, opened: Opened | None, scene: Scene, distribution: Distribution, last: RankWork | None = None
) -> RankWork:
    """Complete the scene, plan the frame and assign its pieces; collective.

    Parameters
    ----------
    last : work of the last frame, whose scene may differ in camera and transfer function only
    """
    with run.local("plan", "plan"):
        completed = complete_scene(scene, opened.infos if opened else ())
        if last:
            check_same_volume(last.scene, completed)
        if opened is None:
            return RankWork(completed, None, (), frozenset())
        plan = plan_frame(opened, completed, last)
        pieces = distribution.assign(plan)
        return RankWork(completed, plan, pieces, distribution.holds(run.channel.rank), distribution.mode)


def plan_frame(opened: Opened, scene: Scene, last: RankWork | None) -> Plan:
    """Plan a completed scene; where only the camera moved, reuse all but the view of the last plan."""
    if last and last.plan and scene == last.scene.model_copy(update={"camera": scene.camera}):
        return replace(last.plan, view=make_view(scene.camera, scene.image.size, opened.grid))
    return opened.plan(scene)
