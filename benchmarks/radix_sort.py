"""Keys a second and core of the radix sort, beside NumPy's sorts.

    python benchmarks/radix_sort.py [--keys 560000 4000000] [--rounds 9] [--json F]

Runs alternate; a time is the least of the CPU times of all rounds, divided by it the number of keys. NumPy's `argsort`
gives an order, as ours does; its `sort` moves the keys alone.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.kernels.radix_sort import sorted_order


def depths(count: int) -> np.ndarray[Any, Any]:
    """Depths of faces as float32, both signs."""
    return np.random.default_rng(1).normal(size=count).astype(np.float32)


WAYS: dict[str, Callable[[np.ndarray[Any, Any]], Any]] = {
    "radix": sorted_order,
    "radix, 2 threads": lambda keys: sorted_order(keys, 2),
    "numpy argsort": np.argsort,
    "numpy stable argsort": lambda keys: np.argsort(keys, kind="stable"),
    "numpy sort": np.sort,
}


def measure(count: int, rounds: int) -> dict[str, dict[str, float]]:
    """Return the rates of every way."""
    keys = depths(count)
    assert np.array_equal(sorted_order(keys), np.argsort(keys, kind="stable"))
    cpu, wall = ({name: [] for name in WAYS} for _ in range(2))
    for _ in range(rounds):
        for name, way in WAYS.items():
            begin, begin_cpu = time.perf_counter(), time.process_time()
            way(keys)
            cpu[name].append(time.process_time() - begin_cpu)
            wall[name].append(time.perf_counter() - begin)
    return {
        name: {"keys": count, "million_a_cpu_second": count / min(cpu[name]) / 1e6, "wall_s": min(wall[name])}
        for name in WAYS
    }


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--keys", type=int, nargs="*", default=[560_000, 1_000_000, 4_000_000])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = [measure(count, options.rounds) for count in options.keys]
    for each in found:
        for name, rate in each.items():
            print(
                f"{rate['keys']:8d} keys, {name:21} {rate['million_a_cpu_second']:6.1f} million a CPU second, "
                f"{1e3 * rate['wall_s']:7.1f} ms"
            )
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
