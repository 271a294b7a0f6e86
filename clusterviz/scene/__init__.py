"""Scene description: frozen values that are read from YAML or JSON, validated, completed and written back.

Nothing here reads voxels, or imports OpenGL or MPI.
"""

from __future__ import annotations

from clusterviz.scene.background import background_rgb
from clusterviz.scene.complete import VolumeInfo, complete_scene, transfer_function
from clusterviz.scene.files import dump_scene, load_scene, scene_of_data, scene_schema
from clusterviz.scene.overrides import parse_overrides
from clusterviz.scene.transfer import TransferFunction
from clusterviz.scene.values import Camera, Cluster, ImageSettings, Quality, Scene, Volume

__all__ = [
    "Camera",
    "Cluster",
    "ImageSettings",
    "Quality",
    "Scene",
    "TransferFunction",
    "Volume",
    "VolumeInfo",
    "background_rgb",
    "complete_scene",
    "dump_scene",
    "load_scene",
    "parse_overrides",
    "scene_of_data",
    "scene_schema",
    "transfer_function",
]
