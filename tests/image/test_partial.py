"""Rectangles against sets of pixels, and the merge operators against their definitions on sequences of samples."""

from __future__ import annotations

from functools import reduce

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.image import EMPTY, Rect, blank
from clusterviz.image.merge import CLOSED, EXISTS, MERGES, STARTS, merge_partials
from clusterviz.image.partial import PartialImage

ends = st.integers(-1, 4)
rects = st.builds(Rect, ends, ends, ends, ends)


def pixels(rect: Rect) -> set[tuple[int, int]]:
    return {(x, y) for x in range(rect.x_begin, rect.x_end) for y in range(rect.y_begin, rect.y_end)}


@given(rects, rects)
def test_rectangles_behave_as_sets_of_pixels(a: Rect, b: Rect) -> None:
    assert a.pixels == len(pixels(a))
    assert pixels(a.intersect(b)) == pixels(a) & pixels(b)
    assert pixels(a) | pixels(b) <= pixels(a.unite(b))


@given(rects, rects)
def test_the_union_is_the_smallest(a: Rect, b: Rect) -> None:
    both = pixels(a) | pixels(b)
    united = pixels(a.unite(b))
    if both:
        assert {x for x, _ in united} == set(range(min(x for x, _ in both), max(x for x, _ in both) + 1))
        assert {y for _, y in united} == set(range(min(y for _, y in both), max(y for _, y in both) + 1))
    else:
        assert not united


def test_blank_has_no_pixels() -> None:
    assert blank().rect == EMPTY
    assert blank().rgba.shape == (0, 0, 4)


THRESHOLD = 0.5
SAMPLES = st.lists(st.one_of(st.none(), st.floats(-1, 1, width=32)), max_size=8)


def sample(operator: str, s: float | None) -> np.ndarray:
    """Return the pixel of one sample; None is an invalid one."""
    if s is None:
        return np.zeros(4)
    if operator == "over":
        return np.array([abs(s) * 0.5, 0, 0, abs(s)])
    if operator == "run":
        above = s >= THRESHOLD
        return np.array([s if above else 0.0, s, STARTS | EXISTS if above else 0, 1])
    return np.array([s, 0, 0, 1])


def stretch_by_hand(values: list[float]) -> tuple[float | None, float]:
    """Return the largest sample of the first run, or None, and the largest of all."""
    begin = next((k for k, s in enumerate(values) if s >= THRESHOLD), None)
    if begin is None:
        return None, max(values)
    end = next((k for k in range(begin, len(values)) if values[k] < THRESHOLD), len(values))
    return max(values[begin:end]), max(values)


@pytest.mark.cover
@pytest.mark.parametrize("operator", MERGES)
@given(parts=st.lists(SAMPLES, min_size=2, max_size=5))
def test_cuts_and_brackets_do_not_matter(operator: str, parts: list[list[float | None]]) -> None:
    merge, blank = MERGES[operator], np.zeros((1, 4))
    pixels = [[sample(operator, s)[None] for s in part] for part in parts]
    plain = reduce(merge, [p for part in pixels for p in part], blank)
    folded = [reduce(merge, part, blank) for part in pixels]
    for found in (reduce(merge, folded), reduce(lambda behind, front: merge(front, behind), folded[::-1])):
        np.testing.assert_allclose(found, plain, atol=1e-12)
    values = [s for part in parts for s in part if s is not None]
    assert bool(plain[0, 3]) == any(operator != "over" or s for s in values)
    if not values:
        return
    if operator in ("maximum", "minimum"):
        assert plain[0, 0] == {"maximum": max, "minimum": min}[operator](values)
    if operator == "sum":
        assert plain[0] == pytest.approx([sum(values), 0, 0, len(values)])
    if operator == "run":
        first, largest = stretch_by_hand(values)
        assert plain[0, 1] == largest
        assert bool(int(plain[0, 2]) & EXISTS) == (first is not None)
        assert first is None or plain[0, 0] == first
        assert bool(int(plain[0, 2]) & STARTS) == (values[0] >= THRESHOLD)
        assert not int(plain[0, 2]) & CLOSED or first is not None


def test_parts_lie_where_their_rectangles_are() -> None:
    front = PartialImage(Rect(0, 0, 2, 1), np.full((1, 2, 4), (3, 0, 0, 1), np.float32))
    behind = PartialImage(Rect(1, 0, 3, 1), np.full((1, 2, 4), (5, 0, 0, 1), np.float32))
    assert merge_partials([front, behind], (4, 2), "maximum")[..., 0].tolist() == [[3, 5, 5, 0], [0, 0, 0, 0]]
    assert merge_partials([front, behind], (4, 2), "minimum")[..., 0].tolist() == [[3, 3, 5, 0], [0, 0, 0, 0]]
