"""Rectangles against sets of pixels."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from clusterviz.image import EMPTY, Rect, blank

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
