"""Send strange messages to a live session by the thousand: `python tests/fuzz/messages.py --count 100000 [--draw]`.

The session is the oracle: it lives on, answers each message that it refuses, and after a reset shows the scene that was
opened. With `--draw`, each request is drawn, too, 8 x 8 pixels on the CPU.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
import numpy as np
from fuzz.mutate import mutated

from clusterviz.comm import LoopbackChannel
from clusterviz.errors import InputError
from clusterviz.frame import Options
from clusterviz.scene import scene_of_data
from clusterviz.scene.values import Scene
from clusterviz.viewer.describe import known_keys
from clusterviz.viewer.messages import Edit, Reset, parse
from clusterviz.viewer.pace import Pace
from clusterviz.viewer.render_loop import RenderLoop
from clusterviz.viewer.session import Job, Request, Session

OVERRIDES = (
    "volumes=[{path: 'field:gaussian:6', opacity: 0.5, clim: [0, 1]}, {path: 'field:gaussian:5', opacity: linear}]",
    *("image.size=[8, 8]", "automatic=false", "cluster.brick=8", "lights=[{position: [1, 1, 1]}]"),
)
SECTIONS = (*Scene.model_fields, "hidden", "volumes.0", "volumes.1", "volumes.2", "lights.0")
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 0.5, 1e308, -1e308, 1e-308, 2**53, 10**30, "", "x", "a.npy", "/dev/zero", "../x"),
    *("http://u:p@host/a.zarr?b=c", "field:gaussian:4", "field:gaussian:x", "*.npy", "\0", "é" * 50, "~", "front"),
    *("all", "auto", "isosurface", [], [0], [0, 1], [1, 0], [0, 0], [1, 2, 3], [[0, 0], [1, 1]], [[0, 0, 0, 1]] * 4),
    *({}, {"path": "a.npy"}, {"a": {}}, [{}], [{"path": "a.npy"}], [{"path": "a.npy"}] * 2, ["volumes.0"], [[[]]]),
)
NO_PIXELS = np.zeros((8, 8, 4), np.float32)
COSTLY = ("quality.step", "quality.adaptive", "quality.max_error", "quality.lens", "volumes.0.ambient_occlusion")
"""Keys that make a picture arbitrarily exact; they are not drawn."""


def strange_message(random: Random, given: dict[str, Any]) -> str:
    """Return a message of one of several kinds: an edit of some keys, a damaged one, or a step of the history."""
    kind = random.choice(("edit", "edit", "edit", "given", "damaged", "step", "view"))
    if kind == "step":
        return json.dumps({"type": random.choice(("undo", "redo", "reset"))})
    if kind == "view":
        pose = {name: random.choices((0, 1, -1, 1e-300, 1e300), k=3) for name in ("position", "focal_point", "view_up")}
        return json.dumps({"type": "view", "camera": pose, "moving": random.random() < 0.5, "input": 1})
    keys = [*known_keys(), *SECTIONS]
    changes = {random.choice(keys): random.choice(VALUES) for _ in range(random.choice((1, 1, 2, 3)))}
    if kind == "given":  # a part of the scene, which fits somewhere
        name = random.choice(list(given))
        changes = {name: random.choice((given[name], None, given[random.choice(list(given))]))}
    text = json.dumps({"type": "edit", "changes": changes, "moving": False, "input": 1})
    return mutated(text.encode(), random).decode(errors="replace") if kind == "damaged" else text


class Trial:
    """A session with one client, which keeps what it is told."""

    def __init__(self, draws: bool) -> None:
        scene = scene_of_data("a.npy", OVERRIDES)
        self._loop, self._pace = RenderLoop(scene, LoopbackChannel(), options=Options("cpu")), Pace(1.0)
        self.session = Session(self._loop.scene, self._loop.content, folders=[Path(__file__).parent])
        self._draws, self.errors, self.given = draws, list[str](), dict[str, Any]()
        self.client = self.session.join(self)
        self.opened = self.session.completed

    def send(self, message: dict[str, Any]) -> None:
        if message["type"] == "error":
            self.errors.append(message["message"])
        self.given = message.get("given", self.given)

    def show(self, picture: Any) -> None:
        pass

    def send_file(self, *_: Any) -> None:
        pass

    def send_one(self, random: Random) -> str:
        """Send a message, do what the session then asks for, and return what became of it."""
        try:
            message = parse(strange_message(random, self.given))
        except InputError:
            return "malformed"
        before, told = self.session.completed, len(self.errors)
        self._receive(message)
        is_drawn = self._draws and not (isinstance(message, Edit) and any(key in COSTLY for key in message.changes))
        while (request := self.session.next_request(0.0)) is not None:
            if isinstance(request, Job):
                continue
            if is_drawn:
                self._loop._answer(self.session, request, self._pace)
            else:
                self.session.finished(request, NO_PIXELS, 0.0, None)
        assert not self.session.is_ended
        if len(self.errors) > told:
            return "refused"
        return "followed" if self.session.completed != before else "no change"

    def check_reset(self) -> None:
        """Check that the session still shows the scene that was opened, when it is asked to."""
        self._receive(Reset())
        assert isinstance(self.session.next_request(0.0), Request)
        shown = self.session.completed
        opened_image = self.opened.image.model_copy(
            update={"size": shown.image.size}
        )  # a reset keeps the window's size
        assert shown == self.opened.model_copy(update={"image": opened_image})

    def _receive(self, message: Any) -> None:
        self.session.receive(self.client, message)


def run(count: int, seed: int, draws: bool) -> tuple[Counter[str], list[str]]:
    """Send messages; return how many had which outcome, and what was said."""
    random, trial, outcomes = Random(seed), Trial(draws), Counter[str]()
    for number in range(count):
        outcomes[trial.send_one(random)] += 1
        if number % 50 == 49:
            trial.check_reset()
    return outcomes, trial.errors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--draw", action="store_true")
    options = parser.parse_args()
    outcomes, errors = run(options.count, options.seed, options.draw)
    print(dict(outcomes))
    for text, times in Counter(text for text in errors if "Error: " in text).most_common():
        print(f"{times:6} {text[:200]}")


if __name__ == "__main__":
    main()
