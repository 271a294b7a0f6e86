"""Front to back: how runs of what emits and absorbs are put behind what is there; the twin of over.glsl."""

from __future__ import annotations

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import Value, Vector
from clusterviz.render.cpu.blending.samples import add_exactly
from clusterviz.render.cpu.marching.march import Four, Variables


def take_sample(code: Code, sums: Variables, seen: Value, opacity: Value, colour: Vector) -> None:
    """Put a sample behind those of its run, where it is seen; `colour` is straight."""
    weight = code.select(seen, (1.0 - sums[3].now) * opacity, 0.0)
    for part, channel in zip(sums, colour, strict=False):
        part.set(code.select(seen, code.fma(weight, channel, part.now), part.now))
    sums[3].set(sums[3].now + weight)


def put_behind(code: Code, kept: Variables, run: Four, drawn: Value) -> None:
    """Add a run behind what is kept, where it is drawn."""
    rest = 1.0 - kept[3].now
    r, g, b, a = (rest * part for part in run)
    add_exactly(code, kept, (r, g, b, a), drawn)


def too_little_left(kept: Variables, residual: Value) -> Value:
    """Where so little light is left that the scene allows to stop."""
    return 1.0 - kept[3].now <= residual
