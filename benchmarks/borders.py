"""What cutting slabs at the faces of bricks trades: `python benchmarks/borders.py [DATA] [--size N] [--json F]`.

Pre-integrated slabs with one more voxel around every brick (`quality.borders: overlap`) beside slabs that are cut where
they leave a brick (`split`), for several brick sizes: bytes of voxels, field samples, a frame's time, and how far the
picture is from that with overlap, which is the same for all bricks, and from a converged one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from measuring import (
    Row,
    loaded,
    middle,
    opened,
    options,
    picture_of,
    positional,
    prepared,
    sample,
    show,
    timed,
    whole_pieces,
    write,
)

from clusterviz.scene import Scene

BRICKS = (33, 64, 128)
CONVERGED = 1 / 16


def drawn(path: str, size: int, frames: int, brick: int, borders: str, step: float = 1.0) -> tuple[Any, Row]:
    """The picture, and what it took."""
    quality = {"classification": "pre-integrated", "borders": borders, "step": step}
    keys = {"volumes": [{"path": path}], "image": {"size": (size, size)}, "quality": quality}
    plan, bricks = prepared(Scene.model_validate(keys | {"cluster": {"brick": brick}}), [opened(path)[0]])
    caster = loaded(plan, bricks, 0)
    runs = [timed(lambda: caster.draw(plan, whole_pieces(plan))) for _ in range(frames + 1)]
    costs = {"voxel_bytes": caster.pool.bytes, "samples": runs[0].value[0].samples, "seconds": middle(runs[1:])}
    caster.release()
    return picture_of((size, size), runs[0].value), costs


def measured(path: str, size: int, frames: int) -> Iterator[Row]:
    """A row for each brick and way."""
    truth, _ = drawn(path, size, 1, 64, "overlap", CONVERGED)
    for brick in BRICKS:
        overlap = None
        for borders in ("overlap", "split"):
            picture, costs = drawn(path, size, frames, brick, borders)
            overlap = picture if overlap is None else overlap
            errors = {"rms": float(np.sqrt(np.mean((picture - truth) ** 2))), "seam": np.abs(picture - overlap).max()}
            yield {"brick": brick, "borders": borders, **costs, **errors}


def main() -> None:
    """Print the table."""
    asked = options(__doc__, data=positional("data", help="default: the sample mni152"), size=192, frames=5)
    path = sample(asked.data)
    head = "brick | borders | MB | samples | ms | from overlap, max of 255 | from converged, rms of 255"
    cells = "{brick} | {borders} | {voxel_bytes!M:.2f} | {samples:,} | {seconds!m:.1f} | {seam!l:.2f} | {rms!l:.3f}"
    write(asked, rows=show(head, cells, measured(path, asked.size, asked.frames), f"{path}, {asked.size}², step 1"))


if __name__ == "__main__":
    main()
