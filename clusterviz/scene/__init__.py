"""Room 1, what to show: frozen values, read from YAML and written to it; no voxels, no GL, no MPI.

values       the scene: volumes, camera, image, quality, cluster
checks       what a type cannot express
background   the colour behind everything
opacity      opacity presets and points
"""

from __future__ import annotations

from clusterviz.scene.background import background_rgb
from clusterviz.scene.values import Camera, Cluster, ImageSettings, Quality, Scene, Volume

__all__ = ["Camera", "Cluster", "ImageSettings", "Quality", "Scene", "Volume", "background_rgb"]
