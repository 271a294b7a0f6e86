"""A patch with its pixels, and how two of them become one in place.

Pixels that the caller owns are read-only, and never written; whatever was received or merged is ours to change.
"""

from __future__ import annotations

from dataclasses import dataclass

from clusterviz.codec.contract import Pixels
from clusterviz.composite.over import blend
from clusterviz.composite.patch import Patch
from clusterviz.image.merge import Operator


@dataclass(frozen=True, eq=False)
class Fragment:
    """A patch and its pixels.

    Attributes
    ----------
    patch : which pixels of the canvas
    pixels : float32, float16 or uint8 (patch.count, 4), premultiplied, C order; writeable only if they are ours
    """

    patch: Patch
    pixels: Pixels

    def cut(self, patch: Patch) -> Fragment:
        """The part of this fragment that `patch` (from `Patch.cut`) names, without a copy."""
        if patch == self.patch:
            return self
        begin = patch.first - self.patch.first if patch.count else 0
        # The cut rectangle has lost rows above it, which its own count of earlier pixels no longer includes.
        lost = (patch.rect.y_begin - self.patch.rect.y_begin) * self.patch.rect.width if patch.count else 0
        return Fragment(patch, self.pixels[begin + lost : begin + lost + patch.count])


def merge_in_place(front: Fragment, back: Fragment, result: Patch, operator: Operator) -> Fragment | None:
    """Front merged with back in the pixels of whichever is the result's patch and ours; None where neither is."""
    if back.patch == result and back.pixels.flags.writeable:
        blend.put_before(back.pixels, back.patch, front.pixels, front.patch, operator=operator)
        return back
    if front.patch == result and front.pixels.flags.writeable:
        blend.put_behind(front.pixels, front.patch, back.pixels, back.patch, operator=operator)
        return front
    return None
