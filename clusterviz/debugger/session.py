"""Session of the debugger: a draw that stops before statements, with breakpoints, a call stack and watches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from clusterviz.debugger.draws import Draw, Pixel
from clusterviz.debugger.watches import Watched
from clusterviz.errors import InputError
from clusterviz.spmd.interpreter import Frame, Mask
from clusterviz.spmd.ir import Statement, Variable
from clusterviz.spmd.probe import Place, Probe

LOCAL = "local", "in", "out", "inout"
"""Kinds of the variables of functions."""


class State(IntEnum):
    """What a pixel does while the draw is stopped."""

    NOT_DRAWN = 0
    ENDED = 1
    """It has left a loop or function in which others still are."""
    PASSIVE = 2
    """It waits for others, which have taken another branch."""
    ACTIVE = 3
    """It executes the next statement."""


@dataclass(frozen=True)
class Level:
    """Function of the call stack: where it is, and the iteration of each of its running loops, counted from 0."""

    function: str
    file: str
    line: int
    iterations: tuple[int, ...]


@dataclass(eq=False)
class Breakpoint:
    """Place at which a session stops when a pixel comes to it for the n-th time in a dispatch.

    Attributes
    ----------
    where : FILE:LINE
    probe : places, condition and visit
    visits : int (lanes,), those so far
    hit : lanes that have come to the visit with the last stop
    """

    where: str
    probe: Probe
    visits: NDArray[np.int64]
    hit: Mask


class Session:
    """Execution of the draws of a rank that stops.

    Parameters
    ----------
    draws : one after the other, each executed before the next is asked for

    Attributes
    ----------
    draw : that is executed
    number : of the draw, from 0
    place : of the next statement; None at the end
    focus : pixel whose way steps follow; None: that of any pixel
    breakpoints : in the order in which they were set
    """

    def __init__(self, draws: Iterator[Draw]) -> None:
        self._draws, self.number = draws, -1
        self.focus: Pixel | None = None
        self.breakpoints: list[Breakpoint] = []
        self._next_draw()
        self.step()

    def step(self) -> None:
        """Execute up to the next statement, into calls."""
        self._until(lambda frames: True)

    def over(self) -> None:
        """Execute up to the next statement that is not in a call of this one."""
        frame = self._frame
        self._until(lambda frames: frame not in frames or frames[-1] is frame)

    def out(self) -> None:
        """Execute up to the next statement behind the end of this function."""
        frame = self._frame
        self._until(lambda frames: frame not in frames)

    def go(self) -> None:
        """Execute up to a breakpoint, or to the end."""
        self._until(lambda frames: False)

    def go_to(self, where: str) -> None:
        """Execute up to a line, FILE:LINE, for the focus; or to a breakpoint."""
        wanted = self.draw.shader.places_at(where)
        self._until(lambda frames: self.place in wanted)

    def stop_at(self, where: str, condition: str = "", visit: int = 1) -> Breakpoint:
        """Set a breakpoint; raises as `Shader.probe`."""
        lanes = len(self.draw.pixels)
        probe = self.draw.shader.probe(where, (), condition, visit)
        found = Breakpoint(where, probe, np.zeros(lanes, np.int64), np.zeros(lanes, bool))
        self.breakpoints.append(found)
        return found

    def watch(self, text: str) -> Watched:
        """Return an expression of the variables in scope, for the active pixels.

        Raises
        ------
        InputError
            The expression is wrong, or the draw has ended.
        """
        if self.place is None:
            raise InputError("the draw has ended: nothing is in scope", where="watch", found=text)
        expression = self.draw.shader.expression(self.place, text, "watch")
        reached, values = self._interpreter.mask & self.draw.drawn, self._interpreter.value(expression)
        return Watched.of_lanes(text, expression.type, values, reached, self.draw.pixels, self.draw.size)

    @property
    def names(self) -> list[str]:
        """Names of the local variables in scope, the innermost first."""
        known = self.place.names if self.place else {}
        return [name for name, each in known.items() if isinstance(each, Variable) and each.kind in LOCAL][::-1]

    @property
    def stack(self) -> list[Level]:
        """Call stack, the innermost function last."""
        found = []
        for frame in self._interpreter.frames:
            if frame.statement is not None:
                file, line = self.draw.shader.where(frame.statement.at)
                found.append(Level(frame.function.name, file, line, tuple(loop.iteration for loop in frame.loops)))
        return found

    @property
    def states(self) -> NDArray[np.uint8]:
        """What each pixel of the picture does, `State` (h, w)."""
        states = np.zeros(self.draw.size[::-1], np.uint8)
        each = np.where(self._interpreter.ended, State.ENDED, State.PASSIVE)
        if self.place is None:
            each[:] = State.ENDED
        each[self._interpreter.mask] = State.ACTIVE
        x, y = self.draw.pixels[self.draw.drawn].T
        states[y, x] = each[self.draw.drawn]
        return states

    @property
    def faults(self) -> list[str]:
        """Accesses outside of a block or an array so far, a message each."""
        found = []
        for at, (lane, index) in self._interpreter.faults.items():
            file, line = self.draw.shader.where(at)
            x, y = self.draw.pixels[lane].tolist()
            found.append(f"{file}:{line}: index {index} is outside, first at pixel {x},{y}")
        return found

    @property
    def _frame(self) -> Frame | None:
        return self._interpreter.frames[-1] if self._interpreter.frames else None

    def _next_draw(self) -> bool:
        draw = next(self._draws, None)
        if draw is None:
            return False
        self.draw, self.number, self._interpreter = draw, self.number + 1, draw.started()
        self.place: Place | None = None
        for each in self.breakpoints:
            each.visits, each.hit = np.zeros(len(draw.pixels), np.int64), np.zeros(len(draw.pixels), bool)
        return True

    def _until(self, is_there: Callable[[list[Frame]], bool]) -> None:
        """Execute until a condition of the call stack holds for the focus, or a breakpoint is hit."""
        focus = self.draw.lanes_of([self.focus]) if self.focus else self.draw.drawn
        while True:
            statement = self._interpreter.advance()
            if statement is None:
                if not self._next_draw():
                    self.place = None
                    return
                focus = self.draw.lanes_of([self.focus]) if self.focus else self.draw.drawn
                continue
            self.place = self.draw.shader.places.get(statement)
            hit, followed = self._is_hit(statement, focus), (self._interpreter.mask & focus).any()
            if hit or (followed and self.place and is_there(self._interpreter.frames)):
                return

    def _is_hit(self, statement: Statement, focus: Mask) -> bool:
        for each in self.breakpoints:
            point = next((point for point in each.probe.points if point.place.statement is statement), None)
            each.hit = np.zeros(self._interpreter.lanes, bool)
            if point is not None:
                mask = self._interpreter.mask
                if point.condition is not None:
                    mask = mask & self._interpreter.value(point.condition)[0]
                each.visits += mask
                each.hit = mask & (each.visits == each.probe.visit) & focus
        return any(each.hit.any() for each in self.breakpoints)
