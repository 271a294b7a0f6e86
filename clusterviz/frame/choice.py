"""Which distribution a scene gets."""

from __future__ import annotations

from clusterviz.frame.coherent import Coherent
from clusterviz.frame.distribution import Distribution
from clusterviz.frame.interleaved import Interleaved
from clusterviz.frame.replicated import Replicated
from clusterviz.scene.values import Cluster


def choose_distribution(cluster: Cluster, ranks: int) -> Distribution:
    """The distribution that a scene names.

    Parameters
    ----------
    cluster : the scene's section
    ranks : among how many
    """
    limit = cluster.memory_limit
    match cluster.distribution:
        case "interleaved":
            return Interleaved(ranks, limit)
        case "replicated":
            return Replicated(ranks, cluster.copies, limit)
        case _:
            return Coherent(ranks, limit)
