"""Session of the debugger in a terminal: source, call stack, watches and a small picture, and a prompt."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from clusterviz.debugger.session import Session, State
from clusterviz.debugger.watches import Watched
from clusterviz.errors import InputError, escaped

AROUND = 6
"""Lines of the source in front of and behind the next one."""
CELLS = 48, 16
"""Largest picture, in characters."""
COMMANDS = {
    "step": "step, into calls",
    "next": "step over calls; so does an empty line",
    "out": "step out of the function",
    "continue": "continue to the next breakpoint",
    "to FILE:LINE": "continue to a line",
    "break FILE:LINE [#N] [if CONDITION]": "stop at a pixel's N-th visit; break lists, break- removes all",
    "watch EXPRESSION": "show a value at every stop; watch- removes all",
    "pixel X,Y": "follow a pixel; pixel- follows all",
    "list": "variables in scope",
    "map": "how many pixels are active, passive and ended",
    "image EXPRESSION": "picture of a value",
    "histogram EXPRESSION": "histogram of a value",
    "differences": "how the watches changed since the stop before",
    "quit": "end the session",
}
"""What a session understands; the beginning of a name is enough."""


class Page:
    """Session with what is shown of it.

    Parameters
    ----------
    session : stopped
    console : to write to
    watches : expressions shown at every stop
    """

    def __init__(self, session: Session, console: Console, watches: list[str]) -> None:
        self._session, self._console, self._watches = session, console, watches
        self._before: dict[str, Watched] = {}
        self._now: dict[str, Watched] = {}

    def run(self, ask: Callable[[], str]) -> None:
        """Show the session and execute commands until `q` or the end of the input."""
        self._look()
        while True:
            try:
                words = ask().strip()
            except EOFError:
                return
            if words and "quit".startswith(words):
                return
            try:
                self._execute(words)
            except InputError as error:
                self._console.print(f"[red]{error}[/red]", highlight=False)

    def _execute(self, words: str) -> None:
        session, (word, _, rest) = self._session, words.partition(" ")
        found = [name[0] for name in COMMANDS if name.split()[0].startswith(word.removesuffix("-"))]
        command = "".join(found[:1]) + "-" * word.endswith("-") if word else "n"
        steps = {"s": session.step, "n": session.over, "o": session.out, "c": session.go}
        if command in steps or command == "t":
            steps[command]() if command in steps else session.go_to(rest)
            self._look()
        elif command in ("b", "b-", "w", "w-", "p", "p-"):
            self._set(command, rest.strip())
        elif command == "l":
            self._console.print(", ".join(session.names), highlight=False)
        elif command == "m":
            self._console.print(self._states())
        elif command == "i":
            self._console.print(half_blocks(session.watch(rest).picture()))
        elif command == "h" and rest:
            self._console.print(Group(*(histogram_of(rest, each) for each in session.watch(rest).histogram())))
        elif command == "d":
            differences = [now.minus(self._before[text]) for text, now in self._now.items() if text in self._before]
            self._console.print(self._table(differences))
        elif word in ("h", "help", "?"):
            table = Table.grid(padding=(0, 2))
            for each, does in COMMANDS.items():
                table.add_row(Text(each), does)
            self._console.print(table)
        else:
            raise InputError("no command", where="session", found=words, allowed="what help lists")

    def _set(self, command: str, rest: str) -> None:
        session = self._session
        if command == "b" and rest:
            where, _, condition = rest.partition(" if ")
            where, _, visit = where.partition("#")
            if visit and not visit.strip().isdecimal():
                raise InputError("not a number of a visit", where="b", found=visit, allowed="#1, #2, …")
            session.stop_at(where.strip(), condition, int(visit or 1))
        elif command == "b-":
            session.breakpoints.clear()
        elif command == "w" and rest:
            self._watches.append(rest)  # it may come into scope
            session.watch(rest)
        elif command == "w-":
            self._watches.clear()
        elif command == "p" and rest:
            x, _, y = (part.strip() for part in rest.partition(","))
            if not (x.isdecimal() and y.isdecimal() and session.draw.lanes_of([(int(x), int(y))]).any()):
                raise InputError("no pixel of this draw", where="p", found=rest, allowed="X,Y on the volume")
            session.focus = int(x), int(y)
        elif command == "p-":
            session.focus = None
        for each in session.breakpoints:
            condition = f" if {each.probe.condition}" if each.probe.condition else ""
            self._console.print(f"break at {each.where}, visit {each.probe.visit}{condition}")
        watching = ", ".join(self._watches) or "nothing"
        self._console.print(f"watching {watching}; following {session.focus or 'all pixels'}")

    def _look(self) -> None:
        session = self._session
        self._before, self._now = self._now, {}
        for text in self._watches if session.place else ():
            try:
                self._now[text] = session.watch(text)
            except InputError:
                continue  # not in scope here
        if session.place is None:
            self._console.print("the draw has ended")
            return
        stack = Table.grid(padding=(0, 1))
        for level in session.stack[::-1]:
            loops = ", ".join(f"iteration {number}" for number in level.iterations)
            stack.add_row(level.function, escaped(f"{level.file}:{level.line}"), loops)
        parts: list[Any] = [Panel(self._source(), title=self._title(), title_align="left"), stack, self._states()]
        if self._now:
            clim = session.draw.shader.clim
            parts.append(self._table([one for each in self._now.values() for one in each.in_data(clim)]))
            shown = [watch for watch in self._now.values() if len(watch.names) == 1 or watch.is_colour]
            parts += [Text(shown[-1].text), half_blocks(shown[-1].picture())] if shown else []
        self._console.print(Group(*parts, *(Text(fault, style="red") for fault in session.faults)))

    def _title(self) -> str:
        level, number = self._session.stack[-1], self._session.number
        return f"{escaped(level.file)}:{level.line} in {level.function}, dispatch {number}"

    def _source(self) -> Text:
        session, place = self._session, self._session.place
        assert place, "the draw is stopped"
        text = session.draw.shader.source.text
        lines, at = escaped(text).split("\n"), text.count("\n", 0, place.statement.at)
        number = session.draw.shader.where(place.statement.at)[1]
        begin, end = at, at
        while begin > 0 and at - begin < AROUND and not lines[begin - 1].startswith("#line"):
            begin -= 1
        while end + 1 < len(lines) and end - at < AROUND and not lines[end + 1].startswith("#line"):
            end += 1
        found = Text(no_wrap=True, overflow="ellipsis")
        for n in range(begin, end + 1):
            mark, style = ("▶", "bold reverse") if n == at else (" ", "")
            found.append(f"{mark}{number + n - at:5} {lines[n]}\n", style)
        found.rstrip()
        return found

    def _states(self) -> Text:
        states = self._session.states
        names = {State.ACTIVE: "green", State.PASSIVE: "yellow", State.ENDED: "bright_black"}
        parts = [(f"{np.count_nonzero(states == each)} {each.name.lower()}  ", style) for each, style in names.items()]
        return Text.assemble("pixels: ", *parts)

    def _table(self, watches: list[Watched]) -> Table:
        table, focus = Table("watch", "pixel", "least", "mean", "most", box=None), self._session.focus
        for watch in watches:
            at = watch.at(*focus) if focus else None
            for each in watch.histogram(1):
                here = "" if at is None else f"{at[each['name']]:.7g}"
                numbers = (f"{each[key]:.7g}" for key in ("min", "mean", "max"))
                table.add_row(Text(watch.text + each["name"]), here, *numbers)
        return table


def half_blocks(rgba: NDArray[np.float32]) -> Text:
    """Return a picture as text, two pixels in a character; what is transparent is black."""
    height, width = rgba.shape[:2]
    columns, rows = min(CELLS[0], width), min(2 * CELLS[1], height + height % 2)
    y, x = np.arange(rows) * height // rows, np.arange(columns) * width // columns
    colours = np.rint(255 * np.clip(rgba[np.ix_(y, x)][..., :3], 0, 1)).astype(int)
    text = Text(no_wrap=True)
    for top, bottom in zip(colours[::2], colours[1::2], strict=True):
        for above, below in zip(top.tolist(), bottom.tolist(), strict=True):
            text.append("▀", "rgb({},{},{}) on rgb({},{},{})".format(*above, *below))
        text.append("\n")
    text.rstrip()
    return text


def histogram_of(text: str, each: dict[str, object]) -> Text:
    """Return the histogram of a scalar as a line of bars, with its range."""
    counts = np.array(each["counts"])
    bars = "".join(" ▁▂▃▄▅▆▇█"[int(np.ceil(8 * count / max(1, counts.max())))] for count in counts)
    return Text(f"{text}{each['name']:8} {each['min']:.7g} ▕{bars}▏ {each['max']:.7g}, mean {each['mean']:.7g}")
