"""What jittered slabs trade: `python benchmarks/jitter.py [DATA] [--size N] [--json F]`.

Errors against the same picture at step 1/16, with and without jitter: the largest, the root of the mean square, and the
latter after 4 × 4 pixels were averaged, as eyes and smaller pictures do. Rings survive that, noise does not.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from measuring import Row, options, positional, sample, show, write

import clusterviz

STEPS = (1.0, 2.0, 4.0)
CONVERGED = 1 / 16
BLOCK = 4


def picture(path: str, size: int, **quality: Any) -> Any:
    """The volume from its usual camera."""
    found = clusterviz.render(path, size=(size, size), **quality)
    assert found is not None, "one rank"
    return found.astype(np.float64)


def errors(path: str, size: int) -> Iterator[Row]:
    """One row for each step and switch."""
    truth, side = picture(path, size, step=CONVERGED), size // BLOCK
    for step, jitter in product(STEPS, (False, True)):
        apart = picture(path, size, step=step, jitter=jitter) - truth
        means = apart[: side * BLOCK, : side * BLOCK].reshape(side, BLOCK, side, BLOCK, 4).mean(axis=(1, 3))
        rms, averaged = (float(np.sqrt(np.mean(part**2))) for part in (apart, means))
        yield {"step": step, "jitter": str(jitter), "max": np.abs(apart).max(), "rms": rms, "averaged": averaged}


def main() -> None:
    """Print the table."""
    asked = options(__doc__, data=positional("data", help="default: the sample mni152"), size=256)
    path = sample(asked.data)
    cells = "{step:g} | {jitter} | {max!l:.2f} | {rms!l:.3f} | {averaged!l:.3f}"
    rows = show("step | jitter | max | rms | rms of means", cells, errors(path, asked.size), f"{path}, in 255ths")
    write(asked, rows=rows)


if __name__ == "__main__":
    main()
