"""Room 1, what to show: frozen values, read from YAML and written to it; no voxels, no GL, no MPI.

values         the scene: volumes, camera, image, quality, cluster
checks         what a type cannot express
complaints     errors as a user reads them: file, key, found, allowed
files          YAML or JSON to a scene, a scene to YAML, the schema
overrides      -D key=value
yaml_text      YAML with no key twice, in which 1e-3 is a number
background     the colour behind everything
colormaps      names, presets and points to control points of colour
paraview       ParaView's preset files
colour_spaces  the spaces in which ParaView interpolates
opacity        numbers, presets and points to control points of opacity
transfer       the transfer function: colour and opacity of a scalar
automatic      how a bare data file is shown
complete       the scene with every open choice made
camera         the camera by words, and the one that sees everything
unseen         why a picture is empty
"""

from __future__ import annotations

from clusterviz.scene.background import background_rgb
from clusterviz.scene.complete import VolumeFacts, complete_scene, transfer_function
from clusterviz.scene.files import dump_scene, load_scene, open_scene, scene_of_data, scene_schema
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
    "VolumeFacts",
    "background_rgb",
    "complete_scene",
    "dump_scene",
    "load_scene",
    "open_scene",
    "parse_overrides",
    "scene_of_data",
    "scene_schema",
    "transfer_function",
]
