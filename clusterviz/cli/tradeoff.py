"""`clusterviz tradeoff`: measure cost and error of each quality setting of a scene, and write a page.

Each setting is a separate job of this command with `--measure`, so that a failure does not affect the others, and the
memory is that of one setting. The job writes a picture and its cost to a folder.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from clusterviz.cli.arguments import Define, SceneArgument, Size, overrides_of
from clusterviz.cli.console import print_info, show_progress
from clusterviz.cli.jobs import refuse_launcher, run_job
from clusterviz.comm import agree, limit_threads, open_channel
from clusterviz.data import open_scene
from clusterviz.errors import SceneError, public_address
from clusterviz.report.output import check_folder, replacing_folder
from clusterviz.report.tradeoff.knobs import parse_knobs, settings_of
from clusterviz.report.tradeoff.measure import Measured, cost_from_json, measure
from clusterviz.report.tradeoff.page import NUMBERS, PAGE, check_libraries, write_report
from clusterviz.report.tradeoff.survey import Survey
from clusterviz.scene import Scene

PICTURE, RESULT = "picture.npy", "result.json"


def command(
    scene: SceneArgument,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the page and its numbers.")],
    ranks: Annotated[int, typer.Option(min=1, help="Number of ranks.")] = 1,
    define: Define = None,
    size: Size = None,
    knobs: Annotated[str | None, typer.Option(metavar="K,K,…", help="Settings to vary; default: all.")] = None,
    frames: Annotated[int, typer.Option(min=1, help="Number of timed frames, after one warm-up frame.")] = 5,
    rounds: Annotated[
        int, typer.Option(min=1, help="Number of measurements of each setting, of which the best counts.")
    ] = 1,
    budget: Annotated[float, typer.Option(min=0, help="Time limit of the reference picture, seconds.")] = 60.0,
    most: Annotated[
        int, typer.Option(min=1, help="Largest number of settings; combinations beyond it are left out.")
    ] = 40,
    one_job: Annotated[bool, typer.Option("--measure", hidden=True, help="Do one job of this command.")] = False,
) -> None:
    """Measure what each quality setting of a scene costs and buys (starting mpirun by itself)."""
    if one_job:
        measure_job(Path(scene), output)
        return
    refuse_launcher("tradeoff")
    check_libraries()
    names = parse_knobs(knobs)
    # Automatic settings would change the measured scene.
    opened = open_scene(scene, overrides_of(define, size)).model_copy(update={"automatic": False})
    if not opened.has_content:
        raise SceneError("nothing to trade", where=scene, allowed="a scene with content")
    check_folder(output, NUMBERS)
    survey = Survey(*settings_of(opened, ranks, names, most), ranks, frames, rounds, budget)
    with (
        tempfile.TemporaryDirectory(prefix="clusterviz-tradeoff-") as folder,
        show_progress(survey.steps) as progress,
    ):
        report = survey.run(Path(public_address(scene)).name, opened, MpirunJob(ranks, Path(folder)), progress)
    with replacing_folder(output, NUMBERS) as temporary:
        write_report(temporary, report)
    print_info("\n".join(report.verdict))
    print_info(f"\nthe page is {output / PAGE}, its numbers are in {output / NUMBERS}")


@dataclass(frozen=True)
class MpirunJob:
    """Drawing of scenes in MPI jobs; see `survey.Job`.

    Attributes
    ----------
    folder : folder for files exchanged with the jobs
    """

    ranks: int
    folder: Path

    def __call__(self, scene: Scene, frames: int, warm_up: int = 1) -> Measured:
        """Draw one scene; errors are those of `run_job`."""
        order = {"scene": scene.model_dump(mode="json"), "frames": frames, "warm_up": warm_up}
        task = self.folder / "job.json"
        task.write_text(json.dumps(order))
        run_job(self.ranks, ["tradeoff", str(task), "-o", str(self.folder), "--measure"])
        found = json.loads((self.folder / RESULT).read_text())
        image = np.load(self.folder / PICTURE, allow_pickle=False)
        return Measured(
            cost_from_json(found["cost"]), image, Scene.model_validate(found["scene"]), found["renderer"]
        )  # fmt: skip


def measure_job(task: Path, folder: Path) -> None:
    """Run one job on each rank; rank 0 writes the result."""
    channel = open_channel()
    limit_threads(channel.placement())
    with agree(channel, 0, "job"):
        read: dict[str, Any] = json.loads(task.read_text()) if channel.rank == 0 else {}
    order = channel.broadcast(read)  # other nodes may not have this temporary folder
    measured = measure(Scene.model_validate(order["scene"]), channel, order["frames"], order["warm_up"])
    with agree(channel, 0, "result"):
        if measured.image is not None:
            np.save(folder / PICTURE, measured.image)
            found = {"cost": measured.cost.as_json(), "scene": measured.scene.model_dump(mode="json")}
            (folder / RESULT).write_text(json.dumps(found | {"renderer": measured.renderer}))
