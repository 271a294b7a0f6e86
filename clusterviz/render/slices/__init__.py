"""Slices drawn as polygons by OpenGL's graphics pipeline, by each of the generators of plan/slices.

The renderer of `quality.renderer: slices` is the ray caster, which samples the same planes on CPUs and GPUs, with all
that a scene may hold. What is here draws one composited volume as the thesis did, to compare the generators.
"""

from __future__ import annotations

from clusterviz.render.slices.drawing import Drawn, SliceDrawing

__all__ = ["Drawn", "SliceDrawing"]
