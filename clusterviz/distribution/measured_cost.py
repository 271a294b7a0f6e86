"""From what ranks measured to what bricks should cost next: the first half of balancing, a value from frame to frame.

What is kept is not a cost but a factor for each brick: measured over expected. The expectation knows the camera, and
the factor what the camera does not change, such as how much of a brick is empty: so a jump of the camera costs little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.partition.bsp import Costs
from clusterviz.partition.owners import UNASSIGNED, Owners
from clusterviz.report.statistics import RankFrame

Kind = Literal["samples", "seconds"]
LEAST = 1e-3  # of what is expected, for a rank or a brick: what costs nothing now may come into view in the next frame
FRAMES = 16  # that are remembered: with other owners each tells something else of the same bricks
SWEEPS = 3  # over them a frame
SMOOTH = 6  # corrections pass over from rank to rank within this share of the volume's sides, to both sides of a plane


@dataclass(frozen=True, eq=False)
class Frame:
    """What one frame told.

    Attributes
    ----------
    party : int64 (bz, by, bx), who drew each brick, counted from 1; 0 where it was out of view
    model : float64 (bz, by, bx), what it was expected to cost; 0 there
    costs : float64 (ranks,), what it cost each rank
    """

    party: NDArray[np.int64]
    model: Costs
    costs: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Measured:
    """What was learnt of each brick.

    Attributes
    ----------
    factor : float64 (bz, by, bx), measured over expected, up to a common factor
    frames : of which it was learnt, the last ones that cost anything
    """

    factor: NDArray[np.float64]
    frames: tuple[Frame, ...] = ()


def unmeasured(shape_zyx: tuple[int, int, int]) -> Measured:
    """Before the first frame: bricks cost what the model says."""
    return Measured(np.ones(shape_zyx))


def rank_costs(per_rank: Sequence[RankFrame], by: Kind = "samples") -> NDArray[np.float64]:
    """What a frame cost each rank, float64 (ranks,): samples, or seconds of rendering.

    Samples are the same in every run, and blind to slow GPUs; seconds know these, and whatever else the node does.
    """
    if by == "samples":
        return np.array([rank.samples for rank in per_rank], np.float64)
    return np.array([rank.seconds.get("render", 0.0) for rank in per_rank], np.float64)


def measure(past: Measured, model: Costs, owners: Owners, costs: NDArray[np.float64], damping: float = 0.0) -> Measured:
    """Learn from one frame.

    A rank's cost is spread over its bricks as the model and the past have it: the factors of all its bricks are
    multiplied by measured over expected. Costs seldom jump at the planes of a tree, so these ratios first pass over
    smoothly from rank to rank; then the sums of the last frames are made right, one frame after the other, the newest
    last. So bricks that have changed hands are told apart. Nothing is learnt of bricks out of view, and of frames
    that cost nothing.

    Parameters
    ----------
    past : of the frames before
    model : float64 (bz, by, bx), expected in this frame, such as `expected_samples`
    owners : who drew what
    costs : float64 (ranks,), as of `rank_costs`
    damping : the weight of the past, 0 … below 1: 0 for samples, which are exact; above for seconds, which are not

    Raises
    ------
    InputError
        Costs of another number of ranks, negative or not finite ones, an impossible damping.

    References
    ----------
    R. Gordon, R. Bender, G. Herman: Algebraic reconstruction techniques, Journal of Theoretical Biology 29, 1970 (the
    multiplicative form: the ranks of a frame are what the rays of a view are there).
    """
    if costs.shape != (owners.ranks,) or not (np.isfinite(costs).all() and (costs >= 0).all()):
        raise InputError("not a cost a rank", where="costs", found=costs.tolist(), allowed=f"{owners.ranks} of ≥ 0")
    if not 0 <= damping < 1:
        raise InputError("impossible", where="damping", found=damping, allowed="0 or more, below 1")
    drawn = (model > 0) & (owners.owner != UNASSIGNED)
    frame = Frame(np.where(drawn, owners.owner + 1, 0).astype(np.int64), np.where(drawn, model, 0.0), costs)
    ratio = _ratio(frame, past.factor)
    if ratio is None:
        return past
    factor = past.factor * np.exp(_smooth(np.log(ratio)))
    frames = (*past.frames, frame)[-FRAMES:]
    for _ in range(SWEEPS):
        for age, each in zip(reversed(range(len(frames))), frames, strict=True):
            ratio = _ratio(each, factor)
            if ratio is not None:
                factor = factor * (ratio ** ((1 - damping) ** age) if damping else ratio)
    factor = past.factor**damping * factor ** (1 - damping)
    return Measured(factor / factor[drawn].mean(), frames)


def predict(measured: Measured, model: Costs, shown: NDArray[np.bool_]) -> Costs:
    """What each brick should cost in the frame of a model.

    Parameters
    ----------
    model : float64 (bz, by, bx), expected in that frame
    shown : bool (bz, by, bx), bricks that have something to show

    Returns
    -------
    cost : float64 (bz, by, bx); above 0 exactly where `shown`, also out of view: a brick that costs nothing now may
        come into view, and who has it shall be well spread
    """
    cost = model * measured.factor
    mean = float(cost[shown].mean()) if shown.any() else 0.0
    return np.where(shown, np.maximum(cost, LEAST * mean if mean > 0 else 1.0), 0.0)


def _ratio(frame: Frame, factor: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Measured over expected of each brick's rank; 1 for bricks that nobody drew; None where nothing cost anything."""
    # Many frames are gone through each frame, of few bricks: what counts is how many arrays are made.
    expected = np.bincount(frame.party.ravel(), (frame.model * factor).ravel(), minlength=len(frame.costs) + 1)[1:]
    counts = expected > 0
    total = float(frame.costs @ counts)
    if total <= 0:
        return None
    ratio = np.ones(len(expected) + 1)
    # In units of the frame's own mean, so that a slow frame does not look like dear bricks.
    np.divide(frame.costs * (float(expected.sum()) / total), expected, out=ratio[1:], where=counts)
    return np.maximum(LEAST, ratio)[frame.party]


def _smooth(field: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over boxes that reach a share of the volume's sides to both sides, twice, which is nearly a Gaussian."""
    for axis, bricks in enumerate(field.shape):
        reach = bricks // SMOOTH
        for _ in range(2):
            padded = np.pad(field, [(reach + 1, reach) if other == axis else (0, 0) for other in range(3)], mode="edge")
            sums = np.moveaxis(np.cumsum(padded, axis), axis, 0)
            width = 2 * reach + 1
            field = np.moveaxis((sums[width:] - sums[:bricks]) / width, 0, axis)
    return field
