"""The codec that changes nothing.

What: pixels travel as they lie in memory. When: small messages, fast links, images without structure, and whenever
another codec does not pay. When not: large sparse images on a slow link. Cost: none, not even a copy. Limits: none.
"""

from __future__ import annotations

from clusterviz.codec.contract import Pixels


def encode(pixels: Pixels) -> None:
    """Never pays: the message stays raw."""
    return
