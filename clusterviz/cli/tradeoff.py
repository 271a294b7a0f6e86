"""`clusterviz tradeoff`: measure cost and error of each quality setting of a scene, and write a page.

Each setting is a separate job of this command with `--measure`, so that a failure does not affect the others, and the
memory is that of one setting. The job writes a picture and its cost to a folder.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from clusterviz.cli.arguments import Define, Frames, SceneArgument, Size, overrides_of
from clusterviz.cli.console import show_progress
from clusterviz.cli.jobs import refuse_launcher
from clusterviz.cli.reporting import OneJob, Output, check_report, do_order, print_report, run_measuring, write_report
from clusterviz.comm import Channel
from clusterviz.data import open_scene
from clusterviz.errors import SceneError, public_address
from clusterviz.pages.tradeoff.knobs import parse_knobs, settings_of
from clusterviz.pages.tradeoff.measure import Image, Measured, cost_from_json, measure
from clusterviz.pages.tradeoff.page import KIND, write_files
from clusterviz.pages.tradeoff.survey import Survey
from clusterviz.scene import Scene


def command(
    scene: SceneArgument,
    output: Output,
    ranks: Annotated[int, typer.Option(min=1, help="Number of ranks.")] = 1,
    define: Define = None,
    size: Size = None,
    knobs: Annotated[str | None, typer.Option(metavar="K,K,…", help="Settings to vary; default: all.")] = None,
    frames: Frames = 5,
    rounds: Annotated[
        int, typer.Option(min=1, help="Number of measurements of each setting, of which the best counts.")
    ] = 1,
    budget: Annotated[float, typer.Option(min=0, help="Time limit of the reference picture, seconds.")] = 60.0,
    most: Annotated[
        int, typer.Option(min=1, help="Largest number of settings; combinations beyond it are left out.")
    ] = 40,
    one_job: OneJob = False,
) -> None:
    """Measure what each quality setting of a scene costs and buys (starting mpirun by itself)."""
    if one_job:
        do_order(Path(scene), output, _draw)
        return
    refuse_launcher("tradeoff")
    names = parse_knobs(knobs)
    # Automatic settings would change the measured scene.
    opened = open_scene(scene, overrides_of(define, size)).model_copy(update={"automatic": False})
    if not opened.has_content:
        raise SceneError("nothing to trade", where=scene, allowed="a scene with content")
    check_report(output, KIND)
    survey = Survey(*settings_of(opened, ranks, names, most), ranks, frames, rounds, budget)
    with tempfile.TemporaryDirectory(prefix="clusterviz-tradeoff-") as folder, show_progress(survey.steps) as progress:
        report = survey.run(Path(public_address(scene)).name, opened, MpirunJob(ranks, Path(folder)), progress)
    write_report(output, KIND, lambda folder: write_files(folder, report))
    print_report(output, KIND, "\n".join(report.verdict))


@dataclass(frozen=True)
class MpirunJob:
    """Drawing of scenes in MPI jobs; see `survey.Job`."""

    ranks: int
    folder: Path  # folder for files exchanged with the jobs

    def __call__(self, scene: Scene, frames: int, warm_up: int = 1) -> Measured:
        """Draw one scene; errors are those of `run_job`."""
        order = {"scene": scene.model_dump(mode="json"), "frames": frames, "warm_up": warm_up}
        found, image = run_measuring(KIND, self.ranks, order, self.folder)
        drawn = Scene.model_validate(found["scene"])
        return Measured(cost_from_json(found["cost"]), image, drawn, found["renderer"])


def _draw(channel: Channel, order: dict[str, Any]) -> tuple[dict[str, Any], Image | None]:
    measured = measure(Scene.model_validate(order["scene"]), channel, order["frames"], order["warm_up"])
    found = {"cost": measured.cost.as_json(), "scene": measured.scene.model_dump(mode="json")}
    return found | {"renderer": measured.renderer}, measured.image
