"""Drawing of a live session on all ranks.

Rank 0 takes requests from the session and sends them to the other ranks, which wait with a growing back-off. One
request is one frame of a `FrameLoop`, which is opened again where the scene names other content. A still picture is
abandoned on all ranks as soon as there is newer input.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from clusterviz.comm import Channel
from clusterviz.comm.agree import describe, is_agreed
from clusterviz.comm.channel import Pending
from clusterviz.errors import ClustervizError
from clusterviz.frame import FrameLoop, Options, Rendered
from clusterviz.frame.opening import Given
from clusterviz.frame.run import Image
from clusterviz.image.picture import layers_of
from clusterviz.kernels import objects
from clusterviz.report.provenance import Provenance
from clusterviz.scene.values import Scene
from clusterviz.viewer.describe import Content
from clusterviz.viewer.knobs import Measurement, described, trials
from clusterviz.viewer.messages import Pick, Save
from clusterviz.viewer.pace import Pace
from clusterviz.viewer.picking import SIDE, index_of, names_of_objects, position_at, scene_of_pick, value_at
from clusterviz.viewer.saving import OpenedAs, command_line, path_file, picture_file, scene_file
from clusterviz.viewer.session import Job, Request, Session

WAKE, STOP = 7101, 7102
"""Tags of messages from rank 0: there is a command; a frame is abandoned (1), or not (0)."""
LONGEST_SLEEP, SHORTEST_SLEEP, SLEEP_SHARE = 2e-2, 2e-4, 1 / 500
"""Sleep of waiting ranks between two looks for a command, seconds: a share of the time that they have waited."""
QUICK_SECONDS = 0.3
"""A still picture that is expected to take longer comes after one of the quality of moving ones."""
IDLE_SECONDS = 1.0
"""Time that rank 0 waits for a request before it looks for a signal."""


class AbandonedError(ClustervizError):
    """A frame was abandoned, as newer input has come."""


@dataclass(frozen=True)
class Command:
    """What all ranks do next."""

    kind: Literal["draw", "end"]  # draw a frame, or end
    scene: Scene | None = None  # completed
    alone: bool = False  # decide on the frame as on a single one
    may_stop: bool = False  # whether newer input abandons the frame


class Abandoning:
    """Agreement of all ranks to abandon a frame, on rank 0's decision.

    Rank 0 sends each rank one message a frame: while it draws, if there is newer input, else at the end.

    `has_input`: on rank 0, whether there is newer input.
    """

    def __init__(self, channel: Channel, has_input: Callable[[], bool]) -> None:
        self._channel, self._has_input = channel, has_input
        self._answer, self._pending = np.zeros(1, np.uint8), list[Pending]()
        self._is_open = False
        self.abandoned = False

    def begin(self) -> None:
        """Begin a frame that may be abandoned."""
        self._is_open, self.abandoned = True, False
        if self._channel.rank:
            self._pending = [self._channel.post_receive(self._answer, 0, STOP)]

    def poll(self) -> None:
        """Abandon the frame if there is reason to; called while a rank draws.

        Raises AbandonedError: rank 0 has decided so.
        """
        if not self._is_open or self.abandoned:
            return
        if self._channel.rank == 0:
            if self._has_input():
                self._tell(True)
        elif self._pending and self._channel.test_some(self._pending):
            self._pending, self.abandoned = [], bool(self._answer[0])
        if self.abandoned:
            raise AbandonedError("newer input has come")

    def end(self) -> bool:
        """End the frame; return whether it was abandoned, the same on every rank."""
        if self._channel.rank == 0 and not self.abandoned:
            self._tell(False)
        while self._pending:
            if self._channel.wait_some(self._pending):
                self._pending, self.abandoned = [], bool(self._answer[0])
        self._channel.wait_sends()
        self._is_open = False
        return self.abandoned

    def _tell(self, abandoned: bool) -> None:
        self.abandoned = abandoned
        self._answer[0] = abandoned
        for rank in range(1, self._channel.size):
            self._channel.isend(self._answer, rank, STOP)


class RenderLoop:
    """Frames of a session on all ranks.

    `source`: the data instead of the files that the scene names. `opened_as`: how the scene was opened, for command
    lines. Raises ClustervizError as `FrameLoop` does.
    """

    def __init__(
        self,
        scene: Scene,
        channel: Channel,
        source: Given = None,
        options: Options | None = None,
        *,
        opened_as: OpenedAs | None = None,
    ) -> None:
        self._channel, self._source = channel, source
        self._opened_as = opened_as
        self._session: Session | None = None
        self._abandoning = Abandoning(channel, self._has_input)
        kept: dict[str, Any] = {"overlap": False, "keep_bricks": True, "keep_drawn": True, "annotate": True}
        self._options = replace(options or Options(), **kept, poll=self._abandoning.poll, write=self._note)
        self._made: Provenance | None = None
        self._fatal: Exception | None = None
        self._loop = FrameLoop(scene, channel, source, self._options)
        self._frames, self._is_new = 0, False
        self._content = self.content
        self._still_seconds, self._previewed, self._measured = math.inf, 0, 0

    @property
    def scene(self) -> Scene:
        """The completed scene, as it was opened."""
        return self._loop.scene

    @property
    def content(self) -> Content:
        """What is known of the data."""
        return Content(self._loop.opened.infos)

    def follow(self) -> None:
        """Draw what rank 0 says until the end; for all other ranks."""
        while (command := self._next_command()).kind != "end":
            try:
                self._draw(command)
            except ClustervizError as error:
                if not error.agreed:
                    raise
        self.close()

    def lead(self, session: Session, pace: Pace) -> None:
        """Draw what a session asks for until it is closed; for rank 0."""
        self._session = session
        announce = objects.on_compiling

        def tell(name: str) -> None:
            announce(name)
            session.busy("compiling kernels")

        objects.on_compiling = tell
        while not session.is_ended:
            request = session.next_request(IDLE_SECONDS)
            if isinstance(request, Request):
                self._answer(session, request, pace)
            elif isinstance(request, Job):
                self._do(session, request)
            else:
                self._measure(session)
        objects.on_compiling = announce
        self._send(Command("end"))
        self.close()

    def close(self) -> None:
        """Free what the frames needed; collective."""
        self._loop.__exit__(None)

    def _answer(self, session: Session, request: Request, pace: Pace) -> None:
        if not request.moving and self._still_seconds > QUICK_SECONDS and request.number != self._previewed:
            request = replace(request, moving=True)  # the still picture follows
        self._previewed = request.number
        began = time.perf_counter()
        completed = request.completed
        scene = pace.settings(completed) if request.moving else completed
        try:
            rendered = self._draw_on_all(Command("draw", scene, not request.moving, not request.moving))
        except Exception as error:
            session.failed(request, self._answerable(error))
            return
        seconds = time.perf_counter() - began
        if not request.moving:
            self._still_seconds = seconds
        if self._is_new and not request.hidden:
            session.reopened(self.content)
        self._is_new = self._is_new and bool(request.hidden)
        if rendered is None or rendered.image is None:
            return
        if request.moving:
            width, height = completed.image.size
            drawing = rendered.statistics.seconds.get("render", 0.0)
            pace.learn(width * height, seconds, seconds - drawing)
        statistics = _statistics(rendered)
        remarks = (*rendered.statistics.warnings, *map(str, rendered.statistics.changes))
        session.finished(request, rendered.image, seconds, statistics, remarks)

    def _do(self, session: Session, job: Job) -> None:
        message, scene = job.message, job.request.completed
        try:
            if isinstance(message, Pick):
                found = {"type": "picked", "pick": message.pick, **self._picked(scene, job.request.hidden, message)}
                session.answer(job.client, lambda client: client.send(found))
            else:
                name, media_type, content = self._saved(scene, message)
                session.answer(job.client, lambda client: client.send_file(message.save, name, media_type, content))
        except Exception as error:
            about = {"pick": message.pick} if isinstance(message, Pick) else {"save": message.save}
            failed = {"type": "error", "message": str(self._answerable(error)), "key": None, **about}
            session.answer(job.client, lambda client: client.send(failed))

    def _picked(self, scene: Scene, hidden: Sequence[str], message: Pick) -> dict[str, Any]:
        nothing = {"position": None, "index": None, "value": None, "name": ""}
        if not self._loop.opened.infos:
            return nothing
        small = scene_of_pick(scene, message.x, message.y)
        rendered = self._draw_on_all(Command("draw", small, alone=True))
        layers = layers_of(rendered.image) if rendered is not None and rendered.image is not None else {}
        middle = SIDE // 2, SIDE // 2
        if not layers or layers["object"][middle] < 0:
            return nothing
        position = position_at(small, float(layers["depth"][middle]))
        name, volume = names_of_objects(scene, hidden)[int(layers["object"][middle])]
        found = {**nothing, "position": position.tolist(), "name": name}
        if volume is not None:
            source = self._loop.opened.volumes[volume].source
            index = index_of(source.grid, position)
            found |= {"index": index.tolist(), "value": value_at(source, index)}
        return found

    def _saved(self, scene: Scene, message: Save) -> tuple[str, str, bytes]:
        """Return name, media type and content of a file."""
        if message.what == "scene":
            return "scene.yaml", "application/yaml", scene_file(scene)
        if message.what == "path":
            return "path.yaml", "application/yaml", path_file(message.keys)
        if message.what == "command":
            if self._opened_as is None:
                raise ClustervizError("a scene in memory has no command line: save it as a file")
            line = command_line(self._opened_as, scene, self._content)
            return "command.txt", "text/plain", line.encode()
        width, height = scene.image.size
        size = message.width or width, message.height or height
        sized = scene.model_copy(update={"image": scene.image.model_copy(update={"size": size})})
        rendered = self._draw_on_all(Command("draw", sized, alone=True))
        if rendered is None or rendered.image is None or self._made is None:
            raise ClustervizError("there is no picture")
        types = {"png": "image/png", "npz": "application/octet-stream"}
        content = picture_file(rendered.image, rendered.scene, self._made, message.format)
        return f"picture.{message.format}", types[message.format], content

    def _measure(self, session: Session) -> None:
        """Measure cost and error of settings on small pictures, once for each scene, while there is nothing else."""
        request, measured = session.present(), list[Measurement]()
        if request is None or request.revision == self._measured:
            return
        for trial in trials(request.completed):
            try:
                rendered = self._draw_on_all(Command("draw", trial.scene, may_stop=True)) if session.is_idle else None
            except Exception as error:
                self._answerable(error)
                self._measured = request.revision
                return
            if rendered is None or rendered.image is None:
                return
            measured.append(Measurement(trial, np.asarray(rendered.image), rendered.statistics.seconds["render"]))
        self._measured = request.revision
        session.tell({"type": "knobs", "items": described(request.completed, measured)})

    def _draw_on_all(self, command: Command) -> Rendered | None:
        self._send(command)
        try:
            return self._draw(command)
        except Exception as error:
            if self._channel.size > 1 and not is_agreed(error):
                self._fatal = error
            raise

    def _answerable(self, error: Exception) -> ClustervizError:
        """Return an error for clients; raise one after which other ranks wait for messages that will not come."""
        if error is self._fatal:
            raise error
        return error if isinstance(error, ClustervizError) else ClustervizError(describe(error))

    def _draw(self, command: Command) -> Rendered | None:
        """Draw a frame; None if it was abandoned; collective."""
        scene = command.scene
        assert scene is not None, "there is something to draw"
        is_complete = self._loop.suits(scene)  # else by facts on other content
        if not is_complete:
            self._reopen(scene)
        if command.may_stop:
            self._abandoning.begin()
        self._frames += 1
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # clients are told
                rendered = self._loop.frame(scene, self._frames, alone=command.alone, is_complete=is_complete)
        except Exception as error:
            is_answered = is_agreed(error) or self._channel.size == 1
            if command.may_stop and is_answered and self._abandoning.end():
                return None
            raise
        return None if command.may_stop and self._abandoning.end() else rendered

    def _reopen(self, scene: Scene) -> None:
        """Open the content of another scene; if that fails, the last one stays."""
        loop = FrameLoop(scene, self._channel, self._source, self._options)
        self._loop.__exit__(None)
        self._loop, self._is_new = loop, True

    def _note(self, image: Image, scene: Scene, made: Provenance) -> None:
        self._made = made

    def _has_input(self) -> bool:
        return self._session is not None and self._session.has_input()

    def _send(self, command: Command) -> None:
        wake = np.zeros(1, np.uint8)
        for rank in range(1, self._channel.size):
            self._channel.isend(wake, rank, WAKE)
        if self._channel.size > 1:
            self._channel.broadcast(command)
            self._channel.wait_sends()

    def _next_command(self) -> Command:
        """Wait for a command of rank 0; the sleep between looks grows with the time."""
        began = time.perf_counter()
        pending = [self._channel.post_receive(np.zeros(1, np.uint8), 0, WAKE)]
        while not self._channel.test_some(pending):
            waited = time.perf_counter() - began
            time.sleep(min(LONGEST_SLEEP, max(SHORTEST_SLEEP, waited * SLEEP_SHARE)))
        return self._channel.broadcast(Command("end"))


def _statistics(rendered: Rendered) -> dict[str, Any]:
    statistics = rendered.statistics
    stages = [name for name in statistics.seconds if name != "total"]
    names = ("samples", "bricks_drawn", "bytes_sent", "peak_memory_bytes")
    per_rank = [
        {
            "seconds": {name: rank.seconds.get(name, 0.0) for name in stages},
            "total": rank.seconds.get("total", 0.0),
            **{name: int(getattr(rank, name)) for name in names},
        }
        for rank in statistics.per_rank
    ]
    return {
        "total_seconds": statistics.seconds.get("total", 0.0),
        "stages": stages,
        "per_rank": per_rank,
        "imbalance": statistics.imbalance,
        "boxes": _boxes(rendered),
    }


def _boxes(rendered: Rendered) -> list[dict[str, Any]]:
    """Return the boxes around what each rank has drawn, with their corners in the world."""
    drawn = rendered.drawn
    if drawn is None or drawn.work.plan is None or drawn.work.mode != "sort-last":
        return []
    plan, found = drawn.work.plan, []
    matrix = plan.content.domain.grid.world_from_index
    for piece in drawn.work.pieces:
        begin, end = plan.layout.cells_of(piece.box.begin_zyx, piece.box.end_zyx)
        ends = np.array([begin[::-1], end[::-1]], float)
        corners = [[*(ends[bits >> axis & 1, axis] for axis in range(3)), 1.0] for bits in range(8)]
        found.append({"rank": piece.rank, "corners": (np.array(corners) @ matrix.T)[:, :3].tolist()})
    return found
