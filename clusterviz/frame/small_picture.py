"""A small picture of a scene, from which settings are chosen, and how one is asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from clusterviz.frame.run import Image
from clusterviz.plan.plan import Filter
from clusterviz.scene.values import Scene


@dataclass(frozen=True)
class SmallPicture:
    """A picture that was asked for; the same on every rank but for the image.

    Attributes
    ----------
    image : on rank 0 only
    samples : that all ranks took
    seconds : of drawing, on the slowest rank
    filter : of the plan
    is_textured : whether all ranks draw by OpenGL
    """

    image: Image | None
    samples: int
    seconds: float
    filter: Filter
    is_textured: bool


Draw = Callable[[Scene], SmallPicture]
"""Draws the picture of a scene whose settings are given; collective."""
