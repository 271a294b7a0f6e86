"""The browser's view beside PyVista and trame: frames a second, latency from input to pixels, time to full quality.

    python benchmarks/view_ratio.py --peer-python PYTHON_WITH_PYVISTA [--ranks 1,2,4] [--pictures FOLDER] [--json F]

A real Chromium, driven by Playwright, drags the mouse over both programs' pages, in turn, with the same volume (mni152,
resampled to 256³ samples of uint8), transfer function, camera and picture of 800 × 600 pixels. Nothing of either
program is asked: a script in the page looks at the picture that is shown, once for each frame of the browser, and notes
when it changes. A latency is the time from the first `pointermove` event of a drag to the first change after it; before
it, nothing has changed for a second. The time to full quality is that from the release of the button to the last
change. The picture's own format and quality while moving are each program's defaults.
"""

from __future__ import annotations

import io
import json
import os
import signal
import socket
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from measuring import CLUSTERVIZ, Row, beside, options, sample, show, write
from measuring import opened as opened_volume
from PIL import Image
from playwright.sync_api import Page, sync_playwright

CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")
SIZE = (800, 600)
SIDE = 256
PEER = "PyVista and trame"
PAUSE_SECONDS, REST_SECONDS = 0.25, 1.0
# Notes when the picture changes: all large images and canvases are drawn into a small one, and its pixels compared.
PROBE = """() => {
  const small = document.createElement("canvas"); small.width = 64; small.height = 48;
  const context = small.getContext("2d", {willReadFrequently: true});
  const probe = window.__probe = {changes: [], moves: [], ups: [], last: 0};
  addEventListener("pointermove", () => probe.moves.push(performance.now()), true);
  addEventListener("pointerup", () => probe.ups.push(performance.now()), true);
  const shown = () => [...document.querySelectorAll("img, canvas")].filter(each => {
    const box = each.getBoundingClientRect();
    return box.width * box.height > 0.5 * innerWidth * innerHeight;
  });
  const look = () => {
    context.clearRect(0, 0, 64, 48);
    for (const each of shown()) { try { context.drawImage(each, 0, 0, 64, 48); } catch { /* not decoded yet */ } }
    const data = context.getImageData(0, 0, 64, 48).data;
    let sum = 0, uniform = true;
    for (let n = 0; n < data.length; n += 1) {
      sum = (Math.imul(sum, 31) + data[n]) | 0;
      uniform &&= data[n] === data[n % 4];
    }
    if (!uniform && sum !== probe.last) { probe.last = sum; probe.changes.push(performance.now()); }
    requestAnimationFrame(look);
  };
  look();
}"""


def head(path: Path) -> None:
    """Write mni152, resampled linearly to 256³ samples, as .npy."""
    samples = opened_volume(sample())[1].astype(np.float32)
    for axis, count in enumerate(samples.shape):
        at = np.linspace(0, count - 1, SIDE)
        first = np.minimum(at.astype(int), count - 2)
        share = (at - first).reshape([-1 if n == axis else 1 for n in range(3)]).astype(np.float32)
        samples = np.take(samples, first, axis) * (1 - share) + np.take(samples, first + 1, axis) * share
    np.save(path, np.rint(samples).astype(np.uint8))


def scene_of(volume: Path, shade: bool) -> dict[str, Any]:
    """The scene of `view_peer.py`."""
    centre = (SIDE - 1) / 2
    eye = [centre + share * SIDE for share in (1.3, 0.9, 1.6)]
    shown = {
        "path": str(volume),
        "cmap": [[0, 0.1, 0.2, 0.6], [255, 1.0, 0.9, 0.4]],
        "clim": [0, 255],
        "opacity": [[0, 0], [60, 0], [120, 0.05], [255, 0.3]],
        "opacity_unit_distance": 1.0,
        "shade": shade,
    }
    camera = {"position": eye, "focal_point": [centre] * 3, "view_up": [0, 1, 0]}
    return {"volumes": [shown], "camera": camera, "image": {"size": list(SIZE), "background": "black"}}


@contextmanager
def served(arguments: list[Any], url: str | None) -> Iterator[tuple[str, float]]:
    """Start a server; give its address and the time of its start. None: it prints the address."""
    began = time.perf_counter()
    output = subprocess.PIPE if url is None else subprocess.DEVNULL
    process = subprocess.Popen(
        list(map(str, arguments)), stdout=output, stderr=subprocess.DEVNULL, text=True, start_new_session=True
    )
    try:
        while url is None:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line, f"{arguments} ended"
            url = next((word for word in line.split() if word.startswith("http://")), None)
        yield url, began
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def opened(page: Page, url: str) -> None:
    """Open a page as soon as it is served, with the probe, and wait for its first picture."""
    deadline = time.perf_counter() + 120
    while True:
        try:
            page.goto(url)
            break
        except Exception:
            if time.perf_counter() > deadline:
                raise
            time.sleep(0.05)
    page.evaluate(PROBE)


def quiet(page: Page, seconds: float = PAUSE_SECONDS, longest: float = 120) -> None:
    """Wait until the picture has not changed for some seconds."""
    script = "s => window.__probe.changes.length > 0 && performance.now() - window.__probe.changes.at(-1) > 1000 * s"
    page.wait_for_function(script, arg=seconds, timeout=1000 * longest, polling=20)


def noted(page: Page, name: str) -> list[float]:
    """Return the times, seconds, of what the probe has noted."""
    return [at / 1000 for at in page.evaluate("name => window.__probe[name]", name)]


def shown(page: Page) -> list[float]:
    """Return where the picture is in the page: x, y, width and height."""
    script = """() => [...document.querySelectorAll("img, canvas")].map(e => e.getBoundingClientRect())
      .sort((a, b) => b.width * b.height - a.width * a.height).map(b => [b.x, b.y, b.width, b.height])[0]"""
    return list(page.evaluate(script))


def centre_of(page: Page) -> tuple[float, float]:
    x, y, width, height = shown(page)
    return x + width / 2, y + height / 2


def fitted(page: Page) -> list[float]:
    """Resize the window so that the picture has its size; return what it got."""
    for _ in range(2):
        _, _, width, height = shown(page)
        window = page.viewport_size
        assert window is not None
        sides = round(window["width"] + SIZE[0] - width), round(window["height"] + SIZE[1] - height)
        page.set_viewport_size({"width": sides[0], "height": sides[1]})
        page.wait_for_timeout(500)
    return shown(page)[2:]


def orbited(page: Page, seconds: float) -> dict[str, float]:
    """Drag in circles; return frames a second, and seconds from the release to the last change."""
    x, y = centre_of(page)
    page.mouse.move(x + 100, y)
    page.mouse.down()
    began = time.perf_counter()
    while (elapsed := time.perf_counter() - began) < seconds:
        page.mouse.move(x + 100 * np.cos(2 * elapsed), y + 100 * np.sin(2 * elapsed))
        time.sleep(0.008)
    page.mouse.up()
    quiet(page, 2.0)
    changes, moves, up = noted(page, "changes"), noted(page, "moves"), noted(page, "ups")[-1]
    # The first second may still adapt.
    within = [at for at in changes if up - seconds + 1 <= at <= up]
    gaps = np.diff(within) if len(within) > 1 else np.array([seconds])
    after = [at for at in changes if at > up]
    return {
        "frames_per_second": len(within) / (seconds - 1),
        "longest_gap_s": float(gaps.max()),
        "moves_per_second": len([at for at in moves if up - seconds + 1 <= at <= up]) / (seconds - 1),
        "to_full_quality_s": after[-1] - up if after else 0.0,
    }


def latencies(page: Page, count: int) -> list[float]:
    """Begin to drag, again and again; return the seconds from the first event to the first change after it."""
    x, y = centre_of(page)
    found = []
    for n in range(count):
        page.mouse.move(x, y)
        quiet(page, REST_SECONDS)
        before, moves = len(noted(page, "changes")), len(noted(page, "moves"))
        page.mouse.down()
        sign = 1 - 2 * (n % 2)
        for step in range(1, 5):
            page.mouse.move(x + 12 * sign * step, y + 5 * step)
        script = "count => window.__probe.changes.length > count"
        page.wait_for_function(script, arg=before, timeout=120000, polling=10)
        page.mouse.up()
        moved = noted(page, "moves")[moves]
        found.append(next(at for at in noted(page, "changes") if at > moved) - moved)
    return found


def measured(page: Page, url: str, began: float, seconds: float, count: int) -> tuple[dict[str, Any], bytes]:
    """Measure one program; return the numbers and the last picture, PNG."""
    opened(page, url)
    page.wait_for_function("() => window.__probe.changes.length > 0", timeout=120000, polling=10)
    first = time.perf_counter() - began
    quiet(page, 2.0)
    size = fitted(page)
    quiet(page, 2.0)
    turning = orbited(page, seconds)
    each = latencies(page, count)
    numbers = {
        "size": size,
        "first_picture_s": first,
        **turning,
        "latency_median_s": statistics.median(each),
        "latency_95_s": float(np.quantile(each, 0.95)),
    }
    return numbers, page.screenshot()


def main() -> None:
    asked = options(
        __doc__,
        peer_python={"help": "a Python with pyvista and trame; without it ours alone is measured"},
        ranks={"default": "1", "help": "of ours, as in 1,2,4"},
        shade=False,
        rounds=2,
        seconds={"type": float, "default": 8, "help": "of each drag"},
        moves={"type": int, "default": 40, "help": "whose latency is measured"},
        pictures={"type": Path, "help": "a folder for screenshots"},
    )
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        volume, scene = Path(folder) / "head.npy", Path(folder) / "scene.json"
        head(volume)
        scene.write_text(json.dumps(scene_of(volume, asked.shade)))
        programs: dict[str, tuple[list[Any], str | None]] = {
            f"clusterviz, {ranks} rank{'s' * (ranks != '1')}": (
                [*CLUSTERVIZ, "view", scene, "--ranks", ranks, "--port", free_port()],
                None,
            )
            for ranks in asked.ranks.split(",")
        }
        if asked.peer_python:
            peer, shade = beside("view_peer.py"), str(asked.shade).lower()
            for mapper in ("smart", "fixed_point"):
                port = free_port()
                arguments = [asked.peer_python, peer, volume, port, shade, mapper]
                programs[f"{PEER}, {mapper}"] = arguments, f"http://127.0.0.1:{port}"
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        for number in range(asked.rounds):
            for name, (arguments, url) in programs.items():
                page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]}, bypass_csp=True)
                with served(arguments, url) as (address, began):
                    numbers, picture = measured(page, address, began, asked.seconds, asked.moves)
                page.close()
                rows.append({"program": name, "round": number, **numbers, "load": os.getloadavg()[0]})
                print(json.dumps(rows[-1]), flush=True)
                if asked.pictures:
                    Image.open(io.BytesIO(picture)).save(asked.pictures / f"{name.replace(', ', '-')}.png")
        browser.close()
    write(asked, rows=rows, medians=report(rows))


def report(rows: list[Row]) -> list[Row]:
    """Print medians over the rounds, and over those of the peer's mapper that gives more frames."""
    keys = ("frames_per_second", "latency_median_s", "latency_95_s", "to_full_quality_s", "first_picture_s")
    found = []
    for name in dict.fromkeys(row["program"] for row in rows):
        mine = [row for row in rows if row["program"] == name]
        found.append({"program": name, **{key: statistics.median(row[key] for row in mine) for key in keys}})
    peer = max((row for row in found if row["program"].startswith(PEER)), key=lambda row: row[keys[0]], default=None)
    for row in found if peer else []:
        row |= {"frames": row[keys[0]] / peer[keys[0]], "latency": row[keys[1]] / peer[keys[1]]}
    head = "program | frames/s | latency, ms | 95 %, ms | quality, s | first, s | frames over peer's | latency over it"
    cells = "{program} | {frames_per_second:.1f} | {latency_median_s!m:.0f} | {latency_95_s!m:.0f} | "
    cells += "{to_full_quality_s:.2f} | {first_picture_s:.2f} | {frames:.1f} | {latency:.2f}"
    return show(head, cells, found)


if __name__ == "__main__":
    main()
