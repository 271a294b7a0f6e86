"""Loop over the pieces of a frame, the same in both ray casters, which draw each piece."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from operator import length_hint

from clusterviz.image.partial import Rect, blank
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.discarding import HiddenPixels, LastEnds
from clusterviz.render.frame_coherence import LastFrame, Starts
from clusterviz.render.passes import Passes
from clusterviz.render.refraction import CarriedRays
from clusterviz.render.render_result import PartOf, Progress, RenderResult, footprint

Rays = Starts | CarriedRays


@dataclass(frozen=True)
class Task:
    """A piece to draw in a rectangle of pixels.

    Attributes
    ----------
    rays : what its rays carry; None: nothing
    progress : called with the part that is drawn
    hidden : what is left out at its pixels; None: nothing
    repeats : it shows the bricks of the piece before, which are where they were
    """

    piece: Piece
    rect: Rect
    rays: Rays | None
    progress: Progress
    hidden: HiddenPixels | None = None
    repeats: bool = False


class LastDraws:
    """What a ray caster keeps of the last frame's rays, piece by piece: where they hit something, and where they ended.

    Attributes
    ----------
    hits, ends : of frame coherence, and of early fragment discarding
    """

    def __init__(self) -> None:
        self.hits, self.ends = LastFrame(), LastEnds()

    def forget(self) -> None:
        """Forget all of it."""
        self.hits.forget()
        self.ends = LastEnds()

    def draw(
        self,
        plan: Plan,
        pieces: Iterable[Piece],
        progress: Progress,
        carried: Sequence[CarriedRays],
        passes: Passes | None,
        draw: Callable[[Plan, Task], RenderResult],
        draw_parts: Callable[[Plan, Task, Sequence[Piece], Passes], RenderResult],
    ) -> list[RenderResult]:
        """Draw pieces by two functions: for a piece, and for one whose bricks are loaded part by part.

        Parameters are those of `Raycaster.draw`. A piece is blank if it shows nothing.
        """
        if not carried:
            self.hits.next_frame()
            self.ends.next_frame()
        last: Piece | None = None
        count, drawn = length_hint(pieces), list[RenderResult]()
        for number, piece in enumerate(pieces):
            rect, part = footprint(plan, piece), PartOf(progress, number, count)
            part(0.0)
            repeats = last is not None and piece.shows_bricks_of(last)
            if not rect.pixels or not (repeats or len(piece.members(plan.cost > 0))):
                drawn.append(RenderResult(blank()))
                continue
            rays: Rays | None = carried[number] if carried else None
            if plan.march.frame_coherence is not None:
                rays = Starts.of(self.hits, plan, piece, rect)
            task, parts = Task(piece, rect, rays, part), passes.parts(piece) if passes else [piece]
            if passes and len(parts) > 1:
                drawn.append(draw_parts(plan, task, parts, passes))
                continue
            if passes:
                passes.load(piece)
            # Windows of the same bricks share their tables.
            task = replace(task, hidden=self.ends.begin(plan, piece, rect), repeats=repeats)
            found, last = draw(plan, task), None if passes else piece
            if task.hidden:
                self.ends.finish(plan, piece, rect, task.hidden)
                found = replace(found, early_discarding=task.hidden.counts(found.fragments))
            drawn.append(found)
        return drawn
