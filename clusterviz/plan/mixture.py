"""Several volumes in one scene, as the renderer needs them: a domain, and what of each volume is shown in it.

A slab lies in every volume that holds its midpoint. There the extinctions add up, κ = Σ κ_i, and the slab's colour is
that of what is in it, Σ κ_i c_i / Σ κ_i; its opacity is 1 − exp(−Σ κ_i d). So the volumes of a scene have no order.

References
----------
N. Max: Optical models for direct volume rendering, IEEE TVCG 1(2), 1995, sections 2 and 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.grid import Grid
from clusterviz.data.summary import VolumeSummary
from clusterviz.plan.clip import clip_planes
from clusterviz.plan.cut import Cut, make_cut, samples_in_bricks
from clusterviz.plan.domain import Domain, domain_layout, make_domain
from clusterviz.plan.encoding import Encoding, make_encoding
from clusterviz.plan.grading import make_grading
from clusterviz.plan.lattice import slab_units
from clusterviz.plan.look import (
    Look,
    is_graded,
    is_lit,
    is_preintegrated,
    make_look,
    margin_of,
    reach_of,
    spread_of,
)
from clusterviz.plan.preintegration import make_preintegrated
from clusterviz.plan.segments import Segments, make_segments
from clusterviz.plan.shading import make_shading
from clusterviz.scene.complete import transfer_function
from clusterviz.scene.transfer import TransferFunction
from clusterviz.scene.values import Scene, Volume


@dataclass(frozen=True, eq=False)
class KnownVolume:
    """A volume of a scene, as far as planning needs to know it.

    Attributes
    ----------
    grid, dtype : of its voxels
    layout : bricks of its own, over which it is summarised; their margin is at least `margin_of`'s
    summary : what it holds
    """

    grid: Grid
    dtype: np.dtype[Any]
    layout: BrickLayout
    summary: VolumeSummary


@dataclass(frozen=True, eq=False)
class Ingredient:
    """One volume of a mixture.

    Attributes
    ----------
    cut : which of its voxels a brick of the domain needs
    look : what depends on its gradient; its blending is composite
    encoding, transfer, segments : as in `Plan`
    interpolation : of its voxels
    spread : samples beyond a cell's corners on which the field in it depends
    slab_units : length of a slab in its opacity unit distances
    preintegrated : its slabs are classified between their ends, not at their midpoints
    """

    cut: Cut
    look: Look
    encoding: Encoding
    transfer: TransferFunction
    segments: Segments
    interpolation: Literal["linear", "nearest", "cubic"]
    spread: int
    slab_units: float
    preintegrated: bool = False


@dataclass(frozen=True, eq=False)
class Mixture:
    """Several volumes in one domain.

    Attributes
    ----------
    domain : the box around them
    ingredients : the volumes, in the order of the scene
    """

    domain: Domain
    ingredients: tuple[Ingredient, ...]

    @property
    def around(self) -> tuple[tuple[int, int], ...]:
        """Margin and reach of each volume's cut: portions that were read with others are of no use."""
        return tuple((part.cut.margin, part.cut.reach) for part in self.ingredients)


def make_mixture(
    scene: Scene, volumes: Sequence[KnownVolume], step_world: float
) -> tuple[Mixture, NDArray[np.float64]]:
    """What a completed scene shows of its volumes, and what it costs to draw each brick of the domain.

    Parameters
    ----------
    volumes : in the order of the scene
    step_world : length of a slab in world units

    Returns
    -------
    mixture, cost : float64 (bz, by, bx), the cells of all volumes; 0 where none has anything to show
    """
    domain = make_domain([known.grid for known in volumes])
    layout = domain_layout(domain, scene.cluster.brick)
    cost = np.zeros(layout.counts_zyx)
    ingredients = []
    for volume, known in zip(scene.volumes, volumes, strict=True):
        reach = reach_of(volume, scene.quality.classification)
        cut = make_cut(domain, layout, known.grid, margin_of(volume) - reach_of(volume), reach)
        part = _ingredient(volume, known, scene, cut, step_world)
        hidden = part.look.hides(part.transfer, known.summary.minimum, known.summary.maximum)
        cost += samples_in_bricks(part.cut, known.layout, hidden)
        ingredients.append(part)
    return Mixture(domain, tuple(ingredients)), cost


def _ingredient(volume: Volume, known: KnownVolume, scene: Scene, cut: Cut, step_world: float) -> Ingredient:
    transfer, planes = transfer_function(volume), clip_planes(scene.clip, known.grid) if scene.clip.cap else None
    preintegrated = is_preintegrated(volume, scene.quality.classification)
    return Ingredient(
        cut,
        make_look(
            volume,
            transfer,
            make_shading(volume, scene.lights, known.grid, transfer.unit_distance, planes) if is_lit(volume) else None,
            make_grading(volume, transfer.domain, known.grid) if is_graded(volume) else None,
        ),
        make_encoding(known.dtype, transfer.domain),
        transfer,
        # Extinctions are added, not opacities: the opacity of a unit length is what is needed, and that is linear.
        make_preintegrated(transfer) if preintegrated else make_segments(transfer, 1.0),
        volume.interpolation,
        spread_of(volume) - reach_of(volume),
        slab_units(step_world, transfer.unit_distance),
        preintegrated,
    )
