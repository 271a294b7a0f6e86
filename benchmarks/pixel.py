"""What `quality.pixel` saves and costs: `mpirun -n 4 python benchmarks/pixel.py [--size S] [--frames K]`.

The MNI head in the default look, at the step of the scene. For each transport and format: bytes that all ranks send,
the slowest rank's seconds from its partial images to the picture on rank 0 (rounding included, medians of frames taken
in turn), and the largest error beside float32.
"""

from __future__ import annotations

import argparse
from statistics import median

import numpy as np

from clusterviz.comm import open_channel
from clusterviz.composite import rounding_bound
from clusterviz.data.samples import fetch_sample
from clusterviz.frame import FrameLoop, Options
from clusterviz.scene import scene_of_data
from clusterviz.scene.overrides import with_settings

FORMATS = ("float32", "float16", "uint8")
STAGES = ("encode", "exchange", "blend", "collect", "finish")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--frames", type=int, default=7)
    arguments = parser.parse_args()
    channel = open_channel()
    scene = scene_of_data(str(fetch_sample("mni152")), [f"image.size=[{arguments.size},{arguments.size}]"])
    for transport in ("messages", "shared"):
        keys = {"transport": transport, "codec": "raw", "mode": "sort-last", "step": 2.0}
        scenes = {pixel: with_settings(scene, {**keys, "pixel": pixel}) for pixel in FORMATS}
        with FrameLoop(scenes["float32"], channel, options=Options(overlap=False)) as loop:
            drawn = [{pixel: loop.frame(one) for pixel, one in scenes.items()} for _ in range(arguments.frames)]
        if channel.rank:
            continue
        exact = drawn[0]["float32"].image
        for pixel in FORMATS:
            image, ranks = drawn[0][pixel].image, drawn[0][pixel].statistics.per_rank
            assert image is not None
            assert exact is not None
            seconds = median(sum(one[pixel].statistics.seconds[name] for name in STAGES) for one in drawn[1:])
            sent = sum(rank.bytes_sent + rank.compositing["bytes_collected"] for rank in ranks) / 2**20
            error, bound = float(np.abs(image - exact).max()), rounding_bound(pixel, channel.size)
            cells = (str(channel.size), transport, pixel, f"{sent:.1f}", f"{1e3 * seconds:.1f}")
            print(f"| {' | '.join(cells)} | {error:.1e} | {bound:.1e} |")


if __name__ == "__main__":
    main()
