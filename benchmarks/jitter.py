"""What jittered slabs trade: `python benchmarks/jitter.py [DATA] [--size N] [--json F]`.

Errors against the same picture at step 1/16, with and without jitter: the largest, the root of the mean square, and the
latter after 4 × 4 pixels were averaged, as eyes and smaller pictures do. Rings survive that, noise does not.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clusterviz
from clusterviz.data.samples import fetch_sample

STEPS = (1.0, 2.0, 4.0)
CONVERGED = 1 / 16
BLOCK = 4
Pixels = NDArray[np.float64]


def picture(path: str, size: int, **quality: Any) -> Pixels:
    """The volume from its usual camera."""
    found = clusterviz.render(path, size=(size, size), **quality)
    assert found is not None, "one rank"
    return found.astype(np.float64)


def averaged(pixels: Pixels) -> Pixels:
    """Means of blocks."""
    side = len(pixels) // BLOCK
    means: Pixels = pixels[: side * BLOCK, : side * BLOCK].reshape(side, BLOCK, side, BLOCK, 4).mean(axis=(1, 3))
    return means


def errors(path: str, size: int, volume: dict[str, Any]) -> list[dict[str, Any]]:
    """One row for each step and switch."""
    truth = picture(path, size, step=CONVERGED, **volume)
    rows = []
    for step in STEPS:
        for jitter in (False, True):
            difference = picture(path, size, step=step, jitter=jitter, **volume) - truth
            rms, blurred = (float(np.sqrt(np.mean(part**2))) for part in (difference, averaged(difference)))
            row = {"step": step, "jitter": jitter, "max": float(np.abs(difference).max()), "rms": rms}
            rows.append(row | {"averaged_rms": blurred})
    return rows


def main() -> None:
    """Print the table, and write it as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", help="a data file; default: the sample mni152")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    path = options.data or str(fetch_sample("mni152"))
    rows = errors(path, options.size, {})
    print(f"{path}, {options.size} × {options.size}, against step {CONVERGED}, in 255ths")
    for row in rows:
        name = f"step {row['step']:g}, {'jittered' if row['jitter'] else 'straight'}"
        largest, rms, blurred = (255 * row[key] for key in ("max", "rms", "averaged_rms"))
        print(f"{name:18} max {largest:6.2f}  rms {rms:6.3f}  averaged {blurred:6.3f}")
    if options.json:
        options.json.write_text(json.dumps({"data": path, "size": options.size, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
