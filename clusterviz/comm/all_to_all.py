"""Exchange of arrays between all ranks, each with each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.channel import Channel


def all_to_all(
    channel: Channel, sent: Sequence[NDArray[Any]], tag: int, counts: Sequence[int] | None = None
) -> list[NDArray[Any]]:
    """Send an array to each rank, and return those of all ranks, the own one uncopied; collective.

    Parameters
    ----------
    sent : one array (k,) for each rank, C order, of the same type everywhere
    tag : of the messages
    counts : length of the array from each rank; None: the ranks tell each other
    """
    if counts is None:
        counts = channel.allgather_numbers([len(each) for each in sent])[:, channel.rank].tolist()
    received = [np.empty(count, sent[0].dtype) for count in counts]
    received[channel.rank] = sent[channel.rank]
    others = [source for source in range(channel.size) if source != channel.rank]
    pending = [channel.post_receive(received[source], source, tag) for source in others if counts[source]]
    for target in others:
        if len(sent[target]):
            channel.isend(sent[target], target, tag)
    while pending:
        done = {index for index, _ in channel.wait_some(pending)}
        pending = [one for index, one in enumerate(pending) if index not in done]
    channel.wait_sends()
    return received
