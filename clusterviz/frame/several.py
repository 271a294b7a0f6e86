"""Several volumes of one scene, opened together: planned in their domain, and read brick of the domain by brick."""

from __future__ import annotations

from collections.abc import Iterator, Set
from dataclasses import dataclass
from typing import Any

import numpy as np

from clusterviz.data.bricks import read_bricks
from clusterviz.data.grid import Grid
from clusterviz.data.source import Index
from clusterviz.frame.share import Bricks, OpenedVolume
from clusterviz.plan.domain import make_domain
from clusterviz.plan.mixture import KnownVolume
from clusterviz.plan.plan import Plan, make_mixed_plan
from clusterviz.plan.portions import Portions
from clusterviz.scene.complete import VolumeInfo
from clusterviz.scene.values import Scene


@dataclass(frozen=True)
class OpenedVolumes:
    """What `OpenedVolume` is for one volume.

    Attributes
    ----------
    volumes : in the order of the scene
    held : bricks of the domain that this rank has read and may need, by index; not the same on every rank
    """

    volumes: tuple[OpenedVolume, ...]
    held: Bricks

    @property
    def grid(self) -> Grid:
        """In whose index space plans are."""
        return make_domain([volume.grid for volume in self.volumes]).grid

    @property
    def facts(self) -> tuple[VolumeInfo, ...]:
        """What completing a scene needs to know."""
        return tuple(fact for volume in self.volumes for fact in volume.facts)

    @property
    def range_type(self) -> np.dtype[Any]:
        """Of what is known of groups of cells."""
        return np.dtype(np.float64)

    def plan(self, scene: Scene) -> Plan:
        """One frame's decisions."""
        known = [KnownVolume(v.grid, v.source.dtype, v.layout, v.summary) for v in self.volumes]
        return make_mixed_plan(scene, known)

    def read(self, plan: Plan, wanted: Set[Index]) -> Iterator[tuple[Index, Portions]]:
        """Bricks of a plan, from all sources: volume after volume, each passed once."""
        if plan.mixture is None:
            raise ValueError("the plan is not one of several volumes")
        each = []
        for volume, part in zip(self.volumes, plan.mixture.ingredients, strict=True):
            met = part.cut.bricks_met()
            each.append(dict(read_bricks(volume.source, part.cut, [index for index in wanted if met[index]])))
        for index in wanted:
            yield index, Portions(index, tuple(samples.pop(index, None) for samples in each), plan.mixture.around)

    def fitting(self, plan: Plan) -> Bricks:
        """What is held and was read as a plan asks for."""
        around = plan.mixture.around if plan.mixture else ()
        return {index: portions for index, portions in self.held.items() if portions.around == around}


Opened = OpenedVolume | OpenedVolumes
