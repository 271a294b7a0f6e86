"""Shares of functions and lines of the shader."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.render.profiling import CodeProfile
from clusterviz.spmd.profiling import Site, reached
from clusterviz.spmd.source import ShaderSource

SAMPLING = "take_run", "last_of", "take_slab", "class_at"
"""Functions that take samples, with all that they call; others find rays, bricks and gaps."""


@dataclass(frozen=True)
class Share:
    """Function or line of the shader."""

    name: str  # of the function, or file:line
    executions: int  # by packets of lanes; of the statement of a line that is executed most
    lanes: int
    idle: float  # share of lanes that were not active, in [0, 1]; of a line, in all its statements
    share: float  # of the time, in [0, 1], without functions that it calls; 0 where they are timed with their callers


@dataclass(frozen=True)
class Code:
    """Profile of the shader on a CPU, of all ranks.

    `ticks`, `seconds`: of drawing by one thread, without measuring. `functions`, `lines`: from the largest share on.
    `ideal`: share of the time in which the same samples would be taken if no lane were ever idle, and nothing else
    done.
    """

    lanes: int
    ticks: float
    seconds: float
    functions: list[Share]
    lines: list[Share]
    idle: float  # share of lanes that were idle, weighted by time
    ideal: float
    source: dict[str, dict[int, str]]  # lines of each file of the shader


def code_of(profiles: Sequence[CodeProfile]) -> Code | None:
    """Return the profile of the code of all pieces, which have the same shader; None without profiles."""
    if not profiles:
        return None
    variant = profiles[0].variant
    assert variant.cpu, "the variant is one of a CPU"
    lanes, source = variant.cpu.lanes, variant.source
    counts, functions, statements = dict[Site, NDArray[np.int64]](), dict[str, float](), dict[Site, float]()
    for profile in profiles:
        for site, numbers in profile.counts.items():
            counts[site] = counts.get(site, np.zeros(2, np.int64)) + numbers
        for site, ticks in profile.functions.items():
            name = site.function or "main"  # before it, variables of the whole shader get their values
            functions[name] = functions.get(name, 0.0) + ticks
        for site, ticks in profile.lines.items():
            if site.line:
                statements[site] = statements.get(site, 0.0) + ticks
    ticks = sum(functions.values()) or 1.0
    functions = {name: own / ticks for name, own in functions.items()}
    shares = _scaled(statements, functions)
    active = {site: row[1] / (row[0] * lanes) for site, row in counts.items()}
    sampling, used = reached(source, SAMPLING), sum(shares.values()) or 1.0
    busy = {site: share * active.get(site, 1.0) for site, share in shares.items()}
    return Code(
        lanes,
        sum(profile.ticks for profile in profiles),
        sum(profile.seconds for profile in profiles),
        _listed(counts, lambda site: "" if site.line else site.function, functions, lanes),
        _listed(counts, line_of, _by_line(shares), lanes),
        1.0 - sum(busy.values()) / used,
        sum(share for site, share in busy.items() if site.function in sampling) / used,
        lines_of(source),
    )


def line_of(site: Site) -> str:
    """Return file:line of a statement; "" for a function."""
    return f"{site.file}:{site.line}" if site.line else ""


def _scaled(statements: dict[Site, float], functions: dict[str, float]) -> dict[Site, float]:
    """Return the shares of statements, so that those of a function sum to its own."""
    sums: dict[str, float] = {}
    for site, ticks in statements.items():
        sums[site.function] = sums.get(site.function, 0.0) + ticks
    return {
        site: functions.get(site.function, 0.0) * ticks / sums[site.function]
        for site, ticks in statements.items()
        if sums[site.function]
    }


def _by_line(shares: dict[Site, float]) -> dict[str, float]:
    found: dict[str, float] = {}
    for site, share in shares.items():
        found[line_of(site)] = found.get(line_of(site), 0.0) + share
    return found


def _listed(
    counts: dict[Site, NDArray[np.int64]], name_of: Callable[[Site], str], shares: dict[str, float], lanes: int
) -> list[Share]:
    """Return what has been executed, by name, from the largest share on."""
    rows: dict[str, list[NDArray[np.int64]]] = {}
    for site, row in counts.items():
        if name := name_of(site):
            rows.setdefault(name, []).append(row)
    found = []
    for name, each in rows.items():
        most, total = max(each, key=lambda row: int(row[0])), np.sum(each, axis=0)
        idle = 1.0 - float(total[1]) / (float(total[0]) * lanes)
        found.append(Share(name, int(most[0]), int(most[1]), idle, shares.get(name, 0.0)))
    return sorted(found, key=lambda one: (-one.share, one.name))


def lines_of(source: ShaderSource) -> dict[str, dict[int, str]]:
    """Return the lines of each file of an assembled shader, by their numbers."""
    found: dict[str, dict[int, str]] = {}
    file, number = source.names[0], 1
    for line in source.text.splitlines():
        if match := re.fullmatch(r"#line (\d+) (\d+)", line):
            file, number = source.names[int(match[2])], int(match[1])
            continue
        found.setdefault(file, {})[number] = line
        number += 1
    return found
