"""The page of `clusterviz view` in a real Chromium: what a user does, what is sent, and what is shown."""

from __future__ import annotations

import io
import json
import struct
from base64 import b64decode
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from viewer.pages import wait_until

from clusterviz.content.complete import complete_scene
from clusterviz.scene import Scene, VolumeInfo
from clusterviz.scene.camera import project_points
from clusterviz.viewer.describe import Content
from clusterviz.viewer.server import Server, open_socket
from clusterviz.viewer.session import Job, Request, Session

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, WebSocketRoute

pytestmark = pytest.mark.browser
SIDE = 24
CORNERS = np.array(list(product((0.0, SIDE - 1.0), repeat=3)))
STATISTICS = {
    "total_seconds": 0.01, "stages": [], "per_rank": [], "imbalance": 1.0,
    "boxes": [{"rank": rank, "corners": (CORNERS * (1 / 3, 1, 1) + (rank * 8, 0, 0)).tolist()} for rank in range(3)],
}  # fmt: skip
STILL = """((v) => v?.picture?.still && v.picture.width === v.size.width && v.picture.height === v.size.height
    && !v.pendingView && !v.animation && !v.viewInput.active && v.picture.input >= v.input)(window.clustervizViewer)"""
VIEW = {"width": 840, "height": 420}


def draw(session: Session) -> None:
    """Draw what a session asks for in place of ranks: discs at the ends of the data's axes."""
    while not session.is_ended:
        request = session.next_request(0.2)
        if isinstance(request, Job):
            found = {"type": "picked", "pick": request.message.pick, "position": [4, 9, 20]}
            answer = found | {"index": [4.04, 9.0, 19.96], "value": 31.25, "name": "volumes.0"}
            session.answer(request.client, lambda client, answer=answer: client.send(answer))
        elif request is not None:
            session.finished(request, picture_of(request), 0.01, STATISTICS)


def picture_of(request: Request) -> NDArray[np.float32]:
    """Return float32 (h, w, 4), a half as wide and high while the view moves."""
    width, height = (side // (2 if request.moving else 1) for side in request.completed.image.size)
    picture = np.zeros((height, width, 4), np.float32)
    picture[..., 3] = 1
    rows, columns = np.ogrid[:height, :width]
    pixels, ahead = project_points(
        request.completed.camera, np.vstack([CORNERS[0], np.eye(3) * (SIDE - 1)]), (width, height)
    )
    for (x, y), depth, colour in zip(pixels, ahead, np.vstack([np.ones(3), np.eye(3)]), strict=True):
        if depth > 0:
            picture[(columns - x) ** 2 + (rows - y) ** 2 < (height / 25) ** 2, :3] = colour
    return picture


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Address of a live session of three ranks, which ends with the module."""
    info = VolumeInfo((SIDE,) * 3, (1.0,) * 3, CORNERS, 0.0, 100.0, 1.0, 99.0, orientation="RAS")
    volume = {"path": "ball.nii.gz", "cmap": "bone", "clim": [0, 100], "opacity": [[20, 0.0], [30, 0.6]]}
    scene = complete_scene(Scene.model_validate({"volumes": [volume]}), info)
    session = Session(scene, Content((info,)), ranks=3)
    server = Server(session, open_socket("127.0.0.1", 0), "secret")
    server.start()
    drawing = Thread(target=draw, args=(session,))
    drawing.start()
    yield f"http://127.0.0.1:{server.port}/?token=secret"
    session.close("the test has ended")
    server.close()
    drawing.join(10)


class Opened:
    """A page with what it has sent, what it has asked for, and what has gone wrong in it."""

    def __init__(self, page: Page) -> None:
        self.page, self.sent, self.pictures = page, list[dict[str, Any]](), list[bytes]()
        self.requests, self.complaints = list[str](), list[str]()
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on(
            "console", lambda each: self.complaints.append(each.text) if each.type in ("error", "warning") else None
        )
        page.on("websocket", self._listen)

    def _listen(self, websocket: Any) -> None:
        self.requests.append(websocket.url)
        websocket.on("framesent", lambda frame: self.sent.append(json.loads(frame)))
        websocket.on("framereceived", lambda frame: self.pictures.append(frame) if isinstance(frame, bytes) else None)

    def messages(self, kind: str) -> list[dict[str, Any]]:
        return [message for message in self.sent if message["type"] == kind]

    def value(self, expression: str) -> Any:
        """Return a property of the page's viewer."""
        return self.page.evaluate(f"clustervizViewer.{expression}")

    def wait(self, expression: str) -> Any:
        return wait_until(self.page, expression)

    def wait_still(self) -> dict[str, Any]:
        """Wait for the still picture that follows the newest input, and return its header."""
        self.wait(STILL)
        return self.value("picture")


@pytest.fixture
def open_page(browser: Browser, address: str, tmp_path: Path) -> Iterator[Callable[..., Opened]]:
    """Opens pages that show a still picture; at the end each must be without complaint. They are kept as pictures."""
    opened: list[Opened] = []

    def new_page(path: str = "", before: Callable[[Page], None] | None = None, **options: Any) -> Opened:
        page = browser.new_context(**{"viewport": VIEW, **options}).new_page()
        opened.append(Opened(page))
        if before:
            before(page)
        page.goto(address)
        opened[-1].wait(STILL)
        return opened[-1]

    yield new_page
    for number, each in enumerate(opened):
        each.page.screenshot(path=tmp_path / f"page{number}.png")
        each.value("send({type: 'reset'})")  # the session serves the next test too
        each.page.context.close()
    assert [each.complaints for each in opened] == [[] for _ in opened]


def drag(page: Page, start: tuple[float, float], step: tuple[float, float], steps: int = 6, **keys: Any) -> None:
    """Drag over the page in steps, each in a frame of its own."""
    page.mouse.move(*start)
    page.mouse.down(**keys)
    for n in range(1, steps + 1):
        page.mouse.move(start[0] + n * step[0], start[1] + n * step[1])
        page.wait_for_timeout(20)
    page.mouse.up(**keys)


def assert_same_camera(found: dict[str, Any], expected: dict[str, Any]) -> None:
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        assert found[key] == pytest.approx(value), key


def test_page_asks_nobody_else_and_shows_each_pixel_of_the_still_picture(open_page: Callable[..., Opened]) -> None:
    opened = open_page()
    host = urlsplit(opened.page.url).netloc
    assert {urlsplit(url).netloc for url in opened.requests} == {host}
    assert len(opened.requests) > 5
    assert "token" not in opened.page.url
    assert opened.page.title() == "clusterviz"
    opened.wait_still()
    data = next(data for data in reversed(opened.pictures) if b'"still":true' in data[:600])
    (length,) = struct.unpack_from("<I", data)
    expected = np.asarray(Image.open(io.BytesIO(data[4 + length :])).convert("RGB"))
    shown = opened.value("pictureCanvas.canvas.toDataURL('image/png')").partition(",")[2]
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(b64decode(shown))).convert("RGB")), expected)
    assert expected.std() > 10


def test_a_drag_orbits_and_pictures_follow(open_page: Callable[..., Opened]) -> None:
    opened = open_page()
    before = opened.value("camera")
    drag(opened.page, (250, 250), (12, 5))
    header = opened.wait_still()
    views = opened.messages("view")
    assert [view["moving"] for view in views] == [True] * (len(views) - 1) + [False]
    assert 3 < len(views) <= 8
    assert [view["input"] for view in views] == sorted({view["input"] for view in views})
    after = opened.value("camera")
    assert_same_camera(header["camera"], after)
    assert after["focal_point"] == pytest.approx(before["focal_point"])
    turned = np.subtract(after["position"], after["focal_point"])
    start = np.subtract(before["position"], before["focal_point"])
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(start))
    assert np.degrees(np.arccos(turned @ start / (start @ start))) > 10
    shown = {message["picture"] for message in opened.messages("ack")}
    assert len(shown) > 3
    moving = [data for data in opened.pictures if b'"still":false' in data[:600]]
    assert moving
    assert b'"format":"jpeg"' in moving[-1][:600]


DISTANCE = "Math.hypot(...[0, 1, 2].map((i) => v.camera.position[i] - v.camera.focal_point[i]))"
KEYS: list[tuple[str, str, str]] = [
    ("ArrowRight", "v.camera.position.join()", "changes"),
    ("Shift+ArrowUp", "v.camera.focal_point.join()", "changes"),
    ("+", DISTANCE, "falls"),
    ("-", DISTANCE, "rises"),
    ("o", "v.camera.parallel_scale", "changes"),
    ("3", "v.camera.position[0]", "falls"),
    ("x", "v.camera.position[0]", "rises"),
    ("Shift+X", "v.camera.position[0]", "falls"),
    ("4", "v.camera.position[0]", "rises"),
    ("+", "v.camera.parallel_scale", "falls"),
    ("r", "v.camera.parallel_scale", "rises"),
    ("f", "v.viewInput.flying", "changes"),
    ("w", "v.camera.focal_point[0]", "falls"),
    ("b", "v.element.className", "changes"),
    ("?", "v.help.open", "changes"),
]


def test_keys_do_what_the_help_says(open_page: Callable[..., Opened]) -> None:
    opened = open_page(reduced_motion="reduce")
    wrong = []
    for key, expression, expected in KEYS:
        read = f"((v) => {expression})(clustervizViewer)"
        before = opened.page.evaluate(read)
        opened.page.keyboard.press(key, delay=50)
        after = opened.page.evaluate(read)
        fine = {"changes": lambda a, b: a != b, "falls": lambda a, b: b < a, "rises": lambda a, b: b > a}[expected]
        if not fine(before, after):
            wrong.append((key, before, after))
    assert wrong == []
    opened.page.keyboard.press("Escape")
    opened.wait_still()


def test_views_are_named_by_the_files_directions_and_buttons_have_names(open_page: Callable[..., Opened]) -> None:
    opened = open_page()
    opened.page.get_by_label("Views").click()
    names = opened.page.locator(".menu button").all_inner_texts()
    assert names == ["Anterior", "Posterior", "Left", "Right", "Superior", "Inferior"]
    opened.page.get_by_role("button", name="Superior").click()
    header = opened.wait_still()
    toward = np.subtract(header["camera"]["position"], header["camera"]["focal_point"])
    assert np.argmax(np.abs(toward)) == 2
    assert toward[2] > 0
    views = opened.messages("view")
    assert views[-1]["moving"] is False
    assert len(views) > 4
    unnamed = opened.page.evaluate(
        """() => [...document.querySelectorAll("button, summary, [tabindex='0']")].filter(
        (each) => !(each.ariaLabel || each.textContent.trim() || each.title)).map((each) => each.outerHTML)"""
    )
    assert unnamed == []


def test_undo_takes_back_an_edit_and_an_invalid_one_is_told_of(open_page: Callable[..., Opened]) -> None:
    opened = open_page()
    state = "clustervizViewer.state.scene.volumes[0].shade"
    assert opened.page.evaluate(state) is False
    opened.value("edit({'volumes.0.shade': true})")
    opened.wait(state)
    opened.page.keyboard.press("Control+z")
    opened.wait(f"!{state}")
    opened.page.keyboard.press("Control+y")
    opened.wait(state)
    opened.value("edit({'volumes.0.clim': [3, 3, 3]})")
    toast = opened.page.locator(".toast")
    toast.wait_for()
    assert "volumes.0.clim" in toast.inner_text()
    assert opened.page.evaluate("clustervizViewer.state.scene.volumes[0].clim") == [0, 100]


def test_a_click_picks_and_a_double_click_centres(open_page: Callable[..., Opened]) -> None:
    opened = open_page()
    area = opened.value("surface.getBoundingClientRect().toJSON()")
    opened.page.mouse.click(area["width"] / 4, area["height"] / 2)
    text = opened.wait("clustervizViewer.picked?.text")
    assert text.splitlines() == ["ball.nii.gz: 31.25", "(4, 9, 20)", "index 4, 9, 20"]
    pick = opened.messages("pick")[0]
    assert (pick["x"], pick["y"]) == pytest.approx((0.25, 0.5))
    before = opened.value("camera")
    opened.page.mouse.dblclick(area["width"] / 2, area["height"] / 2)
    opened.wait("clustervizViewer.camera.focal_point[2] === 20")
    after = opened.wait_still()["camera"]
    assert after["focal_point"] == [4, 9, 20]
    eye = np.subtract(before["position"], before["focal_point"])
    assert np.subtract(after["position"], after["focal_point"]) == pytest.approx(eye)


def test_fingers_orbit_pan_zoom_roll_and_centre(open_page: Callable[..., Opened]) -> None:
    opened = open_page(has_touch=True)
    touch = opened.page.context.new_cdp_session(opened.page)

    def move(*paths: tuple[tuple[float, float], tuple[float, float]]) -> dict[str, Any]:
        """Move fingers from where to where; return the camera."""
        before = opened.value("input")
        for n in range(6):
            points = [{"x": a[0] + (b[0] - a[0]) * n / 5, "y": a[1] + (b[1] - a[1]) * n / 5} for a, b in paths]
            kind = "touchMove" if n else "touchStart"
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
            opened.page.wait_for_timeout(20)
        touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        opened.wait(f"clustervizViewer.input > {before}")
        return opened.wait_still()["camera"]

    start = opened.value("camera")
    orbited = move(((200, 200), (300, 200)))
    assert orbited["focal_point"] == pytest.approx(start["focal_point"])
    assert orbited["position"] != pytest.approx(start["position"], rel=0.05)
    panned = move(((200, 200), (260, 200)), ((300, 200), (360, 200)))
    assert np.linalg.norm(np.subtract(panned["focal_point"], orbited["focal_point"])) > 1
    pinched = move(((250, 200), (150, 200)), ((300, 200), (400, 200)))
    far, near = (np.linalg.norm(np.subtract(each["position"], each["focal_point"])) for each in (panned, pinched))
    assert near == pytest.approx(far / 5, rel=0.05)
    turned = move(((200, 250), (300, 150)), ((400, 250), (300, 350)))
    for _ in range(2):
        opened.page.touchscreen.tap(250, 200)
    opened.wait("clustervizViewer.camera.focal_point[2] === 20")
    up, down = (np.array(each["view_up"]) for each in (turned, pinched))
    assert np.degrees(np.arccos(up @ down)) == pytest.approx(90, abs=5)


def test_a_handle_of_the_clip_box_is_dragged_in_one_step_of_undo(open_page: Callable[..., Opened]) -> None:
    opened = open_page()
    opened.value("edit({'clip.box': [0, 23, 0, 23, 0, 23]})")
    opened.page.keyboard.press("5")
    opened.wait_still()
    before = opened.wait("clustervizViewer.state.scene.clip.box")
    handle = opened.page.evaluate(
        """() => { const overlay = clustervizViewer.overlayCanvas;
        const handle = overlay.handles().find((each) => each.name === "box 1");
        return overlay.project(handle.point).slice(0, 2).map((value) => value / overlay.unit); }"""
    )
    drag(opened.page, tuple(handle), (-14, 0))
    opened.wait("clustervizViewer.state.scene.clip.box[1] < 20")
    opened.wait_still()
    after = opened.value("state.scene.clip.box")
    edits = [edit for edit in opened.messages("edit") if "merge" in edit]
    assert after[0] == before[0]
    assert after[2:] == before[2:]
    assert [edit["moving"] for edit in edits] == [True] * (len(edits) - 1) + [False]
    assert len({edit["merge"] for edit in edits}) == 1
    assert opened.messages("view")[-1]["input"] < edits[0]["input"]
    opened.page.keyboard.press("Control+z")
    opened.wait(f"clustervizViewer.state.scene.clip.box[1] === {before[1]}")


def test_the_picture_follows_the_window_but_never_to_zero(open_page: Callable[..., Opened]) -> None:
    opened = open_page(device_scale_factor=2)
    opened.page.set_viewport_size({"width": 800, "height": 300})
    opened.wait("clustervizViewer.size.height === 600")
    header = opened.wait_still()
    width = opened.value("surface.clientWidth")
    assert (header["width"], header["height"]) == (2 * width, 600)
    sizes = len(opened.messages("size"))
    opened.value("element.hidden = true")
    opened.page.wait_for_timeout(300)
    opened.value("element.hidden = false")
    assert len(opened.messages("size")) <= sizes + 1
    assert all(size["width"] > 100 and size["height"] > 100 for size in opened.messages("size"))


def test_a_second_browser_watches_asks_and_steers(open_page: Callable[..., Opened]) -> None:
    first, second = open_page(), open_page()
    second.page.get_by_role("button", name="Ask to steer").wait_for()
    drag(second.page, (250, 250), (10, 0))
    second.page.locator(".toast").wait_for()
    assert second.messages("view") == []
    drag(first.page, (250, 250), (10, 0))
    header = first.wait_still()
    second.wait(f"clustervizViewer.picture.picture >= {header['picture']}")
    assert_same_camera(second.value("camera"), first.value("camera"))
    second.page.get_by_role("button", name="Ask to steer").click()
    first.page.get_by_role("button", name="Let them steer").click()
    second.wait("clustervizViewer.steers")
    drag(second.page, (250, 250), (0, 8))
    second.wait_still()
    assert len(second.messages("view")) > 1
    first.page.get_by_role("button", name="Ask to steer").wait_for()


def test_a_lost_connection_is_told_of_and_found_again(open_page: Callable[..., Opened]) -> None:
    routes: list[WebSocketRoute] = []
    refuse = False

    def connect(route: WebSocketRoute) -> None:
        if refuse:
            route.close(code=1012)
        else:
            route.connect_to_server()
            routes.append(route)

    opened = open_page(before=lambda page: page.route_web_socket("**/ws", connect))
    refuse = True
    routes[0].close(code=1012)
    banner = opened.page.locator(".banner.lost")
    banner.get_by_text("Attempt 2").wait_for()
    refuse = False
    opened.page.get_by_role("button", name="Connect now").click()
    banner.wait_for(state="hidden")
    opened.wait("clustervizViewer.status.connection === 'open'")
    opened.wait_still()
    drag(opened.page, (250, 250), (10, 0))
    opened.wait_still()
    routes[1].send(json.dumps({"type": "ended", "message": "rank 1 was killed"}))
    banner.get_by_text("The session has ended: rank 1 was killed").wait_for()


def test_panels_change_the_scene_and_show_why_a_value_is_refused(open_page: Callable[..., Opened]) -> None:
    opened = open_page(viewport={"width": 840, "height": 700})
    page, state = opened.page, "clustervizViewer.state"
    box = page.locator("[data-handle=point-1]").bounding_box()
    assert box
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 40, y + 20, steps=4)
    page.mouse.up()
    wait_until(page, f"{state}.input >= clustervizViewer.input")
    moved = opened.value("state.scene.volumes[0].opacity")
    assert moved[0] == [20, 0]
    assert moved[1][0] > 35
    assert moved[1][1] < 0.55
    page.get_by_role("button", name="Undo").click()
    wait_until(page, f"{state}.scene.volumes[0].opacity[1][0] === 30")
    page.locator("[data-panel=quality] summary").click()
    step = page.locator("[data-key='quality.step']")
    step.locator("input.number").fill("-1")
    page.keyboard.press("Enter")
    wait_until(page, "document.querySelector('[data-key=\"quality.step\"].invalid') !== null")
    assert "more than 0" in step.locator("+ .error-text").inner_text()
    assert opened.value("state.scene.quality.step") == 1
    step.locator("input.number").fill("2")
    page.keyboard.press("Enter")
    wait_until(page, f"{state}.scene.quality.step === 2")
    assert page.locator(".invalid").count() == 0
