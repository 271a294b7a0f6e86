"""Constants of the time model, and the files that hold them.

The file that `clusterviz bench network` saved is used, else one of the package. docs/concepts/time-model.md explains
the constants.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from clusterviz.composite.schedules.schedule import Load
from clusterviz.errors import InputError, OutputError
from clusterviz.image.replace import replacing
from clusterviz.input_files import require_regular_file

FOLDER = Path(__file__).parent / "networks"
FILE_VARIABLE = "CLUSTERVIZ_NETWORK"
REQUIRED = ("name", "source", "latency_seconds", "overhead_seconds", "seconds_per_byte", "seconds_per_pixel")
COUNTS = ("cores", "nodes")

# Default of a constant that is not given: another one, times a factor.
DERIVED_CONSTANTS = {
    "node_latency_seconds": ("latency_seconds", 1.0),
    "node_overhead_seconds": ("overhead_seconds", 1.0),
    "node_seconds_per_byte": ("seconds_per_byte", 1.0),
    "seconds_per_float_pixel": ("seconds_per_pixel", 1.0),
    # Blending a byte pixel reads 8 bytes and writes 4; copying one reads 4 and writes 4.
    "copy_seconds_per_byte": ("seconds_per_pixel", 0.25),
    "barrier_seconds": ("latency_seconds", 1.0),
}


@dataclass(frozen=True)
class Network:
    """Constants of the time model T = rounds·α + messages of a rank·o + bytes of a rank·β + merged pixels of a rank·γ.

    This is the model between nodes, with one rank on each. The other constants describe what the ranks of a node share.
    A constant that is not given (NaN) is derived from the others.
    """

    # name of the network, and origin of its constants
    name: str
    source: str
    latency_seconds: float  # α of one round between nodes
    overhead_seconds: float  # o of one message between nodes
    seconds_per_byte: float  # β of the link of a node, in each direction
    seconds_per_pixel: float  # γ of the over operator for byte pixels
    # α, o and β inside a node
    node_latency_seconds: float = math.nan
    node_overhead_seconds: float = math.nan
    node_seconds_per_byte: float = math.nan
    seconds_per_float_pixel: float = math.nan  # γ of float32 pixels
    copy_seconds_per_byte: float = math.nan  # time of copying a byte into shared memory of a node
    barrier_seconds: float = math.nan  # time of a barrier of the ranks of a node, if each has a core
    turn_seconds: float = 0.0  # time of each round, for each rank of a core beyond the first
    # this program's cost of each frame, and of each message beyond o
    frame_seconds: float = 0.0
    message_seconds: float = 0.0
    cores: int = 0  # cores of a node; 0 if each rank has its own
    nodes: int = 2  # number of nodes on which the constants were measured; 1 gives no constants between nodes

    def __post_init__(self) -> None:
        for name, (other, factor) in DERIVED_CONSTANTS.items():
            if math.isnan(getattr(self, name)):
                object.__setattr__(self, name, getattr(self, other) * factor)

    def seconds(self, load: Load, bytes_per_pixel: int) -> float:
        """Return the predicted time of a load with one rank per node; links are full duplex."""
        return float(
            load.rounds * self.latency_seconds
            + load.most_messages * self.overhead_seconds
            + load.most_pixels * bytes_per_pixel * self.seconds_per_byte
            + load.pixels_received.max(initial=0) * self.seconds_per_pixel
        )


def shipped_networks() -> list[str]:
    """Return the names of the network files of the package."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def open_network(name: str) -> Network:
    """Read a network file, or one of the package by its name.

    Raises InputError if there is no such file, it is not JSON, or a key is missing, unknown or impossible.
    """
    path = FOLDER / f"{name}.json" if name in shipped_networks() else Path(name)
    require_regular_file(path)
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        allowed = f"a JSON file, or {', '.join(shipped_networks())}"
        raise InputError("no such network file", where=name, found=error.strerror, allowed=allowed) from None
    except ValueError as error:
        allowed = "the keys of docs/concepts/time-model.md"
        raise InputError("not a JSON file", where=name, found=error, allowed=allowed) from None
    known = [field.name for field in fields(Network)]
    if not isinstance(found, dict) or not set(REQUIRED) <= set(found) <= set(known):
        keys = ", ".join(found) if isinstance(found, dict) else type(found).__name__
        allowed = f"{', '.join(REQUIRED)}; and of {', '.join(known[len(REQUIRED) :])} what is known"
        raise InputError("wrong keys in a network file", where=name, found=keys, allowed=allowed)
    return Network(**{key: _value(f"{name}: {key}", key, value) for key, value in found.items()})


def _value(where: str, key: str, value: object) -> Any:
    if key in ("name", "source"):
        return str(value)
    if key in COUNTS:
        if isinstance(value, bool) or not isinstance(value, int) or value < (key == "nodes"):
            raise InputError("not a number of things", where=where, found=value, allowed="a whole number")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
        raise InputError("not a time", where=where, found=value, allowed="seconds, 0 and more")
    return float(value)


def saved_path() -> Path:
    """Return the path of this user's measured constants: from the environment, else in the configuration folder."""
    named, folder = os.environ.get(FILE_VARIABLE), os.environ.get("XDG_CONFIG_HOME")
    return Path(named) if named else Path(folder or Path.home() / ".config") / "clusterviz" / "network.json"


def save_network(network: Network, path: Path) -> None:
    """Write a network file, completely or not at all; a missing folder is made.

    Raises OutputError if the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError("no folder can be made here", where=str(path.parent), found=error.strerror) from None
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(asdict(network), indent=2) + "\n", encoding="utf-8")


def default_network(nodes: int) -> Network:
    """Return the network for a run on `nodes` nodes: the measured one, else one of the package.

    Without measurements several nodes are assumed to have 10 Gb/s Ethernet: an algorithm that saves bytes loses little
    on a faster network, while one that does not loses much on a slower one. The number of cores is then that of this
    machine.

    Raises InputError if the saved file is invalid, or named by the environment and missing.
    """
    path = saved_path()
    kept = open_network(str(path)) if path.exists() or os.environ.get(FILE_VARIABLE) else None
    if kept is None:
        shipped = open_network("laptop" if nodes < 2 else "ethernet-10g")
        return replace(shipped, cores=os.cpu_count() or 1)
    if nodes < 2 or kept.nodes > 1:
        return kept
    slow = open_network("ethernet-10g")
    between = ("latency_seconds", "overhead_seconds", "seconds_per_byte")
    return replace(kept, name=f"{kept.name}; {slow.name}", **{name: getattr(slow, name) for name in between})
