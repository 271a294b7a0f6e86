"""The order of merging on one rank: all that comes together in one range, blended in one pass where that can be.

Over is associative but not commutative, and rounding makes it, like sums, not even quite associative. So that the
picture does not depend on who is early, the order is fixed: what lies from this rank's own layers on to the back, front
to back; what lies before them, front to back; then the one over the other. What was blended is kept in float32 and
rounded once. What has come in line is merged while other messages travel, if there is enough to be worth a pass.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clusterviz.composite.fragment import Fragment, merge_in_place
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.composite.patch import Patch
from clusterviz.composite.traffic import Merge, Part
from clusterviz.image.merge import Operator

# So many layers in line are merged before the rest has come; fewer would cost more passes than they spare waiting.
LAYERS_AT_ONCE = 4


class Merging:
    """The merge of one range under way.

    Parameters
    ----------
    merge : what comes together
    own : this rank's fragments, one for each part of the zone
    dtype : of the pixels
    operator : how two of them become one
    """

    def __init__(self, merge: Merge, own: list[Fragment], dtype: np.dtype[Any], operator: Operator = "over") -> None:
        self._result = merge.result
        self._dtype, self._operator = dtype, operator
        parts = sorted((*merge.zone.parts, *merge.incoming), key=lambda part: (part.depth, part.patch.begin))
        self._before = _Line([part for part in parts if part.depth < merge.depth])
        self._behind = _Line([part for part in parts if part.depth >= merge.depth])
        self._missing = len(merge.incoming)
        for part, fragment in zip(merge.zone.parts, own, strict=True):
            self._behind.put(part, Layer(fragment.patch, fragment.pixels))

    @property
    def result(self) -> Patch:
        """The patch that holds everything in the end."""
        return self._result

    def add(self, part: Part, layer: Layer) -> None:
        """Take in what has arrived."""
        (self._before if part in self._before.parts else self._behind).put(part, layer)
        self._missing -= 1

    def advance(self) -> None:
        """Merge what is next in line, while other messages are on their way."""
        if self._missing:
            for line in (self._behind, self._before):
                line.fold(self._result, self._operator)

    def finish(self) -> Fragment:
        """The merged range, after everything has come."""
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
        """Two dense layers as one, where one of them can hold the result."""
        types = {front.pixels.dtype, back.pixels.dtype}
        if front.runs is not None or back.runs is not None or types != {self._dtype}:
            return None
        near, far = Fragment(front.patch, front.pixels), Fragment(back.patch, back.pixels)
        return merge_in_place(near, far, self._result, self._operator)

    def _is_result(self, layer: Layer) -> bool:
        return layer.runs is None and layer.patch == self._result and layer.pixels.dtype == self._dtype


class _Line:
    """Layers one behind the other, from front to back; a place is None until its layer has come."""

    def __init__(self, parts: list[Part]) -> None:
        self.parts = {part: index for index, part in enumerate(parts)}
        self._places: list[Layer | None] = [None] * len(parts)
        self._folded = 0
        self._front: Layer | None = None

    def put(self, part: Part, layer: Layer) -> None:
        """Fill a place."""
        self._places[self.parts[part]] = layer

    def fold(self, patch: Patch, operator: Operator) -> None:
        """Merge the layers that have come without a gap from the front on."""
        ready = self._folded
        while ready < len(self._places) and self._places[ready] is not None:
            ready += 1
        if ready - self._folded >= LAYERS_AT_ONCE:
            pixels = np.empty((patch.count, 4), np.float32)
            blend_layers(self.layers(ready), patch, pixels, operator=operator)
            self._places[self._folded : ready] = [None] * (ready - self._folded)
            self._front, self._folded = Layer(patch, pixels), ready

    def layers(self, end: int | None = None) -> list[Layer]:
        """What there is before a place, front to back."""
        rest = [layer for layer in self._places[self._folded : end] if layer is not None]
        return [self._front, *rest] if self._front else rest
