"""The plan room: one frame's decisions, a pure function of the scene and of facts about the data.

- plan.py      the plan, and how it is made
- view.py      the camera in index space; footprints
- lattice.py   how long slabs are
- look.py      what becomes of the samples along a ray
- mixture.py   several volumes
- domain.py    the box around them, and its bricks
- cut.py       which of their voxels a brick needs
- shading.py   how a volume is lit
- clip.py      clipping planes in index space
- encoding.py  how voxels are stored
- segments.py  the transfer function as the shader reads it
- accuracy.py  which settings hold a bound on the error at least cost; estimate.py: by which errors; leftover.py: filter
  and pixels
- stretching.py  where slabs may be longer
- preintegration.py  the same for slabs that are classified between their ends
"""

from __future__ import annotations

from clusterviz.plan.blend_mode import BlendMode, make_blend_mode
from clusterviz.plan.encoding import Encoding, make_encoding
from clusterviz.plan.plan import March, Plan, make_multi_volume_plan, make_plan
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
    "make_multi_volume_plan",
    "make_plan",
    "make_segments",
    "make_view",
]
