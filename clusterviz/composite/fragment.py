"""A patch with its pixels, and how two of them become one.

Pixels that the caller owns are never written: a fragment says whether it may be. Merging writes into whichever of the
two is large enough and may be written, and makes a new one only where neither is; the result is the same, bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clusterviz.codec.contract import Pixels
from clusterviz.composite import blend
from clusterviz.composite.patch import Patch


@dataclass(frozen=True, eq=False)
class Fragment:
    """A patch and its pixels.

    Attributes
    ----------
    patch : which pixels of the canvas
    pixels : float32 or uint8 (patch.count, 4), premultiplied, C order
    writable : whether the pixels are ours to change
    """

    patch: Patch
    pixels: Pixels
    writable: bool

    def cut(self, patch: Patch) -> Fragment:
        """The part of this fragment that `patch` (from `Patch.cut`) names, without a copy."""
        begin = patch.first - self.patch.first if patch.count else 0
        # The cut rectangle has lost rows above it, which its own count of earlier pixels no longer includes.
        lost = (patch.rect.y_begin - self.patch.rect.y_begin) * self.patch.rect.width if patch.count else 0
        return Fragment(patch, self.pixels[begin + lost : begin + lost + patch.count], self.writable)


def merge(front: Fragment, back: Fragment, result: Patch) -> Fragment:
    """Front over back, where `result` is a patch that contains both."""
    if back.patch.count == 0 or front.patch.count == 0:
        return front if front.patch.count else back
    if back.writable and back.patch.contains(front.patch):
        blend.put_before(back.pixels, back.patch, front.pixels, front.patch)
        return back
    if front.writable and front.patch.contains(back.patch):
        blend.put_behind(front.pixels, front.patch, back.pixels, back.patch)
        return front
    grown = _copy(back, result)
    blend.put_before(grown.pixels, grown.patch, front.pixels, front.patch)
    return grown


def grow(fragment: Fragment, patch: Patch) -> Fragment:
    """The fragment on a larger patch, transparent where it had no pixels."""
    return fragment if fragment.patch == patch else _copy(fragment, patch)


def _copy(fragment: Fragment, patch: Patch) -> Fragment:
    """The same pixels, ours to change, on a patch that contains the fragment's."""
    copied = Fragment(patch, np.zeros((patch.count, 4), fragment.pixels.dtype), True)
    if fragment.patch.count:
        blend.copy(copied.pixels, copied.patch, fragment.pixels, fragment.patch)
    return copied
