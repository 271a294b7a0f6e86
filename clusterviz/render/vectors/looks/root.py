"""Where the field is the value of an isosurface, in slabs whose ends are on different sides of it: twin of root.glsl.

References
----------
M. Dowell, P. Jarratt: A modified regula falsi method for computing the root of an equation, BIT 11, 1971 (the Illinois
method).
"""

from __future__ import annotations

from dataclasses import dataclass

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import I32, Value, Vector
from clusterviz.render.vectors.fields.field import Spot
from clusterviz.render.vectors.looks.samples import LARGEST, Samples

REFINEMENTS = 10  # as in root.glsl
NEAR = 2.0**-20  # slabs; two guesses that are no farther apart end the search


@dataclass(frozen=True)
class Side:
    """One end of where a root is looked for.

    Attributes
    ----------
    along : slabs from the spot
    above : by how much the field there is more than the value
    """

    along: Value
    above: Value


def root(
    code: Code, samples: Samples, line: tuple[Spot, Vector], value: Value, sides: tuple[Side, Side], wanted: Value
) -> tuple[Value, Value]:
    """Where along lines the field is a value, and whether it was met: not where an invalid field is on the way.

    A ray that has its root keeps it while others of its packet look on.

    Parameters
    ----------
    line : spots, and slabs in index space
    sides : the field there is below the value and above it, or above and below
    wanted : which rays look for a root
    """
    spot, slab = line
    (a, above_a), (b, above_b) = ((Variable(side.along), Variable(side.above)) for side in sides)
    c, last = Variable(b.now), Variable(code.same(I32, 0))
    looking, met = Variable(wanted.to(I32)), Variable(wanted.to(I32))
    number = Variable(code.number(I32, 0))
    with code.loop(lambda: code.any(looking.now > 0) & (number.now < REFINEMENTS)):
        goes_on = looking.now > 0
        guess = _between(code, (a.now, above_a.now), (b.now, above_b.now))
        above = samples.at(samples.moved(spot, slab, guess)) - value
        fine = code.size(above) <= LARGEST
        far = code.size(guess - c.now) > NEAR
        c.set(code.select(goes_on, guess, c.now))
        met.set(code.select(goes_on & ~fine, 0, met.now))
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
        looking.set((goes_on & fine & far & ~above.equals(0.0)).to(I32))
        number.set(number.now + 1)
    return c.now, met.now > 0


def _between(code: Code, first: tuple[Value, Value], second: tuple[Value, Value]) -> Value:
    """Where a straight line between two sides is 0."""
    (a, above_a), (b, above_b) = first, second
    rise = above_b - above_a
    flat = rise.equals(0.0)
    return code.select(flat, b, (a * above_b - b * above_a) / code.select(flat, 1.0, rise))
