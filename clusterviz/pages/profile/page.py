"""Files of the profile: a self-contained HTML page, its numbers as JSON, and the maps as arrays."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.pages.output import numbers_of, write_page
from clusterviz.pages.pictures import data_url, heat, thumbnail_url
from clusterviz.pages.profile.code import Code, Share
from clusterviz.pages.profile.measure import RankProfile, Report
from clusterviz.scene import background_rgb

KIND, MAPS = "profile", "maps.npz"
TOP = 10
SHOWN = {
    "samples": "samples",
    "iterations": "iterations: runs of samples, and gaps",
    "skipped": "slabs skipped, as nothing is visible there",
    "left_out": "slabs left out behind the opaque point",
    "fragments": "fragments of meshes, lines and points",
    "ticks": "cost",
}
"""Maps on the page, and what they show."""


def write_files(folder: Path, name: str, report: Report) -> None:
    """Write the page, the numbers and the maps."""
    write_page(
        folder,
        KIND,
        as_json(report),
        report.scene,
        name=name,
        report=report,
        picture=thumbnail_url(report.picture, background_rgb(report.scene.image.background)),
        maps=[_map(report.whole, key, text) for key, text in SHOWN.items() if report.whole.maps[key].any()],
        ranks=[(rank, [_map(own, key, SHOWN[key]) for key in ("samples", "ticks")]) for rank, own in _several(report)],
        rows=[("all", report.whole), *_several(report)],
        top=_top(report.code) if report.code else [],
        text=_text(report.code) if report.code else [],
        maps_name=MAPS,
    )
    maps = {f"{name}_rank_{rank}": values for rank, own in report.ranks.items() for name, values in own.maps.items()}
    np.savez_compressed(folder / MAPS, allow_pickle=False, **report.whole.maps, **maps)


def as_json(report: Report) -> dict[str, Any]:
    """Return the contents of the JSON file."""
    code = report.code and {key: value for key, value in asdict(report.code).items() if key != "source"}
    return numbers_of(
        report.scene,
        renderer=report.renderer,
        clock=report.clock,
        block_side=report.block_side,
        totals=_numbers(report.whole),
        ranks=[{"rank": rank} | _numbers(own) for rank, own in report.ranks.items()],
        code=code,
    )


def _numbers(profile: RankProfile) -> dict[str, Any]:
    return profile.totals | {"bricks": profile.bricks} | profile.memory


def _several(report: Report) -> list[tuple[int, RankProfile]]:
    return list(report.ranks.items()) if len(report.ranks) > 1 else []


def _map(profile: RankProfile, key: str, text: str) -> dict[str, Any]:
    """Return a heat map, from black (0) to white; 1 % of the pixels may be above that."""
    from PIL import Image

    values: NDArray[Any] = profile.maps[key]
    white = float(np.percentile(values[values > 0], 99)) if (values > 0).any() else 1.0
    url = data_url(Image.fromarray(heat(np.clip(values / white, 0, 1))))
    return {"text": text, "url": url, "white": white, "mean": float(values.mean())}


def _top(code: Code) -> list[tuple[Share, str]]:
    found = []
    for one in code.lines[:TOP]:
        file, _, number = one.name.rpartition(":")
        found.append((one, code.source[file][int(number)].strip()))
    return found


def _text(code: Code) -> list[dict[str, Any]]:
    """Return the files of the shader of which a line was executed, with the numbers of each line."""
    known = {one.name: one for one in code.lines}
    top = {one.name for one in code.lines[:TOP]}
    found = []
    for file, lines in code.source.items():
        rows = [(number, text, known.get(f"{file}:{number}")) for number, text in lines.items()]
        if any(one for _, _, one in rows):
            share = sum(one.share for _, _, one in rows if one)
            is_open = any(f"{file}:{number}" in top for number in lines)
            found.append({"file": file, "rows": rows, "share": share, "open": is_open})
    return sorted(found, key=lambda file: -file["share"])
