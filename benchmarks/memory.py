"""Peak memory of each rank against what it must hold: `python benchmarks/memory.py [SCENE] [--ranks 4] [--json F]`.

A rank must hold its bricks with their overlap once, on the GPU or (with llvmpipe) in main memory, and its images. What
the libraries take is measured by a scene of hardly any data on as many ranks: it imports, draws and composites alike.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from clusterviz.cli.arguments import parse_size
from clusterviz.cli.jobs import run_job

BYTES_PER_PIXEL = 16  # float32 RGBA
NOTHING = ("field:gaussian:32", "8x8", "cluster.brick=4")


def run(ranks: int, scene: str, size: str, *settings: str) -> list[dict[str, Any]]:
    """What each rank says of one run."""
    with tempfile.TemporaryDirectory() as folder:
        picture, stats = Path(folder) / "picture.npy", Path(folder) / "statistics.json"
        defines = [word for setting in settings for word in ("-D", setting)]
        run_job(ranks, ["render", scene, "-o", str(picture), "--stats", str(stats), "--size", size, *defines])
        per_rank: list[dict[str, Any]] = json.loads(stats.read_text())["frames"][0]["per_rank"]
        return per_rank


def measure(scene: str, ranks: int, size: str) -> list[dict[str, float]]:
    """A row a rank, in bytes."""
    width, height = parse_size(size)
    image = width * height * BYTES_PER_PIXEL
    return [
        {
            "rank": number,
            "peak": rank["peak_memory_bytes"],
            "libraries": idle["peak_memory_bytes"],
            "bricks": rank["voxel_bytes"],
            # What the rank draws, and on rank 0 the whole picture as well.
            "images": image * (2 if number == 0 else 1),
        }
        for number, (rank, idle) in enumerate(zip(run(ranks, scene, size), run(ranks, *NOTHING), strict=True))
    ]


def main() -> None:
    """Print a table, and write it as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", nargs="?", default="field:marschner-lobb:400")
    parser.add_argument("--ranks", type=int, default=4)
    parser.add_argument("--size", default="512x512")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = measure(options.scene, options.ranks, options.size)
    print("MiB    rank      peak libraries    bricks    images   peak / sum   above libraries / (bricks + images)")
    for row in rows:
        needed = row["bricks"] + row["images"]
        row["ratio"] = row["peak"] / (row["libraries"] + needed)
        row["ratio_above"] = (row["peak"] - row["libraries"]) / needed
        numbers = "".join(f"{row[name] / 2**20:10.1f}" for name in ("peak", "libraries", "bricks", "images"))
        print(f"{row['rank']:11}{numbers}{row['ratio']:13.2f}{row['ratio_above']:14.2f}")
    if options.json:
        chosen = {"scene": options.scene, "ranks": options.ranks, "size": options.size}
        options.json.write_text(json.dumps({**chosen, "per_rank": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
