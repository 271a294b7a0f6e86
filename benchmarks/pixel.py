"""What `quality.pixel` saves and costs: `mpirun -n 4 python benchmarks/pixel.py [--size S] [--frames K]`.

The MNI head in the default look, at the step of the scene. For each transport and format: bytes that all ranks send,
the slowest rank's seconds from its partial images to the picture on rank 0 (rounding included, medians of frames taken
in turn), and the largest error beside float32.
"""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median
from typing import Any

import numpy as np
from measuring import Row, options, sample, show, write

from clusterviz.comm import open_channel
from clusterviz.composite import rounding_bound
from clusterviz.frame import FrameLoop, Options
from clusterviz.scene import scene_of_data
from clusterviz.scene.overrides import with_settings

FORMATS = ("float32", "float16", "uint8")
STAGES = ("encode", "exchange", "blend", "collect", "finish")


def measured(asked: Any, channel: Any) -> Iterator[Row]:
    """A row for each transport and format."""
    scene = scene_of_data(sample(), [f"image.size=[{asked.size},{asked.size}]"])
    for transport in ("messages", "shared"):
        keys = {"transport": transport, "codec": "raw", "mode": "sort-last", "step": 2.0}
        scenes = {pixel: with_settings(scene, {**keys, "pixel": pixel}) for pixel in FORMATS}
        with FrameLoop(scenes["float32"], channel, options=Options(overlap=False)) as loop:
            drawn = [{pixel: loop.frame(one) for pixel, one in scenes.items()} for _ in range(asked.frames)]
        exact = drawn[0]["float32"].image
        for pixel in FORMATS if channel.rank == 0 else ():
            ranks = drawn[0][pixel].statistics.per_rank
            yield {
                "ranks": channel.size,
                "transport": transport,
                "pixel": pixel,
                "sent": sum(rank.bytes_sent + rank.compositing["bytes_collected"] for rank in ranks) / 2**20,
                "s": median(sum(one[pixel].statistics.seconds[name] for name in STAGES) for one in drawn[1:]),
                "error": float(np.abs(np.asarray(drawn[0][pixel].image) - exact).max()),
                "bound": rounding_bound(pixel, channel.size),  # type: ignore[arg-type]
            }


def main() -> None:
    """Print the table on rank 0."""
    asked, channel = options(__doc__, size=1024, frames=7), open_channel()
    rows = measured(asked, channel)
    if channel.rank:
        list(rows)
        return
    cells = "{ranks} | {transport} | {pixel} | {sent:.1f} | {s!m:.1f} | {error:.1e} | {bound:.1e}"
    write(asked, rows=show("ranks | transport | pixel | MiB sent | ms | error | bound", cells, rows))


if __name__ == "__main__":
    main()
