"""The witness room: plain float64 twins of the fast paths, which stay for ever and are compared in tests.

- rays.py         pixels to rays, rays to the box
- slabs.py        rays to slabs
- sample.py       trilinear and nearest look-up
- spline.py       cubic B-splines
- fields.py       all of these by name
- clipping.py     what planes and boxes keep
- lighting.py     gradients and lights
- projections.py  maximum, minimum, local maximum, average, sum
- surfaces.py     isosurfaces
- crossings.py    where rays cross them
- preintegrated.py  slabs that are classified between their ends
- mixture.py      several volumes
- raycast.py      the picture of a scene
- over.py         layers to one picture
"""

from __future__ import annotations

from clusterviz.reference.over import over
from clusterviz.reference.raycast import render_reference

__all__ = ["over", "render_reference"]
