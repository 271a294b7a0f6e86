"""The texture unit's filter tried beside exact weights: what it adds to the error, and what it costs on this device.

How a unit rounds and how fast it is differ from device to device: on a GPU it may take a fraction of the time, in
software more than exact weights do. So nothing is assumed; both draw the same small picture.
"""

from __future__ import annotations

from clusterviz.comm import Channel
from clusterviz.frame.small_picture import Draw, SmallPicture
from clusterviz.plan.accuracy import SAFETY, Aim
from clusterviz.plan.estimate import apart, largest
from clusterviz.scene.values import Scene

TURNS = 3
"""Pictures of each that are timed; the fastest counts."""


class TextureUnit:
    """Pictures by the texture unit and by exact weights; every method is collective.

    Parameters
    ----------
    small : a small scene whose settings are given
    draw : a small picture

    Attributes
    ----------
    samples : that all of them took so far
    """

    def __init__(self, small: Scene, channel: Channel, draw: Draw) -> None:
        qualities = (small.quality.model_copy(update={"filter": name}) for name in ("exact", "hardware"))
        self._scenes = [small.model_copy(update={"quality": quality}) for quality in qualities]
        self._channel, self._draw = channel, draw
        self.samples = 0

    def error(self, aim: Aim) -> float:
        """What the texture unit adds to the error of the whole picture, estimated."""
        exact, textured = (self._drawn(scene).image for scene in self._scenes)
        added = 0.0
        if exact is not None and textured is not None:
            added = largest(apart(exact, textured), aim.pixels) * (2 * SAFETY if aim.jumps else SAFETY)
        return self._channel.broadcast(added)

    def share(self) -> float:
        """Its time beside that of exact weights, on the slowest rank."""
        fastest = []
        for scene in self._scenes:
            self._drawn(scene)  # compiles, and brings bricks as this filter has them stored
            fastest.append(min(self._drawn(scene).seconds for _ in range(TURNS)))
        return fastest[1] / max(fastest[0], 1e-9)

    def _drawn(self, scene: Scene) -> SmallPicture:
        drawn = self._draw(scene)
        self.samples += drawn.samples
        return drawn
