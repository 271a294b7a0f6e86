"""The checks of how a scene's ranks share the work: which keys go together."""

from __future__ import annotations

from clusterviz.scene.checks import UnusableError


def check_groups(mode: str, groups: int | None) -> None:
    """One group is sort-last, and sort-first has as many as ranks, so neither leaves a choice."""
    if mode == "sort-last" and groups not in (None, 1):
        raise UnusableError("sort-last has one group", "1, or mode: hybrid", key="groups", found=groups)
    if mode == "sort-first" and groups is not None:
        raise UnusableError("sort-first has a group a rank", "null, or mode: hybrid", key="groups", found=groups)


def check_sharing(mode: str, tiling: str, distribution: str, compositing: str, transport: str) -> None:
    """Where the screen is not shared it has no tiles; where the data are not, nothing is blended."""
    if mode == "sort-last" and tiling != "auto":
        allowed = "auto, or mode: sort-first or hybrid"
        raise UnusableError("sort-last does not share the screen", allowed, key="tiling", found=tiling)
    if mode in ("sort-first", "hybrid") and distribution != "auto":
        allowed = "auto, or mode: sort-last"
        text = "where the screen is shared, bricks are dealt by trees"
        raise UnusableError(text, allowed, key="distribution", found=distribution)
    if mode == "sort-first" and compositing != "auto":
        allowed = "auto, or mode: sort-last or hybrid"
        raise UnusableError("sort-first blends nothing", allowed, key="compositing", found=compositing)
    if mode == "sort-first" and transport not in ("auto", "messages"):
        allowed = "messages, auto, or mode: sort-last or hybrid"
        raise UnusableError("sort-first sends tiles straight to rank 0", allowed, key="transport", found=transport)
