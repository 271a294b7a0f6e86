"""Where the field is the value of an isosurface, between two places in a cell: the twin of root.glsl.

References
----------
M. Dowell, P. Jarratt: A modified regula falsi method for computing the root of an equation, BIT 11, 1971 (the Illinois
method).
"""

from __future__ import annotations

from collections.abc import Callable

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import I32, Value
from clusterviz.render.cpu.blending.cubic_along_ray import Mark

REFINEMENTS = 10  # as in root.glsl
NEAR = 2.0**-20  # slabs; two guesses that are no farther apart end the search


def root(code: Code, field: Callable[[Value], Value], value: Value, sides: tuple[Mark, Mark], wanted: Value) -> Value:
    """Where on ways through cells the field is a value.

    That is where it begins, if it is on the same side there as behind: then it has jumped from the cell before. A ray
    that has its root keeps it while others of its packet look on.

    Parameters
    ----------
    field : somewhere on them
    sides : two places
    wanted : which rays look for a root
    """
    low, high = sides
    (a, above_a), (b, above_b) = ((Variable(side.along), Variable(side.s - value)) for side in sides)
    jumps = ~((low.s < value) ^ (high.s < value))
    c, last = Variable(code.select(jumps, low.along, high.along)), Variable(code.same(I32, 0))
    looking, number = Variable((wanted & ~jumps).to(I32)), Variable(code.number(I32, 0))
    with code.loop(lambda: code.any(looking.now > 0) & (number.now < REFINEMENTS)):
        goes_on = looking.now > 0
        guess = _between(code, (a.now, above_a.now), (b.now, above_b.now))
        above = field(guess) - value
        far = code.size(guess - c.now) > NEAR
        c.set(code.select(goes_on, guess, c.now))
        # The end on the guess's side moves; the other one counts half where it has stayed twice.
        behind = ~((above < 0.0) ^ (above_b.now < 0.0))
        side = code.select(behind, code.same(I32, 1), -1)
        share = code.select(last.now.equals(side), code.same(above.element, 0.5), 1.0)
        moves_b, moves_a = goes_on & behind, goes_on & ~behind
        above_a.set(code.select(moves_a, above, code.select(moves_b, above_a.now * share, above_a.now)))
        above_b.set(code.select(moves_b, above, code.select(moves_a, above_b.now * share, above_b.now)))
        a.set(code.select(moves_a, guess, a.now))
        b.set(code.select(moves_b, guess, b.now))
        last.set(side)
        looking.set((goes_on & far & ~above.equals(0.0)).to(I32))
        number.set(number.now + 1)
    return c.now


def _between(code: Code, first: tuple[Value, Value], second: tuple[Value, Value]) -> Value:
    """Where a straight line between two sides is 0."""
    (a, above_a), (b, above_b) = first, second
    rise = above_b - above_a
    flat = rise.equals(0.0)
    return code.select(flat, b, (a * above_b - b * above_a) / code.select(flat, 1.0, rise))
