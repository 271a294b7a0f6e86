"""The notebook's widget: its module in a real Chromium, edits from Python, snapshots, and sessions that end."""

from __future__ import annotations

import base64
import json
import os
import queue
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import clusterviz
from clusterviz.data.given import given_scene
from clusterviz.errors import ClustervizError, InputError, SceneError
from clusterviz.viewer.bundle import bundled_modules
from clusterviz.viewer.local_session import LocalSession
from clusterviz.viewer.scene_client import changed_keys
from clusterviz.viewer.widget import Viewer

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

VOXELS = np.random.default_rng(0).random((12, 13, 14), np.float32)
SETTINGS: dict[str, Any] = {"size": (80, 60), "brick": 8, "cmap": "viridis", "opacity": "linear"}


@pytest.fixture
def widget() -> Iterator[Viewer]:
    viewer = Viewer(LocalSession(*given_scene(VOXELS, None, SETTINGS, "view")))
    yield viewer
    viewer.close()


FAKE_MODEL = """
async (source) => {
  const {default: widget} = await import(URL.createObjectURL(new Blob([source], {type: "text/javascript"})));
  const listeners = {};
  window.model = {
    get: (name) => ({height: 300})[name],
    on: (name, f) => { (listeners[name] ??= new Set()).add(f); },
    off: (name, f) => { listeners[name]?.delete(f); },
    send: (content) => window.toKernel(JSON.stringify(content)),
    tell: (content, buffer) => {
      const bytes = buffer && Uint8Array.from(atob(buffer), (letter) => letter.charCodeAt(0));
      for (const f of listeners["msg:custom"] ?? []) f(content, bytes ? [new DataView(bytes.buffer)] : []);
    },
    heard: () => listeners["msg:custom"].size,
  };
  window.show = () => {
    const el = document.body.appendChild(document.createElement("div"));
    const remove = widget.render({model: window.model, el});
    el.removeAttribute("style");  // as the layout of ipywidgets may do
    return () => { remove(); el.remove(); };
  };
}
"""


RULES_OUTSIDE = """(() => {
  const selectors = (rules) => [...rules].filter((rule) => !(rule instanceof CSSKeyframesRule)).flatMap(
    (rule) => [...(rule.selectorText ? [rule.selectorText] : []), ...selectors(rule.cssRules ?? [])],
  );
  const all = selectors(document.styleSheets[0].cssRules);
  return all.length > 50 ? all.filter((selector) => document.querySelector(selector)) : ["there are no rules"];
})()"""


class Notebook:
    """Page with views of a widget; the messages between them pass through here, in the test's thread."""

    def __init__(self, page: Page, widget: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
        self.page, self._widget = page, widget
        self._to_page: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._to_kernel: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.errors: list[str] = []
        monkeypatch.setattr(widget, "send", lambda content, buffers=None: self._to_page.put((content, buffers)))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", lambda text: self.errors.append(text.text) if text.type == "error" else None)
        page.expose_function("toKernel", lambda text: self._to_kernel.put(text))
        page.evaluate(FAKE_MODEL, widget._esm)
        page.add_style_tag(content=widget._css)

    def run_until(self, expression: str, seconds: float = 20.0) -> Any:
        """Exchange messages until an expression of the page is true; return its value."""
        end = time.monotonic() + seconds
        while not (value := self.page.evaluate(expression)):
            assert time.monotonic() < end, f"{expression}: not after {seconds} s; {self.errors}"
            self.page.wait_for_timeout(10)
            while not self._to_kernel.empty():
                self._widget._receive(json.loads(self._to_kernel.get()), [])
            while not self._to_page.empty():
                content, buffers = self._to_page.get()
                data = [base64.b64encode(each).decode() for each in buffers or []]
                self.page.evaluate("([content, buffer]) => window.model.tell(content, buffer)", [content, *data])
        return value


COLOURED = """[...document.querySelectorAll(".clusterviz canvas.picture")].every((canvas) => {
  const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  return data.some((red, i) => i % 4 === 0 && Math.abs(red - data[i + 1]) > 40);
})"""


CHANGES: list[tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = [
    ({"a": 1, "b": {"c": [1, 2]}}, {"a": 1, "b": {"c": [1, 2]}}, {}),
    ({"b": {"c": [1, 2], "d": 3}}, {"b": {"c": [1, 3]}}, {"b.c": [1, 3], "b.d": None}),
    ({"v": [{"a": 1}, {"a": 2}]}, {"v": [{"a": 1}, {"a": 3}]}, {"v.1.a": 3}),
    ({"v": [{"a": 1}]}, {"v": [{"a": 1}, {"a": 3}]}, {"v": [{"a": 1}, {"a": 3}]}),
    ({"v": [{"a": 1}]}, {}, {"v": None}),
    ({}, {"camera": {}}, {"camera": {}}),
]


@pytest.mark.parametrize(("before", "after", "changes"), CHANGES)
def test_changes_are_the_keys_that_differ(before: Any, after: Any, changes: Any) -> None:
    assert changed_keys(before, after) == changes


def test_modules_are_joined_in_the_order_of_their_imports(tmp_path: Path) -> None:
    (tmp_path / "a-b.js").write_text("export const one = 1;\nconst x = 2;\n")
    (tmp_path / "c.js").write_text(
        'import {\n  one as first,\n} from "./a-b.js";\nexport class C {}\nconst x = first;\n'
    )
    (tmp_path / "d.js").write_text(
        'import {C} from "./c.js";\nimport {one} from "./a-b.js";\nexport default {C, one};\n'
    )
    text = bundled_modules("d", tmp_path)
    assert [line for line in text.splitlines() if line] == [
        "const module_a_b = (() => {",
        "const one = 1;",
        "const x = 2;",
        "return {one};",
        "})();",
        "const module_c = (() => {",
        "const {",
        "  one: first,",
        "} = module_a_b;",
        "class C {}",
        "const x = first;",
        "return {C};",
        "})();",
        "const {C} = module_c;",
        "const {one} = module_a_b;",
        "export default {C, one};",
    ]


def test_view_needs_a_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        InputError, match="no notebook here; allowed a notebook; elsewhere the command `clusterviz view`"
    ):
        clusterviz.view(VOXELS)
    monkeypatch.setattr("clusterviz.viewer.notebook.is_notebook", lambda: True)
    with pytest.raises(InputError, match="view: ranks: not a number of ranks; found 0"):
        clusterviz.view(VOXELS, ranks=0)
    with pytest.raises(InputError, match="view: nothing to view; found int"):
        clusterviz.view(7)  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "anywidget", None)
    monkeypatch.delitem(sys.modules, "clusterviz.viewer.widget")
    with pytest.raises(ClustervizError, match=r"notebooks need anywidget: pip install '\.\[notebook\]' in a checkout"):
        clusterviz.view(VOXELS)


@pytest.mark.gl
def test_snapshots_are_what_render_makes(widget: Viewer) -> None:
    assert widget.scene.volumes[0].cmap == "viridis"
    found = [widget.snapshot()]
    widget.edit(clim=(0.2, 0.8), step=0.5)
    widget.edit(**{"volumes.0.shade": True})
    found.append(widget.snapshot())
    widget.camera = {"position": (40, 30, 20), "view_angle": 25}
    found.append(widget.snapshot((30, 40)))
    assert (widget.scene.volumes[0].clim, widget.scene.volumes[0].shade) == ((0.2, 0.8), True)
    assert widget.camera == widget.scene.camera.model_dump(mode="json", include=set(widget.camera))
    changed: dict[str, Any] = {**SETTINGS, "clim": (0.2, 0.8), "step": 0.5, "shade": True}
    moved = {**changed, "size": (30, 40), "camera": widget.scene.camera}
    assert widget.scene.camera.position == (40.0, 30.0, 20.0)
    for picture, settings in zip(found, (SETTINGS, changed, moved), strict=True):
        expected = clusterviz.render(VOXELS, **settings)
        assert expected is not None
        assert expected.max() > 0
        assert isinstance(picture, clusterviz.Image)
        assert picture.background == expected.background
        assert np.array_equal(picture, expected)


@pytest.mark.gl
def test_another_scene_is_shown_and_a_wrong_one_is_not(widget: Viewer) -> None:
    before, camera = widget.scene, widget.camera
    for settings in ({"clim": "wide"}, {"colour": "red"}, {"volumes.1.cmap": "hot"}):
        with pytest.raises(SceneError):
            widget.edit(**settings)
    for wrong in ({"azimuth": 3}, {"view_angle": -1}, {"position": camera["focal_point"]}):
        with pytest.raises(SceneError):
            widget.camera = wrong
    assert (widget.scene, widget.camera) == (before, camera)
    assert np.array_equal(widget.snapshot(), clusterviz.render(VOXELS, **SETTINGS))  # type: ignore[arg-type]
    other = clusterviz.Scene(volumes=[{"path": "field:gaussian:12", "opacity": 0.3}], automatic=True)  # type: ignore[list-item]
    scenes: list[Any] = []
    widget.observe(lambda change: scenes.append(change["new"]), "scene")
    widget.scene = other
    picture = widget.snapshot()
    assert widget.scene.volumes[0].opacity == 0.3
    began = time.monotonic()
    while widget.scene.image.size != (80, 60) and time.monotonic() - began < 20:
        widget.snapshot()  # without an event loop, traits follow with calls only
    assert widget.scene.image.size == (80, 60)
    assert scenes[0] is other
    widget.close()
    with pytest.raises(ClustervizError, match="it was closed"):
        widget.snapshot()
    assert np.array_equal(picture, clusterviz.render(VOXELS, opacity=0.3, size=(80, 60)))  # type: ignore[arg-type]


def ranks_of(folder: Path) -> list[int]:
    """Return the processes that show what lies in a folder."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            words = (process / "cmdline").read_bytes().split(b"\0")
            if os.path.basename(words[0]).startswith(b"python") and str(folder).encode() in b" ".join(words):
                found.append(int(process.name))
    return sorted(found)


@pytest.mark.fresh
@pytest.mark.gl
def test_ranks_draw_the_same_and_one_that_is_killed_ends_the_session(monkeypatch: pytest.MonkeyPatch) -> None:
    grid = clusterviz.Grid(VOXELS.shape, (1.0, 1.0, 2.0))
    monkeypatch.setattr("clusterviz.viewer.notebook.is_notebook", lambda: True)
    widget = clusterviz.view(VOXELS, grid=grid, ranks=3, **SETTINGS)
    folder = Path(widget.scene.volumes[0].path).parent
    try:
        widget.edit(clim=(0.1, 0.9))
        expected = clusterviz.render(VOXELS, grid=grid, **SETTINGS, clim=(0.1, 0.9))
        assert expected is not None
        assert np.abs(widget.snapshot() - expected).max() < 1e-6
        os.kill(ranks_of(folder)[-1], signal.SIGKILL)
        began = time.monotonic()
        with pytest.raises(ClustervizError, match="the job has ended"):
            widget.snapshot()
        assert time.monotonic() - began < 20
    finally:
        widget.close()
    assert not folder.exists()


@pytest.mark.browser
@pytest.mark.gl
def test_views_in_a_page_show_the_picture_and_leave(
    browser: Browser, widget: Viewer, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = browser.new_page(viewport={"width": 700, "height": 700})
    tags = "aside button canvas details dialog h1 input label main p select span summary svg table textarea"
    page.set_content("".join(f"<{tag}></{tag}>" for tag in tags.split()))
    notebook = Notebook(page, widget, monkeypatch)
    assert page.evaluate(RULES_OUTSIDE) == []
    page.set_content("<h1>Notebook</h1>")
    page.add_style_tag(content=widget._css)
    page.evaluate("window.first = window.show(); window.second = window.show(); 0")
    notebook.run_until(COLOURED)
    assert page.evaluate("window.model.heard()") == 2
    page.evaluate("window.first(); window.second(); 0")
    notebook.run_until("window.model.heard() === 0")
    notebook.run_until("true")
    page.close()
    assert notebook.errors == []
