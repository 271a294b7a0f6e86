"""Float64 reference of the renderer: plain NumPy implementations with which tests compare the fast paths."""

from __future__ import annotations

from clusterviz.reference.over import over
from clusterviz.reference.raycast import reference_layers, render_lens, render_reference
