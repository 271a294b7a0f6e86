"""Network files: what is kept is found again, what is not given is derived, and what is broken is named."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from clusterviz.composite.model.network import (
    DERIVED_CONSTANTS,
    Network,
    default_network,
    open_network,
    save_network,
    saved_path,
    shipped_networks,
)
from clusterviz.errors import InputError, OutputError

FOUR = {"latency_seconds": 2e-6, "overhead_seconds": 1e-6, "seconds_per_byte": 1e-10, "seconds_per_pixel": 2e-9}
LAPTOP = asdict(open_network("laptop"))


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A configuration folder of our own, in which nothing is kept."""
    monkeypatch.delenv("CLUSTERVIZ_NETWORK", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    return tmp_path


def test_a_plain_file_is_taken_and_the_rest_is_derived(tmp_path: Path) -> None:
    path = tmp_path / "n.json"
    path.write_text(json.dumps({"name": "mine", "source": "made up", **FOUR}))
    network = open_network(str(path))
    for name, (other, factor) in DERIVED_CONSTANTS.items():
        assert getattr(network, name) == getattr(network, other) * factor
    assert (network.frame_seconds, network.message_seconds, network.cores, network.nodes) == (0, 0, 0, 2)
    plain = Network("", "", 1.0, 2.0, 3.0, 4.0)
    assert (plain.node_latency_seconds, plain.node_overhead_seconds, plain.node_seconds_per_byte) == (1.0, 2.0, 3.0)
    assert (plain.seconds_per_float_pixel, plain.copy_seconds_per_byte) == (4.0, 1.0)


def test_what_is_kept_is_read_back(tmp_path: Path) -> None:
    network = replace(open_network("laptop"), name="kept", cores=7, barrier_seconds=3e-6, nodes=3)
    path = tmp_path / "new" / "folder" / "n.json"
    save_network(network, path)
    assert open_network(str(path)) == network
    assert os.listdir(path.parent) == ["n.json"]
    with pytest.raises(OutputError, match="no folder can be made here"):
        save_network(network, path / "n.json")


def test_shipped_files_give_every_constant_and_say_where_it_comes_from() -> None:
    assert shipped_networks() == ["ethernet-10g", "infiniband-200g", "laptop"]
    for name in shipped_networks():
        found = json.loads((Path(__file__).parents[2] / f"clusterviz/composite/model/networks/{name}.json").read_text())
        network = open_network(name)
        assert set(found) == set(asdict(network))
        assert len(network.source) > 100
        assert min(getattr(network, constant) for constant in FOUR) > 0


@pytest.mark.parametrize(
    ("content", "text"),
    [
        *(
            (LAPTOP | change, text)
            for change, text in (
                ({"latency_seconds": -1}, "latency_seconds: not a time; found -1"),
                ({"frame_seconds": "1"}, "frame_seconds: not a time"),
                ({"barrier_seconds": math.inf}, "barrier_seconds: not a time"),
                ({"message_seconds": math.nan}, "message_seconds: not a time"),
                ({"overhead_seconds": True}, "not a time"),
                ({"cores": 1.5}, "cores: not a number of things; found 1.5"),
                ({"cores": True}, "cores: not a number of things"),
                ({"cores": -1}, "cores: not a number of things"),
                ({"nodes": 0}, "nodes: not a number of things"),
                ({"speed": 1}, "wrong keys"),
            )
        ),
        *(({k: v for k, v in LAPTOP.items() if k != each}, "wrong keys") for each in ("name", "source", *FOUR)),
        ([1], "wrong keys"),
        ({"name": "x"}, "wrong keys"),
        (b"", "not a JSON file"),
        (b"latency: 1", "not a JSON file"),
        (b"\xff\xfe\x00", "not a JSON file"),
        (None, "no such network file"),
    ],
)
def test_a_faulty_file_is_an_error_that_names_it(home: Path, content: Any, text: str) -> None:
    saved_path().parent.mkdir()
    if content is not None:
        saved_path().write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
        with pytest.raises(InputError, match=rf"clusterviz/network\.json.*{text}"):
            default_network(1)
    with pytest.raises(InputError, match=rf"clusterviz/network\.json.*{text}"):
        open_network(str(saved_path()))


def test_the_environment_names_the_file_before_the_folders(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert saved_path() == home / "clusterviz" / "network.json"
    monkeypatch.delenv("XDG_CONFIG_HOME")
    monkeypatch.setenv("HOME", str(home / "me"))
    assert saved_path() == home / "me" / ".config" / "clusterviz" / "network.json"
    monkeypatch.setenv("CLUSTERVIZ_NETWORK", str(home / "x.json"))
    assert saved_path() == home / "x.json"
    with pytest.raises(InputError, match=r"x\.json: no such network file"):
        default_network(1)


def test_without_a_kept_file_one_node_is_a_laptop_and_several_have_a_slow_network(home: Path) -> None:
    cores = os.cpu_count() or 1
    assert default_network(1) == replace(open_network("laptop"), cores=cores)
    assert default_network(2) == replace(open_network("ethernet-10g"), cores=cores)


def test_the_kept_file_counts_but_one_of_a_single_node_tells_nothing_of_the_network(home: Path) -> None:
    kept = replace(open_network("infiniband-200g"), name="kept")
    save_network(kept, saved_path())
    assert default_network(1) == default_network(8) == kept
    kept = replace(open_network("laptop"), name="kept", nodes=1, node_latency_seconds=1.5, seconds_per_pixel=2.5)
    save_network(kept, saved_path())
    found, slow = default_network(2), open_network("ethernet-10g")
    assert default_network(1) == kept
    assert (found.latency_seconds, found.seconds_per_byte) == (slow.latency_seconds, slow.seconds_per_byte)
    assert (found.node_latency_seconds, found.seconds_per_pixel) == (1.5, 2.5)
