"""The looks of `examples/looks`, and of `wild.glsl`, in float64, for the reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clusterviz.reference.grading import LOOKS

FOLDER = Path(__file__).parents[2] / "examples" / "looks"
PATHS = {path.stem: str(path) for path in (*FOLDER.glob("*.glsl"), Path(__file__).with_name("wild.glsl"))}
Array = np.ndarray


def smoothstep(low: float, high: float, x: Array) -> Array:
    share = np.clip((x - low) / (high - low), 0, 1)
    return share * share * (3 - 2 * share)


def contours(value: Array, gradient: Array, position: Array) -> Array:
    share = np.mod(value / 0.1, 1.0)
    strength = smoothstep(0.0, 0.15, share) * (1 - smoothstep(0.25, 0.4, share))
    low, high = np.array([0.2, 0.3, 0.6]), np.array([1.0, 0.8, 0.3])
    return np.column_stack([low + (high - low) * value[:, None], 0.02 + 0.6 * strength])


def octants(value: Array, gradient: Array, position: Array) -> Array:
    near = 1 - smoothstep(0.2, 0.6, np.linalg.norm(position, axis=1))[:, None]
    colour = 0.25 + 0.7 * (position >= 0)
    return np.column_stack([colour + (1 - colour) * near, 0.5 * value * (1 - 0.9 * near[:, 0])])


def boundaries(value: Array, gradient: Array, position: Array) -> Array:
    steepness = np.linalg.norm(gradient, axis=1)
    colour = 0.5 + 0.5 * gradient / np.where(steepness > 0, steepness, 1)[:, None]
    share = np.minimum(steepness / 4.0, 1)
    return np.column_stack([colour, 0.7 * (share + share**2 + share**3) / 3])


def wild(value: Array, gradient: Array, position: Array) -> Array:
    """Of wild.glsl: NaN is 0, and a loop without an end has 253 iterations, as the one before has had three."""
    opaque = np.where(value < 0.5, 0.0, 1.0)
    return np.column_stack([np.full((len(value), 2), (0.5, 0.0)), np.full(len(value), 253 / 512), opaque])


LOOKS.update({PATHS[look.__name__]: look for look in (contours, octants, boundaries, wild)})
