"""Surface LIC of a frame: what it adds to the picture, from the layers that the ranks have found.

    layers of each rank -> vectors there -> exchange in bands of rows -> LIC -> change of the picture, on rank 0

The light of a surface is multiplied by the pattern; what is in front of it keeps its colours, and so does a surface
beyond the vectors. A surface with which the opacity of a pixel does not pass one half keeps them, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite import TileCollector
from clusterviz.content.flow.opening import OpenedFlow
from clusterviz.content.flow.section import FlowSection, Lic
from clusterviz.data.source import Grid
from clusterviz.flow.cells import Cells
from clusterviz.flow.lic import line_weights
from clusterviz.flow.surface_lic import (
    Convolution,
    SurfacePixels,
    VectorSamples,
    change,
    convolved,
    exchange,
    points_of,
    screen_directions,
    stretched,
)
from clusterviz.frame.run import Image, Run
from clusterviz.image.partial import PartialImage, Rect
from clusterviz.jobs.device import devices_of, on_device
from clusterviz.plan.view import View, make_view
from clusterviz.render.crossing import FoundLayers
from clusterviz.scene.background import background_rgb
from clusterviz.scene.colormaps import colour_points
from clusterviz.scene.transfer import interpolate
from clusterviz.scene.values import Scene

WORLD = Grid((1, 1, 1))
STRENGTH = 0.7
"""Default share of a surface's light that the pattern takes where it is darkest."""


class SurfacePainter:
    """Painter of the surface LIC of a loop's frames; it keeps the vectors that it has read near the surfaces."""

    def __init__(self, run: Run, flows: Sequence[OpenedFlow]) -> None:
        each = (flow.vectors for flow in flows)
        self._samples = [None if isinstance(vectors, Cells) else VectorSamples(vectors) for vectors in each]
        with run.collective("open", "load"):
            local_rank = run.channel.placement().local_rank
        with run.local("open", "load"):
            self._device = devices_of(None if run.options.device is None else [run.options.device], local_rank)[0]

    def paint(self, run: Run, scene: Scene, layers: Sequence[FoundLayers]) -> Image | None:
        """Return what is added to the picture, float32 (h, w, 4), on rank 0; see `Painter`."""
        size = scene.image.size
        view = make_view(scene.camera, size, WORLD)
        total: Image | None = None
        for flow, samples in zip(scene.flows, self._samples, strict=True):
            if flow.show != "surface-lic" or samples is None:
                continue
            with run.local("render", "render"):
                pixels = _found(view, layers, objects_of(scene, flow), samples)
            # Each rank convolves a band of rows, for which it needs the pixels of others in and near it.
            lic = flow.lic or Lic()
            weights = line_weights(lic.kernel, lic.length, lic.step)
            convolution = Convolution(weights, lic.step, lic.integrator, lic.blur, lic.seed, lic.phase)
            with run.collective("composite", "exchange"):
                begin, end, pixels = exchange(run.channel, pixels, size, convolution.halo)
            with run.local("render", "render"), on_device(self._device):
                values = convolved(view, samples.source.grid, pixels, (begin, end), convolution)
            with run.collective("composite", "exchange"):
                values = stretched(run.channel, values) if lic.contrast else values
                strength = flow.opacity if isinstance(flow.opacity, float) else STRENGTH
                added = change(pixels, values, begin, strength, _tints(flow, pixels.speed))
                # Rank 0 collects the bands.
                band = PartialImage(Rect(0, begin, size[0], end), np.pad(added, ((0, 0), (0, 0), (0, 1))))
                found, _ = TileCollector(run.channel, size, codec="raw").collect([band] if end > begin else [])
            if found is not None:
                total = np.array(found, np.float32) if total is None else total + np.asarray(found, np.float32)
        return total


def objects_of(scene: Scene, flow: FlowSection) -> list[int]:
    """Return the numbers, as in the layer `object`, of the isosurfaces and meshes that a flow is shown on."""
    found, first = list[int](), 0
    for key, section in scene.entries.items():
        if key.startswith(("volumes", "meshes")) and (flow.surfaces is None or key in flow.surfaces):
            # Volumes come before their isosurfaces.
            found += range(first + (section.drawn_as == "samples"), first + section.objects)
        first += section.objects
    return found


def _found(view: View, layers: Sequence[FoundLayers], objects: Sequence[int], samples: VectorSamples) -> SurfacePixels:
    """Return the pixels of some objects that this rank has found, with their vectors."""
    width, parts = view.size[0], list[NDArray[np.int32]]()
    for each in layers:
        where, normals, light = (np.asarray(one.rgba, np.float32) for one in each)
        there: NDArray[np.bool_] = np.asarray((where[..., 3] > 0) & np.isin(where[..., 1], objects))
        rows, columns = np.nonzero(there)
        rows, columns = rows + each[0].rect.y_begin, columns + each[0].rect.x_begin
        depth, normal = where[there, 0], normals[there, :3]
        vectors = samples.at(points_of(view, columns, rows, depth))
        direction = screen_directions(view, columns, rows, depth, normal, vectors)
        speed = np.sqrt((vectors * vectors).sum(axis=1)).astype(np.float32)
        numbers = (rows * width + columns).astype(np.int32)
        found = SurfacePixels(numbers, depth, normal, direction, speed, light[there, :3])
        parts.append(found.words(~np.isnan(speed)))
    return SurfacePixels.from_words(np.concatenate([np.zeros(0, np.int32), *parts]))


def _tints(flow: FlowSection, speed: NDArray[np.float32]) -> NDArray[np.float32]:
    if flow.color_by == "color":
        return np.broadcast_to(np.array(background_rgb(flow.color) or (1, 1, 1), np.float32), (len(speed), 3))
    assert flow.clim is not None, "the scene is completed"
    return interpolate(speed, *colour_points(flow.cmap, flow.clim)).astype(np.float32)
