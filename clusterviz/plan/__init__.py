"""The plan of a frame, a pure function of the scene and of metadata of its volumes.

`make_plan` gives a `Plan`: the camera in index space, the sampling of rays, the blend mode, clipping planes, the
encoding of voxels, the transfer function as the shader reads it, and the cost of each brick. It is equal on all ranks.
The modules on accuracy choose settings that hold `quality.max_error`.
"""

from __future__ import annotations

from clusterviz.plan.blend_mode import BlendMode, make_blend_mode
from clusterviz.plan.encoding import Encoding, make_encoding
from clusterviz.plan.plan import March, Plan, make_plan
from clusterviz.plan.segments import Segments, make_segments
from clusterviz.plan.view import View, make_view

__all__ = [
    "BlendMode",
    "Encoding",
    "March",
    "Plan",
    "Segments",
    "View",
    "make_blend_mode",
    "make_encoding",
    "make_plan",
    "make_segments",
    "make_view",
]
