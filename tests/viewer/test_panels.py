"""The panels of the page, in a real browser: what they send, and how they show states and errors."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from clusterviz.content.complete import complete_scene
from clusterviz.content.facts import box_corners
from clusterviz.content.volume.info import VolumeInfo
from clusterviz.scene.values import Scene
from clusterviz.viewer.describe import Content
from clusterviz.viewer.messages import parse

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page

pytestmark = pytest.mark.browser
POINTS = [[0.0, 0.0], [100.0, 0.2], [200.0, 0.8]]
START = """async () => {
  for (const name of ["page.css", "viewer.css", "panels.css"]) {
    const link = Object.assign(document.createElement("link"), {rel: "stylesheet", href: name});
    document.head.append(link);
    await new Promise((done) => (link.onload = done));
  }
  const {createViewer} = await import("./viewer.js");
  const listeners = {};
  window.sent = [];
  createViewer(document.body, {
    send: (message) => window.sent.push(message), close() {}, onClose() {}, onStatus() {},
    onText: (listen) => (listeners.text = listen), onBinary: (listen) => (listeners.binary = listen),
  });
  window.tell = (message) => listeners.text(message);
  window.tellFile = (header, bytes) => {
    const head = new TextEncoder().encode(JSON.stringify(header));
    const data = new Uint8Array(4 + head.length + bytes.length);
    new DataView(data.buffer).setUint32(0, head.length, true);
    data.set(head, 4);
    data.set(bytes, 4 + head.length);
    listeners.binary(data.buffer);
  };
}"""
"""Starts the page with a connection to nothing, which keeps what is sent."""


def described(**keys: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """The messages hello and state of a scene with one volume of values 0 to 250."""
    info = VolumeInfo(
        shape_zyx=(40, 40, 40),
        spacing=(1.0, 1.0, 1.0),
        corners=box_corners(np.array([[0.0, 0.0, 0.0], [39.0, 39.0, 39.0]])),
        minimum=0.0,
        maximum=250.0,
        percentile_1=10.0,
        percentile_99=240.0,
        histogram=np.arange(1, 65),
    )
    volume = {"path": "head.nii.gz", "cmap": "bone", "clim": [0, 200], "opacity": POINTS, **keys.pop("volume", {})}
    scene = complete_scene(Scene(volumes=[volume], **keys), [info])
    content = Content((info,))
    hello = {"type": "hello", "protocol": 1, "client": 1, "ranks": 2, "budget_ms": 50, **content.hello()}
    hello["colour_maps"] = [one for one in hello["colour_maps"] if one["name"] in ("bone", "viridis", "gray")]
    hello["presets"] = [{"name": "bone", "description": "bone alone"}]
    state = {"type": "state", "revision": 1, "scene": scene.model_dump(mode="json"), "given": {}, "steering": 1}
    state |= {"clients": [1], "asking": [], "can_undo": True, "can_redo": False, "warnings": [], "hidden": []}
    return hello, {**state, **content.state(scene)}


class Panels:
    """The page with a session that answers nothing by itself."""

    def __init__(self, page: Page) -> None:
        self.page = page

    def tell(self, message: dict[str, Any]) -> None:
        self.page.evaluate("message => tell(message)", message)

    def start(self, **keys: Any) -> dict[str, Any]:
        """Show a scene; return the state."""
        hello, state = described(**keys)
        self.tell(hello)
        self.tell(state)
        self.sent()
        return state

    def open(self, name: str) -> Locator:
        """Open one panel, and close the others."""
        self.page.evaluate(
            "name => document.querySelectorAll('.panel').forEach((p) => (p.open = p.dataset.panel === name))", name
        )
        return self.page.locator(f".panel[data-panel={name}]")

    def sent(self) -> list[dict[str, Any]]:
        """Messages since the last call, of all kinds but sizes and pings; the session understands each of them."""
        # Edits are sent with the next frame.
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        sent = self.page.evaluate("() => sent.splice(0)")
        for message in sent:
            parse(json.dumps(message))
        return [message for message in sent if message["type"] not in ("size", "ping")]

    def change(self) -> dict[str, Any]:
        """The changes of the one edit since the last call."""
        (message,) = self.sent()
        assert message["type"] == "edit"
        assert not message["moving"]
        changes: dict[str, Any] = message["changes"]
        return changes

    def place(self, value: float, opacity: float) -> tuple[float, float]:
        """Where the plot has a value and an opacity, in pixels of the page."""
        editor = "import('./histogram.js').then(({PLOT}) => PLOT)"
        plot = self.page.evaluate(editor)
        box = self.page.locator(".plot").bounding_box()
        scale = box["width"] / plot["width"]
        low, high = -5.0, 255.0
        x = plot["left"] + (value - low) / (high - low) * (plot["right"] - plot["left"])
        y = plot["bottom"] - opacity * (plot["bottom"] - plot["top"])
        return box["x"] + x * scale, box["y"] + y * scale

    def drag(self, start: tuple[float, float], *stops: tuple[float, float]) -> list[dict[str, Any]]:
        """Drag from one place of the plot over others; return what was sent."""
        mouse = self.page.mouse
        mouse.move(*self.place(*start))
        mouse.down()
        for stop in stops:
            mouse.move(*self.place(*stop), steps=2)
        mouse.up()
        return self.sent()


@pytest.fixture(scope="module")
def page(module_page: Page) -> Iterator[Page]:
    problems: list[str] = []
    module_page.on("pageerror", lambda error: problems.append(str(error)))
    module_page.set_viewport_size({"width": 1000, "height": 900})
    module_page.set_default_timeout(5000)
    module_page.evaluate(START)
    yield module_page
    assert problems == []


@pytest.fixture
def panels(page: Page) -> Panels:
    return Panels(page)


def test_a_dragged_point_is_one_gesture(panels: Panels) -> None:
    panels.start()
    panels.open("contents")
    sent = panels.drag((100, 0.2), (120, 0.3), (140, 0.5))
    assert len(sent) >= 2
    assert {message["merge"] for message in sent} == {sent[0]["merge"]}
    assert [message["moving"] for message in sent] == [True] * (len(sent) - 1) + [False]
    points = np.array(sent[-1]["changes"]["volumes.0.opacity"])
    assert points == pytest.approx(np.array([[0, 0], [140, 0.5], [200, 0.8]]), abs=1.0)
    assert points[[0, 2]].tolist() == [POINTS[0], POINTS[2]]
    assert points[1, 1] == pytest.approx(0.5, abs=0.02)


def test_points_stay_in_order_and_may_be_a_step(panels: Panels) -> None:
    panels.start()
    panels.open("contents")
    points = panels.drag((100, 0.2), (240, 0.2))[-1]["changes"]["volumes.0.opacity"]
    assert points[1][0] == points[2][0] == 200.0


def test_points_are_added_and_removed(panels: Panels) -> None:
    state = panels.start()
    panels.open("contents")
    panels.page.mouse.dblclick(*panels.place(50, 0.6))
    added = panels.change()["volumes.0.opacity"]
    assert [point[0] for point in added] == pytest.approx([0, 50, 100, 200], abs=1.0)
    assert added[1][1] == pytest.approx(0.6, abs=0.02)
    panels.page.keyboard.press("Delete")
    assert panels.change()["volumes.0.opacity"] == POINTS
    panels.tell(state)
    panels.page.mouse.click(*panels.place(200, 0.8), button="right")
    assert panels.change()["volumes.0.opacity"] == POINTS[:2]


def test_keys_and_numbers_move_a_point(panels: Panels) -> None:
    panels.start()
    panels.open("contents")
    panels.page.locator("[data-handle=point-1]").focus()
    panels.page.keyboard.press("ArrowUp")
    assert panels.change()["volumes.0.opacity"][1] == [100.0, 0.21]
    panels.page.locator(".selected-row input[title=value]").fill("150.5")
    panels.page.keyboard.press("Enter")
    assert panels.change()["volumes.0.opacity"][1] == [150.5, 0.21]


def test_a_preset_of_opacity_is_shown_as_points(panels: Panels) -> None:
    panels.start(volume={"opacity": "linear"})
    panels.open("contents")
    assert panels.page.locator(".handle.point").count() == 2
    points = panels.drag((200, 1.0), (200, 0.5))[-1]["changes"]["volumes.0.opacity"]
    assert points == [[0, 0], [pytest.approx(200, abs=1), pytest.approx(0.5, abs=0.02)]]


def test_a_state_does_not_disturb_a_drag(panels: Panels) -> None:
    state = panels.start()
    panels.open("contents")
    mouse = panels.page.mouse
    mouse.move(*panels.place(100, 0.2))
    mouse.down()
    mouse.move(*panels.place(160, 0.6), steps=2)
    panels.tell(state)
    at = panels.page.locator("[data-handle=point-1]").get_attribute("aria-valuenow")
    mouse.up()
    assert float(at) == pytest.approx(160, abs=1.5)
    assert panels.sent()[-1]["changes"]["volumes.0.opacity"][1][0] == pytest.approx(160, abs=1.5)


def test_isovalues(panels: Panels) -> None:
    panels.start(volume={"isosurfaces": [150, [60, 0.5]]})
    panels.open("contents")
    moved = panels.drag((60, 0.5), (80, 0.5))[-1]["changes"]["volumes.0.isosurfaces"]
    assert moved == [150, [pytest.approx(80, abs=1.5), pytest.approx(0.5, abs=0.02)]]
    panels.page.get_by_role("button", name="+ isovalue").click()
    assert len(panels.change()["volumes.0.isosurfaces"]) == 3


def test_a_blend_mode_that_the_table_gains_shows_its_threshold(panels: Panels) -> None:
    hello, state = described()
    hello["blend_modes"]["own"] = {"threshold": True, "surfaces": "refused"}
    state["scene"]["volumes"][0]["blending"] = "own"
    for message in (hello, state):
        panels.tell(message)
    assert panels.open("contents").get_by_label("Threshold").is_visible()


CHANGES = [
    (
        "contents",
        lambda p: p.get_by_label("Blend mode").select_option(label="maximum"),
        {"volumes.0.blending": "maximum"},
    ),
    (
        "contents",
        lambda p: p.get_by_label("Blend mode").select_option(label="isosurface"),
        {"volumes.0.blending": "isosurface", "volumes.0.isosurfaces": [[100, 1]]},
    ),
    ("contents", lambda p: p.get_by_label("Show head.nii.gz").click(), {"hidden": ["volumes.0"]}),
    ("contents", lambda p: p.get_by_role("button", name="1–99 %").click(), {"volumes.0.clim": [10, 240]}),
    ("lights", lambda p: p.get_by_role("button", name="+ headlight").click(), {"lights": [{"type": "headlight"}]}),
    ("clipping", lambda p: p.get_by_title("A plane across y").click(), {"clip.planes": [[[19.5] * 3, [0, 1, 0]]]}),
    ("clipping", lambda p: p.get_by_label("Clip box").check(), {"clip.box": [0, 39, 0, 39, 0, 39]}),
    ("picture", lambda p: p.get_by_role("button", name="black").click(), {"image.background": "black"}),
    ("quality", lambda p: p.get_by_label("Filter").select_option(label="hardware"), {"quality.filter": "hardware"}),
]


@pytest.mark.parametrize(("panel", "act", "changes"), CHANGES, ids=[next(iter(row[2])) for row in CHANGES])
def test_controls_send_their_key(panels: Panels, panel: str, act: Any, changes: dict[str, Any]) -> None:
    panels.start()
    act(panels.open(panel))
    assert panels.change() == changes


def test_a_choice_of_colours_and_a_preset(panels: Panels) -> None:
    panels.start()
    contents = panels.open("contents")
    contents.locator(".map-choice summary").click()
    contents.get_by_placeholder("Search…").fill("virid")
    panels.page.keyboard.press("Enter")
    assert panels.change() == {"volumes.0.cmap": "viridis"}
    contents.get_by_label("Preset").select_option("bone")
    assert panels.sent() == [{"type": "preset", "volume": 0, "name": "bone"}]


def test_an_error_is_shown_at_its_key_until_the_next_state(panels: Panels) -> None:
    state = panels.start()
    panels.open("quality")
    panels.tell({"type": "error", "message": "quality.step: too small", "key": "quality.step"})
    place = panels.page.locator("[data-key='quality.step'].invalid + .error-text")
    assert place.inner_text() == "quality.step: too small"
    panels.tell(state)
    assert panels.page.locator(".invalid, .error-text").count() == 0


def test_clients_that_watch_cannot_edit(panels: Panels) -> None:
    state = panels.start()
    contents = panels.open("contents")
    panels.tell({**state, "steering": 2, "clients": [1, 2]})
    assert contents.get_by_label("Blend mode").is_disabled()
    assert panels.drag((100, 0.2), (140, 0.5)) == []
    assert panels.page.get_by_role("button", name="Undo").is_disabled()
    assert panels.open("save").get_by_role("button", name="Scene").is_enabled()


def test_bars_of_stages_add_up_to_the_frame(panels: Panels) -> None:
    panels.start()
    opened = panels.open("statistics")
    seconds = [{"plan": 0.01, "render": 0.3, "exchange": 0.05}, {"plan": 0.01, "render": 0.25, "exchange": 0.08}]
    ranks = [{"seconds": one, "samples": 1e6, "bricks_drawn": 8, "bytes_sent": 2**20} for one in seconds]
    message = {"type": "statistics", "total_seconds": 0.4, "stages": ["plan", "render", "exchange"], "per_rank": ranks}
    panels.tell({**message, "imbalance": 1.2, "boxes": []})
    for rank in range(2):
        bar = opened.locator(f".bar[data-rank='{rank}']")
        widths = bar.locator(".track span").evaluate_all("parts => parts.map((part) => part.offsetWidth)")
        assert float(bar.get_attribute("data-seconds")) == pytest.approx(0.4)
        assert sum(widths) == pytest.approx(bar.locator(".track").evaluate("track => track.offsetWidth"), abs=4)
        assert widths[1] / sum(widths) == pytest.approx(seconds[rank]["render"] / 0.4, abs=0.02)
    assert "1 MiB" in opened.locator("tbody").inner_text()


def test_measured_choices(panels: Panels) -> None:
    panels.start()
    opened = panels.open("quality")
    choices = [{"value": 0.5, "seconds": 0.2, "error": 0.004}, {"value": 1.0, "seconds": 0.1, "error": 0.02}]
    panels.tell({"type": "knobs", "items": [{"key": "quality.step", "value": 1.0, "choices": choices}]})
    opened.get_by_role("button", name="0.5 200 ms 1/255").click()
    assert panels.change() == {"quality.step": 0.5}


def test_files_and_key_frames(panels: Panels) -> None:
    panels.start()
    opened = panels.open("save")
    opened.get_by_role("button", name="Scene").click()
    (message,) = panels.sent()
    assert (message["type"], message["what"]) == ("save", "scene")
    header = {"kind": "file", "save": message["save"], "name": "scene.yaml", "media_type": "application/yaml"}
    with panels.page.expect_download() as download:
        panels.page.evaluate("([header, bytes]) => tellFile(header, bytes)", [header, list(b"volumes: []\n")])
    assert download.value.suggested_filename == "scene.yaml"
    assert Path(download.value.path()).read_bytes() == b"volumes: []\n"
    for _ in range(2):
        opened.get_by_role("button", name="Add this view").click()
    panels.sent()
    opened.get_by_role("button", name="Save path").click()
    (message,) = panels.sent()
    assert [key["time"] for key in message["keys"]] == [0, 2]
