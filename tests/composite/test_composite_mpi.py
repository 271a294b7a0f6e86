"""Over MPI the picture is the loopback's, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from composite.images import composite_all, picture, random_partial, random_rect

from clusterviz.comm.mpi import MpiChannel
from clusterviz.composite import ALGORITHMS, compile_kernels


@pytest.mark.mpi(ranks=[2, 3, 5, 7], timeout=120)
def test_mpi_equals_loopback(mpi_ranks: int) -> None:
    size = (61, 47)
    channel = MpiChannel()
    compile_kernels(channel)
    for seed, dtype in enumerate((np.float32, np.uint8)):
        rng = np.random.default_rng(seed)
        partials = [random_partial(rng, random_rect(rng, size), dtype) for _ in range(mpi_ranks)]
        order = [int(rank) for rank in rng.permutation(mpi_ranks)]
        for root, algorithm in enumerate(ALGORITHMS):
            root %= mpi_ranks
            made = picture(channel, partials, order, size, algorithm, root)
            assert (made is None) == (channel.rank != root)
            if made is not None:
                assert np.array_equal(made, composite_all(partials, order, size, algorithm))
    channel.close()
