"""Files of the tradeoff report: a self-contained HTML page, and its numbers as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from clusterviz.pages.output import numbers_of, write_page
from clusterviz.pages.pictures import error_map_url, thumbnail_url
from clusterviz.pages.tradeoff.ground_truth import GroundTruth
from clusterviz.pages.tradeoff.knobs import KNOBS
from clusterviz.pages.tradeoff.rating import FailedSetting, RatedSetting, by_rms, verdict
from clusterviz.scene import Scene, background_rgb
from clusterviz.scene.background import RGB

KIND = "tradeoff"
PIXELATED = 200


@dataclass(frozen=True)
class Report:
    """Contents of the page."""

    name: str
    scene: Scene  # the completed scene
    ranks: int
    frames: int
    rounds: int
    renderer: str
    truth: GroundTruth
    rated: Sequence[RatedSetting]  # settings with cost and error; the unchanged scene comes first
    failed: Sequence[FailedSetting]  # settings that could not be drawn
    left_out: int  # number of combinations not measured
    seconds_again: float  # seconds of a frame of the unchanged scene, measured again at the end

    @property
    def drift(self) -> float:
        """Ratio of both times of the unchanged scene, at least 1; 1 on an idle machine."""
        both = (self.rated[0].cost.total_seconds, self.seconds_again)
        return max(both) / min(both)

    @property
    def verdict(self) -> list[str]:
        """Conclusions, in sentences."""
        return verdict(self.rated, self.truth, self.drift)


def write_files(folder: Path, report: Report) -> None:
    """Write the page and the numbers into a folder."""
    from clusterviz.pages.tradeoff import charts

    background = background_rgb(report.scene.image.background)
    used = {name for one in report.rated if one.setting.kind == "control" for name in one.setting.changes}
    write_page(
        folder,
        KIND,
        numbers(report),
        report.scene,
        report=report,
        main_chart=charts.main_chart(report.rated, report.truth),
        small_charts=charts.small_charts(report.rated, report.truth),
        truth_picture=thumbnail_url(report.truth.picture, background),
        rows=[_row(one, report.truth, background) for one in report.rated],
        controls=", ".join(f"{knob.name} ({knob.about})" for knob in KNOBS if knob.name in used),
        small=' class="small"' if report.scene.image.size[0] < PIXELATED else "",
        rms=by_rms(report.truth),
    )


def numbers(report: Report) -> dict[str, Any]:
    """Return the report without pictures as JSON values; docs/reference/reports.md describes the keys."""
    truth = asdict(report.truth)
    del truth["picture"]
    return numbers_of(
        report.scene,
        ranks=report.ranks,
        size=list(report.scene.image.size),
        frames=report.frames,
        rounds=report.rounds,
        renderer=report.renderer,
        verdict=report.verdict,
        judged_by="rms" if by_rms(report.truth) else "max",
        truth=truth,
        settings=[_as_json(one) for one in report.rated],
        failed=[
            {"changes": dict(one.setting.changes), "kind": one.setting.kind, "reason": one.reason}
            for one in report.failed
        ],
        left_out=report.left_out,
        drift=report.drift,
    )


def _as_json(one: RatedSetting) -> dict[str, Any]:
    errors = {
        "max": one.max,
        "rms": one.rms,
        "wrong_pixels": one.wrong_pixels,
        "ssim": one.ssim,
    }
    setting = {"name": str(one.setting), "changes": dict(one.setting.changes), "kind": one.setting.kind}
    return setting | one.cost.as_json() | errors | {"front": one.front}


def _row(one: RatedSetting, truth: GroundTruth, background: RGB | None) -> dict[str, Any]:
    """Return a row of the table with its pictures, in the page's units."""
    error, factor = error_map_url(one.image - truth.picture)
    return {
        "name": str(one.setting),
        "front": one.front,
        "total_ms": 1e3 * one.cost.total_seconds,
        "render_ms": 1e3 * one.cost.render_seconds,
        "max": one.max,
        "rms": one.rms,
        "wrong_pixels": one.wrong_pixels,
        "ssim": one.ssim,
        "samples": one.cost.samples,
        "voxel_mib": one.cost.voxel_bytes / 2**20,
        "peak_mib": one.cost.peak_memory_bytes / 2**20,
        "sent_mib": one.cost.bytes_sent / 2**20,
        "picture": thumbnail_url(one.image, background),
        "error": error,
        "factor": factor,
    }
