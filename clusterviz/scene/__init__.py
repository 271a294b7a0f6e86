"""Scene description: frozen values that are read from YAML or JSON, validated, completed and written back.

Nothing here reads voxels, or imports OpenGL or MPI. The names below are found when they are asked for, since the kinds
of content import modules of this package, and it theirs.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clusterviz.content.volume.info import VolumeInfo as VolumeInfo
    from clusterviz.scene.background import background_rgb as background_rgb
    from clusterviz.scene.files import dump_scene as dump_scene
    from clusterviz.scene.files import load_scene as load_scene
    from clusterviz.scene.files import scene_of_data as scene_of_data
    from clusterviz.scene.files import scene_schema as scene_schema
    from clusterviz.scene.overrides import parse_overrides as parse_overrides
    from clusterviz.scene.transfer import TransferFunction as TransferFunction
    from clusterviz.scene.values import Camera as Camera
    from clusterviz.scene.values import Cluster as Cluster
    from clusterviz.scene.values import ImageSettings as ImageSettings
    from clusterviz.scene.values import Quality as Quality
    from clusterviz.scene.values import Scene as Scene
    from clusterviz.scene.values import Volume as Volume

HOMES = {
    "content.volume.info": ("VolumeInfo",),
    "scene.background": ("background_rgb",),
    "scene.files": ("dump_scene", "load_scene", "scene_of_data", "scene_schema"),
    "scene.overrides": ("parse_overrides",),
    "scene.transfer": ("TransferFunction",),
    "scene.values": ("Camera", "Cluster", "ImageSettings", "Quality", "Scene", "Volume"),
}


def __getattr__(name: str) -> Any:
    for module, names in HOMES.items():
        if name in names:
            return getattr(import_module(f"clusterviz.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
