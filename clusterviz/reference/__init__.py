"""Float64 reference of the renderer: plain NumPy implementations with which tests compare the fast paths.

- rays.py           rays of the camera, and their part in the volume
- slabs.py          slabs of rays
- sample.py         trilinear and nearest interpolation, cubic B-splines
- grading.py        gradient opacity and 2-D transfer functions
- lighting.py       gradients and lights
- projections.py    maximum, minimum, local maximum, average, sum
- surfaces.py       isosurfaces
- intersections.py  intersections with triangles, spheres and tubes
- fragments.py      meshes, lines and points
- cells.py          unstructured grids
- preintegrated.py  pre-integrated classification
- multi_volume.py   several volumes, and geometry
- layers.py         layers beside the colours
- raycast.py        picture of a scene, also by a thin lens
- over.py           compositing of layers
"""

from __future__ import annotations

from clusterviz.reference.over import over
from clusterviz.reference.raycast import reference_layers, render_lens, render_reference

__all__ = ["over", "reference_layers", "render_lens", "render_reference"]
