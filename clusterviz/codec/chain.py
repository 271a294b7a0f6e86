"""Codecs are chains of stages, joined by "+": `rectangle+shuffle+lz4`.

The order is fixed, since no other pays: a selection leaves fewer pixels, filters rearrange what is left, a squeeze
makes it fewer bytes. Filters save nothing by themselves, so they stand only before a squeeze. The bits of a chain's
stages are the first byte of its messages; a message may name fewer stages than its codec has, where some do not pay.

**Adding a stage**: one file, one line in `STAGES` with a bit of its own, and its place in the order below.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

from clusterviz.codec import active, delta, lz4_block, rectangle, shuffle
from clusterviz.codec.contract import Filter, Selection, Squeeze, Stage
from clusterviz.errors import InputError

STAGES: dict[str, Stage] = {
    "active": Selection(1, active.select, active.restore),
    "rectangle": Selection(2, rectangle.select, rectangle.restore),
    "delta": Filter(4, delta.apply, delta.undo),
    "shuffle": Filter(8, shuffle.apply, shuffle.undo),
    "lz4": Squeeze(16, lz4_block.compress, lz4_block.expand),
}

SELECTIONS = ("", "active", "rectangle")
FILTERS = ("", "delta", "shuffle", "delta+shuffle")
SQUEEZES = ("lz4",)

ALLOWED = (
    'raw, auto, or stages joined by "+" in this order, each at most once: active or rectangle, delta, shuffle, lz4; '
    "delta and shuffle only before lz4"
)


@dataclass(frozen=True)
class Chain:
    """The stages of one codec, in the order in which they pack.

    Attributes
    ----------
    name : of the stages, joined by "+"; "raw" where there is none
    selection, filters, squeeze : the stages
    """

    name: str
    selection: Selection | None = None
    filters: tuple[Filter, ...] = ()
    squeeze: Squeeze | None = None

    @property
    def flag(self) -> int:
        """The bits of all stages."""
        stages = (self.selection, *self.filters, self.squeeze)
        return sum(stage.bit for stage in stages if stage is not None)


def _chain(*parts: str) -> Chain:
    """The chain of these stages; empty parts are left out."""
    name = "+".join(filter(None, parts))
    stages = [STAGES[part] for part in name.split("+") if part]
    selection = next((stage for stage in stages if isinstance(stage, Selection)), None)
    squeeze = next((stage for stage in stages if isinstance(stage, Squeeze)), None)
    return Chain(name or "raw", selection, tuple(stage for stage in stages if isinstance(stage, Filter)), squeeze)


_ALL = [_chain(name) for name in SELECTIONS] + [_chain(*parts) for parts in product(SELECTIONS, FILTERS, SQUEEZES)]

CODECS: dict[str, Chain] = {chain.name: chain for chain in _ALL}
BY_FLAG: dict[int, Chain] = {chain.flag: chain for chain in _ALL if chain.flag}


def choose_codec(name: str) -> str:
    """The codec to use where each message is packed alike; `auto` is raw then.

    Raises
    ------
    InputError
        There is no such codec.
    """
    if name == "auto":
        return "raw"
    if name not in CODECS:
        raise InputError("unknown codec", where="cluster.codec", found=name, allowed=ALLOWED)
    return name
