"""A scene and networks between whose modes automatic mode chooses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from clusterviz.comm import Channel
from clusterviz.composite.model.network import default_network
from clusterviz.data.memory import ArraySource
from clusterviz.frame import Options, Run
from clusterviz.frame.brick_reader import BrickReader
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.opening import Opened, open_content
from clusterviz.scene import Scene, Volume
from clusterviz.scene.overrides import with_settings

RANKS = 4
NODES = tuple((rank,) for rank in range(RANKS))
SLOW = replace(default_network(RANKS), seconds_per_byte=1e-6)
INSTANT = replace(default_network(RANKS), seconds_per_byte=0.0, message_seconds=0.0, frame_seconds=0.0)
OPAQUE = {"opacity": 1.0, "opacity_unit_distance": 60.0, "early_termination": 1 / 255}
SOURCE = ArraySource(np.random.default_rng(1).random((73, 73, 73), np.float32))
CPU = Options(device="cpu")


def scene_of(settings: dict[str, Any]) -> Scene:
    settings = {"size": (160, 120), "brick": 12, "clim": (0.0, 1.0), "opacity": 0.1} | settings
    return with_settings(Scene(volumes=(Volume(path="array"),)), settings)


def opened_on(channel: Channel, settings: dict[str, Any]) -> tuple[Run, Scene, Opened, Drawing]:
    """The complete scene and the volume on one rank, and what draws it."""
    run = Run(channel, CPU)
    scene, opened, bricks = open_content(run, scene_of(settings), SOURCE)
    assert opened is not None
    return run, scene, opened, Drawing(BrickReader(opened, bricks))
