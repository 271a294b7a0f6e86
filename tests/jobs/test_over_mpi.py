"""Applications on ranks of MPI find the bits of one process; in one mpirun, whose start takes longer than they do."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from cone_beam import reconstruct
from jobs.phantom import phantom_grid, phantom_scan, reconstructed
from jobs.test_filters import check_ranks
from jobs.test_reconstruction import EXAMPLE

from clusterviz import jobs
from clusterviz.comm import Channel, LoopbackChannel, open_channel
from clusterviz.data import open_source
from clusterviz.data.memory import ArraySource
from clusterviz.errors import ClustervizError
from clusterviz.image import read_image


def check_reconstruction(channel: Channel) -> None:
    geometry, views = phantom_scan(angles={"begin": 0, "end": 360, "count": 9})
    spoilt = views.read((0, 0, 0), geometry.shape)
    spoilt[8, 3, 3] = np.inf
    with jobs.cluster(channel) as cluster:
        found, _ = reconstruct(cluster, views, geometry, phantom_grid(16), blocks=6)
        np.testing.assert_array_equal(found[...], reconstructed(geometry, views, 16))
        with pytest.raises(ClustervizError, match="view 8, row 3, column 3: a pixel has no value"):
            reconstruct(cluster, ArraySource(spoilt, name="views"), geometry, phantom_grid(16), blocks=6)


def check_example(channel: Channel, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a user starts it: scan, reconstruction, file and picture."""
    name = "field:shepp-logan:24"
    options = ["--phantom", name, "--count", "9", "--pixels", "20", "--picture", str(folder / "a.png")]
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), *options, "-o", str(folder / "a.npy")])
    example = runpy.run_path(str(EXAMPLE), run_name="__main__")
    if channel.rank > 0:
        return
    assert np.asarray(read_image(folder / "a.png"))[..., :3].std() > 0.03
    phantom = open_source(name)
    with jobs.cluster(LoopbackChannel()) as cluster:
        geometry = example["circle_around"](phantom, 9, 20)
        volume, _ = reconstruct(cluster, example["scan"](cluster, phantom, geometry), geometry)
        np.testing.assert_array_equal(volume[...], np.load(folder / "a.npy"))


@pytest.mark.mpi(ranks=[3], timeout=100)
def test_ranks_of_mpi_find_what_one_process_finds(
    mpi_ranks: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel = open_channel()
    assert channel.size == mpi_ranks
    check_ranks(channel)
    check_reconstruction(channel)
    check_example(channel, Path(channel.broadcast(str(tmp_path))), monkeypatch)
