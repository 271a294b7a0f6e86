"""What skipping empty groups of cells saves: `python benchmarks/skipping.py [DATA] [--size N] [--json F]`.

The same scenes drawn twice on one rank: as always, and with every group of cells of every brick called visible, so that
each ray samples all of its slabs. The pictures' largest difference is printed beside the samples: what is skipped
has no opacity at all, and places and sums are those of batches, wherever runs begin, so there is none.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
from measuring import Row, loaded, opened, options, picture_of, positional, prepared, sample, show, whole_pieces, write

from clusterviz.cli.arguments import parse_device
from clusterviz.data.bricks import read_bricks
from clusterviz.image import compare
from clusterviz.plan.content import brick_cost, bricks_of_volume
from clusterviz.plan.plan import Plan
from clusterviz.render import brick_atlas
from clusterviz.render.cpu import device as cpu_device
from clusterviz.render.storage import Slot
from clusterviz.scene import Scene

CORTEX = [(40.0, 0.0), (60.0, 0.0), (100.0, 0.04), (140.0, 0.25), (220.0, 0.7)]
SPARSE = [(0.0, 0.0), (0.6, 0.0), (0.7, 0.5), (1.0, 0.9)]


def all_visible(ranges: Any, plan: Plan, slot: Slot) -> Any:
    """In place of `visibility_bits`: nothing is empty."""
    return np.full((len(ranges[0]), slot.visibility_words), 0xFFFFFFFF, np.uint32)


def measure(name: str, volume: dict[str, Any], size: int, device: Any) -> Row:
    """One scene with and without skipping."""
    source, _ = opened(volume["path"])
    plan, _ = prepared(Scene.model_validate({"volumes": [volume], "image": {"size": (size, size)}}), [source])
    bricks = bricks_of_volume(plan.layout, read_bricks(source, plan.layout, np.ndindex(*plan.layout.counts_zyx)))

    def drawn(plan: Plan) -> Any:
        return loaded(plan, dict(bricks), device).draw(plan, whole_pieces(plan))[0]

    skipping = drawn(plan)
    every = replace(plan, cost=brick_cost(plan.layout, np.zeros(plan.layout.counts_zyx, bool)))
    with (
        patch.object(brick_atlas, "visibility_bits", all_visible),
        patch.object(
            cpu_device, "visible_groups", lambda ranges, plan: np.ones((len(ranges[0]), *ranges[0].shape[2:]), bool)
        ),
    ):
        whole = drawn(every)
    pictures = [picture_of((size, size), [each]) for each in (skipping, whole)]
    samples = {"samples": skipping.samples, "without": whole.samples, "share": skipping.samples / whole.samples}
    bricks_drawn = f"{skipping.bricks}/{whole.bricks}"
    return {"scene": name, **samples, "bricks": bricks_drawn, "max": compare(*pictures).max}


def main() -> None:
    """Print the table."""
    data = positional("data", help="a head like that of the sample mni152, which is the default")
    asked = options(__doc__, data=data, size=256, device={"type": parse_device, "help": "an EGL device, or cpu"})
    head = sample(asked.data)
    scenes: dict[str, dict[str, Any]] = {
        "head, default": {"path": head},
        "head, cortex": {"path": head, "clim": (40.0, 220.0), "opacity": CORTEX},
        "hydrogen, 192³": {"path": "field:hydrogen:192", "clim": (0.0, 1.0), "opacity": SPARSE},
    }
    rows = (measure(name, volume, asked.size, asked.device) for name, volume in scenes.items())
    cells = "{scene} | {samples:,} | {without:,} | {share:.3f} | {bricks} | {max:.1e}"
    write(asked, rows=show("scene | samples | without | share | bricks | max", cells, rows))


if __name__ == "__main__":
    main()
