"""The four constants that predict how long a composition takes, and the files that hold them."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields
from pathlib import Path

from clusterviz.composite.load import Load
from clusterviz.errors import InputError

FOLDER = Path(__file__).parent / "networks"


@dataclass(frozen=True)
class Network:
    """T = rounds·α + messages of a rank·o + bytes of a rank·β + pixels merged by a rank·γ.

    Attributes
    ----------
    name, source : what it is, and where its constants come from
    latency_seconds : α, of one round
    overhead_seconds : o, of one message
    seconds_per_byte : β, of a link
    seconds_per_pixel : γ, of the over operator
    """

    name: str
    source: str
    latency_seconds: float
    overhead_seconds: float
    seconds_per_byte: float
    seconds_per_pixel: float

    def seconds(self, load: Load, bytes_per_pixel: int) -> float:
        """The time predicted for a load; links carry both directions at once, so the busier one counts."""
        messages = max(load.messages_sent.max(initial=0), load.messages_received.max(initial=0))
        pixels = max(load.pixels_sent.max(initial=0), load.pixels_received.max(initial=0))
        return float(
            load.rounds * self.latency_seconds
            + messages * self.overhead_seconds
            + pixels * bytes_per_pixel * self.seconds_per_byte
            + load.pixels_received.max(initial=0) * self.seconds_per_pixel
        )


def shipped_networks() -> list[str]:
    """Names of the network files that come with the package."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def open_network(name: str) -> Network:
    """Read a network file, or one of those that come with the package by its name.

    Raises
    ------
    InputError
        There is no such file, it is not JSON, or a key is missing, unknown or impossible.
    """
    path = FOLDER / f"{name}.json" if name in shipped_networks() else Path(name)
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        allowed = f"a JSON file, or {', '.join(shipped_networks())}"
        raise InputError("no such network file", where=name, found=error.strerror, allowed=allowed) from None
    except ValueError as error:
        raise InputError("not a JSON file", where=name, found=error, allowed="as in docs/compositing.md") from None
    wanted = [field.name for field in fields(Network)]
    if not isinstance(found, dict) or sorted(found) != sorted(wanted):
        keys = ", ".join(found) if isinstance(found, dict) else type(found).__name__
        raise InputError("wrong keys in a network file", where=name, found=keys, allowed=", ".join(wanted))
    for key in wanted[2:]:
        value = found[key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise InputError("not a time", where=f"{name}: {key}", found=value, allowed="seconds, 0 and more")
    return Network(str(found["name"]), str(found["source"]), *(float(found[key]) for key in wanted[2:]))
