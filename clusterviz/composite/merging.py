"""Merging of all layers of one range on one rank, in an order that does not depend on when messages arrive.

Over is associative but not commutative, and with rounding neither over nor sums are exactly associative. The order of
merging is therefore fixed: this rank's own layers and those behind them, front to back; the layers before them, front
to back; then the one result over the other. Intermediate results are float32 and rounded once. Layers that have
arrived without a gap are merged while other messages travel, if they are enough for a pass.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clusterviz.composite.fragment import Fragment, Patch
from clusterviz.composite.over import blend
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.composite.traffic import Merge, Part
from clusterviz.image.merge import Operator

# Fewest layers that are merged before the rest has arrived; smaller passes cost more time than they save waiting.
LAYERS_AT_ONCE = 4


class RangeMerge:
    """Merge of one range in progress.

    Parameters
    ----------
    merge : the layers to be merged
    own : this rank's fragments, one for each part of the zone
    dtype : pixel type
    operator : merge operator
    """

    def __init__(self, merge: Merge, own: list[Fragment], dtype: np.dtype[Any], operator: Operator = "over") -> None:
        self._result = merge.result
        self._dtype, self._operator = dtype, operator
        parts = sorted((*merge.zone.parts, *merge.incoming), key=lambda part: (part.depth, part.patch.begin))
        self._before = _OrderedLayers([part for part in parts if part.depth < merge.depth])
        self._behind = _OrderedLayers([part for part in parts if part.depth >= merge.depth])
        self._missing = len(merge.incoming)
        for part, fragment in zip(merge.zone.parts, own, strict=True):
            self._behind.put(part, Layer(fragment.patch, fragment.pixels))

    @property
    def result(self) -> Patch:
        """Patch of the merged layer."""
        return self._result

    def add(self, part: Part, layer: Layer) -> None:
        """Add a layer that has arrived."""
        (self._before if part in self._before.parts else self._behind).put(part, layer)
        self._missing -= 1

    def advance(self) -> None:
        """Merge the layers that are ready, while other messages travel."""
        if self._missing:
            for ordered in (self._behind, self._before):
                ordered.merge_ready(self._result, self._operator)

    def finish(self) -> Fragment:
        """Return the merged range, after all layers have arrived."""
        before, behind = self._before.layers(), self._behind.layers()
        layers = [*before, *behind]
        if len(layers) == 1 and self._is_result(layers[0]):
            return Fragment(self._result, layers[0].pixels)
        if len(layers) == 2 and (merged := self._in_place(*layers)):
            return merged
        pixels: Any = np.empty((self._result.count, 4), self._dtype)
        blend_layers(layers, self._result, pixels, operator=self._operator, split=len(before))
        return Fragment(self._result, pixels)

    def _in_place(self, front: Layer, back: Layer) -> Fragment | None:
        """Merge two dense layers in the memory of one of them, if that is possible."""
        types = {front.pixels.dtype, back.pixels.dtype}
        if front.runs is not None or back.runs is not None or types != {self._dtype}:
            return None
        near, far = Fragment(front.patch, front.pixels), Fragment(back.patch, back.pixels)
        return merge_in_place(near, far, self._result, self._operator)

    def _is_result(self, layer: Layer) -> bool:
        return layer.runs is None and layer.patch == self._result and layer.pixels.dtype == self._dtype


class _OrderedLayers:
    """Layers from front to back; a slot is None until its layer has arrived."""

    def __init__(self, parts: list[Part]) -> None:
        self.parts = {part: index for index, part in enumerate(parts)}
        self._slots: list[Layer | None] = [None] * len(parts)
        self._merged = 0
        self._front: Layer | None = None

    def put(self, part: Part, layer: Layer) -> None:
        """Store a layer in the slot of its part."""
        self._slots[self.parts[part]] = layer

    def merge_ready(self, patch: Patch, operator: Operator) -> None:
        """Merge the layers that have arrived without a gap, beginning in front."""
        ready = self._merged
        while ready < len(self._slots) and self._slots[ready] is not None:
            ready += 1
        if ready - self._merged >= LAYERS_AT_ONCE:
            pixels = np.empty((patch.count, 4), np.float32)
            blend_layers(self.layers(ready), patch, pixels, operator=operator)
            self._slots[self._merged : ready] = [None] * (ready - self._merged)
            self._front, self._merged = Layer(patch, pixels), ready

    def layers(self, end: int | None = None) -> list[Layer]:
        """Return the layers before slot `end`, front to back."""
        rest = [layer for layer in self._slots[self._merged : end] if layer is not None]
        return [self._front, *rest] if self._front else rest


def merge_in_place(front: Fragment, back: Fragment, result: Patch, operator: Operator) -> Fragment | None:
    """Merge two fragments in the memory of one that is writeable and has the result's patch; None if neither does."""
    if back.patch == result and back.pixels.flags.writeable:
        blend.put_before(back.pixels, back.patch, front.pixels, front.patch, operator=operator)
        return back
    if front.patch == result and front.pixels.flags.writeable:
        blend.put_behind(front.pixels, front.patch, back.pixels, back.patch, operator=operator)
        return front
    return None
