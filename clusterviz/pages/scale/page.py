"""Files of the scaling report: a self-contained HTML page, and its numbers as JSON and CSV."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from clusterviz.pages.output import numbers_of, write_page
from clusterviz.pages.scale.forecast import Machine, PredictedFrame, Rates
from clusterviz.pages.scale.points import DEGREES, FRAMES, Point, as_json
from clusterviz.pages.scale.survey import SurveyResult
from clusterviz.pages.scale.verdict import verdict
from clusterviz.report.statistics import STAGES
from clusterviz.scene import Scene

KIND, TABLE, BALANCE_TABLE = "scale", "scale.csv", "balance.csv"


@dataclass(frozen=True)
class Report:
    """Contents of the page. `strong`, `weak`: forecasts; weak may be empty."""

    name: str
    scene: Scene  # the completed scene
    frames: int
    threads: str  # threads of each rank at every count; "" if set by the environment
    found: SurveyResult
    rates: Rates
    machine: Machine
    strong: Sequence[PredictedFrame]
    weak: Sequence[PredictedFrame]
    others: Mapping[str, Sequence[PredictedFrame]]  # name of another network -> forecast of strong scaling
    environment: Mapping[str, Any]  # output of `clusterviz doctor --json`, or {"problem": reason}

    @property
    def verdict(self) -> list[str]:
        """Conclusions, in sentences."""
        return verdict(self.found, self.strong, self.machine.far.name)

    @property
    def points(self) -> tuple[Point, ...]:
        """Points of strong scaling, then of weak scaling."""
        return (*self.found.strong, *self.found.weak)


def write_files(folder: Path, report: Report) -> None:
    """Write the page, the numbers and the table into a folder."""
    from clusterviz.pages.scale import charts

    rows, found = [row(point) for point in report.points], report.found
    write_page(
        folder,
        KIND,
        numbers(report),
        report.scene,
        report=report,
        found=found,
        points=report.points,
        rows=rows,
        stages=STAGES,
        renderer=next((point.renderer for point in report.points if point.renderer), "nothing was drawn"),
        frame_chart=charts.frame_chart(found),
        stage_chart=charts.stage_chart(found),
        balance_chart=charts.balance_chart(found),
        orbit_chart=charts.orbit_chart(found.balance) if found.balance else "",
        orbit=f"{DEGREES:g} degrees in {FRAMES} frames",
        forecast_chart=charts.forecast_chart(found, report.strong, report.weak, report.others),
        far=report.machine.far,
        expected=[one for one in report.strong if one.ranks in (1, 4, 16, 64, 256, 1024, 4096, 16384, 65536)],
        counted=[point for point in found.points if point.rounds],
        bricks=max(sum(point.bricks) for point in report.points),
        environment=report.environment,
        environment_text=json.dumps(report.environment, indent=2),
        csv_name=TABLE,
        balance_name=BALANCE_TABLE,
    )
    _write_table(folder / TABLE, rows)
    if found.balance:
        _write_table(folder / BALANCE_TABLE, [line for one in found.balance for line in one.rows()])


def _write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def numbers(report: Report) -> dict[str, Any]:
    """Return the report as JSON values; docs/reference/reports.md describes the keys."""
    machine = report.machine
    return numbers_of(
        report.scene,
        size=list(report.scene.image.size),
        frames=report.frames,
        threads_per_rank=report.threads,
        verdict=report.verdict,
        strong=[as_json(point) for point in report.found.strong],
        weak=[as_json(point) for point in report.found.weak],
        balance=[asdict(one) for one in report.found.balance],
        failed=[asdict(one) for one in report.found.failed],
        prediction={
            "rates": asdict(report.rates),
            "networks": {"one_node": asdict(machine.near), "several_nodes": asdict(machine.far)},
            "ranks_per_node": machine.ranks_per_node,
            "strong": [_expected(one) for one in report.strong],
            "weak": [_expected(one) for one in report.weak],
            "other_networks": {name: [_expected(one) for one in curve] for name, curve in report.others.items()},
        },
        environment=dict(report.environment),
    )


def row(point: Point) -> dict[str, Any]:
    """Return one line of the CSV file."""
    difference = point.difference
    return {
        "scaling": point.scaling,
        "ranks": point.ranks,
        "nodes": point.nodes,
        "step": point.step,
        "oversubscribed": point.crowded,
        "total_seconds": point.total_seconds,
        "efficiency": "" if point.efficiency is None else point.efficiency,
        **{f"{stage}_seconds": point.seconds[stage] for stage in STAGES},
        "cpu_seconds": point.cpu_seconds,
        "imbalance": sum(point.imbalance) / len(point.imbalance),
        "imbalance_samples": point.imbalance_samples,
        "samples": sum(point.samples),
        "sharing": point.sharing,
        "algorithm": point.algorithm,
        "transport": point.transport,
        "compositing_seconds": point.compositing_seconds,
        "predicted_compositing_seconds": point.predicted_seconds,
        "counted_algorithm": point.counted_algorithm,
        "messages": sum(one.messages for one in point.rounds),
        "messages_theory": sum(one.messages_theory for one in point.rounds),
        "bytes": sum(one.bytes for one in point.rounds),
        "bytes_theory": sum(one.bytes_theory for one in point.rounds),
        "bytes_dense": point.bytes_dense,
        "largest_memory_bytes": max(point.peak_memory_bytes),
        "voxel_bytes": sum(point.voxel_bytes),
        "picture_max_difference": difference.max if difference else "",
    }


def _expected(one: PredictedFrame) -> dict[str, Any]:
    return asdict(one) | {"total_seconds": one.total_seconds}
