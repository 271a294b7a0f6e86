"""Codecs: chains of stages, joined by "+", such as `rectangle+shuffle+lz4`.

The order is fixed: a selection leaves fewer pixels, filters rearrange their bytes, a compressor shortens them. Filters
alone save nothing, so they stand only before a compressor. The first byte of a message has the bits of its stages. A
message may use fewer stages than its codec has, if some do not save bytes.

**Adding a stage**: one file, one line in `STAGES` with a new bit, and its place in the order below.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

from clusterviz.codec import active, delta, lz4_block, rectangle, shuffle
from clusterviz.codec.contract import Compressor, Filter, Selection, Stage
from clusterviz.errors import InputError

STAGES: dict[str, Stage] = {
    "active": Selection(1, active.select, active.restore),
    "rectangle": Selection(2, rectangle.select, rectangle.restore),
    "delta": Filter(4, delta.apply, delta.undo),
    "shuffle": Filter(8, shuffle.apply, shuffle.undo),
    "lz4": Compressor(16, lz4_block.compress, lz4_block.decompress),
}

SELECTIONS = ("", "active", "rectangle")
FILTERS = ("", "delta", "shuffle", "delta+shuffle")
COMPRESSORS = ("lz4",)

ALLOWED = (
    'raw, auto, or stages joined by "+" in this order, each at most once: active or rectangle, delta, shuffle, lz4; '
    "delta and shuffle only before lz4"
)


@dataclass(frozen=True)
class Chain:
    """Stages of one codec, in the order in which they pack."""

    name: str  # names of the stages, joined by "+"; "raw" without stages
    # the stages
    selection: Selection | None = None
    filters: tuple[Filter, ...] = ()
    compressor: Compressor | None = None

    @property
    def flag(self) -> int:
        """The bits of all stages."""
        stages = (self.selection, *self.filters, self.compressor)
        return sum(stage.bit for stage in stages if stage is not None)


def _chain(*parts: str) -> Chain:
    """Return the chain of the named stages; empty names are left out."""
    name = "+".join(filter(None, parts))
    stages = [STAGES[part] for part in name.split("+") if part]
    selection = next((stage for stage in stages if isinstance(stage, Selection)), None)
    compressor = next((stage for stage in stages if isinstance(stage, Compressor)), None)
    return Chain(name or "raw", selection, tuple(stage for stage in stages if isinstance(stage, Filter)), compressor)


_ALL = [_chain(name) for name in SELECTIONS] + [_chain(*parts) for parts in product(SELECTIONS, FILTERS, COMPRESSORS)]

CODECS: dict[str, Chain] = {chain.name: chain for chain in _ALL}
BY_FLAG: dict[int, Chain] = {chain.flag: chain for chain in _ALL if chain.flag}


def choose_codec(name: str) -> str:
    """Return the codec that packs every message of a transfer; raw for `auto`.

    Raises InputError if there is no such codec.
    """
    if name == "auto":
        return "raw"
    if name not in CODECS:
        raise InputError("unknown codec", where="cluster.codec", found=name, allowed=ALLOWED)
    return name
