"""`clusterviz scale`: measure strong and weak scaling of a scene, predict it for more ranks, and write a page.

Each rank count is a separate job of this command with `--measure`, so that a failure does not affect the others. Ranks
have the same number of threads at every count, so that more ranks use more cores; llvmpipe on one rank would otherwise
use all of them.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from clusterviz.cli.arguments import Define, Frames, SceneArgument, Size, overrides_of, parse_counts
from clusterviz.cli.console import show_progress
from clusterviz.cli.jobs import refuse_launcher, run_job
from clusterviz.cli.reporting import (
    PICTURE,
    RESULT,
    OneJob,
    Output,
    check_report,
    do_order,
    print_report,
    run_measuring,
    write_report,
)
from clusterviz.comm import Channel
from clusterviz.comm.placement import THREAD_VARIABLES, granted_cores
from clusterviz.composite.model.network import default_network, open_network, shipped_networks
from clusterviz.data import open_scene
from clusterviz.errors import ClustervizError, SceneError, public_address
from clusterviz.pages.scale.forecast import Machine, PredictedFrame, Rates, fit_rates, forecast, rank_counts
from clusterviz.pages.scale.measure import Image, Measured, measure, measured_from_json
from clusterviz.pages.scale.page import KIND, TABLE, Report, write_files
from clusterviz.pages.scale.points import DEGREES, FRAMES
from clusterviz.pages.scale.survey import SurveyResult, run_survey, steps_of
from clusterviz.scene import Cluster, Scene


def command(
    scene: SceneArgument,
    output: Output,
    ranks: Annotated[str, typer.Option(metavar="N,N,…", help="Numbers of ranks.")] = "1,2,4",
    weak: Annotated[bool, typer.Option("--weak/--no-weak", help="Weak scaling too: step / n on n ranks.")] = True,
    balance: Annotated[
        bool,
        typer.Option("--balance/--no-balance", help="Imbalance over an orbit, with static and dynamic distributions."),
    ] = True,
    define: Define = None,
    size: Size = None,
    frames: Frames = 5,
    network: Annotated[
        str | None,
        typer.Option(metavar="F.json", help=f"Predict for this network: a file, or {', '.join(shipped_networks())}."),
    ] = None,
    ranks_per_node: Annotated[
        int | None, typer.Option(min=1, help="Predict for this number of ranks a node; default: this machine's cores.")
    ] = None,
    one_job: OneJob = False,
) -> None:
    """Measure how a scene scales (starting mpirun by itself), and predict how it would on up to 65,536 ranks."""
    if one_job:
        do_order(Path(scene), output, partial(_draw, output))
        return
    refuse_launcher("scale")
    counts = sorted(parse_counts(ranks, 1, "--ranks"))
    machine = _machine(network, ranks_per_node)
    opened = open_scene(scene, overrides_of(define, size))
    if not opened.has_content:
        raise SceneError("nothing to measure", where=f"{scene}: volumes", allowed="a scene with content")
    check_report(output, KIND)
    threads = threads_per_rank(counts)
    with (
        tempfile.TemporaryDirectory(prefix="clusterviz-scale-") as folder,
        show_progress(steps_of(counts, weak, balance)) as progress,
    ):
        job = MpirunJob(frames, threads, Path(folder))
        found = run_survey(opened, counts, weak, balance, job, progress)
        drawn = Scene.model_validate(json.loads((Path(folder) / RESULT).read_text())["scene"])
    shown = opened.model_copy(update={"camera": drawn.camera, "volumes": drawn.volumes, "image": drawn.image})
    report = make_report(Path(public_address(scene)).name, shown, frames, threads, found, machine)
    write_report(output, KIND, lambda folder: write_files(folder, report))
    lost = [f"\n{failed.scaling} scaling, {failed.ranks} ranks: {failed.reason}" for failed in found.failed]
    print_report(output, KIND, "\n".join([*report.verdict, *lost]), beside=f" and {output / TABLE}")


def threads_per_rank(counts: Sequence[int]) -> str:
    """Return the number of threads of each rank: cores / the largest count with a core for each rank.

    The result is "" if the environment sets the number of threads.
    """
    if any(name in os.environ for name in THREAD_VARIABLES):
        return ""
    cores = len(granted_cores())
    return str(cores // max((count for count in counts if count <= cores), default=cores))


def make_report(name: str, scene: Scene, frames: int, threads: str, found: SurveyResult, machine: Machine) -> Report:
    """Return the report: measurements, forecasts and the description of the machine."""
    points = (*found.strong, *found.weak)
    rates = fit_rates(points)
    return Report(
        name=name,
        scene=scene,
        frames=frames,
        threads=threads,
        found=found,
        rates=rates,
        machine=machine,
        strong=forecast(rates, machine, scene.cluster, False, rank_counts()),
        weak=forecast(rates, machine, scene.cluster, True, rank_counts()) if found.weak else [],
        others=_elsewhere(rates, machine, scene.cluster),
        environment=_environment(max(point.ranks for point in points)),
    )


def _machine(network: str | None, ranks_per_node: int | None) -> Machine:
    each = ranks_per_node or len(granted_cores())
    if network:
        named = open_network(network)
        return Machine(named, named, each)
    return Machine(default_network(1), default_network(2), each)


def _elsewhere(rates: Rates, machine: Machine, cluster: Cluster) -> dict[str, list[PredictedFrame]]:
    """Return forecasts for the other networks of several nodes that come with the package."""
    others = [open_network(name) for name in shipped_networks()]
    others = [other for other in others if other.nodes > 1 and other.name != machine.far.name]
    return {
        other.name: forecast(rates, Machine(other, other, machine.ranks_per_node), cluster, False, rank_counts())
        for other in others
    }


def _environment(ranks: int) -> dict[str, Any]:
    """Return the doctor's report; its errors do not prevent the measurement."""
    try:
        found: dict[str, Any] = json.loads(run_job(ranks, ["doctor", "--json"]))
    except ClustervizError as error:
        return {"problem": f"clusterviz doctor: {error}"}
    return found


@dataclass(frozen=True)
class MpirunJob:
    """Drawing of scenes in MPI jobs; see `survey.Job`."""

    frames: int
    threads: str  # threads of each rank; "" to use the environment's
    folder: Path  # folder for files exchanged with the jobs

    def __call__(self, scene: Scene, ranks: int, orbit: bool = False) -> tuple[Measured, Image]:
        """Draw one scene; errors are those of `run_job`."""
        frames = {"frames": FRAMES, "warm_up": 0, "orbit": DEGREES} if orbit else {"frames": self.frames}
        order = {"scene": scene.model_dump(mode="json"), **frames}
        limits = dict.fromkeys(THREAD_VARIABLES, self.threads) if self.threads else {}
        found, image = run_measuring(KIND, ranks, order, self.folder, limits)
        return measured_from_json(found["measured"]), image


def _draw(folder: Path, channel: Channel, order: dict[str, Any]) -> tuple[Any, None]:
    """Do one job; collective. The time of writing the picture is measured, too."""
    drawn: list[Scene] = []

    def write(image: Image, scene: Scene) -> None:
        np.save(folder / PICTURE, image)
        drawn.append(scene)

    how = {name: order[name] for name in ("warm_up", "orbit") if name in order}
    measured = measure(Scene.model_validate(order["scene"]), channel, order["frames"], write, **how)
    found = {"measured": measured.as_json(), "scene": drawn[0].model_dump(mode="json")} if drawn else None
    return found, None
