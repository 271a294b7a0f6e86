"""Slices of one composited volume, drawn in two ways that are compared with the ray caster.

The renderer of `quality.renderer: slices` is the ray caster, which samples the same planes on CPUs and GPUs, with all
that a scene may hold.

- drawing.py   polygons by OpenGL's graphics pipeline, by each of the generators of plan/slices
- adaptive.py  adaptive sampling in three dimensions, by kernels
"""

from __future__ import annotations

from clusterviz.render.slices.adaptive import AdaptivePicture, draw_adaptively
from clusterviz.render.slices.drawing import Drawn, SliceDrawing

__all__ = ["AdaptivePicture", "Drawn", "SliceDrawing", "draw_adaptively"]
