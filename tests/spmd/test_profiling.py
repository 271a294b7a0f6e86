"""Profiles of generated code against counts by hand."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.spmd.ir import PROFILE_BLOCK
from clusterviz.spmd.machine_code import addresses
from clusterviz.spmd.profiling import Mode, Site, instrument
from clusterviz.spmd.source import ShaderSource

SHADER = """layout(std430, binding = 0) readonly buffer GivenBlock { int given[]; };
layout(std430, binding = 1) writeonly buffer FoundBlock { int found[]; };
int next(int x) {
    if (x % 2 == 0)
        return x / 2;
    return 3 * x + 1;
}
int steps(int x) {
    int n = 0;
    while (x > 1 && n < 40) {
        x = next(x);
        ++n;
    }
    return n;
}
void main() {
    int x = given[gl_LocalInvocationIndex];
    if (x > 50)
        found[gl_LocalInvocationIndex] = steps(x);
}
"""
LINES = {text.strip(): number for number, text in enumerate(SHADER.splitlines(), start=1)}


def sequence(x: int) -> list[int]:
    """The numbers from which a step goes on."""
    found: list[int] = []
    while x > 1 and len(found) < 40:
        found.append(x)
        x = 3 * x + 1 if x % 2 else x // 2
    return found


def profiled(given: np.ndarray, lanes: int, mode: Mode) -> tuple[dict[Site, np.ndarray], np.ndarray]:
    """Counters by site, and what was found."""
    code = instrument(ShaderSource(SHADER, ("c:1/steps.glsl",)), "profiled", lanes, mode)
    counters, found, system = code.counters(), np.full(len(given), -1, np.int32), np.zeros(7, np.uint32)
    table = addresses({}, {0: given, 1: found}, system)
    table[PROFILE_BLOCK] = counters.ctypes.data
    for system[6] in range(0, len(given), lanes):
        code.call(table.ctypes.data)
    return dict(zip(code.sites, counters, strict=True)), found


@pytest.mark.parametrize("lanes", [16, 4, 1])
def test_statements_are_counted_by_packet_and_by_lane(lanes: int) -> None:
    given = np.random.default_rng(5).permutation(100).astype(np.int32)[:96]
    each = [sequence(int(x)) if x > 50 else [] for x in given]
    counters, found = profiled(given, lanes, "counts")
    assert found.tolist() == [len(own) if x > 50 else -1 for x, own in zip(given, each, strict=True)]

    packets = [each[begin : begin + lanes] for begin in range(0, len(each), lanes)]
    longest, total = sum(max(map(len, packet)) for packet in packets), sum(map(len, each))
    taken = [int((given[begin : begin + lanes] > 50).sum()) for begin in range(0, len(given), lanes)]
    even = sum(x % 2 == 0 for own in each for x in own)
    expected = {
        ("main", "int x = given[gl_LocalInvocationIndex];"): (len(packets), len(given)),
        ("main", "found[gl_LocalInvocationIndex] = steps(x);"): (sum(map(bool, taken)), sum(taken)),
        ("steps", "while (x > 1 && n < 40) {"): (longest + sum(map(bool, taken)), total + sum(taken)),
        ("steps", "++n;"): (longest, total),
        ("steps", "return n;"): (sum(map(bool, taken)), sum(taken)),
        ("next", "return x / 2;"): (None, even),
        ("next", "return 3 * x + 1;"): (None, total - even),
    }
    for (function, text), (executions, active) in expected.items():
        (site,) = (row for site, row in counters.items() if (site.function, site.line) == (function, LINES[text]))
        assert site[1] == active, text
        assert executions is None or site[0] == executions, text
    assert counters[Site("next")][:2].tolist() == [longest, total]


@pytest.mark.parametrize("mode", ["functions", "lines"])
def test_cycles_are_charged_to_what_is_executed(mode: Mode) -> None:
    given = np.arange(51, 67, dtype=np.int32)
    counters, found = profiled(given, 16, mode)
    assert found.tolist() == [len(sequence(int(x))) for x in given]
    cycles = {site: found[2] for site, found in counters.items() if found[2]}
    assert {site.function for site in cycles} >= {"main", "steps"}
    assert all((site.line == 0) == (mode == "functions") for site in cycles if site.function)
    assert min(cycles.values()) > 0
    # `next` costs less than a look at the counter, so that its callers pay for it.
    assert "next" not in {site.function for site in cycles}
